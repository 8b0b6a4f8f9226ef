//! Lines 20 to 24.

use super::{MotionInput, MotionOutcome, add_seconds};
use anyhow::Result;
use ffgs_core::{Camera, EstimateStatus, Estimates, Observations};
use ffgs_triangulation::{Triangulator, WeightedRays};
use std::time::Instant;

/// Lines 20 to 24: every tracker's estimates.
pub fn triangulate(
    input: &MotionInput,
    observations: &[Observations],
    outcome: &mut MotionOutcome,
) -> Result<Vec<Estimates>> {
    let start = Instant::now();
    let cameras: Vec<Camera> = input.now.iter().map(|v| v.camera).collect();
    let solver = WeightedRays { config: input.config.triangulation };
    let mut all = Vec::with_capacity(observations.len());
    for observation in observations {
        let mut estimates = Estimates::default();
        solver.triangulate(&outcome.previous, &cameras, observation, &mut estimates)?;
        all.push(estimates);
    }
    let failed = all.iter().flat_map(|e| &e.status).filter(|s| **s != EstimateStatus::Ok).count();
    outcome.skip("triangulations without a result (too few views, residual, geometry)".into(), failed);
    add_seconds(&mut outcome.seconds.triangulation, start);
    Ok(all)
}
