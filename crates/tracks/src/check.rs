//! What a capture's trackers offer, and what is wrong with their files.

use crate::store::TrackStore;
use ffgs_core::{ImageSize, TrackerLevel, ViewMotion, is_present};
use ffgs_method::{Fault, Tracked};
use rayon::prelude::*;
use std::fmt;
use std::path::PathBuf;

/// What one tracker offers.
#[derive(Clone, Debug)]
pub struct TrackerSummary {
    /// Name of the tracker.
    pub name: String,
    /// Its level.
    pub level: TrackerLevel,
    /// Files found and read.
    pub files: usize,
    /// Files that are missing: that view and frame goes without this tracker.
    pub missing: usize,
    /// Correspondences, or flow pixels with motion known.
    pub tracks: usize,
    /// Rows or pixels left out as not finite or unknown.
    pub dropped: usize,
    /// Visible correspondences that start outside of the image.
    pub outside: usize,
    /// Of those, how many would start inside with column and row exchanged.
    pub inside_exchanged: usize,
    /// Frames for which no view has a file, though other frames have some.
    pub frames_without: Vec<usize>,
}

impl TrackerSummary {
    /// Why it has no track, and what to do.
    fn emptiness(&self) -> Option<(String, &'static str)> {
        let Self { name, files, missing, .. } = self;
        if *files > 0 {
            let problem = format!("tracker '{name}': zero tracks in all of its {files} files");
            return Some((problem, "run the tracker again, or remove it from tracks/tracks.json"));
        }
        let problem = format!("tracker '{name}': none of its {missing} files exists");
        (*missing > 0)
            .then_some((problem, "correct its pattern in tracks/tracks.json, or remove the tracker"))
    }
}

/// More of the tracks than this outside of the image are a mistake and no overshoot at its border.
const MOST_OUTSIDE: f64 = 0.05;

/// Inventory and faults of a capture's trackers; prints as a table.
#[derive(Clone, Debug, Default)]
pub struct TracksReport {
    /// One entry per tracker.
    pub trackers: Vec<TrackerSummary>,
    /// The list of trackers.
    pub list: PathBuf,
    /// What must be mended.
    pub faults: Vec<Fault>,
    /// What a run goes on with: a tracker or a frame without files beside trackers that have some.
    pub notes: Vec<String>,
}

/// Which files are read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FilesRead {
    /// All.
    All,
    /// Those of some frames; of the others it is only asked whether they are there. For a caller that reads them when it comes to
    /// them: dense motion of a long capture is more than a machine reads in minutes.
    Sampled,
}

/// Frames of which files are read where not all are.
const FRAMES_READ: usize = 16;

impl FilesRead {
    /// Whether those of one of so many frames are.
    fn includes(self, frame: usize, frames: usize) -> bool {
        self == Self::All || frame.is_multiple_of(frames.div_ceil(FRAMES_READ).max(1)) || frame + 1 == frames
    }
}

/// Reads, in parallel, the files of every tracker for `cameras` (folder name, image size) and the motions into
/// frames `1..frames`.
pub fn check(
    store: &TrackStore,
    cameras: &[(String, ImageSize)],
    frames: usize,
    read: FilesRead,
) -> TracksReport {
    let mut report = TracksReport { list: store.list(), ..TracksReport::default() };
    for tracker in 0..store.trackers().len() {
        let mut summary = look(store, tracker, (cameras, frames), read, &mut report);
        // Nothing in some frames is not nothing in all.
        if summary.tracks == 0 && read == FilesRead::Sampled && report.faults.is_empty() {
            summary = look(store, tracker, (cameras, frames), FilesRead::All, &mut report);
        }
        report.judge(&summary);
        report.trackers.push(summary);
    }
    report.judge_empty();
    if report.trackers.is_empty() {
        report.add("it lists no tracker", "list at least one tracker, or remove the file");
    }
    report
}

