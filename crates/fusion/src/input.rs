//! What the fusion of one frame reads, by column.

use crate::cell_views::ViewObservations;
use ffgs_core::Estimates;
use glam::{DMat3, DVec3};

/// What one frame's fusion reads. Columns have one entry per Gaussian (N).
#[derive(Clone, Copy, Debug)]
pub struct FusionInput<'a> {
    /// Fused means of t-1 (m).
    pub prior_means: &'a [DVec3],
    /// Position covariances of t-1 (m^2).
    pub prior_covariances: &'a [DMat3],
    /// One set of estimates per tracker (L).
    pub estimates: &'a [Estimates],
    /// Last frame's steps (m), for [`crate::PriorModel::ConstantVelocity`].
    pub previous_steps: Option<&'a [DVec3]>,
    /// Object of each Gaussian, for [`crate::ProcessNoise::PerObject`].
    pub groups: Option<&'a [u32]>,
    /// The q of the last frame (m), used when no estimate succeeded.
    pub last_q: f64,
    /// Lower bound of q (m): 0.25 px times depth / focal length; 0 = literal.
    pub q_floor_m: f64,
    /// What each view saw; without, a group is taken for rigid.
    pub observed: Option<ViewObservations<'a>>,
    /// [`crate::Fused::flexibility`] of the last frame, if there was one.
    pub flexibility: Option<&'a [f64]>,
}
