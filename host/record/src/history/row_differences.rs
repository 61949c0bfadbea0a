//! Compares the row of a check with its document: a change to one of them appears as a difference.

use serde::Serialize;
use serde_json::{Value, json};

use super::error::HistoryError;
use super::rows::Check;
use super::store::History;

/// A value that differs from the stored one.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Difference {
    /// Path in the document, for example `features.0.wear_um`.
    pub what: String,
    pub stored: Value,
    /// Present value.
    pub now: Value,
}

/// Columns of a check's row that differ from its document; both were written from the same result.
#[must_use]
pub fn row_differences(check: &Check, document: &Value) -> Vec<Difference> {
    let mut differences = Vec::new();
    let origin = &check.origin;
    let mut told = |what: String, row: Value, said: &Value| {
        if row != *said {
            differences.push(Difference {
                what: format!("column {what}"),
                stored: row,
                now: said.clone(),
            });
        }
    };
    for (what, row, said) in [
        ("verdict", json!(check.verdict), &document["verdict"]),
        ("reason", json!(check.reason), &document["reason"]),
        ("tool", json!(check.tool), &document["tool"]),
        ("serial", json!(check.serial), &document["die"]["serial"]),
        (
            "press_cycles",
            json!(check.press_cycles),
            &document["press_cycles"],
        ),
        (
            "baseline",
            json!(check.baseline),
            &document["hashes"]["baseline"],
        ),
        ("link", json!(origin.link), &document["link"]),
        ("simulated", json!(origin.simulated), &document["simulated"]),
        ("station", json!(origin.station), &document["station"]),
        ("operator", json!(origin.operator), &document["operator"]),
        ("head", json!(origin.head.name), &document["head"]["name"]),
        (
            "head_blake3",
            json!(origin.head.blake3),
            &document["head"]["blake3"],
        ),
        (
            "head_seal",
            json!(origin.head.seal),
            &document["head"]["seal"],
        ),
    ] {
        told(what.to_owned(), row, said);
    }
    let none = Vec::new();
    let features = document["features"].as_array().unwrap_or(&none);
    told(
        "flanks".into(),
        json!(check.flanks.len()),
        &json!(features.len()),
    );
    for flank in &check.flanks {
        let this = |f: &&Value| f["tooth"] == flank.id.tooth && f["flank"] == flank.id.flank.word();
        let feature = features.iter().find(this).unwrap_or(&Value::Null);
        for (key, row) in [
            ("wear_um", json!(flank.wear_um)),
            ("u95_um", json!(flank.u95_um)),
            ("warn_um", json!(flank.warn_um)),
            ("limit_um", json!(flank.limit_um)),
            ("verdict", json!(flank.verdict)),
            ("code", json!(flank.code)),
            ("patch", json!(flank.id.patch)),
        ] {
            let what = format!("{key} of {}", flank.id);
            told(what, row, &feature[key]);
        }
    }
    differences
}

impl History {
    /// Columns of a stored check's row that differ from its document.
    ///
    /// # Errors
    /// The check does not exist, or its document is not JSON.
    pub fn row_differences(&self, id: i64) -> Result<Vec<Difference>, HistoryError> {
        let text = self.document(id)?;
        let document =
            serde_json::from_str(&text).map_err(|source| HistoryError::Stored { id, source })?;
        Ok(row_differences(&self.check(id)?, &document))
    }
}
