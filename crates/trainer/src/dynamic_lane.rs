//! The dynamic lane: all parameters of the moving Gaussians, at a cost proportional to the foreground.
//!
//! Per view the static layer and the sky are rendered once, cut at the depth of the moving layer (docs/adr/0003):
//! image = front + T_front (dynamic over behind). A step then touches only the moving Gaussians and the tiles under
//! the dilated mask.

use crate::backend::{Around, CutLayers, LayerTask, TaskView, TrainBackend};
use crate::layer_lane::train_layer;
use crate::lengths::{TILE_DILATION, pixel_length};
use crate::prior::Prior;
use crate::rates::LearningRates;
use crate::rates::decay;
use crate::schedule::{Epochs, Schedule};
use crate::view::Progress;
use ffgs_core::{Gaussians, SkyCube, TrainingView};
use ffgs_rasterizer::TileMask;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// How the dynamic layer is finetuned each frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DynamicLaneConfig {
    /// Steps per frame, one view each (N_dyn); fewer once the layer has settled.
    pub iterations: usize,
    /// Of the steps that are left every other one is taken as soon as moving the Gaussians promises less than this (nats per Gaussian,
    /// by the last derivatives and the information; natural steps only); 0 = all steps are taken.
    pub settled: f64,
    /// Share of the way to the minimum that a step goes along the natural gradient, at the first step; 0 = steps of Adam, of
    /// which about three times as many are needed. The rates below then limit each step to three times their values.
    pub natural_step: f32,
    /// The share at the last step.
    pub natural_step_end: f32,
    /// Position rate at the first step, in pixels: times [`pixel_length`].
    pub position_rate_px: f32,
    /// Position rate at the last step, likewise.
    pub position_rate_end_px: f32,
    /// Rate of quaternions.
    pub quat_rate: f32,
    /// Rate of log scales.
    pub scale_rate: f32,
    /// Rate of opacity logits.
    pub opacity_rate: f32,
    /// Rate of SH coefficient 0.
    pub sh0_rate: f32,
    /// Rate of the other SH coefficients.
    pub sh_rest_rate: f32,
    /// Pixels by which the mask is grown for the loss, so that silhouettes are learnt from both sides.
    pub loss_dilation: usize,
    /// Weight of the mean alpha outside the mask: keeps floaters away.
    pub outside_alpha: f32,
    /// Weight of what earlier frames know; 1 = as their information says, 0 = nothing is kept. The diagonal counts what
    /// neighbours that overlap share as known of each, so it claims too much.
    pub prior_weight: f32,
    /// Least change of a parameter from frame to frame (standard deviation): turns (rad), log scales, opacity logits, SH
    /// coefficient 0, the others.
    pub drift: [f64; 5],
}

impl Default for DynamicLaneConfig {
    fn default() -> Self {
        Self {
            iterations: 100,
            settled: 0.01,
            natural_step: 0.2,
            natural_step_end: 0.03,
            position_rate_px: 0.2,
            position_rate_end_px: 0.006,
            quat_rate: 1e-3,
            scale_rate: 5e-3,
            opacity_rate: 1e-2,
            sh0_rate: 2.5e-3,
            sh_rest_rate: 1.25e-4,
            loss_dilation: 1,
            outside_alpha: 0.05,
            prior_weight: 0.1,
            drift: [0.02, 0.04, 0.1, 0.04, 0.02],
        }
    }
}

impl DynamicLaneConfig {
    fn natural_step(&self, iteration: usize) -> f32 {
        if self.natural_step == 0.0 {
            return 0.0;
        }
        decay(self.natural_step, self.natural_step_end, iteration, self.iterations)
    }

    fn position_rate_px(&self, iteration: usize) -> f32 {
        decay(self.position_rate_px, self.position_rate_end_px, iteration, self.iterations)
    }

    /// Step sizes at a step, where a pixel is `pixel` (m) large.
    pub fn rates(&self, iteration: usize, pixel: f32) -> LearningRates {
        LearningRates {
            means: self.position_rate_px(iteration) * pixel,
            quats: self.quat_rate,
            scales: self.scale_rate,
            opacities: self.opacity_rate,
            sh0: self.sh0_rate,
            sh_rest: self.sh_rest_rate,
        }
    }
}

