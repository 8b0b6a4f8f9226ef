//! Rigid motions refined by the photographs: every group is aligned with all views at t, beyond the paper.
//!
//! Trackers tell from frame to frame where points go. What they get wrong together stays in a group's motion, and adds up
//! over frames: a car that is ahead of its photographs by a centimetre in each of twenty frames is lost. The layer itself
//! knows what the group looks like. Rendered where the trackers take it, its pixels, thousands with six unknowns, tell how
//! far it has to go until the photographs at t agree: direct image alignment (Lucas and Kanade 1981) in three dimensions,
//! by Gauss-Newton steps. Layer and photograph are seen from the same place, so an error of the depth does no harm, and
//! an error of earlier frames is seen and mended.
//!
//! The result is fused with the trackers' by their covariances. That of the photographs comes from how the views disagree:
//! neighbouring pixels share their errors, views do not.

mod continuation;
mod departures;
mod groups;
mod lost;
mod normal;
mod photograph;
mod starts;
mod surface;

pub(crate) use groups::{align_groups, departure_odds};

use crate::Rotate;
use crate::turn::turn;
use ffgs_core::{Gaussians, TrainingView};
use ffgs_fusion::{Group, Groups, RigidMotion};
use glam::{DQuat, DVec3};
use nalgebra::{Matrix6, Vector6};
use normal::Joint;
use photograph::{Patch, Unknowns};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use surface::{SurfacePoint, surface_points};

/// Settings of the alignment.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AlignmentConfig {
    /// Most Gauss-Newton steps; 0 = the trackers' motions stay as they are.
    pub steps: usize,
    /// Pixels of a group that count in a view, at most.
    pub pixels: usize,
    /// Factor on the information of the trackers' motion. They read the same photographs, so what they say is no
    /// independent evidence.
    pub trackers: f64,
    /// Error (px) of what one view taught the layer's shape. It stays in every frame, and is smaller by the square root of the
    /// number of views.
    pub shared_px: f64,
}

impl Default for AlignmentConfig {
    fn default() -> Self {
        Self { steps: 10, pixels: 4096, trackers: 0.1, shared_px: 0.45 }
    }
}

/// Fewest pixels of a group in a view that counts.
const LEAST_PIXELS: usize = 32;
/// Fewest views: how they disagree is the measure of the error.
const LEAST_VIEWS: usize = 3;

/// Refines the motions of the rigid groups of `layer`, which is where it was at t-1, by the `views` at t. `last` has the
/// motion of each group in the last frame, where it is known. Returns how many were refined: the others are seen by too few
/// views, or show nothing that an alignment could use.
pub(crate) fn align(
    config: &AlignmentConfig,
    rotate: Rotate,
    views: &[TrainingView],
    layer: &Gaussians,
    last: &[Option<RigidMotion>],
    groups: &mut Groups,
) -> usize {
    if config.steps == 0 || groups.found.is_empty() {
        return 0;
    }
    let moved = moved_layer(layer, groups, rotate);
    let views: Vec<&TrainingView> = views.iter().filter(|view| view.mask.count() > 0).collect();
    let seen: Vec<Vec<Vec<SurfacePoint>>> =
        views.par_iter().map(|view| surface_points(view, &moved, groups, config.pixels)).collect();
    let corrections: Vec<Option<Correction>> = (groups.found.par_iter().enumerate())
        .map(|(g, group)| {
            let patches = views.iter().zip(&seen).map(|(view, seen)| Patch { view, points: &seen[g] });
            let patches: Vec<Patch> = patches.filter(|p| p.points.len() >= LEAST_PIXELS).collect();
            starts::best_correction(config, group, last[g].as_ref(), &patches)
        })
        .collect();
    let aligned: Vec<bool> = corrections.iter().map(Option::is_some).collect();
    let pairs = groups.found.iter_mut().zip(corrections);
    pairs.filter_map(|(group, correction)| Some((group, correction?))).for_each(|(group, c)| c.apply(group));
    lost::find_lost(config, rotate, &views, layer, &aligned, groups);
    aligned.iter().zip(&groups.found).filter(|(aligned, group)| **aligned || group.lost).count()
}

