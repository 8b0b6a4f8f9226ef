//! `tracks.json`, the list of a capture's trackers.

use crate::error::TracksError;
use crate::formats::FORMATS;
use ffgs_core::{TrackerLevel, read_text};
use ffgs_method::{PixelCenter, TrackFormat};
use serde::Deserialize;
use serde::de::{Deserializer, Error};
use std::path::Path;

/// Most bytes of tracks.json.
const MAX_INDEX_BYTES: u64 = 1 << 20;
/// Most trackers: each costs a motion field per view, and a triangulation, in every frame.
const MAX_TRACKERS: usize = 64;

/// One entry of tracks.json.
#[derive(Clone, Debug, Deserialize)]
pub struct Tracker {
    /// Name in reports and options.
    pub name: String,
    /// How densely it covers the image.
    pub level: TrackerLevel,
    /// File format, by its name.
    #[serde(deserialize_with = "by_name")]
    pub format: &'static dyn TrackFormat,
    /// Path below `tracks/` with `{camera}` and one of `{frame}` or, zero-padded, `{frame:06}` (the frame's index), or
    /// `{stem}` (the name of the camera's image of that frame, without folder and extension).
    pub pattern: String,
    /// Its pixel convention.
    #[serde(default)]
    pub pixel_center: PixelCenter,
}

fn by_name<'de, D: Deserializer<'de>>(text: D) -> Result<&'static dyn TrackFormat, D::Error> {
    FORMATS.find(&String::deserialize(text)?).map_err(D::Error::custom)
}

#[derive(Deserialize)]
struct Index {
    trackers: Vec<Tracker>,
}

pub(crate) fn read_index(file: &Path) -> Result<Vec<Tracker>, TracksError> {
    let text = read_text(file, MAX_INDEX_BYTES)
        .map_err(|source| TracksError::Io { file: file.to_owned(), source })?;
    let fail = |reason: String| TracksError::Index { file: file.to_owned(), reason };
    let trackers = serde_json::from_str::<Index>(&text).map_err(|e| fail(e.to_string()))?.trackers;
    if trackers.len() > MAX_TRACKERS {
        return Err(fail(format!("{} trackers; at most {MAX_TRACKERS} can be fused", trackers.len())));
    }
    for (i, tracker) in trackers.iter().enumerate() {
        tracker.validate().map_err(|reason| fail(format!("tracker '{}': {reason}", tracker.name)))?;
        if trackers[..i].iter().any(|t| t.name == tracker.name) {
            return Err(fail(format!("two trackers are named '{}'", tracker.name)));
        }
    }
    Ok(trackers)
}

impl Tracker {
    fn validate(&self) -> Result<(), String> {
        if self.format.is_dense() != (self.level == TrackerLevel::Dense) {
            return Err(format!("level {:?} does not go with format {}", self.level, self.format.name()));
        }
        if !self.pattern.contains("{camera}") || self.pattern.contains("{frame") == self.uses_stem() {
            return Err(format!(
                "pattern {:?} needs {{camera}} and one of {{frame:06}}, {{stem}}",
                self.pattern
            ));
        }
        if self.pattern.starts_with('/') || self.pattern.split('/').any(|part| part == "..") {
            return Err(format!("pattern {:?} leaves the tracks folder", self.pattern));
        }
        self.expand("camera", 0, Some("stem")).map(|_| ())
    }

    /// Whether files are named after images rather than numbered.
    pub(crate) fn uses_stem(&self) -> bool {
        self.pattern.contains("{stem}")
    }

    /// The pattern with camera and frame put in. `stem` is the name of the image.
    pub(crate) fn expand(&self, camera: &str, frame: usize, stem: Option<&str>) -> Result<String, String> {
        if self.uses_stem() {
            let stem = stem.ok_or_else(|| format!("camera '{camera}' has no image of frame {frame}"))?;
            return Ok(self.pattern.replace("{stem}", stem).replace("{camera}", camera));
        }
        let (before, rest) = self.pattern.split_once("{frame").ok_or("no {frame} in the pattern")?;
        let (format, after) = rest.split_once('}').ok_or("'{frame' is not closed")?;
        let width = match format.strip_prefix(":0") {
            Some(width) => width.trim_end_matches('d').parse().ok().filter(|w| *w < 100),
            None => format.is_empty().then_some(0),
        };
        let width: usize =
            width.ok_or_else(|| format!("'{{frame{format}}}' is not {{frame}} or {{frame:06}}"))?;
        Ok(format!("{before}{frame:0width$}{after}").replace("{camera}", camera))
    }
}