/// What stays fixed while the dynamic layer is trained.
#[derive(Clone, Copy, Debug)]
pub struct Surroundings<'a> {
    /// The static layer.
    pub static_layer: &'a Arc<Gaussians>,
    /// The sky.
    pub sky: &'a SkyCube,
    /// What is known of the dynamic layer; `None` = nothing.
    pub prior: Option<Prior<'a>>,
}

/// Finetunes `dynamic` on the foreground of `views`, and says in how many steps. Views without foreground are not used; with none
/// left, or no Gaussians, nothing changes.
///
/// # Errors
/// When the device fails or has too little memory; `dynamic` is then as it was.
pub fn train_dynamic<B: TrainBackend>(
    backend: &B,
    config: &DynamicLaneConfig,
    views: &[TrainingView],
    surroundings: Surroundings,
    dynamic: &mut Gaussians,
    seed: u64,
    report: &mut dyn FnMut(Progress),
) -> Result<usize, B::Error> {
    let views: Vec<TaskView> =
        views.iter().filter(|v| v.mask.count() > 0).map(|v| task_view(config, v)).collect();
    if dynamic.is_empty() || config.iterations == 0 || views.is_empty() {
        return Ok(0);
    }
    let pixel = pixel_length(dynamic, views.iter().map(|v| &v.view.camera));
    let mut layer = Arc::new(std::mem::take(dynamic));
    let around = Around::Cut(CutLayers {
        static_layer: surroundings.static_layer,
        sky: surroundings.sky,
        outside_alpha: config.outside_alpha,
    });
    let task = LayerTask { prior: surroundings.prior, ..LayerTask::new(&mut layer, views, around) };
    let schedule = Schedule {
        iterations: config.iterations,
        rates: &|iteration| config.rates(iteration, pixel),
        natural: &|iteration| config.natural_step(iteration),
        settled: config.settled,
        ..Schedule::default()
    };
    let order = order(config.natural_step > 0.0 && task.prior.is_some(), &task.views, seed);
    let trained = train_layer(backend, task, &schedule, &order, report);
    *dynamic = Arc::unwrap_or_clone(layer);
    trained
}

/// A view tells as much as it has pixels that count; steps of Adam are as long whatever it tells (docs/adr/0081).
fn order(natural: bool, views: &[TaskView], seed: u64) -> Epochs {
    let pixels: Vec<f64> = views.iter().map(|view| view.pixels() as f64).collect();
    if natural { Epochs::weighted(&pixels, seed) } else { Epochs::new(views.len(), seed) }
}

fn task_view<'a>(config: &DynamicLaneConfig, view: &'a TrainingView) -> TaskView<'a> {
    let region = view.mask.widened(config.loss_dilation);
    // A region that reaches beyond the usual tiles takes its own.
    let tiles = TileMask::covering(&view.mask.widened(TILE_DILATION.max(config.loss_dilation)));
    TaskView { view, region: Some(region), tiles: Some(tiles) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ffgs_core::{Camera, ImageRgb8, ImageSize, Intrinsics, Mask};
    use glam::DMat4;

    #[test]
    fn natural_steps_see_a_view_as_often_as_it_has_pixels_that_count() {
        let size = ImageSize { width: 8, height: 6 };
        let intrinsics = Intrinsics { fx: 8.0, fy: 8.0, cx: 4.0, cy: 3.0 };
        let view = TrainingView {
            camera: Camera::new(intrinsics, DMat4::IDENTITY, size).unwrap(),
            image: ImageRgb8::new(size, vec![0; 144]).unwrap(),
            mask: Mask::filled(size, true),
        };
        let first = |count: usize| Mask::new(size, (0..48).map(|i| u8::from(i < count)).collect()).unwrap();
        let views = [30, 10].map(|count| TaskView::of_region(&view, first(count)));
        let drawn = |natural: bool| {
            let mut order = order(natural, &views, 1);
            let second: usize = (0..400).map(|_| order.draw().unwrap()).sum();
            [400 - second, second]
        };
        assert_eq!((drawn(true), drawn(false)), ([300, 100], [200, 200]));
    }
}
