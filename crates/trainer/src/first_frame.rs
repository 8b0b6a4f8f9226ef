//! Frame 0: static, dynamic and sky together, from points, trackside and initialisation views.

use crate::adam::LearningRates;
use crate::backend::{Around, LayerTask, LayerTraining, Revision, TrainBackend};
use crate::density_control::{DensityConfig, DensityControl, DensityPlan, Split, reset_opacities};
use crate::floaters::floaters;
use crate::hidden_sky::fill_hidden;
use crate::pyramid::Pyramid;
use crate::resolution::reduction;
use crate::schedule::{Epochs, Schedule, decay};
use crate::view::Progress;
use ffgs_core::{Gaussians, SkyCube, TrainingView};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Opacity to which all are lowered by a reset, as in 3DGS.
const RESET_OPACITY: f32 = 0.01;
/// Share of the steps after which no floaters are removed: what they showed is learnt by others in the steps that are left.
const LAST_CLEARING: f32 = 0.9;

/// How frame 0 is trained.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FirstFrameConfig {
    /// Steps, one view each; half of them where views are few.
    pub iterations: usize,
    /// SH degree of the colours (0..=3); one degree more is switched on at each tenth of the steps.
    pub sh_degree: usize,
    /// Whether Gaussians are drawn with the opacity compensation of Mip-Splatting, here and in all later frames.
    pub antialiased: bool,
    /// Position rate at the first step, as a share of the scene's extent.
    pub position_rate: f32,
    /// Position rate at the last step, likewise.
    pub position_rate_end: f32,
    /// Rate of log scales; half of it where views are few.
    pub scale_rate: f32,
    /// Rate of opacity logits.
    pub opacity_rate: f32,
    /// Rate of SH coefficients of degree 1 and above.
    pub sh_rest_rate: f32,
    /// Steps between two rounds of growth and removal; 0 = none.
    pub densify_every: usize,
    /// Growth begins and ends at these shares of the steps.
    pub densify_span: [f32; 2],
    /// Photographs are halved as often as splats keep this standard deviation in reduced pixels, as in
    /// [`ResolutionConfig`](crate::ResolutionConfig); 0 = never.
    pub coarse_splat_px: f32,
    /// Share of the steps after which all photographs are whole.
    pub coarse_until: f32,
    /// Mean gradient from which a Gaussian grows.
    pub grow_gradient: f32,
    /// Initial points from which training starts at most; 0 = all.
    pub max_points: usize,
    /// Number of Gaussians never exceeded by growth.
    pub max_gaussians: usize,
    /// Nor by growth, per pixel of all photographs together.
    pub gaussians_per_pixel: f32,
    /// Opacity below which a Gaussian in mid-air is removed in the rounds from the end of growth on; 0 = none is.
    pub floater_opacity: f32,
    /// Lower all opacities at this share of the steps; 0 = never.
    pub opacity_reset: f32,
    /// Rate of the sky's texels.
    pub sky_rate: f32,
    /// Share of the steps after which texels of the sky that no view sees get the colours that photographs show in their directions; 0 =
    /// they keep their first colour.
    pub hidden_sky: f32,
    /// Number of views that counts as few.
    pub few_views: usize,
    /// Share of the Gaussians that each step leaves out.
    pub dropout: f32,
    /// Whether Gaussians that a step does not draw go on by their momentum.
    pub coasting: bool,
    /// Whether differences of the cameras' exposures are removed from the photographs.
    pub exposures: bool,
}

impl Default for FirstFrameConfig {
    fn default() -> Self {
        Self {
            iterations: 2000,
            sh_degree: 3,
            antialiased: true,
            position_rate: 2e-4,
            position_rate_end: 2e-6,
            scale_rate: 3e-2,
            opacity_rate: 3e-2,
            sh_rest_rate: 3.75e-4,
            densify_every: 200,
            densify_span: [0.1, 0.6],
            coarse_splat_px: 1.5,
            coarse_until: 0.6,
            grow_gradient: 2e-4,
            max_points: 0,
            max_gaussians: 90_000,
            gaussians_per_pixel: 0.13,
            floater_opacity: 0.5,
            opacity_reset: 0.0,
            sky_rate: 5e-3,
            hidden_sky: 0.9,
            few_views: 12,
            dropout: 0.4,
            coasting: true,
            exposures: true,
        }
    }
}

