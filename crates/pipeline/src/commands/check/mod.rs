//! What a capture holds and what is wrong with it: images, masks and points (`dataset`), and the trackers' files
//! (`tracks`). `ffgs check` prints it, and a run starts with it.

pub(crate) mod pictures;

use crate::plugins::registry::open_capture;
use anyhow::Result;
use ffgs_core::{ImageSize, counted};
use ffgs_dataset::{CheckReport, ImageCheck, Note, check_with_progress};
use ffgs_method::{Capture, Part, Split, ViewAt};
use ffgs_prepare::{Step, Summary};
use ffgs_tracks::{FilesRead, MovingBackground, TrackStore, TracksReport, moving_backgrounds};
use indicatif::{ProgressBar, ProgressStyle};
use std::fmt;
use std::path::Path;

/// Inventory and faults of a capture with its trackers; prints as a table.
#[derive(Clone, Debug, Default)]
pub(crate) struct CaptureCheck {
    /// The capture's content; its faults include those of the trackers.
    pub content: CheckReport,
    /// The trackers; empty for a capture without.
    pub tracks: TracksReport,
}

impl CaptureCheck {
    /// Whether a run can start.
    pub(crate) fn is_usable(&self) -> bool {
        self.content.is_usable()
    }
}

impl fmt::Display for CaptureCheck {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // The faults are part of the content's list.
        let tracks = TracksReport { faults: Vec::new(), ..self.tracks.clone() };
        if !tracks.trackers.is_empty() {
            writeln!(f, "Trackers")?;
        }
        write!(f, "{tracks}{}", self.content)
    }
}

/// Notes that a run repeats at most.
const NOTES: usize = 8;

impl CaptureCheck {
    /// Repeats what a run goes on with as warnings.
    pub(crate) fn warn(&self) {
        let notes = self.tracks.notes.iter().cloned();
        let content = self.content.notes.iter().map(|note| format!("{}: {}", note.file.display(), note.text));
        let notes: Vec<String> = notes.chain(content).collect();
        notes.iter().take(NOTES).for_each(|note| tracing::warn!("{note}"));
        if let Some(more @ 1..) = notes.len().checked_sub(NOTES) {
            tracing::warn!("`ffgs check` lists {} more", counted(more, "note"));
        }
    }
}

/// Reads every file of the capture and its trackers, or with [`ImageCheck::Probe`] those of some frames. The bar (unless `quiet`) counts images.
///
/// # Errors
/// When the capture cannot be opened at all; the message names file and fix.
pub(crate) fn check_capture(root: &Path, images: ImageCheck, quiet: bool) -> Result<CaptureCheck> {
    let capture = open_capture(root)?;
    let bar = progress_bar(quiet);
    let mut content = check_with_progress(&*capture, images, &|done, total| {
        bar.set_length(total as u64);
        bar.set_position(done as u64);
    });
    bar.set_message("tracks");
    let tracks = check_tracks(&*capture, images, &mut content);
    content.notes.extend(older_steps(capture.root()));
    bar.finish_and_clear();
    Ok(CaptureCheck { content, tracks })
}

fn progress_bar(quiet: bool) -> ProgressBar {
    if quiet {
        return ProgressBar::hidden();
    }
    let style = ProgressStyle::with_template("check {bar:40} {pos}/{len} {msg}, {eta} left");
    ProgressBar::new(0)
        .with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
        .with_message("images")
}

fn check_tracks(capture: &dyn Capture, images: ImageCheck, content: &mut CheckReport) -> TracksReport {
    let folder = capture.root().join("tracks");
    let tracks = match TrackStore::of(capture) {
        Ok(Some(store)) => {
            if images == ImageCheck::Decode {
                content.notes.extend(moving_backgrounds(&store, capture).iter().map(|m| moving(capture, m)));
            }
            let read = if images == ImageCheck::Decode { FilesRead::All } else { FilesRead::Sampled };
            ffgs_tracks::check(&store, &training_cameras(capture), capture.frames(), read)
        }
        Ok(None) => {
            let text = "no tracks.json: the methods trackers, tracker:NAME and trackersplat cannot be used; `ffgs track` makes tracks".to_owned();
            content.notes.push(Note { file: folder, text });
            return TracksReport::default();
        }
        Err(fault) => TracksReport { faults: vec![fault], ..TracksReport::default() },
    };
    content.faults.extend(tracks.faults.iter().cloned());
    tracks
}

/// What an older version of `ffgs prepare` made of the capture; nothing where that is not known.
fn older_steps(root: &Path) -> Vec<Note> {
    let file = root.join(Summary::FILE);
    let older = Summary::read(&file).map(|summary| summary.older).unwrap_or_default();
    let note = |step: &Step| {
        let text = format!(
            "its {step} were made by an older version of this program; `ffgs prepare`, as it was called then and with \
             --force {step}, makes them again"
        );
        Note { file: file.clone(), text }
    };
    older.iter().map(note).collect()
}

fn moving(capture: &dyn Capture, found: &MovingBackground) -> Note {
    let MovingBackground { camera, pixels } = found;
    let text = format!(
        "camera '{camera}' has one pose in all frames, but its background moves by {pixels:.1} px per frame: \
         give it a pose for every frame, or stabilise its images"
    );
    Note { file: capture.part(Part::Cameras(Split::Train)), text }
}

/// Folder name and image size of the training views whose cameras are good; the others have a fault already.
fn training_cameras(capture: &dyn Capture) -> Vec<(String, ImageSize)> {
    let views = capture.views(Split::Train).iter().enumerate();
    let camera = |view| capture.camera(ViewAt { split: Split::Train, view, frame: 0 }).ok();
    views.filter_map(|(v, name)| Some((name.clone(), camera(v)?.size()))).collect()
}
