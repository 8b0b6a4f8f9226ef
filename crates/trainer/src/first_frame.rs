//! Frame 0: static, dynamic and sky together, from points, trackside and initialisation views.

use crate::backend::{Around, LayerTask, LayerTraining, Revision, TrainBackend};
use crate::density_control::{DensityConfig, DensityControl, DensityPlan, Split, reset_opacities};
use crate::floaters::floaters;
use crate::hidden_sky::fill_hidden;
use crate::pyramid::Pyramid;
use crate::rates::{LearningRates, cool_down, decay};
use crate::resolution::reduction;
use crate::schedule::{Epochs, Schedule};
use crate::view::Progress;
use ffgs_core::{Gaussians, SkyCube, StageLog, TrainingView};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Opacity to which all are lowered by a reset, as in 3DGS.
const RESET_OPACITY: f32 = 0.01;
/// Share of the steps after which no floaters are removed: what they showed is learnt by others in the steps that are left.
const LAST_CLEARING: f32 = 0.9;
/// Share of the steps that are taken where views are few.
const FEW_STEPS: f32 = 0.35;
/// Share of the steps after which exposures are compared on the surfaces that there are.
const SURFACES: f32 = 0.6;
/// Steps per photograph before which there are none.
const LEAST_STEPS: usize = 2;

/// How frame 0 is trained.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FirstFrameConfig {
    /// Steps, one view each; 35 % of them where views are few.
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
    /// Share of the steps, the last ones, over which all rates of Gaussians fall to zero; none where views are few.
    pub cool_down: f32,
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
            cool_down: 0.3,
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
    /// and none with half as many again, with half of `scale_rate` (docs/adr/0070), 35 % of the steps (docs/adr/0076) and no `cool_down` (docs/adr/0089)
    /// where they are few, and with no more Gaussians than they can tell apart.
    #[must_use]
    pub fn for_photographs(self, views: usize, pixels: usize) -> Self {
        let scarcity = (3.0 - 2.0 * views as f32 / self.few_views as f32).clamp(0.0, 1.0);
        let told_apart = (f64::from(self.gaussians_per_pixel) * pixels as f64) as usize;
        let shortened = |steps: usize| (steps as f32 * (1.0 - (1.0 - FEW_STEPS) * scarcity)).round() as usize;
        Self {
            iterations: shortened(self.iterations),
            dropout: self.dropout * scarcity,
            scale_rate: self.scale_rate * (1.0 - 0.5 * scarcity),
            cool_down: self.cool_down * (1.0 - scarcity),
            max_gaussians: self.max_gaussians.min(told_apart.max(1)),
            ..self
        }
    }

    /// The step after which the surfaces show the exposures of so many photographs; `None` where no step does.
    fn surfaces_after(&self, views: usize) -> Option<usize> {
        let at = (SURFACES * self.iterations as f32) as usize;
        (at >= LEAST_STEPS * views).then_some(at)
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

/// What frame 0 is trained from.
pub struct FirstFrameTask<'a> {
    /// Photographs.
    pub views: &'a [TrainingView],
    /// Gaussians at the initial points, and a sky.
    pub start: FirstFrame,
    /// Radius of the training cameras (m).
    pub extent: f32,
    /// Of the order of the views, and of the growth.
    pub seed: u64,
}

/// Given the Gaussians of a first frame on its way: photographs that cameras of one exposure would have taken; `None` where the photographs
/// are to stay as they are.
pub type Equalise<'a> = &'a mut dyn FnMut(&Gaussians) -> Option<Vec<TrainingView>>;

/// Trains frame 0. `equalise` is asked once, as soon as there are surfaces to compare the colours of photographs on, and never where there
/// are too few steps for that; the steps that are left are taken on its photographs. Floaters that are removed are counted in `log`.
///
/// # Errors
/// When the device fails or has too little memory.
pub fn train_first_frame<B: TrainBackend>(
    backend: &B,
    config: &FirstFrameConfig,
    task: FirstFrameTask,
    equalise: Equalise,
    log: &mut StageLog,
    report: &mut dyn FnMut(Progress),
) -> Result<FirstFrame, B::Error> {
    let FirstFrameTask { views, start, extent, seed } = task;
    if views.is_empty() || config.iterations == 0 {
        return Ok(start);
    }
    let points = start.gaussians.len();
    let density = DensityControl::new(density_config(config), seed);
    let order = Epochs::new(views.len(), seed);
    let mut course = Course { config, extent, points, density, order, log };
    let look = config.surfaces_after(views.len()).map(|step| (step, equalise));
    match course.steps(backend, views, (0, start), look, report)? {
        (trained, None) => Ok(trained),
        (begun, Some((step, equal))) => Ok(course.steps(backend, &equal, (step, begun), None, report)?.0),
    }
}

