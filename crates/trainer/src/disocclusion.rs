//! Disocclusion: static Gaussians that a moving thing hid so far are trained in full where they come to light.
//!
//! Frame 0 knows nothing of what all of its views had behind the moving layer: the ground under a car is a hole, or
//! rubble. The static layer's shape is otherwise fixed, so both would stay for ever. Here the Gaussians that few views
//! have seen are optimised with all their parameters, against the pixels that they cover. The moving layer is drawn along,
//! as it is: were its pixels left out, what stands beside it would grow into its place.

use crate::backend::TrainBackend;
use crate::lengths::robust_extent;
use crate::rates::LearningRates;
use crate::rates::decay;
use crate::schedule::Schedule;
use crate::subset::{Subset, shown, train_subset};
use crate::view::Progress;
use ffgs_core::{Gaussians, Mask, SkyCube, TrainingView};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// How static Gaussians that were hidden are trained.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DisocclusionConfig {
    /// Whether the surfaces around what moves are continued behind it in the first frame.
    pub continued: bool,
    /// Frames from one round to the next. A stream sends the static layer again after each.
    pub every: usize,
    /// Steps per round, one view each; 0 = the static layer keeps its shape.
    pub iterations: usize,
    /// Rounds in which a Gaussian is trained once half of the views that could see it do.
    pub rounds: usize,
    /// Position rate at the first step, as a share of the extent of what was hidden.
    pub position_rate: f32,
    /// Position rate at the last step, likewise.
    pub position_rate_end: f32,
    /// Rate of log scales.
    pub scale_rate: f32,
    /// Rate of opacity logits.
    pub opacity_rate: f32,
    /// Rate of SH coefficient 0.
    pub sh0_rate: f32,
    /// Rate of the other SH coefficients.
    pub sh_rest_rate: f32,
}

impl Default for DisocclusionConfig {
    fn default() -> Self {
        Self {
            continued: true,
            every: 4,
            iterations: 120,
            rounds: 2,
            position_rate: 2e-4,
            position_rate_end: 1e-5,
            scale_rate: 1.5e-2,
            opacity_rate: 5e-2,
            sh0_rate: 1e-2,
            sh_rest_rate: 5e-4,
        }
    }
}

impl DisocclusionConfig {
    fn rates(&self, iteration: usize, extent: f32) -> LearningRates {
        let rate = decay(self.position_rate, self.position_rate_end, iteration, self.iterations);
        LearningRates {
            scales: self.scale_rate,
            opacities: self.opacity_rate,
            sh0: self.sh0_rate,
            sh_rest: self.sh_rest_rate,
            ..LearningRates::with_means(rate * extent)
        }
    }
}

/// What is trained, what is drawn with it, and what both are compared with.
#[derive(Clone, Copy, Debug)]
pub struct Disoccluded<'a> {
    /// Indices of the static Gaussians that are trained.
    pub gaussians: &'a [usize],
    /// The moving layer at t, which may stand before them.
    pub moving: &'a Gaussians,
    /// Photographs at t.
    pub views: &'a [TrainingView],
    /// Behind everything.
    pub sky: &'a SkyCube,
}

/// Trains some Gaussians of `layer`, the others stay as they are. Returns whether any view showed them: if not, nothing
/// has changed.
///
/// # Errors
/// When the device fails or has too little memory; `layer` is then as it was.
pub fn train_disoccluded<B: TrainBackend>(
    backend: &B,
    config: &DisocclusionConfig,
    what: Disoccluded,
    layer: &mut Arc<Gaussians>,
    seed: u64,
    report: &mut dyn FnMut(Progress),
) -> Result<bool, B::Error> {
    let found = layer.select(what.gaussians);
    if found.is_empty() || config.iterations == 0 {
        return Ok(false);
    }
    let regions: Vec<Mask> = what.views.par_iter().map(|view| shown(view, &found)).collect();
    // Everything is drawn, as it will be; what stays comes first.
    let mut fixed = layer.select(&rest(layer.len(), what.gaussians));
    fixed.extend(what.moving);
    let extent = robust_extent(&found);
    let schedule = Schedule {
        iterations: config.iterations,
        rates: &|iteration| config.rates(iteration, extent),
        ..Schedule::default()
    };
    let subset = Subset { fixed, trained: found, views: what.views, regions, sky: what.sky };
    let Some(trained) = train_subset(backend, &schedule, subset, seed, report)? else { return Ok(false) };
    let layer = Arc::make_mut(layer);
    for (from, &to) in what.gaussians.iter().enumerate() {
        layer.set_from(to, &trained, from);
    }
    Ok(true)
}

