//! Lines 3 to 19: what the trackers say of every Gaussian.

use super::fields::{motion_fields, selected_trackers};
use super::{MotionInput, MotionOutcome, add_seconds};
use crate::config::Config;
use anyhow::Result;
use ffgs_core::{Camera, DenseMotion, Gaussians, Observations};
use ffgs_rasterizer::{Background, CpuRasterizer, FootprintSums, RenderOptions, RenderTape, TileMask, View};
use ffgs_trainer::TrainingView;
use glam::{DVec2, DVec3};
use std::time::Instant;

/// Lines 3 to 19: motion fields view by view (so that memory does not grow with the views), agreement, association.
/// `inspect` sees each view's index and fields.
pub fn observe(
    input: &MotionInput,
    gaussians: &Gaussians,
    outcome: &mut MotionOutcome,
    inspect: &mut dyn FnMut(usize, &[DenseMotion]),
) -> Result<Vec<Observations>> {
    let trackers = selected_trackers(input, outcome);
    let n = gaussians.len();
    let mut observations = vec![Observations::unobserved(input.before.len(), n); trackers.len()];
    let mut joint = gaussians.clone();
    joint.extend(input.static_layer);
    let mut scratch = (RenderTape::default(), FootprintSums::default());
    let previous = outcome.previous.clone();
    for (v, view) in input.before.iter().enumerate().filter(|(_, view)| view.mask.count() > 0) {
        let fields = motion_fields(input, &trackers, v, &view.mask, outcome)?;
        inspect(v, &fields);
        let start = Instant::now();
        associate(input, view, &joint, &fields, &mut scratch);
        let at = ObservedView { config: input.config, camera: &view.camera, view: v, previous: &previous };
        at.fill(&scratch.1, &mut observations);
        add_seconds(&mut outcome.seconds.association, start);
    }
    Ok(observations)
}

/// Sums `alpha T` times mask, flow and confidence over every Gaussian's pixels: 1 + 3 channels a tracker.
fn associate(
    input: &MotionInput,
    view: &TrainingView,
    joint: &Gaussians,
    fields: &[DenseMotion],
    (tape, sums): &mut (RenderTape, FootprintSums),
) {
    let inside: Vec<f32> = view.mask.data().iter().map(|&m| f32::from(m)).collect();
    let mut channels = vec![inside.clone()];
    for field in fields {
        let floor = input.config.association.flow_floor_px;
        // A tracker that knows nothing at a pixel must not pull the mean displacement toward zero.
        let known = |p: usize| inside[p] * f32::from(field.confidence[p] > 0.0);
        let n = inside.len();
        channels.push((0..n).map(known).collect());
        channels.push((0..n).map(|p| known(p) * field.flow[p][0]).collect());
        channels.push((0..n).map(|p| known(p) * field.flow[p][1]).collect());
        let weight = |p: usize| field.confidence[p] * field.flow[p][0].hypot(field.flow[p][1]).max(floor);
        channels.push((0..n).map(|p| inside[p] * weight(p)).collect());
    }
    let channels: Vec<&[f32]> = channels.iter().map(Vec::as_slice).collect();
    let tiles = TileMask::covering(&view.mask);
    let frame = View { camera: &view.camera, background: Background::Colour([0.0; 3]), tiles: Some(&tiles) };
    let options = RenderOptions { antialiased: true, sh_degree: Some(0) };
    CpuRasterizer::new(options).accumulate(joint, &frame, &channels, tape, sums);
}

/// Channels a tracker takes in the footprint sums: coverage, flow x, flow y, weight.
const CHANNELS: usize = 4;

struct ObservedView<'a> {
    config: &'a Config,
    /// Camera at t - 1: the flow leads from its image to the image at t, camera motion included.
    camera: &'a Camera,
    view: usize,
    previous: &'a [DVec3],
}

impl ObservedView<'_> {
    fn fill(&self, sums: &FootprintSums, observations: &mut [Observations]) {
        let association = &self.config.association;
        for (i, &mean) in self.previous.iter().enumerate() {
            let values = sums.of(i);
            let Some(projection) = self.camera.project(mean) else { continue };
            if values[0] <= association.min_coverage || sums.hits(i) < association.min_hits {
                continue;
            }
            for (l, observation) in observations.iter_mut().enumerate() {
                let [coverage, x, y, weight] = [0, 1, 2, 3].map(|c| f64::from(values[1 + l * CHANNELS + c]));
                if coverage > f64::from(association.min_coverage) && weight > 0.0 {
                    let entry = self.view * observation.gaussians + i;
                    observation.targets[entry] = projection.pixel + DVec2::new(x, y) / coverage;
                    observation.weights[entry] = weight;
                }
            }
        }
    }
}
