use crate::{LoadStats, TrackStore, TracksError};
use ffgs_core::{ImageSize, TrackerLevel, ViewMotion};
use rayon::prelude::*;
use std::fmt;

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
    /// Correspondences that start outside of the image.
    pub outside: usize,
    /// Of those, how many would start inside with column and row exchanged.
    pub inside_exchanged: usize,
    /// Frames for which no view has a file, though other frames have some.
    pub frames_without: Vec<usize>,
}

/// More of the tracks than this outside of the image are a mistake and no overshoot at its border.
const MOST_OUTSIDE: f64 = 0.05;

/// Something that keeps a tracker from being used.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TracksFault {
    /// What is wrong; names the file.
    pub problem: String,
    /// What to do about it.
    pub fix: String,
}

/// Inventory and faults of a capture's trackers; prints as a table.
#[derive(Clone, Debug, Default)]
pub struct TracksReport {
    /// One entry per tracker.
    pub trackers: Vec<TrackerSummary>,
    /// What must be mended.
    pub faults: Vec<TracksFault>,
}

/// Reads, in parallel, the file of every tracker for `cameras` (folder name, image size) and the motions into
/// frames `1..frames`.
pub fn check(store: &TrackStore, cameras: &[(String, ImageSize)], frames: usize) -> TracksReport {
    let mut report = TracksReport::default();
    for tracker in 0..store.trackers().len() {
        check_tracker(store, tracker, cameras, frames, &mut report);
    }
    if report.trackers.is_empty() {
        report.add("tracks/tracks.json lists no tracker", "list at least one tracker, or remove the file");
    }
    report
}

type Loaded = Result<Option<(ViewMotion, LoadStats)>, TracksError>;

fn check_tracker(
    store: &TrackStore,
    tracker: usize,
    cameras: &[(String, ImageSize)],
    frames: usize,
    report: &mut TracksReport,
) {
    let items: Vec<_> = cameras.iter().flat_map(|camera| (1..frames).map(move |t| (camera, t))).collect();
    let load = |((name, size), t): &(&(String, ImageSize), usize)| {
        count(store.load_counted(tracker, name, *t, *size), *size)
    };
    let counts: Vec<_> = items.par_iter().map(load).collect();
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
            Ok(Some((stats, outside))) => {
                with_file[*t] = true;
                summary.outside += outside.all;
                summary.inside_exchanged += outside.inside_exchanged;
                summary.files += 1;
                summary.tracks += stats.read - stats.dropped;
                summary.dropped += stats.dropped;
            }
            Ok(None) => summary.missing += 1,
            Err(error) => report.add(&error.to_string(), error.fix()),
        }
    }
    if summary.files > 0 {
        summary.frames_without = (1..frames).filter(|t| !with_file[*t]).collect();
    }
    report.judge(&summary);
    report.trackers.push(summary);
}

/// Correspondences that start outside of the image.
#[derive(Clone, Copy, Default)]
struct Outside {
    all: usize,
    inside_exchanged: usize,
}

/// Drops the motion at once: only counts are kept.
fn count(loaded: Loaded, size: ImageSize) -> Result<Option<(LoadStats, Outside)>, TracksError> {
    Ok(loaded?.map(|(motion, stats)| (stats, outside(&motion, size))))
}

fn outside(motion: &ViewMotion, size: ImageSize) -> Outside {
    let ViewMotion::Tracks(tracks) = motion else { return Outside::default() };
    let (width, height) = (size.width as f32, size.height as f32);
    let inside = |x: f32, y: f32| (0.0..=width).contains(&x) && (0.0..=height).contains(&y);
    let all = tracks.src.iter().filter(|p| !inside(p[0], p[1]));
    let exchanged = all.clone().filter(|p| inside(p[1], p[0]));
    Outside { all: all.clone().count(), inside_exchanged: exchanged.count() }
}

impl TracksReport {
    fn judge(&mut self, summary: &TrackerSummary) {
        let TrackerSummary { name, files, missing, tracks, .. } = summary;
        if *files == 0 && *missing > 0 {
            let problem = format!("tracker '{name}': none of its {missing} files exists");
            self.add(&problem, "correct its pattern in tracks/tracks.json, or remove the tracker");
        } else if *files > 0 && *tracks == 0 {
            let problem = format!("tracker '{name}': zero tracks in all of its {files} files");
            self.add(&problem, "run the tracker again, or remove it from tracks/tracks.json");
        }
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
            let problem = format!("tracker '{name}': no view has a file for frame {frames}");
            self.add(
                &problem,
                "run the tracker for these frames; a file holds the motion from the frame before",
            );
        }
    }

    fn add(&mut self, problem: &str, fix: &str) {
        self.faults.push(TracksFault { problem: problem.to_owned(), fix: fix.to_owned() });
    }
}

impl fmt::Display for TracksReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for t in &self.trackers {
            let level = format!("{:?}", t.level).to_lowercase();
            write!(f, "  tracker {} ({level}): {} files, {} missing, ", t.name, t.files, t.missing)?;
            writeln!(f, "{} tracks, {} dropped", t.tracks, t.dropped)?;
        }
        self.faults.iter().try_for_each(|fault| writeln!(f, "fault: {}\n  fix: {}", fault.problem, fault.fix))
    }
}
