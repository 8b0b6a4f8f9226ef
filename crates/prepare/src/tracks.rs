//! Tracks from frame to frame in every training view, by the trackers of this project.

use crate::{PrepareError, Progress, dark, tracker_list};
use ffgs_arrays::NpzWriter;
use ffgs_core::TrackSet;
use ffgs_dataset::{Capture, Split};
use ffgs_trackers::{Frame, TrackerConfig, lucas_kanade, matches};
use rayon::prelude::*;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};

/// A tracker of this project.
struct Tracker {
    /// Its name, and that of its folder below `tracks/`.
    name: &'static str,
    /// As `tracks.json` has it.
    level: &'static str,
    /// Tracks from one frame to the next; gets what the tracker before it in the list found.
    track: fn(&Frame, &Frame, &TrackSet, &TrackerConfig) -> TrackSet,
}

const TRACKERS: [Tracker; 2] = [
    Tracker {
        name: "descriptors",
        level: "sparse",
        track: |before, now, _, config| matches(before, now, config),
    },
    Tracker { name: "lucas_kanade", level: "medium", track: lucas_kanade },
];

/// Names of the trackers of this project.
pub(crate) fn names() -> [&'static str; 2] {
    TRACKERS.map(|tracker| tracker.name)
}

/// Tracks every view and step whose files are missing, and then lists the trackers. Returns what was done.
pub(crate) fn make(capture: &Capture, progress: &dyn Progress) -> Result<String, PrepareError> {
    let (views, frames) = (capture.views(Split::Train).len(), capture.frames());
    if frames < 2 {
        return Ok("none: one frame has no motion".to_owned());
    }
    let done = AtomicUsize::new(0);
    let tick = || progress.advance("tracks", done.fetch_add(1, Ordering::Relaxed) + 1, views * (frames - 1));
    let counts: Vec<usize> =
        (0..views).into_par_iter().map(|view| track_view(capture, view, &tick)).collect::<Result<_, _>>()?;
    let entries = TRACKERS.map(|Tracker { name, level, .. }| tracker_list::entry(name, level, "npz"));
    tracker_list::add(capture.root(), &entries)?;
    let steps = (views * (frames - 1)).max(1);
    let mean = counts.iter().sum::<usize>() / steps;
    let names = TRACKERS.map(|tracker| format!("{} ({})", tracker.name, tracker.level)).join(", ");
    Ok(format!("made: {names}; {mean} tracks per view and frame"))
}

/// Tracks of one view; the number of those of the last tracker that were found now.
fn track_view(capture: &Capture, view: usize, tick: &(dyn Fn() + Sync)) -> Result<usize, PrepareError> {
    let config = TrackerConfig::default();
    let name = &capture.views(Split::Train)[view].name;
    let gain = dark::gain([&capture.load_image(Split::Train, view, 0)?]);
    let load = |frame: usize| load(capture, view, frame, gain, &config);
    let mut before: Option<(usize, Frame)> = None;
    let mut found = 0;
    for frame in 1..capture.frames() {
        let files = TRACKERS.map(|tracker| path(capture.root(), tracker.name, name, frame, "npz"));
        if !files.iter().all(|file| file.exists()) {
            let last = match before.take() {
                Some((at, last)) if at == frame - 1 => last,
                _ => load(frame - 1)?,
            };
            let next = load(frame)?;
            let mut tracks = TrackSet::default();
            for (tracker, file) in TRACKERS.iter().zip(&files) {
                tracks = (tracker.track)(&last, &next, &tracks, &config);
                write(file, &tracks)?;
            }
            found += tracks.src.len();
            before = Some((frame, next));
        }
        tick();
    }
    Ok(found)
}

/// A picture, multiplied by a gain.
fn load(
    capture: &Capture,
    view: usize,
    frame: usize,
    gain: f32,
    config: &TrackerConfig,
) -> Result<Frame, PrepareError> {
    let image = dark::brightened(capture.load_image(Split::Train, view, frame)?, gain);
    let mask = capture.load_mask(Split::Train, view, frame)?;
    // The outline moves too, and its windows reach over it.
    let mask = mask.map(|m| m.widened(2));
    Ok(Frame::new(&image, mask.as_ref(), config))
}

/// Where the tracks of a camera that lead to a frame lie.
pub(crate) fn path(root: &Path, tracker: &str, camera: &str, frame: usize, suffix: &str) -> PathBuf {
    root.join("tracks").join(tracker).join(camera).join(format!("{frame:06}.{suffix}"))
}

/// Writes tracks, whole or not at all.
pub(crate) fn write(file: &Path, tracks: &TrackSet) -> Result<(), PrepareError> {
    let shape = [tracks.src.len(), 2];
    NpzWriter::new()
        .f32("src", &shape, tracks.src.as_flattened())
        .f32("tgt", &shape, tracks.tgt.as_flattened())
        .f32("visibility", &shape[..1], &tracks.visibility)
        .write(file)?;
    Ok(())
}
