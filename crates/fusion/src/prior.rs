//! The prior of one Gaussian: where it is expected at t, and how surely.

use crate::symmetric::Symmetric;
use glam::{DQuat, DVec3};

/// Prior of one Gaussian.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Prior {
    /// Predicted place (m).
    pub mean: DVec3,
    /// Covariance of the predicted motion (m^2), without that of the place at t-1.
    pub covariance: Symmetric,
    /// Rotation of what it belongs to.
    pub rotation: DQuat,
    /// Row of [`crate::structure::Structured::scales`].
    pub scales: usize,
    /// Variance per axis by which parts of its group deviate from the group's motion (m^2).
    pub spread: f64,
    /// Errors that the prior and the Gaussian's own evidence share (m^2): carried, not fused.
    pub shared: Symmetric,
    /// Whether it follows its own neighbourhood rather than a group.
    pub left: bool,
    /// Whether its own evidence counts in full, however far it is from the prior.
    pub free: bool,
}