/// The files of a tracker, and faults into the report.
fn look(
    store: &TrackStore,
    tracker: usize,
    (cameras, frames): (&[(String, ImageSize)], usize),
    read: FilesRead,
    report: &mut TracksReport,
) -> TrackerSummary {
    let items: Vec<_> = cameras.iter().flat_map(|camera| (1..frames).map(move |t| (camera, t))).collect();
    let load = |((name, size), t): &(&(String, ImageSize), usize)| {
        if read.includes(*t, frames) {
            return count(store.load(tracker, name, *t, *size), *size);
        }
        let present = is_present(&store.path(tracker, name, *t)?);
        Ok(present.then_some(Counts { kept: 0, dropped: 0, outside: 0, inside_exchanged: 0 }))
    };
    let counts: Vec<Result<Option<Counts>, Fault>> = items.par_iter().map(load).collect();
    let entry = &store.trackers()[tracker];
    let mut summary = TrackerSummary {
        name: entry.name.clone(),
        level: entry.level,
        files: 0,
        missing: 0,
        tracks: 0,
        dropped: 0,
        outside: 0,
        inside_exchanged: 0,
        frames_without: Vec::new(),
    };
    let mut with_file = vec![false; frames];
    for (item, (_, t)) in counts.into_iter().zip(&items) {
        match item {
            Ok(Some(counts)) => {
                with_file[*t] = true;
                summary.outside += counts.outside;
                summary.inside_exchanged += counts.inside_exchanged;
                summary.files += 1;
                summary.tracks += counts.kept;
                summary.dropped += counts.dropped;
            }
            Ok(None) => summary.missing += 1,
            Err(fault) => report.faults.push(fault),
        }
    }
    if summary.files > 0 {
        summary.frames_without = (1..frames).filter(|t| !with_file[*t]).collect();
    }
    summary
}

/// Of one file.
struct Counts {
    kept: usize,
    dropped: usize,
    /// Visible correspondences that start outside of the image.
    outside: usize,
    /// Of those, how many would start inside with column and row exchanged.
    inside_exchanged: usize,
}

/// Drops the motion at once.
fn count(loaded: Result<Option<Tracked>, Fault>, size: ImageSize) -> Result<Option<Counts>, Fault> {
    let count = |Tracked { motion, read, dropped }| {
        let (outside, inside_exchanged) = outside(&motion, size);
        Counts { kept: read - dropped, dropped, outside, inside_exchanged }
    };
    Ok(loaded?.map(count))
}

fn outside(motion: &ViewMotion, size: ImageSize) -> (usize, usize) {
    let ViewMotion::Tracks(tracks) = motion else { return (0, 0) };
    let (width, height) = (size.width as f32, size.height as f32);
    let inside = |x: f32, y: f32| (0.0..=width).contains(&x) && (0.0..=height).contains(&y);
    // Trackers of points go on with those that have left the image, and call them invisible.
    let visible =
        tracks.src.iter().zip(&tracks.visibility).filter(|track| *track.1 > 0.0).map(|track| track.0);
    let all = visible.filter(|p| !inside(p[0], p[1]));
    let exchanged = all.clone().filter(|p| inside(p[1], p[0]));
    (all.clone().count(), exchanged.count())
}

impl TracksReport {
    fn judge(&mut self, summary: &TrackerSummary) {
        let TrackerSummary { name, tracks, .. } = summary;
        if summary.outside as f64 > MOST_OUTSIDE * *tracks as f64 {
            let problem = format!(
                "tracker '{name}': {} of {tracks} tracks start outside of the image",
                summary.outside
            );
            let exchanged = 2 * summary.inside_exchanged > summary.outside;
            let fix = if exchanged {
                "store src and tgt as column, row: they look like row, column"
            } else {
                "store src and tgt in pixels of the capture's images: they look like those of another size"
            };
            self.add(&problem, fix);
        }
        if !summary.frames_without.is_empty() {
            let frames =
                summary.frames_without.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ");
            self.notes.push(format!(
                "tracker '{name}': no view has a file for frame {frames} (a file holds the motion from the frame before)"
            ));
        }
    }

    /// A tracker without any track is a fault only where no other has some.
    fn judge_empty(&mut self) {
        let found = self.trackers.iter().any(|t| t.tracks > 0);
        for tracker in self.trackers.clone().iter().filter(|t| t.tracks == 0) {
            let Some((problem, fix)) = tracker.emptiness() else { continue };
            if found { self.notes.push(format!("{problem}: {fix}")) } else { self.add(&problem, fix) }
        }
    }

    fn add(&mut self, problem: &str, fix: &str) {
        self.faults.push(Fault::new(&self.list, problem, fix));
    }
}

impl fmt::Display for TracksReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for t in &self.trackers {
            let level = format!("{:?}", t.level).to_lowercase();
            write!(f, "  tracker {} ({level}): {} files, {} missing, ", t.name, t.files, t.missing)?;
            writeln!(f, "{} tracks, {} dropped", t.tracks, t.dropped)?;
        }
        self.notes.iter().try_for_each(|note| writeln!(f, "note: {note}"))?;
        self.faults.iter().try_for_each(|fault| writeln!(f, "fault: {fault}"))
    }
}
