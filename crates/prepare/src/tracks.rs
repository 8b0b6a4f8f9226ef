//! Tracks from frame to frame in every training view, by the trackers of this project.

use crate::camera_lists::write_json;
use crate::{PrepareError, Progress};
use ffgs_arrays::NpzWriter;
use ffgs_core::TrackSet;
use ffgs_dataset::{Capture, Split};
use ffgs_trackers::{Frame, TrackerConfig, lucas_kanade, matches};
use rayon::prelude::*;
use serde_json::json;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};

/// Folders of the two trackers below `tracks/`.
const SPARSE: &str = "descriptors";
const MEDIUM: &str = "lucas_kanade";

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
    let entry = |name: &str, level: &str| {
        let pattern = format!("{name}/{{camera}}/{{frame:06}}.npz");
        json!({"name": name, "level": level, "format": "npz", "pattern": pattern, "pixel_center": "half"})
    };
    let list = json!({"trackers": [entry(SPARSE, "sparse"), entry(MEDIUM, "medium")]});
    write_json(&capture.root().join("tracks/tracks.json"), &list)?;
    let steps = (views * (frames - 1)).max(1);
    let mean = counts.iter().sum::<usize>() / steps;
    Ok(format!("made: descriptors (sparse) and Lucas-Kanade (medium), {mean} tracks a view and frame"))
}

/// Tracks of one view; the number of medium ones that were found now.
fn track_view(capture: &Capture, view: usize, tick: &(dyn Fn() + Sync)) -> Result<usize, PrepareError> {
    let config = TrackerConfig::default();
    let name = &capture.views(Split::Train)[view].name;
    let mut before: Option<(usize, Frame)> = None;
    let mut found = 0;
    for frame in 1..capture.frames() {
        let [sparse_file, medium_file] =
            [SPARSE, MEDIUM].map(|tracker| path(capture.root(), tracker, name, frame));
        if !(sparse_file.exists() && medium_file.exists()) {
            let last = match before.take() {
                Some((at, last)) if at == frame - 1 => last,
                _ => load(capture, view, frame - 1, &config)?,
            };
            let next = load(capture, view, frame, &config)?;
            let sparse = matches(&last, &next, &config);
            let medium = lucas_kanade(&last, &next, &sparse, &config);
            found += medium.src.len();
            write(&sparse_file, &sparse)?;
            write(&medium_file, &medium)?;
            before = Some((frame, next));
        }
        tick();
    }
    Ok(found)
}

fn load(capture: &Capture, view: usize, frame: usize, config: &TrackerConfig) -> Result<Frame, PrepareError> {
    let image = capture.load_image(Split::Train, view, frame)?;
    let mask = capture.load_mask(Split::Train, view, frame)?;
    // The outline moves too, and its windows reach over it.
    let mask = mask.map(|m| m.dilated(2));
    Ok(Frame::new(&image, mask.as_ref(), config))
}

fn path(root: &Path, tracker: &str, camera: &str, frame: usize) -> PathBuf {
    root.join("tracks").join(tracker).join(camera).join(format!("{frame:06}.npz"))
}

fn write(file: &Path, tracks: &TrackSet) -> Result<(), PrepareError> {
    let shape = [tracks.src.len(), 2];
    NpzWriter::new()
        .f32("src", &shape, tracks.src.as_flattened())
        .f32("tgt", &shape, tracks.tgt.as_flattened())
        .f32("visibility", &shape[..1], &tracks.visibility)
        .write(file)?;
    Ok(())
}