/// The layer where the motions of its groups take it.
fn moved_layer(layer: &Gaussians, groups: &Groups, rotate: Rotate) -> Gaussians {
    let motion = |i: usize| groups.of[i].map(|g| &groups.found[g].motion);
    let mut moved = layer.clone();
    for (i, mean) in moved.means.iter_mut().enumerate() {
        if let Some(motion) = motion(i) {
            *mean = motion.apply(DVec3::from(mean.map(f64::from))).as_vec3().to_array();
        }
    }
    let rotations: Vec<DQuat> =
        (0..layer.len()).map(|i| motion(i).map_or(DQuat::IDENTITY, |m| m.rotation)).collect();
    turn(&mut moved, &rotations, rotate);
    moved
}

/// What is left to move of a group, about its centre at t.
struct Correction {
    motion: RigidMotion,
    /// Covariance of step (m) and rotation vector (rad).
    covariance: Matrix6<f64>,
}

impl Correction {
    fn apply(self, group: &mut Group) {
        tracing::debug!(
            "a group of {} mm step is aligned by {:.1} mm, {:.2} degrees; sigma {:.1} mm",
            (1e3 * group.motion.step.length()).round(),
            1e3 * self.motion.step.length(),
            self.motion.rotation.to_scaled_axis().length().to_degrees(),
            1e3 * (self.covariance.fixed_view::<3, 3>(0, 0).trace() / 3.0).sqrt(),
        );
        group.motion.step += self.motion.step;
        group.motion.rotation = (self.motion.rotation * group.motion.rotation).normalize();
        (group.covariance, group.shared) = (self.covariance, 0.0);
    }
}

/// Gauss-Newton on the difference of layer and photographs; `None` where that does not get less.
fn correction(
    config: &AlignmentConfig,
    start: &starts::Start,
    pixel_m: f64,
    patches: &[Patch],
) -> Option<Correction> {
    let (centre, known) = (start.motion.centre, start.known);
    let shared = (config.shared_px * pixel_m).powi(2) / patches.len() as f64;
    let places = patches.iter().flat_map(|p| p.points);
    let radius = places.map(|point| point.place.distance(centre)).fold(0.0, f64::max);
    let first = Joint::new(patches, &start.motion)?;
    let (mut motion, mut joint, mut covariance) = (start.motion, first.clone(), None);
    for _ in 0..config.steps {
        let (step, mut of_pictures) = joint.solve()?;
        (0..3).for_each(|i| of_pictures[(i, i)] += shared);
        let pictures = of_pictures.cholesky()?.inverse();
        let fused = (pictures + known).cholesky()?;
        let change = fused.solve(&(pictures * step - known * (offset(&motion) - offset(&start.motion))));
        covariance = Some(fused.inverse());
        motion = moved(motion, &change);
        joint = Joint::new(patches, &motion)?;
        if largest_shift(&change, radius) < CONVERGED_PX * pixel_m {
            break;
        }
    }
    let finite = motion.step.is_finite() && motion.rotation.is_finite();
    (finite && joint.scale <= first.scale).then_some(Correction { motion, covariance: covariance? })
}

/// A change that shifts no point of the group by more than this (px of the nearest view) ends the steps.
const CONVERGED_PX: f64 = 1e-3;

/// At most so far (m) does a change move a point within `radius` (m) of the centre.
fn largest_shift(change: &Unknowns, radius: f64) -> f64 {
    change.fixed_rows::<3>(0).norm() + radius * change.fixed_rows::<3>(3).norm()
}

/// A motion as step and rotation vector.
fn offset(motion: &RigidMotion) -> Unknowns {
    let (step, turn) = (motion.step, motion.rotation.to_scaled_axis());
    Vector6::new(step.x, step.y, step.z, turn.x, turn.y, turn.z)
}

fn moved(motion: RigidMotion, change: &Unknowns) -> RigidMotion {
    let turn = DQuat::from_scaled_axis(DVec3::new(change[3], change[4], change[5]));
    RigidMotion {
        centre: motion.centre,
        rotation: (turn * motion.rotation).normalize(),
        step: motion.step + DVec3::new(change[0], change[1], change[2]),
    }
}

#[cfg(test)]
mod tests;
