//! What criterion leaves below `target/criterion`: a folder `new` per case, with its name, its work and its times.

use anyhow::{Context, Result};
use serde_json::Value;
use std::fmt;
use std::path::Path;
use std::time::SystemTime;

/// Work of one iteration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Work {
    /// Multiply-adds, samples, contributions: what the case says.
    Elements(f64),
    /// Bytes that must move.
    Bytes(f64),
}

impl Work {
    pub(crate) fn amount(self) -> f64 {
        match self {
            Self::Elements(n) | Self::Bytes(n) => n,
        }
    }

    pub(crate) fn unit(self) -> &'static str {
        match self {
            Self::Elements(_) => "elements",
            Self::Bytes(_) => "bytes",
        }
    }
}

impl fmt::Display for Work {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let unit = if matches!(self, Self::Bytes(_)) { "MB" } else { "M" };
        write!(f, "{:.3} {unit}", self.amount() / 1e6)
    }
}

/// One measured case.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Case {
    pub name: String,
    /// Median of an iteration.
    pub seconds: f64,
    pub work: Work,
}

/// Cases that were measured since `start`, by name. A case without a stated work is left out.
pub(crate) fn read(folder: &Path, start: SystemTime) -> Result<Vec<Case>> {
    let mut cases = Vec::new();
    collect(folder, start, &mut cases)?;
    cases.sort_by(|a, b| a.name.cmp(&b.name));
    Ok(cases)
}

fn collect(folder: &Path, start: SystemTime, cases: &mut Vec<Case>) -> Result<()> {
    for entry in std::fs::read_dir(folder).with_context(|| format!("cannot list {}", folder.display()))? {
        let path = entry?.path();
        if path.is_dir() && path.ends_with("new") {
            let file = path.join("estimates.json");
            if std::fs::metadata(&file).and_then(|m| m.modified()).is_ok_and(|time| time >= start) {
                cases.extend(case(&json(&path.join("benchmark.json"))?, &json(&file)?));
            }
        } else if path.is_dir() {
            collect(&path, start, cases)?;
        }
    }
    Ok(())
}

fn json(path: &Path) -> Result<Value> {
    let text = std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    serde_json::from_str(&text).with_context(|| format!("{} is not JSON", path.display()))
}

fn case(benchmark: &Value, estimates: &Value) -> Option<Case> {
    let throughput = &benchmark["throughput"];
    let elements = throughput["Elements"].as_f64().map(Work::Elements);
    Some(Case {
        name: benchmark["full_id"].as_str()?.to_owned(),
        seconds: estimates["median"]["point_estimate"].as_f64()? * 1e-9,
        work: elements.or_else(|| throughput["Bytes"].as_f64().map(Work::Bytes))?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cases_of_this_pass_are_read() {
        let root = tempfile::tempdir().unwrap();
        let folder = root.path().join("group/name/new");
        std::fs::create_dir_all(&folder).unwrap();
        let benchmark = r#"{"full_id": "group/name", "throughput": {"Bytes": 300}}"#;
        std::fs::write(folder.join("benchmark.json"), benchmark).unwrap();
        std::fs::write(folder.join("estimates.json"), r#"{"median": {"point_estimate": 2e6}}"#).unwrap();
        let expected = Case { name: "group/name".into(), seconds: 2e-3, work: Work::Bytes(300.0) };
        assert_eq!(read(root.path(), SystemTime::UNIX_EPOCH).unwrap(), [expected]);
        let later = SystemTime::now() + std::time::Duration::from_mins(1);
        assert!(read(root.path(), later).unwrap().is_empty());
    }
}
