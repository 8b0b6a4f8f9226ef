//! The motion of one view from t-1 to t, as trackers find it.

use crate::{Capture, Fault, Plugin, Split, ViewAt};
use ffgs_core::{ImageSize, ViewMotion};
use serde::Deserialize;
use std::fmt;
use std::path::Path;

/// A file format of a tracker's output.
pub trait TrackFormat: Plugin {
    /// Whether a file holds motion for every pixel (optical flow) rather than correspondences.
    fn is_dense(&self) -> bool;

    /// Reads a file. Positions leave in continuous pixel coordinates with pixel centres at + 0.5, finite.
    ///
    /// # Errors
    /// When the file is damaged, or its flow has another size than `size`, the camera's.
    fn read(&self, file: &Path, size: ImageSize, center: PixelCenter) -> Result<Tracked, Fault>;
}

impl fmt::Debug for dyn TrackFormat {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Where a tracker's coordinates put the centre of the first pixel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PixelCenter {
    /// At (0, 0), as most trackers do.
    #[default]
    Integer,
    /// At (0.5, 0.5), as this project does.
    Half,
}

/// The motion of one view, and what became of the rows or pixels that the tracker gave.
#[derive(Clone, Debug, PartialEq)]
pub struct Tracked {
    /// The motion.
    pub motion: ViewMotion,
    /// Rows (correspondences) or pixels (flow) given.
    pub read: usize,
    /// Those left out because they are not finite, or marked as unknown.
    pub dropped: usize,
}

/// A tracker: its files, or a program that tracks.
pub trait TrackSource: Send + Sync {
    /// Its name in reports and options.
    fn name(&self) -> &str;

    /// The motion of a training view from t-1 to t; `None` where it has nothing for this view, which is counted.
    ///
    /// # Errors
    /// When what it has cannot be used.
    fn motion(&self, step: &ViewStep) -> Result<Option<Tracked>, Fault>;
}

/// One training view from frame t-1 to t. A source that tracks asks the capture for images and masks; one that reads
/// files does not.
#[derive(Clone, Copy, Debug)]
pub struct ViewStep<'a> {
    /// The capture.
    pub capture: &'a dyn Capture,
    /// Index of the view in the training split.
    pub view: usize,
    /// t, at least 1.
    pub frame: usize,
    /// Size of the view's image at t-1.
    pub size: ImageSize,
}

impl ViewStep<'_> {
    /// Name of the view.
    pub fn camera(&self) -> &str {
        &self.capture.views(Split::Train)[self.view]
    }

    /// The view at t-1.
    pub fn before(&self) -> ViewAt {
        ViewAt { split: Split::Train, view: self.view, frame: self.frame - 1 }
    }

    /// The view at t.
    pub fn now(&self) -> ViewAt {
        ViewAt { split: Split::Train, view: self.view, frame: self.frame }
    }
}
