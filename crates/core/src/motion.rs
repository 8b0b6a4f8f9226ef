//! Motion in the image plane: sparse tracks of one view, and the dense field of flow, visibility and confidence made of them.

use crate::ImageSize;
use serde::{Deserialize, Serialize};

/// How densely a tracker covers the image; sparse and medium are densified (Algorithm 2).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TrackerLevel {
    /// Feature matches.
    Sparse,
    /// Point tracks.
    Medium,
    /// Optical flow at every pixel.
    Dense,
}

/// Correspondences of one view from frame t-1 to t, continuous pixel coordinates (centre + 0.5).
/// Invariant: all columns have one length and finite values.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TrackSet {
    /// Positions at t-1 (px).
    pub src: Vec<[f32; 2]>,
    /// Positions at t (px).
    pub tgt: Vec<[f32; 2]>,
    /// Visibility at t in 0..=1; 1 where the tracker gives none.
    pub visibility: Vec<f32>,
}

/// A dense motion field of one tracker and view.
#[derive(Clone, Debug, PartialEq)]
pub struct DenseMotion {
    /// Field size.
    pub size: ImageSize,
    /// Displacement from t-1 to t (px), row-major.
    pub flow: Vec<[f32; 2]>,
    /// Visibility at t in 0..=1.
    pub visibility: Vec<f32>,
    /// Confidence in 0..=1: C_vor after densification, C_l after agreement. 0 = no motion known here.
    pub confidence: Vec<f32>,
}

impl DenseMotion {
    /// No motion known anywhere.
    pub fn unknown(size: ImageSize) -> Self {
        let n = size.pixels();
        Self { size, flow: vec![[0.0; 2]; n], visibility: vec![0.0; n], confidence: vec![0.0; n] }
    }

    /// Resizes and clears to "unknown", keeping allocations.
    pub fn reset(&mut self, size: ImageSize) {
        let n = size.pixels();
        self.size = size;
        self.flow.clear();
        self.flow.resize(n, [0.0; 2]);
        self.visibility.clear();
        self.visibility.resize(n, 0.0);
        self.confidence.clear();
        self.confidence.resize(n, 0.0);
    }
}

/// What a tracker file of one view and frame holds.
#[derive(Clone, Debug, PartialEq)]
pub enum ViewMotion {
    /// Sparse or medium correspondences.
    Tracks(TrackSet),
    /// A dense field with confidence 1 where the tracker gave motion.
    Dense(DenseMotion),
}