/// The step after which a training goes on with other photographs, and these.
type Change = (usize, Vec<TrainingView>);

/// The course of a training.
struct Course<'a> {
    config: &'a FirstFrameConfig,
    extent: f32,
    /// Number of Gaussians at the first step.
    points: usize,
    density: DensityControl,
    order: Epochs,
    log: &'a mut StageLog,
}

impl Course<'_> {
    /// Takes the steps after the first `done` ones, on `views`. After the step of `look` it asks whether to go on with other photographs; if
    /// so, it ends there, with these.
    fn steps<B: TrainBackend>(
        &mut self,
        backend: &B,
        views: &[TrainingView],
        (done, begun): (usize, FirstFrame),
        look: Option<(usize, Equalise)>,
        report: &mut dyn FnMut(Progress),
    ) -> Result<(FirstFrame, Option<Change>), B::Error> {
        let Self { config, extent, points, density, order, log } = self;
        let (config, extent, points) = (*config, *extent, *points);
        let FirstFrame { gaussians, mut sky } = begun;
        let mut layer = Arc::new(gaussians);
        let around = Around::TrainedSky(&mut sky, config.sky_rate);
        let coarse = config.may_be_coarse(done);
        let coarsest = if coarse { reduction(config.coarse_splat_px, &layer, views) } else { 1 };
        let pyramid = &Pyramid::new(views, coarsest);
        let task = LayerTask {
            sums_gradients: true,
            coasts: config.coasting,
            ..LayerTask::new(&mut layer, pyramid.task_views(), around)
        };
        let mut training = backend.upload_layer(task)?;
        let mut rounds = Rounds { config, views, pyramid, extent, points, density, log };
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
        let mut take = |part, training: &mut B::Layer<'_>| {
            let after = |done, training: &mut B::Layer<'_>| rounds.after_step(done, training);
            schedule.run_part(part, training, order, after, report)
        };
        let looked_at = look.as_ref().map_or(done, |(step, _)| *step);
        take(done..looked_at, &mut training)?;
        let mut equal = None;
        if let Some((step, equalise)) = look {
            training
                .revise_sky(&mut |gaussians, _| equal = equalise(gaussians).map(|views| (step, views)))?;
        }
        if equal.is_none() {
            take(looked_at..config.iterations, &mut training)?;
        }
        training.download()?;
        Ok((FirstFrame { gaussians: Arc::unwrap_or_clone(layer), sky }, equal))
    }
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
    .scaled(cool_down(c.cool_down, iteration, c.iterations))
}

/// Growth and removal of Gaussians, the resolution of photographs, the reset of opacities and the sky where it is hidden, at their steps.
struct Rounds<'a> {
    config: &'a FirstFrameConfig,
    views: &'a [TrainingView],
    pyramid: &'a Pyramid<'a>,
    extent: f32,
    /// Number of Gaussians at the first step.
    points: usize,
    density: &'a mut DensityControl,
    log: &'a mut StageLog,
}

