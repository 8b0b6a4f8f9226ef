//! Times, counts of Gaussians that came and went and of what was skipped, and warnings of the stages of one frame, by name.

use serde::{Deserialize, Deserializer, Serialize};
use std::collections::BTreeMap;
use std::time::Instant;

/// Seconds by the name of a stage.
pub type Seconds = BTreeMap<String, f64>;

/// What the stages of one frame say beside their results: how long they took, which Gaussians came and went, what they left out,
/// what is odd.
///
/// Names are data: whoever reads a log goes through what is there. A stage is named once, where it is timed.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct StageLog {
    /// Seconds of each stage; those of a stage that ran several times are added.
    #[serde(deserialize_with = "known")]
    pub seconds: Seconds,
    /// What was left out and why, and how often.
    pub skips: BTreeMap<String, u64>,
    /// Gaussians that came, went or changed their layer, and why.
    pub changes: BTreeMap<String, u64>,
    /// Warnings.
    pub warnings: Vec<String>,
}

impl StageLog {
    /// Adds the time from `start` until now to a stage.
    pub fn since(&mut self, stage: &str, start: Instant) {
        self.add_seconds(stage, start.elapsed().as_secs_f64());
    }

    /// Adds seconds to a stage.
    pub fn add_seconds(&mut self, stage: &str, seconds: f64) {
        *self.seconds.entry(stage.to_owned()).or_default() += seconds;
    }

    /// Counts what was left out; a count of 0 leaves no entry.
    pub fn skip(&mut self, what: impl Into<String>, count: usize) {
        if count > 0 {
            *self.skips.entry(what.into()).or_default() += count as u64;
        }
    }

    /// Counts Gaussians that came, went or changed their layer; a count of 0 leaves no entry.
    pub fn change(&mut self, what: &str, count: usize) {
        if count > 0 {
            *self.changes.entry(what.to_owned()).or_default() += count as u64;
        }
    }

    /// Counts as `what` those Gaussians that were counted as `before` and turned out not to be; at most as many as there were.
    pub fn recount(&mut self, before: &str, what: &str, count: usize) {
        let moved = self.changes.get(before).map_or(0, |&all| all.min(count as u64));
        self.changes.entry(before.to_owned()).and_modify(|all| *all -= moved);
        self.changes.retain(|_, all| *all > 0);
        self.change(what, count);
    }

    /// Adds a warning.
    pub fn warn(&mut self, warning: impl Into<String>) {
        self.warnings.push(warning.into());
    }
}

/// A stage that did not run was once written as null.
fn known<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Seconds, D::Error> {
    let all = BTreeMap::<String, Option<f64>>::deserialize(deserializer)?;
    Ok(all.into_iter().filter_map(|(stage, seconds)| Some((stage, seconds?))).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn repeated_entries_are_added_and_nothing_is_not_counted() {
        let mut log = StageLog::default();
        log.since("fuse", Instant::now());
        log.add_seconds("fuse", 2.0);
        log.change("born", 0);
        log.change("faded", 4);
        log.change("faded", 1);
        log.change("removed", 9);
        log.recount("removed", "stopped", 7);
        log.recount("removed", "stopped", 2);
        log.recount("never", "stopped", 1);
        log.skip("empty", 0);
        log.skip("far", 2);
        log.skip("far", 1);
        assert!(log.seconds["fuse"] >= 2.0 && log.seconds.len() == 1);
        assert_eq!(log.changes, BTreeMap::from([("faded".to_owned(), 5), ("stopped".to_owned(), 10)]));
        assert_eq!(log.skips, BTreeMap::from([("far".to_owned(), 3)]));
    }
}
