//! Our method's departures from the paper, one by one: the settings in which the default differs from the paper as printed.

use ffgs_pipeline::settings::config::Config;
use serde_json::Value;

/// In a name of our method before the settings that are as printed.
pub(super) const WITHOUT: &str = "without:";

/// Settings that mean nothing without each other.
const TOGETHER: [&[&str]; 5] = [
    &["dynamic.iterations", "dynamic.natural_step"],
    &["marking.slack", "marking.slack_share", "marking.validation_share"],
    &["triangulation.collinear_degrees", "triangulation.collinear_min_sigma"],
    &["triangulation.depth_weighting", "triangulation.refine"],
    &["fusion.q_floor_px", "fusion.structure"],
];

/// The settings of every departure, as keys like `fusion.structure`. All methods of a comparison share the first frame, so its training has none.
pub(super) fn all() -> Vec<Vec<String>> {
    let [ours, printed] = [Config::default(), Config::word_for_word()].map(|config| leaves(&config));
    let pairs = ours.into_iter().zip(printed).filter(|(ours, printed)| ours != printed);
    let keys: Vec<String> =
        pairs.map(|((key, _), _)| key).filter(|key| !key.starts_with("first_frame.")).collect();
    let group = |key: &String| TOGETHER.iter().position(|keys| keys.contains(&key.as_str()));
    let mut out: Vec<Vec<String>> = Vec::new();
    for key in keys {
        match out.iter_mut().find(|before| group(&key).is_some_and(|own| group(&before[0]) == Some(own))) {
            Some(before) => before.push(key),
            None => out.push(vec![key]),
        }
    }
    out
}

/// The default with the settings `keys`, joined by `+`, as printed in the paper.
///
/// # Errors
/// A text for people, when one of them is no departure.
pub(super) fn without(keys: &str) -> Result<Config, String> {
    let printed = tree(&Config::word_for_word());
    let mut config = tree(&Config::default());
    for key in keys.split('+') {
        let pointer = format!("/{}", key.replace('.', "/"));
        let (Some(place), Some(value)) = (config.pointer_mut(&pointer), printed.pointer(&pointer)) else {
            return Err(format!("'{WITHOUT}{keys}': there is no setting {key}"));
        };
        if place == value {
            return Err(format!("'{WITHOUT}{keys}': {key} is as printed"));
        }
        *place = value.clone();
    }
    serde_json::from_value(config).map_err(|error| format!("'{WITHOUT}{keys}': {error}"))
}

/// A configuration always has this form.
fn tree(config: &Config) -> Value {
    serde_json::to_value(config).unwrap_or_default()
}

/// Every setting with its key, in one order for all configurations.
fn leaves(config: &Config) -> Vec<(String, Value)> {
    fn walk(key: &str, value: Value, out: &mut Vec<(String, Value)>) {
        match value {
            Value::Object(map) => {
                for (name, value) in map {
                    walk(&if key.is_empty() { name } else { format!("{key}.{name}") }, value, out);
                }
            }
            value => out.push((key.to_owned(), value)),
        }
    }
    let mut out = Vec::new();
    walk("", tree(config), &mut out);
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn all_departures_together_are_the_paper_word_for_word() {
        let keys = all();
        assert!(
            keys.contains(&vec!["fusion.q_floor_px".to_owned(), "fusion.structure".to_owned()]),
            "{keys:?}"
        );
        let found = without(&keys.concat().join("+")).unwrap();
        let Config { first_frame, .. } = Config::default();
        assert_eq!(found, Config { first_frame, ..Config::word_for_word() });
        for keys in keys {
            let config = without(&keys.join("+")).unwrap();
            assert_ne!(config, Config::default());
            config.validate().unwrap();
        }
    }

    #[test]
    fn what_is_no_departure_is_refused() {
        assert!(without("dynamic.quat_rate").unwrap_err().contains("is as printed"));
        assert!(without("dynamic.iterashuns").unwrap_err().contains("no setting dynamic.iterashuns"));
    }
}
