//! Tracker files as sources of motion.

use crate::{TrackStore, TracksError};
use ffgs_method::{Capture, Fault, TrackSource, Tracked, ViewStep};
use std::path::Path;
use std::sync::Arc;

/// The files of one tracker of a capture.
struct TrackerFiles {
    store: Arc<TrackStore>,
    tracker: usize,
}

/// The trackers of a capture in the order of its `tracks/tracks.json`; none when there is no such file.
///
/// # Errors
/// When the list of trackers cannot be used.
pub fn sources(capture: &dyn Capture) -> Result<Vec<Box<dyn TrackSource>>, Fault> {
    let list = || capture.root().join("tracks/tracks.json");
    let opened = TrackStore::of(capture).map_err(|error| fault(&list(), &error))?;
    let Some(store) = opened.map(Arc::new) else { return Ok(Vec::new()) };
    let files =
        |tracker| -> Box<dyn TrackSource> { Box::new(TrackerFiles { store: store.clone(), tracker }) };
    Ok((0..store.trackers().len()).map(files).collect())
}

impl TrackSource for TrackerFiles {
    fn name(&self) -> &str {
        &self.store.trackers()[self.tracker].name
    }

    fn motion(&self, step: &ViewStep) -> Result<Option<Tracked>, Fault> {
        let camera = step.camera();
        let loaded = self.store.load_counted(self.tracker, camera, step.frame, step.size);
        let file = || self.store.path(self.tracker, camera, step.frame).unwrap_or_default();
        let loaded = loaded.map_err(|error| fault(&file(), &error))?;
        Ok(loaded.map(|(motion, stats)| Tracked { motion, read: stats.read, dropped: stats.dropped }))
    }
}

fn fault(file: &Path, error: &TracksError) -> Fault {
    Fault::new(file, error, error.fix())
}
