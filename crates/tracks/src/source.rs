//! Tracker files as sources of motion.

use crate::store::TrackStore;
use ffgs_method::{Capture, Fault, TrackSource, Tracked, ViewStep};
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
    let Some(store) = TrackStore::of(capture)?.map(Arc::new) else { return Ok(Vec::new()) };
    let files =
        |tracker| -> Box<dyn TrackSource> { Box::new(TrackerFiles { store: store.clone(), tracker }) };
    Ok((0..store.trackers().len()).map(files).collect())
}

impl TrackSource for TrackerFiles {
    fn name(&self) -> &str {
        &self.store.trackers()[self.tracker].name
    }

    fn motion(&self, step: &ViewStep) -> Result<Option<Tracked>, Fault> {
        self.store.load(self.tracker, step.camera(), step.frame, step.size)
    }
}
