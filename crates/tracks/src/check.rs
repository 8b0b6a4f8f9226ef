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
}

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
    let load =
        |((name, size), t): (&(String, ImageSize), usize)| count(store.load_counted(tracker, name, t, *size));
    let counts: Vec<_> = items.into_par_iter().map(load).collect();
    let entry = &store.trackers()[tracker];
    let mut summary = TrackerSummary {
        name: entry.name.clone(),
        level: entry.level,
        files: 0,
        missing: 0,
        tracks: 0,
        dropped: 0,
    };
    for item in counts {
        match item {
            Ok(Some(stats)) => {
                summary.files += 1;
                summary.tracks += stats.read - stats.dropped;
                summary.dropped += stats.dropped;
            }
            Ok(None) => summary.missing += 1,
            Err(error) => report.add(&error.to_string(), error.fix()),
        }
    }
    report.judge(&summary);
    report.trackers.push(summary);
}

/// Drops the motion at once: only counts are kept.
fn count(loaded: Loaded) -> Result<Option<LoadStats>, TracksError> {
    Ok(loaded?.map(|(_, stats)| stats))
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
