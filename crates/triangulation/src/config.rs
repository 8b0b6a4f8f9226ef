//! Settings of the triangulation; `literal` is Algorithm 1 without our additions.

use serde::{Deserialize, Serialize};

/// Settings of [`crate::WeightedRays`]; [`TriangulationConfig::literal`] is Algorithm 1 without our additions.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TriangulationConfig {
    /// Weigh rays by `(f / z)^2`, so that the squared distance to a ray counts in pixels; `false` = literal: far
    /// cameras dominate.
    pub depth_weighting: bool,
    /// Finish with Gauss-Newton steps on the weighted reprojection error: the maximum-likelihood point under
    /// isotropic pixel noise, with its covariance; `false` = rays only.
    pub refine: bool,
    /// Discard views whose ray is nearer than this to the direction of motion (degrees). 0 = keep all: a view along
    /// the motion still measures the two directions across it. Literal: 25.
    pub collinear_degrees: f64,
    /// Skip the collinearity test when the motion is shorter than this many of its standard deviations; 0 = literal.
    pub collinear_min_sigma: f64,
    /// Throw out views that contradict the others; `false` = literal.
    pub robust: bool,
    /// Scale of the soft weight `1 / (1 + (r / scale)^2)` of the first robust steps (px); raised to twice the pooled
    /// noise where that is larger.
    pub outlier_soft_px: f64,
    /// Residual beyond which a view is thrown out (px); raised to four times the pooled noise where that is larger.
    pub outlier_cut_px: f64,
    /// Degrees of freedom the pooled variance counts for in a Gaussian's own variance; 0 = own residuals only
    /// (literal), where two views give next to nothing.
    pub pooled_degrees: f64,
    /// Least noise assumed (px), so that covariances stay invertible where residuals vanish.
    pub min_noise_px: f64,
    /// Largest accepted residual (px, root mean square over a Gaussian's views).
    pub max_residual_px: f64,
    /// Largest accepted step from the previous mean beyond three of its own standard deviations, in median distances of the
    /// means from the cameras.
    pub max_step: f64,
}

impl Default for TriangulationConfig {
    fn default() -> Self {
        Self {
            depth_weighting: true,
            refine: true,
            collinear_degrees: 0.0,
            collinear_min_sigma: 2.0,
            robust: true,
            outlier_soft_px: 2.0,
            outlier_cut_px: 4.0,
            pooled_degrees: 6.0,
            min_noise_px: 1e-3,
            max_residual_px: 10.0,
            max_step: 1.0,
        }
    }
}

impl TriangulationConfig {
    /// Our most literal reading of Algorithm 1: plain weighted rays, the 25 degree rule, every view counted.
    pub fn literal() -> Self {
        Self {
            depth_weighting: false,
            refine: false,
            collinear_degrees: 25.0,
            collinear_min_sigma: 0.0,
            robust: false,
            pooled_degrees: 0.0,
            ..Self::default()
        }
    }

    /// Whether every number is usable.
    pub(crate) fn is_valid(&self) -> bool {
        let not_negative = [self.collinear_degrees, self.collinear_min_sigma, self.pooled_degrees];
        let positive = [
            self.outlier_soft_px,
            self.outlier_cut_px,
            self.min_noise_px,
            self.max_residual_px,
            self.max_step,
        ];
        not_negative.iter().all(|v| *v >= 0.0 && v.is_finite()) && positive.iter().all(|v| *v > 0.0)
    }
}
