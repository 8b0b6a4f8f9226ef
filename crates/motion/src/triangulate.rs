//! Triangulation of each tracker's observations to positions with covariances (Algorithm 1, lines 20 to 24).

use crate::MotionInput;
use anyhow::Result;
use ffgs_core::{Camera, EstimateStatus, Estimates, Observations, StageLog, stage};
use ffgs_triangulation::WeightedRays;
use std::time::Instant;

/// Lines 20 to 24: every tracker's estimates.
pub(crate) fn triangulate(
    input: &MotionInput,
    observations: &[Observations],
    log: &mut StageLog,
) -> Result<Vec<Estimates>> {
    let start = Instant::now();
    let cameras: Vec<Camera> = input.step.now.iter().map(|v| v.camera).collect();
    let solver = WeightedRays { config: input.config.triangulation };
    let mut all = Vec::with_capacity(observations.len());
    for observation in observations {
        let mut estimates = Estimates::default();
        solver.triangulate(input.previous, &cameras, observation, &mut estimates)?;
        all.push(estimates);
    }
    let failed = all.iter().flat_map(|e| &e.status).filter(|s| **s != EstimateStatus::Ok).count();
    log.skip("triangulations without a result (too few views, residual, geometry)", failed);
    log.since(stage::TRIANGULATION, start);
    Ok(all)
}
