//! `ffgs stage triangulate`.

use super::input::{ANY, Input, flat_matrices3, flat_points3, points2, points3};
use anyhow::Result;
use ffgs_arrays::NpzWriter;
use ffgs_core::{EstimateStatus, Estimates, ImageSize, Observations};
use ffgs_triangulation::WeightedRays;

/// Rays need no image borders.
const ANY_SIZE: ImageSize = ImageSize { width: 1, height: 1 };

pub(super) fn run(input: &Input) -> Result<NpzWriter> {
    let previous = points3(&input.finite("means", &[ANY, Some(3)])?.data);
    let cameras = input.cameras(ANY_SIZE)?;
    let (views, gaussians) = (cameras.len(), previous.len());
    let shape = [Some(views), Some(gaussians)];
    // Targets of weight 0 may hold anything, NaN too.
    let targets = points2(&input.array("targets", &[shape[0], shape[1], Some(2)])?.data);
    let weights = input.array("weights", &shape)?.data;
    let observations = Observations { views, gaussians, targets, weights };
    let mut out = Estimates::default();
    WeightedRays::default().triangulate(&previous, &cameras, &observations, &mut out)?;
    let valid: Vec<u8> = out.status.iter().map(|&s| u8::from(s == EstimateStatus::Ok)).collect();
    let mut results = NpzWriter::new();
    results.f64("means", &[gaussians, 3], &flat_points3(&out.means));
    results.f64("covariances", &[gaussians, 3, 3], &flat_matrices3(&out.covariances));
    results.u8("valid", &[gaussians], &valid);
    Ok(results)
}
