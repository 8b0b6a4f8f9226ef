//! Lines 41 and 42.

use super::{MotionInput, MotionOutcome, add_seconds, pixel_sizes};
use ffgs_core::Dynamic;
use ffgs_fusion::{DensifyConfig, apply_densification, plan_densification};
use std::time::Instant;

/// Splits or clones what is uncertain.
pub(super) fn densify(input: &MotionInput, dynamic: &mut Dynamic, outcome: &mut MotionOutcome) {
    let start = Instant::now();
    let config: &DensifyConfig = &input.config.densification;
    let pixel_m = pixel_sizes(&dynamic.gaussians.positions(), input.now);
    let plan = plan_densification(&dynamic.gaussians, &dynamic.covariances, &pixel_m, config);
    let seed = input.config.seed ^ (input.frame as u64) << 32;
    apply_densification(&mut dynamic.gaussians, &mut dynamic.covariances, &plan, seed);
    dynamic.steps.extend(plan.iter().map(|p| dynamic.steps[p.0]).collect::<Vec<_>>());
    dynamic.number_new();
    outcome.previous.extend(plan.iter().map(|p| outcome.previous[p.0]).collect::<Vec<_>>());
    add_seconds(&mut outcome.seconds.fusion, start);
}
