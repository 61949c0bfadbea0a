//! Changes to what TOML and JSON hold: values, keys, types, entries.

use rand::RngExt;
use rand_pcg::Pcg64;
use serde_json::{Map, Number, Value};

/// `None`: it is no TOML any more.
pub fn toml(content: &[u8], random: &mut Pcg64) -> Option<Vec<u8>> {
    let table: toml::Table = std::str::from_utf8(content).ok()?.parse().ok()?;
    // Through JSON, which has no dates: none of our files has one that is not a string.
    let mut document = serde_json::to_value(table).ok()?;
    change(&mut document, random);
    let table: toml::Table = serde_json::from_value(document).ok()?;
    Some(table.to_string().into_bytes())
}

/// `None`: it is no JSON any more.
pub fn json(content: &[u8], random: &mut Pcg64) -> Option<Vec<u8>> {
    let mut document: Value = serde_json::from_slice(content).ok()?;
    change(&mut document, random);
    serde_json::to_vec(&document).ok()
}

/// Goes down to a random value and changes it, or stops on the way and changes what holds it.
fn change(value: &mut Value, random: &mut Pcg64) {
    let stop = random.random_range(0..5) == 0;
    match value {
        Value::Object(map) if !map.is_empty() && !stop => {
            let n = random.random_range(0..map.len());
            if let Some((_, inner)) = map.iter_mut().nth(n) {
                change(inner, random);
            }
        }
        Value::Array(list) if !list.is_empty() && !stop => {
            let n = random.random_range(0..list.len());
            change(&mut list[n], random);
        }
        Value::Object(map) => entries(map, random),
        Value::Array(list) => items(list, random),
        _ => *value = other(value, random),
    }
}

fn entries(map: &mut Map<String, Value>, random: &mut Pcg64) {
    let keys: Vec<String> = map.keys().cloned().collect();
    let Some(key) = keys.get(random.random_range(0..keys.len().max(1))) else {
        map.insert("x".into(), Value::from(1));
        return;
    };
    match random.random_range(0..4) {
        0 => {
            map.remove(key);
        }
        1 => {
            if let Some(value) = map.remove(key) {
                map.insert(format!("{key}_"), value);
            }
        }
        2 => {
            map.insert("unknown".into(), Value::from(1));
        }
        _ => {
            let value = other(&Value::Null, random);
            map.insert(key.clone(), value);
        }
    }
}

fn items(list: &mut Vec<Value>, random: &mut Pcg64) {
    let Some(last) = list.len().checked_sub(1) else {
        list.push(Value::from(0));
        return;
    };
    let (one, two) = (random.random_range(0..=last), random.random_range(0..=last));
    match random.random_range(0..5) {
        0 => {
            list.remove(one);
        }
        1 => list.push(list[one].clone()),
        2 => list.swap(one, two),
        3 => list.clear(),
        _ => list.truncate(one),
    }
}

/// Another value, often of another type.
fn other(old: &Value, random: &mut Pcg64) -> Value {
    let finite = |value: f64| Number::from_f64(value).map_or(Value::Null, Value::Number);
    if let (Some(value), true) = (old.as_f64(), random.random_bool(0.6)) {
        return match random.random_range(0..8) {
            0 => finite(-value),
            1 => finite(value * 1000.0),
            2 => finite(value / 1000.0),
            3 => finite(value * (1.0 + 1e-6)),
            4 => finite(0.0),
            5 => finite(1e300),
            6 => Value::from(value as i64),
            _ => Value::from(i64::MIN),
        };
    }
    match random.random_range(0..9) {
        0 => Value::Bool(random.random()),
        1 => Value::from(-1),
        2 => Value::from(u64::from(u32::MAX)),
        3 => Value::String(String::new()),
        4 => Value::String("../../../../etc/passwd".into()),
        5 => Value::String("\u{202e}x".repeat(2000)),
        6 => Value::Array(vec![old.clone(); 3]),
        7 => Value::Object(Map::from_iter([("x".into(), old.clone())])),
        _ => finite(f64::MIN_POSITIVE),
    }
}
