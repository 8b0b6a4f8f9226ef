//! What the trackers say, in information form, and how far they are from a motion.

use crate::fuse::symmetric_inverse;
use ffgs_core::{EstimateStatus, Estimates};
use glam::{DMat3, DVec3};
use rayon::prelude::*;

/// Median of a chi-squared variable with three degrees of freedom.
pub const MEDIAN_CHI2: f64 = 2.366;
/// Squared Mahalanobis distance at which a robust weight falls to a quarter: far in the tail of a consistent estimate.
const TAIL: f64 = 12.0;
/// Least factor on a tracker's covariances; keeps weights finite where estimates agree exactly.
pub const MIN_SCALE: f64 = 1e-2;

/// Estimates of L trackers for N Gaussians.
pub struct Evidence<'a> {
    /// The trackers' estimates.
    pub estimates: &'a [Estimates],
    /// (L, N) inverse covariances (1/m^2); zero where there is no usable estimate.
    information: Vec<Vec<DMat3>>,
}

impl<'a> Evidence<'a> {
    pub fn new(estimates: &'a [Estimates]) -> Self {
        let one = |e: &Estimates, i: usize| {
            let inverse = symmetric_inverse(e.covariances[i]);
            let finite = inverse.is_finite() && e.means[i].is_finite();
            let usable = e.status[i] == EstimateStatus::Ok && finite && inverse.x_axis.x > 0.0;
            if usable { inverse } else { DMat3::ZERO }
        };
        let column =
            |e: &Estimates| (0..e.status.len()).into_par_iter().map(|i| one(e, i)).collect::<Vec<_>>();
        Self { estimates, information: estimates.iter().map(column).collect() }
    }

    /// Number of trackers L.
    pub fn trackers(&self) -> usize {
        self.estimates.len()
    }

    /// Mean (m) and inverse covariance of an estimate; `None` where there is none.
    pub fn of(&self, l: usize, i: usize) -> Option<(DVec3, DMat3)> {
        let information = self.information[l][i];
        // An information matrix has a positive diagonal.
        (information.x_axis.x > 0.0).then(|| (self.estimates[l].means[i], information))
    }

    /// Whether any tracker measured Gaussian `i`.
    pub fn measured(&self, i: usize) -> bool {
        self.information.iter().any(|column| column[i].x_axis.x > 0.0)
    }

    /// Mean of the estimates weighted by information over scale, and the sum of the informations.
    pub fn combined(&self, i: usize, scales: &[f64]) -> Option<(DVec3, DMat3)> {
        let (mut sum, mut vector, mut origin) = (DMat3::ZERO, DVec3::ZERO, None);
        for (l, scale) in scales.iter().enumerate() {
            if let Some((mean, information)) = self.of(l, i) {
                let origin = *origin.get_or_insert(mean);
                sum += information * scale.recip();
                vector += information * (mean - origin) * scale.recip();
            }
        }
        let mean = origin? + symmetric_inverse(sum) * vector;
        mean.is_finite().then_some((mean, sum))
    }
}

/// Redescending weight of a squared Mahalanobis distance.
pub fn robust_weight(distance: f64) -> f64 {
    let t = 1.0 + distance / TAIL;
    (t * t).recip()
}
