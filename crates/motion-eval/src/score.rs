//! Errors of estimated positions, and whether their covariances are calibrated.

use glam::{DMat3, DVec3};
use serde::Serialize;

/// One estimate's error.
#[derive(Clone, Copy, Debug)]
pub struct Sample {
    /// Estimate less truth (m).
    pub error: DVec3,
    /// What the estimate claims (m^2).
    pub covariance: DMat3,
}

/// Nominal probabilities of the calibration curve with the quantiles of a chi-squared variable with three degrees
/// of freedom.
pub const NOMINAL: [(f64, f64); 11] = [
    (0.1, 0.5844),
    (0.2, 1.0052),
    (0.3, 1.4237),
    (0.4, 1.8692),
    (0.5, 2.3660),
    (0.6, 2.9462),
    (0.7, 3.6649),
    (0.8, 4.6416),
    (0.9, 6.2514),
    (0.95, 7.8147),
    (0.99, 11.3449),
];

/// Errors of many estimates.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Summary {
    /// Estimates.
    pub count: usize,
    /// Median end-point error (cm).
    pub median_cm: f64,
    /// 95th percentile of the end-point error (cm).
    pub p95_cm: f64,
    /// Root mean square of the end-point error (cm).
    pub rms_cm: f64,
    /// Mean normalised squared error; 3 when calibrated and Gaussian. Outliers dominate it.
    pub nees_mean: f64,
    /// Its median; 2.37 when calibrated and Gaussian.
    pub nees_median: f64,
    /// Share of the truth inside the ellipsoids of [`NOMINAL`]'s probabilities.
    pub coverage: Vec<f64>,
    /// Estimates in each bin of error: 0 to 0.5, 1, 2, 4, 8, 16, 32, 64 cm and beyond.
    pub histogram: [usize; 9],
}

impl Summary {
    /// Share inside the ellipsoid of a probability listed in [`NOMINAL`].
    pub fn coverage_at(&self, probability: f64) -> Option<f64> {
        let at = NOMINAL.iter().position(|n| (n.0 - probability).abs() < 1e-9)?;
        self.coverage.get(at).copied()
    }
}

/// Upper ends of the histogram's bins (cm); the last bin is open.
pub const BINS_CM: [f64; 8] = [0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0];

/// Summary of the samples; all zero without any.
pub fn summarise(samples: &[Sample]) -> Summary {
    let mut errors: Vec<f64> = samples.iter().map(|s| 100.0 * s.error.length()).collect();
    errors.sort_by(f64::total_cmp);
    let mut nees: Vec<f64> = samples.iter().map(normalised_squared_error).collect();
    nees.sort_by(f64::total_cmp);
    let n = samples.len().max(1) as f64;
    let inside = |limit: f64| nees.partition_point(|&e| e <= limit) as f64 / n;
    let mut histogram = [0; BINS_CM.len() + 1];
    errors.iter().for_each(|&e| histogram[BINS_CM.partition_point(|&b| b < e)] += 1);
    Summary {
        count: samples.len(),
        median_cm: quantile(&errors, 0.5),
        p95_cm: quantile(&errors, 0.95),
        rms_cm: (errors.iter().map(|e| e * e).sum::<f64>() / n).sqrt(),
        nees_mean: nees.iter().sum::<f64>() / n,
        nees_median: quantile(&nees, 0.5),
        coverage: NOMINAL.iter().map(|&(_, limit)| inside(limit)).collect(),
        histogram,
    }
}

/// Nearest-rank quantile of ascending values; 0 of none.
pub fn quantile(ascending: &[f64], q: f64) -> f64 {
    let rank = (q * ascending.len() as f64).ceil() as usize;
    ascending.get(rank.clamp(1, ascending.len().max(1)) - 1).copied().unwrap_or(0.0)
}

/// `e^T Sigma^-1 e`; a covariance without an inverse claims certainty, so a large finite number stands for it.
fn normalised_squared_error(sample: &Sample) -> f64 {
    let value = sample.error.dot(sample.covariance.inverse() * sample.error);
    if value >= 0.0 && value.is_finite() { value } else { 1e12 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_coverage_and_bins() {
        let sample =
            |cm: f64| Sample { error: DVec3::new(0.0, cm / 100.0, 0.0), covariance: DMat3::IDENTITY * 1e-4 };
        let samples: Vec<Sample> = (1..=100).map(|i| sample(0.04 * f64::from(i))).collect();
        let s = summarise(&samples);
        assert!((s.median_cm - 2.0).abs() < 1e-9 && (s.p95_cm - 3.8).abs() < 1e-9);
        assert!((s.nees_median - 4.0).abs() < 1e-9);
        // Errors up to 2.5003 cm, the root of 6.2514, are inside.
        assert_eq!(s.coverage_at(0.9), Some(0.62));
        assert_eq!(s.histogram.iter().sum::<usize>(), 100);
        assert_eq!(s.histogram[0], 12);
    }

    #[test]
    fn no_samples_and_no_inverse_are_finite() {
        assert_eq!(summarise(&[]).median_cm, 0.0);
        let certain = Sample { error: DVec3::X, covariance: DMat3::ZERO };
        assert_eq!(summarise(&[certain]).coverage_at(0.99), Some(0.0));
    }
}
