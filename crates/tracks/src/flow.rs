//! Optical flow as files hold it.

use crate::error::TracksError;
use ffgs_core::{DenseMotion, ImageSize, ViewMotion};
use ffgs_method::{Fault, PixelCenter, Plugin, TrackFormat, Tracked};
use std::path::Path;

/// Middlebury's convention: a larger component means that the flow is unknown.
const UNKNOWN_FLOW: f32 = 1e9;

/// A format of files that hold a displacement for every pixel.
pub(crate) struct FlowFormat {
    pub(crate) name: &'static str,
    pub(crate) summary: &'static str,
    /// Reads a file that should be of this size; another one is found before much memory is taken.
    pub(crate) read: fn(&Path, ImageSize) -> Result<RawFlow, TracksError>,
}

impl Plugin for FlowFormat {
    fn name(&self) -> &'static str {
        self.name
    }

    fn summary(&self) -> &'static str {
        self.summary
    }
}

impl TrackFormat for FlowFormat {
    fn is_dense(&self) -> bool {
        true
    }

    fn read(&self, file: &Path, size: ImageSize, _: PixelCenter) -> Result<Tracked, Fault> {
        let tracked = (self.read)(file, size).and_then(|flow| flow.into_motion(file, size));
        tracked.map_err(|error| error.in_file(file))
    }
}

/// Displacements (px) of a file, row-major.
pub(crate) struct RawFlow {
    pub size: ImageSize,
    pub flow: Vec<[f32; 2]>,
}

impl RawFlow {
    /// Confidence 1 where there is motion (standing still included); unknown and non-finite pixels get 0 and count.
    pub(crate) fn into_motion(self, file: &Path, expected: ImageSize) -> Result<Tracked, TracksError> {
        if self.size != expected {
            return Err(TracksError::Size { file: file.to_owned(), expected, found: self.size });
        }
        let (read, mut dropped, mut flow) = (self.flow.len(), 0, self.flow);
        let mut known = vec![1.0; read];
        for (flow, known) in flow.iter_mut().zip(&mut known) {
            if !flow.iter().all(|v| v.abs() <= UNKNOWN_FLOW) {
                (*flow, *known) = ([0.0; 2], 0.0);
                dropped += 1;
            }
        }
        let motion = DenseMotion { size: expected, flow, visibility: known.clone(), confidence: known };
        Ok(Tracked { motion: ViewMotion::Dense(motion), read, dropped })
    }
}