impl Rounds<'_> {
    /// How many Gaussians there may be after the round at step `done`: the limit is reached with the last round, so that early rounds, in which
    /// everything has large gradients, do not use it up.
    fn limit(&self, done: usize) -> usize {
        let c = self.config;
        let [from, to] = c.densify_span;
        let next = (done + c.densify_every) as f32 / c.iterations as f32;
        let share = if to > from { ((next - from) / (to - from)).clamp(0.0, 1.0) } else { 1.0 };
        let grown = self.points + (share * c.max_gaussians.saturating_sub(self.points) as f32) as usize;
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
                let before = plan.removed();
                plan.remove(&floaters(gaussians, c.floater_opacity, self.views));
                self.log.change("removed: in mid-air", plan.removed() - before);
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

    /// On the CPU, of photographs that stay as they are.
    fn trained(config: &FirstFrameConfig, views: &[TrainingView], start: FirstFrame) -> FirstFrame {
        let task = FirstFrameTask { views, start, extent: 1.0, seed: 1 };
        let Ok(trained) = train_first_frame(
            &CpuBackend,
            config,
            task,
            &mut |_| None,
            &mut StageLog::default(),
            &mut |_| {},
        );
        trained
    }

    #[test]
    fn what_few_views_need_ends_with_half_as_many_again() {
        let config = FirstFrameConfig {
            few_views: 12,
            iterations: 3000,
            dropout: 0.4,
            scale_rate: 0.5,
            cool_down: 0.5,
            ..FirstFrameConfig::default()
        };
        let needs = |c: FirstFrameConfig| (c.dropout, c.scale_rate, c.cool_down, c.iterations);
        let of = |views: usize| needs(config.for_photographs(views, 1000));
        let (few, many) = ((0.4, 0.25, 0.0, 1050), (0.0, 0.5, 0.5, 3000));
        assert_eq!([3, 12, 15, 18, 40].map(of), [few, few, (0.2, 0.375, 0.25, 2025), many, many]);
        let never = FirstFrameConfig { few_views: 0, ..config };
        assert_eq!([1, 3].map(|views| needs(never.for_photographs(views, 1000))), [many; 2]);
    }

    #[test]
    fn the_last_steps_are_small() {
        let config = FirstFrameConfig { iterations: 100, cool_down: 0.3, ..FirstFrameConfig::default() };
        let always = FirstFrameConfig { cool_down: 0.0, ..config };
        let share = |done: usize| rates(&config, done, 1.0).scales / rates(&always, done, 1.0).scales;
        assert_eq!((share(0), share(69)), (1.0, 1.0));
        assert!((share(84) - 0.5).abs() < 0.03 && share(99) < 0.02, "{} and {}", share(84), share(99));
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
        let limits = |points: usize, config: &FirstFrameConfig| {
            let density = &mut DensityControl::new(density_config(config), 1);
            let pyramid = &Pyramid::new(&[], 1);
            let log = &mut StageLog::default();
            let rounds = Rounds { config, views: &[], pyramid, extent: 1.0, points, density, log };
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
            let trained = trained(&config, &views, start.clone());
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
        let layer = |view: &TrainingView, coarse_splat_px: f32, coarse_until: f32| {
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
            trained(&config, views, start).gaussians
        };
        let (whole, reduced) = (layer(&view, 0.0, 1.0), layer(&view.reduced(4), 0.0, 1.0));
        assert_ne!(whole, reduced);
        assert_eq!(layer(&view, 1.0, 1.0), reduced);
        assert_eq!(layer(&view, 1.0, 0.0), whole);
        let half = layer(&view, 1.0, 0.5);
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
            let trained = trained(&config, views, start);
            sky_colour(&trained.sky, glam::Vec3::NEG_Z)[0]
        };
        assert_eq!(behind_after(0.0), 0.9);
        assert!((behind_after(0.9) - 0.2).abs() < 1e-3, "{}", behind_after(0.9));
    }

    #[test]
    fn exposures_are_compared_once_and_the_training_goes_on_with_equal_photographs() {
        let size = ImageSize { width: 24, height: 16 };
        let intrinsics = Intrinsics { fx: 20.0, fy: 20.0, cx: 12.0, cy: 8.0 };
        let grey = |value: u8| TrainingView {
            camera: Camera::new(intrinsics, glam::DMat4::IDENTITY, size).unwrap(),
            image: ImageRgb8::new(size, vec![value; 3 * size.pixels()]).unwrap(),
            mask: Mask::filled(size, false),
        };
        let mut start = crate::from_points(&[[0.0, 0.0, 2.0]], &[[0.5; 3]], 0, 0.98);
        start.log_scales.fill([0.0; 3]);
        // Brightness of the Gaussian after so many steps on dark photographs, and on what they are exchanged for.
        let brightness = |iterations: usize, equal: Option<u8>| {
            let config = FirstFrameConfig {
                iterations,
                hidden_sky: 0.0,
                cool_down: 0.0,
                ..FirstFrameConfig::default()
            };
            let views = [grey(51), grey(51)];
            let start = FirstFrame { gaussians: start.clone(), sky: SkyCube::filled(8, [0.2; 3]) };
            let task = FirstFrameTask { views: &views, start, extent: 1.0, seed: 1 };
            let (mut asked, mut steps) = (Vec::new(), 0);
            let mut equalise = |gaussians: &Gaussians| {
                asked.push(gaussians.len());
                equal.map(|value| vec![grey(value); 2])
            };
            let log = &mut StageLog::default();
            let Ok(trained) = train_first_frame(&CpuBackend, &config, task, &mut equalise, log, &mut |p| {
                steps += 1;
                assert_eq!((p.iteration, p.iterations), (steps, iterations));
            });
            assert_eq!(steps, iterations);
            (asked, trained.gaussians.sh[0][0])
        };
        let (asked, darker) = brightness(100, None);
        assert!(asked == [1] && darker < start.sh[0][0], "{darker}");
        let (asked, brighter) = brightness(100, Some(204));
        assert!(asked == [1] && brighter > darker + 0.1, "{brighter} and {darker}");
        assert_eq!(brightness(6, Some(204)).0, Vec::<usize>::new(), "three steps show no surfaces");
    }
}