/// The numbers to `count` that are not in `found`.
fn rest(count: usize, found: &[usize]) -> Vec<usize> {
    let mut is_found = vec![false; count];
    found.iter().for_each(|&i| is_found[i] = true);
    (0..count).filter(|&i| !is_found[i]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{CpuBackend, from_points};
    use ffgs_core::{Camera, ImageRgb8, ImageSize, Intrinsics};
    use ffgs_rasterizer::{Background, CpuRasterizer, RenderTape, View};
    use glam::DMat4;

    const SIZE: ImageSize = ImageSize { width: 64, height: 48 };

    fn camera(x: f64) -> Camera {
        let intrinsics = Intrinsics { fx: 50.0, fy: 50.0, cx: 32.0, cy: 24.0 };
        let pose = DMat4::from_translation(glam::DVec3::new(x, 0.0, 0.0));
        Camera::new(intrinsics, pose, SIZE).unwrap()
    }

    fn drawn(camera: &Camera, layer: &Gaussians) -> ImageRgb8 {
        let frame = View { camera, background: Background::Colour([0.5; 3]), tiles: None };
        let mut tape = RenderTape::default();
        CpuRasterizer::default().render(layer, &frame, &mut tape);
        let bytes = (0..SIZE.pixels()).flat_map(|p| tape.image().pixel(p).map(|v| (v * 255.0).round() as u8));
        ImageRgb8::new(SIZE, bytes.collect()).unwrap()
    }

    /// A wall of which a patch is rubble: Gaussians at other places, of other colours.
    #[test]
    fn rubble_becomes_what_the_photographs_show_and_the_rest_stays() {
        let points: Vec<[f32; 3]> =
            (0..1200).map(|i| [(i % 40) as f32 * 0.1 - 1.95, (i / 40) as f32 * 0.1 - 1.45, 3.0]).collect();
        let colours: Vec<[f32; 3]> = (0..1200).map(|i| [0.2 + 0.015 * (i % 40) as f32, 0.6, 0.3]).collect();
        let truth = from_points(&points, &colours, 1, 0.9);
        let patch: Vec<usize> =
            (0..1200).filter(|&i| points[i][0].abs() < 0.5 && points[i][1].abs() < 0.4).collect();
        let mut rubble = truth.clone();
        for (k, &i) in patch.iter().enumerate() {
            rubble.means[i][2] -= 0.1 * (k % 4) as f32;
            let stride = rubble.sh_stride();
            rubble.sh[i * stride] = [1.5, -1.5, 1.5];
        }
        let sky = SkyCube::filled(8, [0.5; 3]);
        let views: Vec<TrainingView> = [-0.4, 0.0, 0.4]
            .map(|x| {
                let camera = camera(x);
                TrainingView { camera, image: drawn(&camera, &truth), mask: Mask::filled(SIZE, false) }
            })
            .into();
        let error = |layer: &Gaussians| {
            let of = |v: &TrainingView| {
                let shown = drawn(&v.camera, layer);
                let pairs = shown.data().iter().zip(v.image.data());
                pairs.map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2)).sum::<f64>()
            };
            views.iter().map(of).sum::<f64>()
        };
        let none = Gaussians::zeros(0, 1);
        let what = Disoccluded { gaussians: &patch, moving: &none, views: &views, sky: &sky };
        let config = DisocclusionConfig { iterations: 150, ..DisocclusionConfig::default() };
        let mut layer = Arc::new(rubble.clone());
        let changed = train_disoccluded(&CpuBackend, &config, what, &mut layer, 1, &mut |_| {}).unwrap();
        assert!(changed);
        let [before, after] = [&rubble, &*layer].map(error);
        assert!(after < 0.1 * before, "{before} to {after}");
        let rest: Vec<usize> = (0..1200).filter(|i| !patch.contains(i)).collect();
        assert!(layer.select(&rest) == rubble.select(&rest));

        // Behind the cameras nothing comes to light.
        patch.iter().for_each(|&i| rubble.means[i][2] = -3.0);
        let mut layer = Arc::new(rubble.clone());
        let changed = train_disoccluded(&CpuBackend, &config, what, &mut layer, 1, &mut |_| {}).unwrap();
        assert!(!changed && *layer == rubble);
    }

    /// What the moving layer shows is not to be explained by what stands beside it.
    #[test]
    fn the_moving_layer_is_drawn_along() {
        let disc = |z: f32, colour: [f32; 3]| from_points(&[[0.0, 0.0, z]], &[colour], 0, 0.95);
        let mut moving = disc(2.0, [0.9, 0.1, 0.1]);
        moving.log_scales.fill([0.3_f32.ln(); 3]);
        let mut standing = disc(2.2, [0.1, 0.1, 0.9]);
        standing.log_scales.fill([0.35_f32.ln(); 3]);
        let mut joint = standing.clone();
        joint.extend(&moving);
        let sky = SkyCube::filled(8, [0.5; 3]);
        let views: Vec<TrainingView> = [-0.4, 0.0, 0.4]
            .map(|x| TrainingView {
                camera: camera(x),
                image: drawn(&camera(x), &joint),
                mask: Mask::filled(SIZE, false),
            })
            .into();
        let red_after = |moving: &Gaussians| {
            let what = Disoccluded { gaussians: &[0], moving, views: &views, sky: &sky };
            let mut layer = Arc::new(standing.clone());
            let config = DisocclusionConfig::default();
            train_disoccluded(&CpuBackend, &config, what, &mut layer, 1, &mut |_| {}).unwrap();
            layer.sh[0][0] - standing.sh[0][0]
        };
        let (with, without) = (red_after(&moving), red_after(&Gaussians::zeros(0, 0)));
        assert!(with.abs() < 0.1 && without > 0.5, "redder by {with}, and by {without} when it is left out");
    }
}
