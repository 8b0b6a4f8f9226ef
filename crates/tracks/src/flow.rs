//! Optical flow as files hold it.

use crate::error::TracksError;
use ffgs_core::{DenseMotion, ImageSize, ViewMotion};
use ffgs_method::Tracked;
use std::path::Path;

/// Middlebury's convention: a larger component means that the flow is unknown.
const UNKNOWN_FLOW: f32 = 1e9;

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
        let mut motion = DenseMotion::unknown(expected);
        let mut dropped = 0;
        for (i, flow) in self.flow.iter().enumerate() {
            if flow.iter().all(|v| v.abs() <= UNKNOWN_FLOW) {
                motion.flow[i] = *flow;
                motion.visibility[i] = 1.0;
                motion.confidence[i] = 1.0;
            } else {
                dropped += 1;
            }
        }
        Ok(Tracked { motion: ViewMotion::Dense(motion), read: self.flow.len(), dropped })
    }
}
