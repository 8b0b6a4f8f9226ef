//! Where the alignment of a group starts: Gauss-Newton steps reach a few pixels, and trackers that lose what moves fast are off
//! by more. A body that moved in the last frame moves on much the same way.

use super::photograph::{Patch, pixel_m};
use super::{AlignmentConfig, Correction, LEAST_VIEWS, correction};
use ffgs_fusion::{Group, RigidMotion};
use glam::{DQuat, DVec3};
use nalgebra::{Matrix6, Vector6};

/// Relative error of the last frame's motion as a forecast, of step and turn: a racing car brakes by some percent of its
/// speed from one frame to the next.
const FORECAST: f64 = 0.05;
/// Turn (rad) that no forecast excludes.
const LEAST_TURN: f64 = 0.01;
/// Remaining difference, over that of the trackers' motion, from which on another start is the better one.
pub(super) const BETTER: f64 = 0.97;

/// What is known of a motion before the photographs, about the group's centre where the trackers take it.
pub(super) struct Start {
    pub motion: RigidMotion,
    /// Information on step and rotation vector.
    pub known: Matrix6<f64>,
}

impl Start {
    /// What the trackers say.
    fn of_trackers(config: &AlignmentConfig, group: &Group) -> Option<Self> {
        let centre = group.motion.centre + group.motion.step;
        let mut covariance = group.covariance;
        (0..3).for_each(|i| covariance[(i, i)] += group.shared);
        let known = covariance.cholesky()?.inverse() * config.trackers;
        Some(Self { motion: RigidMotion { centre, rotation: DQuat::IDENTITY, step: DVec3::ZERO }, known })
    }

    /// The last frame's motion, once more.
    fn of_last(last: &RigidMotion, group: &Group, pixel_m: f64) -> Self {
        let centre = group.motion.centre;
        Self::of_forecast(&RigidMotion { centre, step: last.apply(centre) - centre, ..*last }, group, pixel_m)
    }

    /// What a motion about the group's centre foretells.
    pub(super) fn of_forecast(forecast: &RigidMotion, group: &Group, pixel_m: f64) -> Self {
        let centre = group.motion.centre + group.motion.step;
        let rotation = (forecast.rotation * group.motion.rotation.inverse()).normalize();
        let step = forecast.step - group.motion.step;
        let place = (FORECAST * forecast.step.length()).powi(2) + pixel_m * pixel_m;
        let turn = (FORECAST * forecast.rotation.to_scaled_axis().length()).powi(2) + LEAST_TURN * LEAST_TURN;
        let diagonal = Vector6::from_fn(|i, _| if i < 3 { place.recip() } else { turn.recip() });
        Self { motion: RigidMotion { centre, rotation, step }, known: Matrix6::from_diagonal(&diagonal) }
    }

    /// The motion where photographs cannot better it.
    pub(super) fn alone(self) -> Option<Correction> {
        Some(Correction { motion: self.motion, covariance: self.known.cholesky()?.inverse() })
    }
}

/// The correction from where the trackers take the group, or from where its last motion does, if that fits the photographs
/// better: Gauss-Newton steps reach a few pixels.
pub(super) fn best_correction(
    config: &AlignmentConfig,
    group: &Group,
    last: Option<&RigidMotion>,
    patches: &[Patch],
) -> Option<Correction> {
    if patches.len() < LEAST_VIEWS {
        return None;
    }
    let centre = group.motion.centre + group.motion.step;
    let pixel_m = patches.iter().map(|p| pixel_m(&p.view.camera, centre)).fold(f64::INFINITY, f64::min);
    let trackers = Start::of_trackers(config, group)?;
    let standing = difference(patches, &trackers.motion);
    let own = correction(config, &trackers, pixel_m, patches);
    let rival =
        last.and_then(|last| correction(config, &Start::of_last(last, group, pixel_m), pixel_m, patches));
    let left = own.as_ref().map_or(standing, |own| difference(patches, &own.motion));
    let better = |rival: &Correction| difference(patches, &rival.motion) < BETTER * left;
    rival.filter(better).or(own)
}

/// Difference of brightness of a pixel that shows something else.
pub(super) const UNLIKE: f64 = 0.2;

/// Mean absolute difference of what the images show; what lies beside the mask shows something else.
fn difference(patches: &[Patch], motion: &RigidMotion) -> f64 {
    let (mut sum, mut count) = (0.0, 0usize);
    for patch in patches {
        let (camera, mask) = (&patch.view.camera, &patch.view.mask);
        for point in patch.points {
            let Some(shown) = camera.project(motion.apply(point.place)).map(|p| p.pixel) else { continue };
            if !camera.shows(shown) {
                continue;
            }
            let size = match patch.bicubic(shown) {
                Some((value, _)) => (value - point.value).abs().min(UNLIKE),
                None if mask.contains(shown.x as usize, shown.y as usize) => continue,
                None => UNLIKE,
            };
            sum += size;
            count += 1;
        }
    }
    if count > 0 { sum / count as f64 } else { f64::INFINITY }
}
