//! JSON files of a run: read within a bound, written whole or not at all.

use anyhow::{Context, Result};
use ffgs_core::read_text;
use serde::{Serialize, de::DeserializeOwned};
use std::path::Path;

/// Most bytes of a JSON file of a run.
const MAX_JSON_BYTES: u64 = 1 << 28;

/// Writes JSON through a temporary file.
///
/// # Errors
/// When the file cannot be written.
pub fn write_json(path: &Path, value: &impl Serialize) -> Result<()> {
    ffgs_core::write_atomically(path, |out| {
        serde_json::to_writer_pretty(&mut *out, value)?;
        std::io::Write::write_all(out, b"\n").map_err(anyhow::Error::from)
    })
    .with_context(|| format!("cannot write {}; is the folder writable, the disk full?", path.display()))
}

/// Reads JSON.
///
/// # Errors
/// When the file cannot be read, or is not a `T`.
pub fn read_json<T: DeserializeOwned>(path: &Path) -> Result<T> {
    let text = read_text(path, MAX_JSON_BYTES).with_context(|| format!("cannot read {}", path.display()))?;
    serde_json::from_str(&text).map_err(|error| {
        let (found, fix) = fault(&error);
        anyhow::Error::new(error)
            .context(format!("{} {found}; {fix}, or run again with another --out", path.display()))
    })
}

/// What is wrong with a file, and what to do. A damaged one is hardly ever valid JSON.
fn fault(error: &serde_json::Error) -> (&'static str, &'static str) {
    if error.is_data() {
        ("was written by another version of ffgs, or is damaged", "read it with that version")
    } else {
        ("is damaged", "bring it back from a copy")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_of_another_version_is_told_from_a_damaged_one() {
        #[derive(Debug, serde::Deserialize)]
        #[serde(deny_unknown_fields)]
        struct Known {
            #[serde(rename = "known")]
            _known: u8,
        }
        let folder = tempfile::tempdir().unwrap();
        let error = |text: &str| {
            let file = folder.path().join("run.json");
            std::fs::write(&file, text).unwrap();
            format!("{:#}", read_json::<Known>(&file).unwrap_err())
        };
        let other = error("{\"known\": 1, \"new\": 2}");
        assert!(
            other.contains("run.json was written by another version") && other.contains("`new`"),
            "{other}"
        );
        assert!(error("{\"known\": 1").contains("run.json is damaged; bring it back"));
    }
}
