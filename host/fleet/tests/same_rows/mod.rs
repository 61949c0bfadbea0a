//! Answers compared row by row.

use serde_json::Value;

/// Asserts that two answers are equal, but for the order in which numbers were added up: fractions may differ by `most_off` of the expected.
pub fn assert_same(found: &Value, expected: &Value, most_off: fn(f64) -> f64, what: &str) {
    match (found, expected) {
        (Value::Array(found), Value::Array(expected)) => {
            assert_eq!(found.len(), expected.len(), "{what}");
            for (row, (found, expected)) in found.iter().zip(expected).enumerate() {
                assert_same(found, expected, most_off, &format!("{what}, row {row}"));
            }
        }
        (Value::Object(found), Value::Object(expected)) => {
            assert!(found.keys().eq(expected.keys()), "{what}");
            for (column, value) in expected {
                let what = format!("{what}, {column}");
                assert_same(&found[column], value, most_off, &what);
            }
        }
        (Value::Number(found), Value::Number(expected)) if found.is_f64() && expected.is_f64() => {
            let (found, expected) = (found.as_f64().unwrap(), expected.as_f64().unwrap());
            assert!(
                (found - expected).abs() <= most_off(expected),
                "{what}: {found}, not {expected}"
            );
        }
        _ => assert_eq!(found, expected, "{what}"),
    }
}