impl FirstFrameConfig {
    /// For `views` photographs with `pixels` pixels together: with the share of `dropout` that they need, all of it where they are few
    /// and none with half as many again, with half of `scale_rate` (docs/adr/0070) and of the steps (docs/adr/0076) where they are few,
    /// and with no more Gaussians than they can tell apart.
    #[must_use]
    pub fn for_photographs(self, views: usize, pixels: usize) -> Self {
        let scarcity = (3.0 - 2.0 * views as f32 / self.few_views as f32).clamp(0.0, 1.0);
        let told_apart = (f64::from(self.gaussians_per_pixel) * pixels as f64) as usize;
        let shortened = |steps: usize| (steps as f32 * (1.0 - 0.5 * scarcity)).round() as usize;
        Self {
            iterations: shortened(self.iterations),
            dropout: self.dropout * scarcity,
            scale_rate: self.scale_rate * (1.0 - 0.5 * scarcity),
            max_gaussians: self.max_gaussians.min(told_apart.max(1)),
            ..self
        }
    }

    /// Whether step `done` may be taken on reduced photographs.
    fn may_be_coarse(&self, done: usize) -> bool {
        done < (self.coarse_until * self.iterations as f32) as usize
    }
}

/// The trained frame 0.
#[derive(Clone, Debug)]
pub struct FirstFrame {
    /// All Gaussians; the split into layers is made from the masks afterwards.
    pub gaussians: Gaussians,
    /// The sky.
    pub sky: SkyCube,
}

/// Trains frame 0 from `start`. `extent` is the radius of the training cameras (m).
///
/// # Errors
/// When the device fails or has too little memory.
pub fn train_first_frame<B: TrainBackend>(
    backend: &B,
    config: &FirstFrameConfig,
    views: &[TrainingView],
    start: FirstFrame,
    extent: f32,
    seed: u64,
    report: &mut dyn FnMut(Progress),
) -> Result<FirstFrame, B::Error> {
    if views.is_empty() || config.iterations == 0 {
        return Ok(start);
    }
    let FirstFrame { gaussians, mut sky } = start;
    let points = gaussians.len();
    let mut layer = Arc::new(gaussians);
    let around = Around::TrainedSky(&mut sky, config.sky_rate);
    let coarsest = if config.may_be_coarse(0) { reduction(config.coarse_splat_px, &layer, views) } else { 1 };
    let pyramid = &Pyramid::new(views, coarsest);
    let task = LayerTask {
        sums_gradients: true,
        coasts: config.coasting,
        ..LayerTask::new(&mut layer, pyramid.task_views(), around)
    };
    let mut training = backend.upload_layer(task)?;
    let density = DensityControl::new(density_config(config), seed);
    let mut rounds = Rounds { config, views, pyramid, extent, start: points, density };
    let schedule = Schedule {
        iterations: config.iterations,
        sh_degree: &|iteration| Some(iteration * 10 / config.iterations),
        dropout: config.dropout,
        // What stands beside a camera veils its photograph, and is thereby kept away from the cameras (docs/adr/0064).
        at_centres: true,
        rates: &|iteration| rates(config, iteration, extent),
        shown: &|view| pyramid.shown(view),
        ..Schedule::default()
    };
    schedule.run(
        &mut training,
        &mut Epochs::new(views.len(), seed),
        |done, training| rounds.after_step(done, training),
        report,
    )?;
    training.download()?;
    Ok(FirstFrame { gaussians: Arc::unwrap_or_clone(layer), sky })
}

/// Thresholds of the density control in frame 0.
fn density_config(config: &FirstFrameConfig) -> DensityConfig {
    DensityConfig {
        grow_gradient: config.grow_gradient,
        max_gaussians: config.max_gaussians,
        prune_scale: f32::INFINITY,
        split: Split::Halves,
        ..DensityConfig::default()
    }
}

fn rates(c: &FirstFrameConfig, iteration: usize, extent: f32) -> LearningRates {
    let rate = decay(c.position_rate, c.position_rate_end, iteration, c.iterations) * extent;
    LearningRates {
        scales: c.scale_rate,
        opacities: c.opacity_rate,
        sh_rest: c.sh_rest_rate,
        ..LearningRates::with_means(rate)
    }
}

/// Growth and removal of Gaussians, the resolution of photographs, the reset of opacities and the sky where it is hidden, at their steps.
struct Rounds<'a> {
    config: &'a FirstFrameConfig,
    views: &'a [TrainingView],
    pyramid: &'a Pyramid<'a>,
    extent: f32,
    /// Number of Gaussians at the first step.
    start: usize,
    density: DensityControl,
}

