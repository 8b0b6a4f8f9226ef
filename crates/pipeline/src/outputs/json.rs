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
    serde_json::from_str(&text).with_context(|| {
        format!("{} is damaged; bring it back from a copy, or run again with another --out", path.display())
    })
}
