//! The trackers' estimates in information form, and their residuals to a motion.

use crate::symmetric::Symmetric;
use ffgs_core::{EstimateStatus, Estimates};
use glam::DVec3;
use rayon::prelude::*;

/// Median of a chi-squared variable with three degrees of freedom.
pub(crate) const MEDIAN_CHI2: f64 = 2.366;
/// Median length of a three-dimensional standard normal vector.
pub(crate) const MEDIAN_LENGTH: f64 = 1.538;
/// Squared Mahalanobis distance at which a robust weight falls to a quarter: far in the tail of a consistent estimate.
const TAIL: f64 = 12.0;
/// Least factor on a tracker's covariances; keeps weights finite where estimates agree exactly.
pub(crate) const MIN_SCALE: f64 = 1e-6;

/// One tracker's estimate of one Gaussian.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct TrackerEstimate {
    /// Place at t (m).
    pub mean: DVec3,
    /// Inverse covariance (1/m^2); zero where there is no usable estimate.
    pub information: Symmetric,
}

impl TrackerEstimate {
    fn new(e: &Estimates, i: usize) -> Self {
        let (mean, information) = (e.means[i], Symmetric::from(e.covariances[i]).inverse());
        let usable = e.status[i] == EstimateStatus::Ok && information.is_finite() && mean.is_finite();
        if usable && information.xx > 0.0 { Self { mean, information } } else { Self::default() }
    }

    /// An information matrix has a positive diagonal.
    pub(crate) fn usable(&self) -> bool {
        self.information.xx > 0.0
    }
}

/// All trackers' estimates of one Gaussian together.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Combined {
    /// Mean of the estimates weighted by information over scale (m).
    pub mean: DVec3,
    /// Sum of their informations over scale (1/m^2).
    pub information: Symmetric,
    /// Its inverse (m^2).
    pub covariance: Symmetric,
}

/// Estimates of L trackers for N Gaussians.
pub(crate) struct Evidence {
    trackers: usize,
    /// (N, L) estimates.
    told: Vec<TrackerEstimate>,
}

impl Evidence {
    pub(crate) fn new(estimates: &[Estimates]) -> Self {
        let (n, trackers) = (estimates.first().map_or(0, |e| e.status.len()), estimates.len());
        let mut told = vec![TrackerEstimate::default(); n * trackers];
        told.par_chunks_mut(trackers.max(1)).enumerate().for_each(|(i, row)| {
            row.iter_mut().zip(estimates).for_each(|(told, e)| *told = TrackerEstimate::new(e, i));
        });
        Self { trackers, told }
    }

    /// Without what was told of some Gaussians.
    pub(crate) fn without(mut self, gone: impl Fn(usize) -> bool + Sync) -> Self {
        let rows = self.told.par_chunks_mut(self.trackers.max(1)).enumerate();
        rows.filter(|(i, _)| gone(*i)).for_each(|(_, row)| row.fill(TrackerEstimate::default()));
        self
    }

    /// Number of trackers L.
    pub(crate) fn trackers(&self) -> usize {
        self.trackers
    }

    /// (L) estimates of a Gaussian.
    pub(crate) fn all(&self, i: usize) -> &[TrackerEstimate] {
        &self.told[i * self.trackers..(i + 1) * self.trackers]
    }

    /// The usable estimates of a Gaussian, each with the number of its tracker.
    pub(crate) fn of(&self, i: usize) -> impl Iterator<Item = (usize, &TrackerEstimate)> {
        self.all(i).iter().enumerate().filter(|t| t.1.usable())
    }

    /// Whether any tracker measured Gaussian `i`.
    pub(crate) fn measured(&self, i: usize) -> bool {
        self.all(i).iter().any(TrackerEstimate::usable)
    }

    /// What all trackers together say with (L) factors `scales` on their covariances.
    pub(crate) fn combined(&self, i: usize, scales: &[f64]) -> Option<Combined> {
        let (mut information, mut vector, mut origin) = (Symmetric::default(), DVec3::ZERO, None);
        for (l, told) in self.of(i) {
            let scaled = told.information * scales[l].recip();
            information += scaled;
            vector += scaled * (told.mean - *origin.get_or_insert(told.mean));
        }
        let covariance = information.inverse();
        let mean = origin? + covariance * vector;
        mean.is_finite().then_some(Combined { mean, information, covariance })
    }
}

/// Redescending weight of a squared Mahalanobis distance.
#[inline(always)]
pub(crate) fn robust_weight(distance: f64) -> f64 {
    let t = 1.0 + distance / TAIL;
    (t * t).recip()
}
