//! `tracks/tracks.json`, which several programs add to.

use crate::PrepareError;
use crate::camera_lists::write_json;
use crate::removal::remove;
use ffgs_core::read_text;
use serde_json::{Value, json};
use std::path::Path;

/// It has some lines per tracker.
const MAX_BYTES: u64 = 1 << 20;

/// A tracker whose files `tracks::path` names.
pub(crate) fn entry(name: &str, level: &str, format: &str) -> Value {
    let pattern = format!("{name}/{{camera}}/{{frame:06}}.{format}");
    json!({"name": name, "level": level, "format": format, "pattern": pattern, "pixel_center": "half"})
}

/// Adds trackers, or replaces those of the same names; others stay.
pub(crate) fn add(capture: &Path, entries: &[Value]) -> Result<(), PrepareError> {
    let file = capture.join("tracks/tracks.json");
    let mut list = read(&file)?;
    list.retain(|old| entries.iter().all(|new| new["name"] != old["name"]));
    list.extend(entries.iter().cloned());
    write_json(&file, &json!({"trackers": list}))
}

/// Takes trackers out; without one, the file goes too.
pub(crate) fn take_out(capture: &Path, names: &[String]) -> Result<(), PrepareError> {
    let file = capture.join("tracks/tracks.json");
    let mut list = read(&file)?;
    list.retain(|tracker| names.iter().all(|name| tracker["name"] != name.as_str()));
    if list.is_empty() { remove(&file) } else { write_json(&file, &json!({"trackers": list})) }
}

fn read(file: &Path) -> Result<Vec<Value>, PrepareError> {
    if !file.exists() {
        return Ok(Vec::new());
    }
    let text = read_text(file, MAX_BYTES).map_err(|e| PrepareError::io(file, e))?;
    let list: Option<Value> = serde_json::from_str(&text).ok();
    let trackers = list.and_then(|list| list["trackers"].as_array().cloned());
    trackers.ok_or_else(|| PrepareError::picture(file, "not a list of trackers; remove it, or mend it"))
}
