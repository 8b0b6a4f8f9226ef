//! What the photographs of t-1 and t say of the rigid groups that the fusion predicted: their motions, and whether cells depart from them.

use super::align;
use super::continuation::continued;
use super::departures::departures;
use super::surface::{SurfacePoint, surface_points};
use crate::MotionInput;
use ffgs_core::{Dynamic, Gaussians, StageLog, TrainingView, stage};
use ffgs_fusion::Groups;
use glam::DVec3;
use rayon::prelude::*;
use std::time::Instant;

/// Refines the motions of `groups` by the photographs at t. `dynamic` is the layer as it was at t-1.
pub(crate) fn align_groups(input: &MotionInput, dynamic: &Dynamic, groups: &mut Groups, log: &mut StageLog) {
    let start = Instant::now();
    let (config, rotate) = (&input.config.alignment, input.config.association.rotate);
    let last = match dynamic.known_steps() {
        Some(steps) => continued(groups, input.previous, steps),
        None => vec![None; groups.found.len()],
    };
    let [_, now] = input.step.reduced;
    let aligned = align(config, rotate, now, &dynamic.gaussians, &last, groups);
    if config.steps > 0 {
        log.skip("rigid groups that the photographs could not align", groups.found.len() - aligned);
        let lost = groups.found.iter().filter(|group| group.lost).count();
        log.skip("rigid groups that trackers lost: they move like another one", lost);
    }
    log.since(stage::ALIGNMENT, start);
}

/// Per cell of `groups`, the logarithm of the odds that it moved by `offsets` (m) beyond its group's motion rather than with the group; 0
/// where nothing can be said. `layer` is where it was at t-1.
pub(crate) fn departure_odds(
    input: &MotionInput,
    layer: &Gaussians,
    groups: &Groups,
    offsets: &[Option<DVec3>],
    log: &mut StageLog,
) -> Vec<f64> {
    if input.config.alignment.steps == 0 || offsets.is_empty() {
        return vec![0.0; offsets.len()];
    }
    let start = Instant::now();
    let [before, now] = input.step.reduced;
    let pairs = before.iter().zip(now);
    let views: Vec<(&TrainingView, &TrainingView)> =
        pairs.filter(|(before, now)| before.mask.count() > 0 && now.mask.count() > 0).collect();
    let pixels = input.config.alignment.pixels;
    let seen: Vec<Vec<Vec<SurfacePoint>>> =
        views.par_iter().map(|(before, _)| surface_points(before, layer, groups, pixels)).collect();
    let odds = departures(&views, &seen, groups, offsets);
    log.since(stage::ALIGNMENT, start);
    odds
}
