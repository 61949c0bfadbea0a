//! A document is accepted only if each of its values is as signed.

use serde_json::json;

use super::*;

fn seals(folder: &tempfile::TempDir, name: &str) -> Seals {
    Seals::open(&folder.path().join(name)).unwrap()
}

/// Paths of all values of a document.
fn leaves(value: &Value, at: &str, found: &mut Vec<String>) {
    match value {
        Value::Object(map) => map
            .iter()
            .for_each(|(key, value)| leaves(value, &format!("{at}/{key}"), found)),
        Value::Array(all) => (0..)
            .zip(all)
            .for_each(|(key, value): (usize, _)| leaves(value, &format!("{at}/{key}"), found)),
        _ => found.push(at.to_owned()),
    }
}

#[test]
fn any_value_that_is_changed_or_taken_off_is_seen() {
    let folder = tempfile::tempdir().unwrap();
    let seals = seals(&folder, "own");
    let mut document = json!({
        "name": "die", "ok": true, "nothing": null, "limits": [1.5, -0.0, 1e-300, 7],
        "deep": { "wear_mm": [[0.1, 0.2], [0.3, null]], "count": u64::MAX },
    });
    let seal = seals.seal(Kind::Baseline, &document).unwrap();
    document[Seal::KEY] = serde_json::to_value(&seal).unwrap();
    let path = Path::new("baseline.json");
    let believed = |document: &Value| seals.believe(Kind::Baseline, path, document).is_ok();
    // Written, read and signed again, the seal is the same.
    let text = serde_json::to_string_pretty(&document).unwrap();
    assert!(believed(&serde_json::from_str(&text).unwrap()));
    let mut places = Vec::new();
    leaves(&document, "", &mut places);
    assert_eq!(places.len(), 14);
    let mut tampered = 0;
    for place in &places {
        for value in [json!(0.25), json!("x"), json!(null), json!([])] {
            let mut changed = document.clone();
            let at = changed.pointer_mut(place).unwrap();
            if *at == value {
                continue;
            }
            *at = value;
            assert!(!believed(&changed), "{place}");
            tampered += 1;
        }
    }
    assert!(tampered > 50, "{tampered}");
    for key in ["name", "nothing", "deep", Seal::KEY] {
        let mut changed = document.clone();
        changed.as_object_mut().unwrap().remove(key);
        assert!(!believed(&changed), "without {key}");
    }
    let mut more = document.clone();
    more["more"] = json!(1);
    assert!(!believed(&more));
    // As another kind of file it is not accepted.
    assert!(seals.believe(Kind::Scan, path, &document).is_err());
}

#[test]
fn another_stations_word_counts_once_somebody_says_so_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let (own, other) = (seals(&folder, "own"), seals(&folder, "other"));
    let path = Path::new("baseline.json");
    let mut document = json!({ "name": "die", "wear_um": 80.0 });
    let unsigned = document.clone();
    document[Seal::KEY] = json!(other.seal(Kind::Baseline, &document).unwrap());
    let error = own.believe(Kind::Baseline, path, &document).unwrap_err();
    let said = error.to_string();
    assert!(
        said.contains(&other.station()) && said.contains("flankscope trust baseline.json"),
        "{said}"
    );
    own.trust(Kind::Baseline, path, &document, "Ada").unwrap();
    let by_ada = Standing::Trusted { by: "Ada".into() };
    for document in [&document, &unsigned] {
        assert_eq!(own.standing(Kind::Baseline, document).unwrap(), by_ada);
    }
    // Trust covers the content at that time only.
    document["wear_um"] = json!(8.0);
    assert!(own.believe(Kind::Baseline, path, &document).is_err());
    assert_eq!(own.all_trusted().unwrap().len(), 1);
}

/// A head file from a vendor, without a calibration, and one with a calibration.
#[test]
fn a_head_that_claims_a_calibration_is_signed_and_one_that_claims_nothing_need_not_be() {
    let folder = tempfile::tempdir().unwrap();
    let seals = seals(&folder, "own");
    let path = folder.path().join("head.toml");
    let text = "name = \"ours\"\nfocal_px = [1.5, 2.5]\n[calibration]\nexpires = \"2026-07-30\"\ndepth_sigma_um = 0.9\n";
    let head = |text: &str, calibrated: bool| {
        std::fs::write(&path, text).unwrap();
        seals.head(&path, calibrated)
    };
    let drawing = text.split("[calibration]").next().unwrap();
    assert_eq!(head(drawing, false).unwrap(), Standing::Unsigned);
    assert!(head(text, true).is_err());
    seals.seal_toml(Kind::Head, &path).unwrap();
    let sealed = std::fs::read_to_string(&path).unwrap();
    assert_eq!(head(&sealed, true).unwrap(), Standing::Signed);
    // Comments and spaces may change, because they are not values.
    let remarked = format!("# ours\n{}", sealed.replace(" = ", "  = "));
    assert_eq!(head(&remarked, true).unwrap(), Standing::Signed);
    for (from, to) in [
        ("2026-07-30", "2036-07-30"),
        ("0.9", "0.1"),
        ("1.5", "1.6"),
        ("ours", "mine"),
    ] {
        assert!(head(&sealed.replace(from, to), true).is_err(), "{to}");
    }
    // Removing both the seal and the calibration does not help: this station signed a head at this path.
    let error = head(drawing, false).unwrap_err().to_string();
    assert!(error.contains("carries no digest"), "{error}");
    // The self-test beside it is checked in the same way.
    std::fs::write(&path, &sealed).unwrap();
    let test = flankscope_profilometry::head::SelfTest::path_of(&path);
    std::fs::write(&test, "due = \"2026-07-30\"\n").unwrap();
    assert!(seals.head(&path, true).is_err());
    seals.seal_toml(Kind::SelfTest, &test).unwrap();
    assert_eq!(seals.head(&path, true).unwrap(), Standing::Signed);
    let text = std::fs::read_to_string(&test).unwrap();
    std::fs::write(&test, text.replace("2026", "2036")).unwrap();
    assert!(seals.head(&path, true).is_err());
}
