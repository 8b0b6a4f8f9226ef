//! `ffgs stage fuse`, in any configuration.

use super::input::{ANY, Input, flat_matrices3, flat_points3, matrices3, points3};
use anyhow::Result;
use ffgs_arrays::NpzWriter;
use ffgs_core::{EstimateStatus, Estimates};
use ffgs_fusion::{FusionConfig, FusionInput, InformationFuser};
use glam::{DMat3, DVec3};

pub(super) fn run(input: &Input, config: FusionConfig) -> Result<NpzWriter> {
    let prior_means = points3(&input.finite("prior_means", &[ANY, Some(3)])?.data);
    let n = prior_means.len();
    let shape = [Some(n), Some(3), Some(3)];
    let prior_covariances = matrices3(&input.finite("prior_covariances", &shape)?.data);
    let estimates = estimates(input, n)?;
    let fused = InformationFuser { config }.fuse(&FusionInput {
        prior_means: &prior_means,
        prior_covariances: &prior_covariances,
        estimates: &estimates,
        previous_steps: None,
        groups: None,
        last_q: 0.0,
        q_floor_m: 0.0,
        observed: None,
        flexibility: None,
    })?;
    let mut results = NpzWriter::new();
    results.f64("means", &[n, 3], &flat_points3(&fused.means));
    results.f64("covariances", &[n, 3, 3], &flat_matrices3(&fused.covariances));
    results.f64("q", &[], &[fused.q]);
    Ok(results)
}

/// One set per tracker; what did not succeed may hold anything.
fn estimates(input: &Input, n: usize) -> Result<Vec<Estimates>> {
    let means = input.array::<f64>("means", &[ANY, Some(n), Some(3)])?;
    let trackers = means.shape[0];
    let covariances = input.array("covariances", &[Some(trackers), Some(n), Some(3), Some(3)])?;
    let valid = input.array::<f64>("valid", &[Some(trackers), Some(n)])?.data;
    let (means, covariances) = (points3(&means.data), matrices3(&covariances.data));
    let tracker = |l: usize| {
        let range = l * n..(l + 1) * n;
        let status = range.clone().map(|i| status(valid[i], means[i], covariances[i])).collect();
        Estimates { means: means[range.clone()].to_vec(), covariances: covariances[range].to_vec(), status }
    };
    Ok((0..trackers).map(tracker).collect())
}

fn status(valid: f64, mean: DVec3, covariance: DMat3) -> EstimateStatus {
    match valid > 0.0 {
        false => EstimateStatus::TooFewViews,
        true if mean.is_finite() && covariance.is_finite() => EstimateStatus::Ok,
        true => EstimateStatus::Degenerate,
    }
}
