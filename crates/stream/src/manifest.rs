//! `manifest.json`, written once, and `frames.jsonl`, a line per finished frame.

use crate::error::{InFile, Problem, StreamError};
use crate::frame_file::{READABLE, Tag, VERSION};
use crate::steps::Steps;
use ffgs_core::{PixelFilter, read_text, refuse_link};
use serde::{Deserialize, Serialize};
use std::fs::OpenOptions;
use std::path::Path;

/// Names of the two files.
pub(crate) const MANIFEST: &str = "manifest.json";
pub(crate) const FRAMES: &str = "frames.jsonl";
/// A line of `frames.jsonl` takes about 400 bytes: a hundred thousand frames.
const MAX_TEXT_BYTES: u64 = 1 << 26;
/// How a manifest says what it is.
const FORMAT: &str = "ffgs-4d";

/// What holds for all frames.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// Always `ffgs-4d`.
    pub format: String,
    /// Of the format.
    pub version: u32,
    /// Name of the capture.
    pub title: String,
    /// Frames per second at which the capture plays.
    pub frames_per_second: f64,
    /// Whether a player must compensate the opacity of thin splats (Mip-Splatting).
    pub antialiased: bool,
    /// The world's up direction, unit. Axes are right-handed, the unit is the capture's.
    pub up: [f32; 3],
    /// What the middle column of the sky looks at, unit, at right angles to `up`.
    pub forward: [f32; 3],
    /// Steps of the static layer.
    #[serde(rename = "static")]
    pub static_steps: Steps,
    /// Steps of the dynamic layer.
    #[serde(rename = "dynamic")]
    pub dynamic_steps: Steps,
}

impl Manifest {
    /// The name and version that this program writes.
    pub(crate) fn stamp(&mut self) {
        FORMAT.clone_into(&mut self.format);
        self.version = VERSION;
    }

    /// With which its Gaussians are drawn.
    pub fn filter(&self) -> PixelFilter {
        if self.antialiased { PixelFilter::Compensated } else { PixelFilter::Plain }
    }

    /// Reads and checks a stream's manifest.
    pub(crate) fn read(folder: &Path) -> Result<Self, StreamError> {
        let path = folder.join(MANIFEST);
        let text = read_text(&path, MAX_TEXT_BYTES).in_file(&path)?;
        let manifest: Self = serde_json::from_str(&text).in_file(&path)?;
        manifest.check().in_file(&path)?;
        Ok(manifest)
    }

    fn check(&self) -> Result<(), Problem> {
        if self.format != FORMAT {
            return Err(Problem::Corrupt(format!("format `{}` is not `{FORMAT}`", self.format)));
        }
        if !READABLE.contains(&self.version) {
            return Err(Problem::Version { found: self.version, known: VERSION });
        }
        if !(self.static_steps.are_valid() && self.dynamic_steps.are_valid()) {
            return Err(Problem::Corrupt("steps out of range".into()));
        }
        Ok(())
    }
}

/// A line of `frames.jsonl`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Entry {
    /// Frame of the capture; ascending.
    pub frame: u64,
    /// File name in the folder of the stream.
    pub file: String,
    /// Its size.
    pub bytes: u64,
    /// Its checksum: the last four bytes of the file, the CRC-32 of all bytes before them.
    pub crc32: u32,
    /// Whether it can be shown after the last static key without any other frame.
    pub key: bool,
    /// Whether it holds the whole static layer.
    pub static_key: bool,
    /// Whether it holds the sky.
    pub sky: bool,
    /// Static and dynamic Gaussians.
    pub gaussians: [usize; 2],
    /// Bytes of each section, by its name.
    pub sections: std::collections::BTreeMap<String, u64>,
}

impl Entry {
    /// Whether it says how well each dynamic position is known.
    pub fn has_uncertainty(&self) -> bool {
        self.sections.contains_key(&Tag::Uncertainty.name())
    }
}

/// The finished frames. A last line without its end is still being written and left out.
pub(crate) fn read_entries(folder: &Path) -> Result<Vec<Entry>, StreamError> {
    let path = folder.join(FRAMES);
    let text = read_list(&path)?;
    let lines = finished(&text).lines().filter(|line| !line.is_empty());
    let entries: Vec<Entry> = lines.map(serde_json::from_str).collect::<Result<_, _>>().in_file(&path)?;
    let ascending = entries.windows(2).all(|pair| pair[0].frame < pair[1].frame);
    let inside = entries.iter().all(|e| is_plain_name(&e.file));
    if ascending && inside {
        return Ok(entries);
    }
    Err(Problem::Corrupt("frames are out of order, or a file lies outside the folder".into())).in_file(&path)
}

/// Cuts off a last line without its end: the line of the next frame would become a part of it.
pub(crate) fn cut_unfinished(folder: &Path) -> Result<(), StreamError> {
    let path = folder.join(FRAMES);
    let text = read_list(&path)?;
    let length = finished(&text).len();
    if length == text.len() {
        return Ok(());
    }
    refuse_link(&path).in_file(&path)?;
    let list = OpenOptions::new().write(true).open(&path).in_file(&path)?;
    list.set_len(length as u64).and_then(|()| list.sync_data()).in_file(&path)
}

/// The text of the list; none before the first frame.
fn read_list(path: &Path) -> Result<String, StreamError> {
    match read_text(path, MAX_TEXT_BYTES) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(String::new()),
        text => text.in_file(path),
    }
}

/// The lines that have their end.
fn finished(text: &str) -> &str {
    text.rfind('\n').map_or("", |end| &text[..=end])
}

/// A file name without a path, so that a stream cannot name files elsewhere.
fn is_plain_name(name: &str) -> bool {
    !name.is_empty()
        && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '.' || c == '_')
        && !name.starts_with('.')
}
