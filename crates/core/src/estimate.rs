//! What trackers measured and what triangulation made of it: displaced projections in, positions with covariances out.

use glam::{DMat3, DVec2, DVec3};

/// What one tracker says of every Gaussian in every view: displaced projections with weights.
/// Layout: view-major, entry `view * gaussians + gaussian`.
#[derive(Clone, Debug, Default)]
pub struct Observations {
    /// Number of views V.
    pub views: usize,
    /// Number of Gaussians N.
    pub gaussians: usize,
    /// (V, N) positions at time t (px).
    pub targets: Vec<DVec2>,
    /// (V, N) weights; 0 = not observed. Their scale carries no meaning.
    pub weights: Vec<f64>,
}

impl Observations {
    /// `views * gaussians` unobserved entries. They take no memory until they are written: there can be a gigabyte of
    /// them, most of it of views that do not see what moves.
    pub fn unobserved(views: usize, gaussians: usize) -> Self {
        let n = views * gaussians;
        Self { views, gaussians, targets: bytemuck::zeroed_vec(n), weights: bytemuck::zeroed_vec(n) }
    }

    /// Where `gaussian` went in `view` (px), if it was observed there.
    pub fn at(&self, view: usize, gaussian: usize) -> Option<DVec2> {
        let entry = view * self.gaussians + gaussian;
        (self.weights[entry] > 0.0).then(|| self.targets[entry])
    }
}

/// Outcome of one triangulation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum EstimateStatus {
    /// Position and covariance hold.
    Ok,
    /// Fewer than two views observed the Gaussian.
    #[default]
    TooFewViews,
    /// The normal matrix is not positive definite (all rays parallel).
    Degenerate,
    /// The point fell behind one of its cameras.
    BehindCamera,
    /// The residual exceeds the accepted maximum.
    Residual,
    /// The step exceeds `max_step`.
    Step,
}

/// One tracker's estimate of every Gaussian's position, columns of length N.
#[derive(Clone, Debug, Default)]
pub struct Estimates {
    /// Positions (m); the previous mean where `status` is not `Ok`.
    pub means: Vec<DVec3>,
    /// Position covariances (m^2); zero where `status` is not `Ok`.
    pub covariances: Vec<DMat3>,
    /// Outcome per Gaussian.
    pub status: Vec<EstimateStatus>,
}
