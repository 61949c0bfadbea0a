//! A check as a DFQ file of the Q-DAS ASCII transfer format: fields named `Kxxxx`, first of the part, then of every characteristic, then of
//! the values. Every value has a field of its own (`K0001/n`), because the short form by position has a place for each
//! characteristic, measured or not, and a reader that does not know which attribute means "not measured" takes what stands there for a value.

use std::fmt::Write;

use flankscope_record::history::FlankRow;

use super::{
    DECIMALS, ExportedCheck, SIMULATED, characteristic, designation, measured, millimetres,
    one_line,
};

/// The file's text; none of a check without a flank, since a part without characteristics is not to be transferred.
pub fn file(exported: &ExportedCheck) -> Option<String> {
    let check = &exported.check;
    if check.flanks.is_empty() {
        return None;
    }
    let origin = &check.origin;
    let mut fields = Fields(String::new());
    fields.add("K0100", check.flanks.len());
    fields.add("K1001", &check.tool);
    fields.add("K1002", &check.tool);
    fields.add_some("K1014", check.serial.as_deref());
    fields.add(
        "K1203",
        match origin.simulated {
            true => "simulated check of wear",
            false => "check of wear in the press",
        },
    );
    fields.add("K1206", &origin.station);
    fields.add_some("K1222", origin.operator.as_deref());
    // Fields that their user names.
    for (name, text, value) in [
        ("K1800", "check id", exported.id.clone()),
        ("K1810", "check number", check.id.to_string()),
        ("K1820", "tool cycles", check.tool_cycles.to_string()),
        ("K1830", "verdict", check.verdict.to_string()),
        ("K1840", "simulated", origin.simulated.to_string()),
    ] {
        fields.add(name, text);
        fields.add(&content_of(name), value);
    }
    let reason = one_line(&check.reason);
    fields.add(
        "K1900",
        match origin.simulated {
            true => format!("{SIMULATED}. {reason}"),
            false => reason,
        },
    );
    let numbered = || (1..).zip(&check.flanks);
    for (n, flank) in numbered() {
        describe(&mut fields, n, flank, &origin.head.name);
    }
    for (n, flank) in numbered() {
        if let Some(wear_um) = measured(flank) {
            fields.add_of("K0001", n, millimetres(wear_um));
            // Valid.
            fields.add_of("K0002", n, 0);
            fields.add_of("K0004", n, exported.at.strftime("%d.%m.%Y/%H:%M:%S"));
            let simulated = if origin.simulated { ", simulated" } else { "" };
            fields.add_of("K0009", n, format!("check {}{simulated}", exported.id));
            if let Some(serial) = &check.serial {
                fields.add_of("K0014", n, serial);
            }
        }
    }
    Some(fields.text())
}

/// The fields of a characteristic.
fn describe(fields: &mut Fields, n: usize, flank: &FlankRow, head: &str) {
    fields.add_of("K2001", n, designation(flank));
    fields.add_of("K2002", n, characteristic(flank));
    // A variable, not an attribute.
    fields.add_of("K2004", n, 0);
    fields.add_of("K2022", n, DECIMALS);
    fields.add_of("K2101", n, millimetres(0.0));
    fields.add_of("K2111", n, millimetres(flank.limit_um));
    // No limit below, a limit above.
    fields.add_of("K2120", n, 0);
    fields.add_of("K2121", n, 1);
    fields.add_of("K2142", n, "mm");
    fields.add_of("K2402", n, head);
    let u95_um = flank.u95_um.filter(|_| measured(flank).is_some());
    let code = flank.code.map(|code| format!(" ({})", code.word()));
    let verdict = format!("{}{}", flank.verdict, code.unwrap_or_default());
    for (name, text, value) in [
        ("K2800", "U95 in mm", u95_um.map(millimetres)),
        (
            "K2810",
            "warn limit in mm",
            Some(millimetres(flank.warn_um)),
        ),
        ("K2820", "verdict", Some(verdict)),
    ] {
        if let Some(value) = value {
            fields.add_of(name, n, text);
            fields.add_of(&content_of(name), n, value);
        }
    }
}

/// The field that holds the content of a field that its user names: two further.
fn content_of(name: &str) -> String {
    format!("{}2", &name[..name.len() - 1])
}

/// Lines of a file.
struct Fields(String);

impl Fields {
    fn add(&mut self, field: &str, value: impl ToString) {
        // Nothing fails in memory.
        let _ = write!(self.0, "{field} {}\r\n", one_line(&value.to_string()));
    }

    fn add_some(&mut self, field: &str, value: Option<&str>) {
        if let Some(value) = value {
            self.add(field, value);
        }
    }

    /// A field of the n-th characteristic.
    fn add_of(&mut self, field: &str, n: usize, value: impl ToString) {
        self.add(&format!("{field}/{n}"), value);
    }

    /// The file: plain ASCII if it can be, else UTF-8 that says so by its first character.
    fn text(self) -> String {
        match self.0.is_ascii() {
            true => self.0,
            false => format!("\u{feff}{}", self.0),
        }
    }
}