impl Rounds<'_> {
    /// How many Gaussians there may be after the round at step `done`: the limit is reached with the last round, so that early rounds, in which
    /// everything has large gradients, do not use it up.
    fn limit(&self, done: usize) -> usize {
        let c = self.config;
        let [from, to] = c.densify_span;
        let next = (done + c.densify_every) as f32 / c.iterations as f32;
        let share = if to > from { ((next - from) / (to - from)).clamp(0.0, 1.0) } else { 1.0 };
        let grown = self.start + (share * c.max_gaussians.saturating_sub(self.start) as f32) as usize;
        grown.min(c.max_gaussians)
    }

    fn after_step<L: LayerTraining>(&mut self, done: usize, training: &mut L) -> Result<(), L::Error> {
        let c = self.config;
        if done == (c.hidden_sky * c.iterations as f32) as usize {
            training.revise_sky(&mut |gaussians, sky| fill_hidden(sky, gaussians, self.views))?;
        }
        if !c.may_be_coarse(done) {
            self.pyramid.refine(1);
        }
        let share = done as f32 / c.iterations as f32;
        let reset_at = (c.opacity_reset * c.iterations as f32) as usize;
        let resets = reset_at > 0 && done == reset_at;
        let due = c.densify_every > 0 && done.is_multiple_of(c.densify_every);
        let grows = due && share >= c.densify_span[0] && share <= c.densify_span[1];
        let clears = due && c.floater_opacity > 0.0 && share >= c.densify_span[1] && share <= LAST_CLEARING;
        let refines = due && self.pyramid.is_reduced();
        if !(resets || grows || clears || refines) {
            return Ok(());
        }
        training.revise(&mut |gaussians, sums| {
            if resets {
                reset_opacities(gaussians, RESET_OPACITY);
            }
            let mut plan = DensityPlan::unchanged(gaussians.len());
            if grows {
                self.density.set_limit(self.limit(done));
                plan = self.density.plan(gaussians, sums, self.extent);
            }
            if clears {
                plan.remove(&floaters(gaussians, c.floater_opacity, self.views));
            }
            let map = (grows || clears).then(|| self.density.apply(&plan, gaussians));
            if refines {
                self.pyramid.refine(reduction(c.coarse_splat_px, gaussians, self.views));
            }
            Revision { map, opacities_reset: resets }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::CpuBackend;
    use crate::sky::sky_colour;
    use ffgs_core::{Camera, ImageRgb8, ImageSize, Intrinsics, Mask};

    #[test]
    fn what_few_views_need_ends_with_half_as_many_again() {
        let config = FirstFrameConfig {
            few_views: 12,
            iterations: 3000,
            dropout: 0.4,
            scale_rate: 0.5,
            ..FirstFrameConfig::default()
        };
        let of = |views: usize| {
            let config = config.for_photographs(views, 1000);
            (config.dropout, config.scale_rate, config.iterations)
        };
        let few = (0.4, 0.25, 1500);
        let expected = [few, few, (0.2, 0.375, 2250), (0.0, 0.5, 3000), (0.0, 0.5, 3000)];
        assert_eq!([3, 12, 15, 18, 40].map(of), expected);
        let never = FirstFrameConfig { few_views: 0, ..config };
        let never = [1, 3].map(|views| never.for_photographs(views, 1000));
        let needs = |config: FirstFrameConfig| (config.dropout, config.scale_rate, config.iterations);
        assert_eq!(never.map(needs), [(0.0, 0.5, 3000); 2]);
    }

    #[test]
    fn the_last_round_reaches_the_limit() {
        let config = FirstFrameConfig {
            iterations: 1000,
            densify_every: 100,
            densify_span: [0.1, 0.6],
            max_gaussians: 600,
            ..FirstFrameConfig::default()
        };
        let limits = |start: usize, config: &FirstFrameConfig| {
            let density = DensityControl::new(density_config(config), 1);
            let pyramid = &Pyramid::new(&[], 1);
            let rounds = Rounds { config, views: &[], pyramid, extent: 1.0, start, density };
            [100, 300, 500, 600].map(|done| rounds.limit(done))
        };
        assert_eq!(limits(100, &config), [200, 400, 600, 600]);
        assert_eq!(limits(700, &config), [600; 4], "no more than the limit, whatever there was");
        let at_once = FirstFrameConfig { densify_span: [0.3, 0.3], ..config };
        assert_eq!(limits(100, &at_once), [600; 4]);
    }

    #[test]
    fn few_pixels_tell_few_gaussians_apart() {
        let config = FirstFrameConfig {
            max_gaussians: 1000,
            gaussians_per_pixel: 0.25,
            ..FirstFrameConfig::default()
        };
        let limits = [0, 400, 4000, 1 << 40].map(|pixels| config.for_photographs(8, pixels).max_gaussians);
        assert_eq!(limits, [1, 100, 1000, 1000]);
    }

    #[test]
    fn what_a_view_does_not_see_coasts_or_stays() {
        let size = ImageSize { width: 24, height: 16 };
        let intrinsics = Intrinsics { fx: 20.0, fy: 20.0, cx: 12.0, cy: 8.0 };
        let towards = |yaw: f64| TrainingView {
            camera: Camera::new(intrinsics, glam::DMat4::from_rotation_y(yaw), size).unwrap(),
            image: ImageRgb8::new(size, vec![51; 3 * size.pixels()]).unwrap(),
            mask: Mask::filled(size, false),
        };
        let views = [towards(0.0), towards(std::f64::consts::PI)];
        let start = crate::from_points(&[[0.0, 0.0, 2.0]], &[[0.9; 3]], 0, 0.5);
        // One view sees the Gaussian, the other has its back to it.
        let moved_by = |coasting: bool| {
            let config = FirstFrameConfig { iterations: 10, coasting, ..FirstFrameConfig::default() };
            let start = FirstFrame { gaussians: start.clone(), sky: SkyCube::filled(8, [0.2; 3]) };
            let Ok(trained) =
                train_first_frame(&CpuBackend, &config, &views, start.clone(), 1.0, 1, &mut |_| {});
            (trained.gaussians.sh[0][0] - start.gaussians.sh[0][0]).abs()
        };
        let (coasting, stays) = (moved_by(true), moved_by(false));
        assert!(stays > 0.0 && coasting > 1.3 * stays, "{coasting} and {stays}");
    }

    #[test]
    fn large_splats_are_trained_on_reduced_photographs_until_the_end_of_these() {
        let size = ImageSize { width: 48, height: 32 };
        let intrinsics = Intrinsics { fx: 40.0, fy: 40.0, cx: 24.0, cy: 16.0 };
        let stripes = |i: usize| [u8::from(i % 48 % 8 < 3) * 200; 3];
        let view = TrainingView {
            camera: Camera::new(intrinsics, glam::DMat4::IDENTITY, size).unwrap(),
            image: ImageRgb8::new(size, (0..size.pixels()).flat_map(stripes).collect()).unwrap(),
            mask: Mask::filled(size, false),
        };
        let mut start = crate::from_points(&[[0.0, 0.0, 2.0]], &[[0.9; 3]], 0, 0.5);
        // Six pixels: as large as one and a half of blocks of 4.
        start.log_scales.fill([0.3_f32.ln(); 3]);
        let trained = |view: &TrainingView, coarse_splat_px: f32, coarse_until: f32| {
            let (iterations, hidden_sky) = (10, 0.0);
            let config = FirstFrameConfig {
                iterations,
                coarse_splat_px,
                coarse_until,
                hidden_sky,
                ..Default::default()
            };
            let start = FirstFrame { gaussians: start.clone(), sky: SkyCube::filled(8, [0.2; 3]) };
            let views = std::slice::from_ref(view);
            let Ok(trained) = train_first_frame(&CpuBackend, &config, views, start, 1.0, 1, &mut |_| {});
            trained.gaussians
        };
        let (whole, reduced) = (trained(&view, 0.0, 1.0), trained(&view.reduced(4), 0.0, 1.0));
        assert_ne!(whole, reduced);
        assert_eq!(trained(&view, 1.0, 1.0), reduced);
        assert_eq!(trained(&view, 1.0, 0.0), whole);
        let half = trained(&view, 1.0, 0.5);
        assert!(half != whole && half != reduced, "five steps each");
    }

    #[test]
    fn the_sky_behind_the_camera_is_filled_or_stays() {
        let size = ImageSize { width: 24, height: 16 };
        let intrinsics = Intrinsics { fx: 20.0, fy: 20.0, cx: 12.0, cy: 8.0 };
        let view = TrainingView {
            camera: Camera::new(intrinsics, glam::DMat4::IDENTITY, size).unwrap(),
            image: ImageRgb8::new(size, vec![51; 3 * size.pixels()]).unwrap(),
            mask: Mask::filled(size, false),
        };
        let behind_after = |hidden_sky: f32| {
            let config = FirstFrameConfig { iterations: 10, hidden_sky, ..FirstFrameConfig::default() };
            let start = FirstFrame {
                gaussians: crate::from_points(&[[0.0, 0.0, 2.0]], &[[0.2; 3]], 0, 0.5),
                sky: SkyCube::filled(8, [0.9; 3]),
            };
            let views = std::slice::from_ref(&view);
            let Ok(trained) = train_first_frame(&CpuBackend, &config, views, start, 1.0, 1, &mut |_| {});
            sky_colour(&trained.sky, glam::Vec3::NEG_Z)[0]
        };
        assert_eq!(behind_after(0.0), 0.9);
        assert!((behind_after(0.9) - 0.2).abs() < 1e-3, "{}", behind_after(0.9));
    }
}
