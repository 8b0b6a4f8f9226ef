//! Damage of what a file means: of the values in a JSON file, and below a checksum.

use super::case::Case;
use super::damage::damage;
use serde_json::{Value, json};

/// Values that a field of a file may hold by mistake or malice.
pub(crate) fn odd_value(case: &mut Case) -> Value {
    let texts =
        ["", "../../../../escape", "/escape", "a\u{1b}]0;title\u{7}", "</script><script>", "con", "a/../b"];
    let numbers = [0.0, -1.0, 0.5, 1e300, -1e300, 1e-300, 4_294_967_296.0, 9.3e18];
    match case.below(8) {
        0 => Value::Null,
        1 => json!(true),
        2 => json!(case.one_of(&texts)),
        3 => json!([]),
        4 => json!({}),
        5 => json!("x".repeat(1 << case.below(17))),
        6 => json!(case.random.next()),
        _ => json!(case.one_of(&numbers)),
    }
}

/// Replaces a random value, wherever it stands, by an odd one; sometimes a branch is left out or doubled.
pub(crate) fn distort(case: &mut Case, value: &mut Value) {
    let descend = case.below(6) > 0;
    match value {
        Value::Array(items) if descend && !items.is_empty() => {
            let at = case.below(items.len());
            match case.below(12) {
                0 => drop(items.remove(at)),
                1 => items.push(items[at].clone()),
                _ => distort(case, &mut items[at]),
            }
        }
        Value::Object(map) if descend && !map.is_empty() => {
            let key = map.keys().nth(case.below(map.len())).cloned().unwrap_or_default();
            match case.below(12) {
                0 => drop(map.remove(&key)),
                _ => map.get_mut(&key).into_iter().for_each(|inner| distort(case, inner)),
            }
        }
        leaf => *leaf = odd_value(case),
    }
}

/// Damage of a file by its kind: half of the JSON files keep their form and change their meaning.
pub(crate) fn damage_file(case: &mut Case, is_json: bool, bytes: &mut Vec<u8>) {
    let parsed =
        if is_json && case.below(3) > 0 { serde_json::from_slice::<Value>(bytes).ok() } else { None };
    match parsed {
        Some(mut value) => {
            distort(case, &mut value);
            *bytes = value.to_string().into_bytes();
        }
        None => damage(&mut case.random, bytes),
    }
}
