//! Lines 25 to 34.

use super::{Dynamic, MotionInput, MotionOutcome, add_seconds};
use crate::turn::turn;
use anyhow::Result;
use ffgs_core::Estimates;
use ffgs_fusion::{Fused, FusionInput, InformationFuser, MotionFuser, ProcessNoise, spatial_objects};
use ffgs_trainer::TrainingView;
use glam::DVec3;
use rayon::prelude::*;
use std::time::Instant;

/// Size of a pixel at each Gaussian (m): z / f in the nearest camera that sees it.
pub fn pixel_sizes(means: &[DVec3], views: &[TrainingView]) -> Vec<f64> {
    let size = |mean: &DVec3| {
        let sizes = views.iter().filter_map(|v| {
            let projection = v.camera.project(*mean).filter(|p| v.camera.shows(p.pixel))?;
            Some(projection.depth / v.camera.intrinsics().focal())
        });
        sizes.fold(f64::INFINITY, f64::min)
    };
    let sizes: Vec<f64> = means.par_iter().map(size).collect();
    let mut seen: Vec<f64> = sizes.iter().copied().filter(|s| s.is_finite()).collect();
    seen.sort_by(f64::total_cmp);
    // A Gaussian that no view sees takes the median size; with none seen at all, a centimetre.
    let typical = seen.get(seen.len() / 2).copied().unwrap_or(0.01);
    sizes.into_iter().map(|s| if s.is_finite() { s } else { typical }).collect()
}

/// Lines 25 to 34: the posterior of the layer.
pub fn fuse(
    input: &MotionInput,
    estimates: &[Estimates],
    dynamic: &Dynamic,
    outcome: &mut MotionOutcome,
) -> Result<Fused> {
    let start = Instant::now();
    let mut pixel_m = pixel_sizes(&outcome.previous, input.before);
    pixel_m.sort_by(f64::total_cmp);
    let fuser = InformationFuser { config: input.config.fusion };
    let objects = match input.config.fusion.q_mode {
        ProcessNoise::Global => None,
        ProcessNoise::PerObject => Some(spatial_objects(&outcome.previous, &input.config.fusion.groups)),
    };
    let standing = vec![DVec3::ZERO; outcome.previous.len()];
    let fused = fuser.fuse(&FusionInput {
        prior_means: &outcome.previous,
        prior_covariances: &dynamic.covariances,
        estimates,
        previous_steps: Some(dynamic.known_steps().unwrap_or(&standing)),
        groups: objects.as_deref(),
        last_q: dynamic.q,
        q_floor_m: 0.25 * pixel_m.get(pixel_m.len() / 2).copied().unwrap_or(0.01),
    })?;
    add_seconds(&mut outcome.seconds.fusion, start);
    Ok(fused)
}

/// Moves the layer to its posterior.
pub fn apply(input: &MotionInput, fused: Fused, dynamic: &mut Dynamic, outcome: &mut MotionOutcome) {
    let start = Instant::now();
    let g = &mut dynamic.gaussians;
    g.means.iter_mut().zip(&fused.means).for_each(|(place, mean)| *place = mean.as_vec3().to_array());
    turn(g, &fused.rotations, input.config.association.rotate);
    dynamic.steps = fused.means.iter().zip(&outcome.previous).map(|(now, before)| *now - *before).collect();
    let left = fused.group_of.iter().filter(|g| g.is_none()).count();
    outcome.skip("Gaussians that follow their neighbours rather than a rigid group".into(), left);
    outcome.skip("Gaussians that no tracker measured".into(), fused.measured.iter().filter(|m| !**m).count());
    dynamic.covariances = fused.covariances;
    dynamic.q = fused.q;
    add_seconds(&mut outcome.seconds.fusion, start);
}
