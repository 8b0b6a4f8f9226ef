//! Fusion of the trackers' positions with the prior to a posterior, and the move to it (Algorithm 1, lines 25 to 34).

use crate::MotionInput;
use crate::turn::turn;
use ffgs_core::{Camera, Dynamic, Estimates, Observations, StageLog, stage};
use ffgs_fusion::{Fused, FusionInput, ProcessNoise, ViewObservations, spatial_objects};
use glam::DVec3;
use rayon::prelude::*;
use std::time::Instant;

/// Size of a pixel at each Gaussian (m): z / f in the nearest camera that sees it.
pub fn pixel_sizes<'a>(means: &[DVec3], cameras: impl IntoIterator<Item = &'a Camera>) -> Vec<f64> {
    let views: Vec<PixelScale> = cameras.into_iter().map(PixelScale::new).collect();
    let size = |mean: &DVec3| views.iter().fold(f64::INFINITY, |least, view| view.nearer(*mean, least));
    let sizes: Vec<f64> = means.par_iter().map(size).collect();
    let mut seen: Vec<f64> = sizes.iter().copied().filter(|s| s.is_finite()).collect();
    // A Gaussian that no view sees takes the median size.
    let typical = typical_size(&mut seen);
    sizes.into_iter().map(|s| if s.is_finite() { s } else { typical }).collect()
}

/// The upper median; 0.01 m where there are no finite sizes.
fn typical_size(sizes: &mut [f64]) -> f64 {
    let half = sizes.len() / 2;
    if sizes.is_empty() { 0.01 } else { *sizes.select_nth_unstable_by(half, f64::total_cmp).1 }
}

/// A camera, and the constants to compute the size of a pixel (m) at a point without projecting it.
struct PixelScale<'a> {
    camera: &'a Camera,
    /// Viewing direction in the world.
    axis: DVec3,
    focal: f64,
}

impl<'a> PixelScale<'a> {
    fn new(camera: &'a Camera) -> Self {
        Self { camera, axis: camera.rotation().transpose().z_axis, focal: camera.intrinsics().focal() }
    }

    /// The size of a pixel (m) at a place, if it is seen there and less than `least`; else `least`.
    fn nearer(&self, place: DVec3, least: f64) -> f64 {
        let size = (self.axis.dot(place) + self.camera.translation().z) / self.focal;
        if size < least && self.camera.pixel_of(place).is_some() { size } else { least }
    }
}

/// What the fusion reads besides observations and estimates.
pub(crate) struct FusionColumns {
    /// Objects by distance in space, where the process noise is one per object.
    objects: Option<Vec<u32>>,
    /// Of the views at t.
    cameras: Vec<Camera>,
    /// (N) steps from t-2 to t-1 (m); zeros where they are not known.
    steps: Vec<DVec3>,
    /// Median size of a pixel at the Gaussians (m).
    pixel_m: f64,
}

impl FusionColumns {
    pub(crate) fn new(input: &MotionInput, dynamic: &Dynamic) -> Self {
        let mut pixel_m = pixel_sizes(input.previous, input.step.before.iter().map(|view| &view.camera));
        Self {
            objects: match input.config.fusion.q_mode {
                ProcessNoise::Global => None,
                ProcessNoise::PerObject => Some(spatial_objects(input.previous, &input.config.fusion.groups)),
            },
            cameras: input.step.now.iter().map(|view| view.camera).collect(),
            steps: dynamic
                .known_steps()
                .map_or_else(|| vec![DVec3::ZERO; input.previous.len()], <[DVec3]>::to_vec),
            pixel_m: typical_size(&mut pixel_m),
        }
    }

    pub(crate) fn input<'a>(
        &'a self,
        input: &'a MotionInput,
        observations: &'a [Observations],
        estimates: &'a [Estimates],
        dynamic: &'a Dynamic,
    ) -> FusionInput<'a> {
        FusionInput {
            prior_means: input.previous,
            prior_covariances: &dynamic.covariances,
            estimates,
            previous_steps: Some(&self.steps),
            groups: self.objects.as_deref(),
            last_q: dynamic.q,
            q_floor_m: input.config.fusion.q_floor_px * self.pixel_m,
            observed: Some(ViewObservations { cameras: &self.cameras, observations }),
            flexibility: dynamic.known_flexibility(),
        }
    }
}

/// Moves the layer to its posterior.
pub(crate) fn apply(input: &MotionInput, fused: Fused, dynamic: &mut Dynamic, log: &mut StageLog) {
    let start = Instant::now();
    let g = &mut dynamic.gaussians;
    g.means.iter_mut().zip(&fused.means).for_each(|(place, mean)| *place = mean.as_vec3().to_array());
    turn(g, &fused.rotations, input.config.association.rotate);
    dynamic.steps = fused.means.iter().zip(input.previous).map(|(now, before)| *now - *before).collect();
    let left = fused.group_of.iter().filter(|g| g.is_none()).count();
    log.skip("Gaussians that follow their neighbours rather than a rigid group", left);
    log.skip("Gaussians that no tracker measured", fused.measured.iter().filter(|m| !**m).count());
    dynamic.covariances = fused.covariances;
    dynamic.flexibility = fused.flexibility;
    dynamic.q = fused.q;
    log.since(stage::FUSION, start);
}
