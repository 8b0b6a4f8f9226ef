//! What a frame is made from, read while the frame before it is trained.

use crate::job::frame::{load_views, training_views};
use crate::job::provenance::{Checksum, track_checksums};
use anyhow::Result;
use ffgs_core::TrainingView;
use ffgs_method::Capture;
use std::ops::Range;
use std::thread::{Scope, ScopedJoinHandle};

/// What a frame is made from. Tracks are read through for their checksums, and decoded when the frame comes to them: by then
/// the system holds their bytes, and gives them up where memory is short.
pub(crate) struct Inputs {
    /// Training views, in the exposure of each camera.
    pub views: Vec<TrainingView>,
    /// Checksums of the files that the training views were read from.
    pub sums: Vec<Checksum>,
    /// Checksums of the tracker files of the motion into the frame.
    pub track_sums: Vec<Checksum>,
}

impl Inputs {
    /// Reads the inputs of `frame` for the training views `views` (by index).
    fn read(capture: &dyn Capture, views: &[usize], frame: usize) -> Result<Self> {
        let track_sums = track_checksums(capture, views, frame)?;
        let (views, sums) = load_views(capture, &training_views(views, frame))?;
        Ok(Self { views, sums, track_sums })
    }
}

/// Reads one frame ahead, on a thread of its own.
pub(crate) struct ReadAhead<'scope, 'env> {
    scope: &'scope Scope<'scope, 'env>,
    capture: &'env dyn Capture,
    views: &'env [usize],
    /// Frames that may be read ahead.
    frames: Range<usize>,
    begun: Option<(usize, ScopedJoinHandle<'scope, Result<Inputs>>)>,
}

impl<'scope, 'env> ReadAhead<'scope, 'env> {
    /// Reads nothing yet. Only `frames` will be read ahead, of the training views `views` (by index).
    pub(crate) fn new(
        scope: &'scope Scope<'scope, 'env>,
        capture: &'env dyn Capture,
        views: &'env [usize],
        frames: Range<usize>,
    ) -> Self {
        Self { scope, capture, views, frames, begun: None }
    }

    /// Begins to read `frame`, which is asked for next.
    pub(crate) fn begin(&mut self, frame: usize) {
        if self.frames.contains(&frame) {
            let (capture, views) = (self.capture, self.views);
            let read = move || Inputs::read(capture, views, frame);
            // Where the system has no thread to give, the frame is read when it is asked for.
            let reading = std::thread::Builder::new().spawn_scoped(self.scope, read).ok();
            self.begun = reading.map(|reading| (frame, reading));
        }
    }

    /// The inputs of `frame`: waits for the reading that was begun, or else reads them now.
    ///
    /// # Errors
    /// When one of them cannot be read.
    pub(crate) fn take(&mut self, frame: usize) -> Result<Inputs> {
        match self.begun.take() {
            Some((begun, reading)) if begun == frame => {
                reading.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
            }
            _ => Inputs::read(self.capture, self.views, frame),
        }
    }
}
