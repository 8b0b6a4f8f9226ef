//! A short training of an export as its viewer draws it, without opacity compensation, towards renders of what was trained.

use crate::target::target;
use crate::viewpoints::cameras_between;
use ffgs_core::{Camera, Gaussians, Scene, TrainingView};
use ffgs_rasterizer::TileMask;
use ffgs_trainer::{
    Around, Epochs, LayerTask, LayerTraining, LearningRates, Progress, Schedule, TILE_DILATION, TaskView,
    TrainBackend, camera_extent, decay,
};
use std::sync::Arc;

/// How exports are fitted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FitConfig {
    /// Steps, one view each.
    pub iterations: usize,
    /// Rates at the first step, of positions as a share of the cameras' extent; all fall to a tenth.
    pub rates: LearningRates,
    /// Fixes the cameras between the cameras and the order of the steps.
    pub seed: u64,
}

impl Default for FitConfig {
    /// Rates several times as large as those of frame 0, for a short training without noise (docs/adr/0023).
    fn default() -> Self {
        let rates = LearningRates {
            means: 1e-4,
            quats: 1e-3,
            scales: 6e-2,
            opacities: 0.3,
            sh0: 2e-2,
            sh_rest: 4e-3,
        };
        Self { iterations: 2000, rates, seed: 0 }
    }
}

impl FitConfig {
    /// The rates at a step, for cameras of this extent (m).
    fn rates(&self, iteration: usize, extent: f32) -> LearningRates {
        let fall = decay(1.0, 0.1, iteration, self.iterations);
        let LearningRates { means, quats, scales, opacities, sh0, sh_rest } = self.rates;
        LearningRates {
            means: fall * means * extent,
            quats: fall * quats,
            scales: fall * scales,
            opacities: fall * opacities,
            sh0: fall * sh0,
            sh_rest: fall * sh_rest,
        }
    }
}

/// A target is seen so many times. Few targets that are seen more often are overfitted: with those of ten cameras alone the views
/// between them lose 1 dB (docs/adr/0023).
const VISITS: usize = 4;
/// Pixels of all targets together at most, which bounds their memory (1 GB); the cameras themselves are always among them.
const MOST_PIXELS: usize = 1 << 28;
/// Pixels by which masks of what is fitted are widened for the loss, so that outlines are learnt from both sides.
const LOSS_DILATION: usize = 2;

/// Fits the Gaussians from number `first` on to renders of `scene` from `cameras` and from between them, by the filter that they have; those
/// before `first` are drawn and stay. Where some stay only the neighbourhood of the others counts. Equal inputs and seeds give equal
/// bytes.
///
/// # Errors
/// When the device fails or has too little memory; `gaussians` are then as they were.
pub fn fit<B: TrainBackend>(
    backend: &B,
    gaussians: &mut Gaussians,
    first: usize,
    scene: &Scene,
    cameras: &[Camera],
    config: &FitConfig,
    report: &mut dyn FnMut(Progress),
) -> Result<(), B::Error> {
    let fitted = (first > 0).then(|| gaussians.select(&(first..gaussians.len()).collect::<Vec<_>>()));
    let targets: Vec<TrainingView> =
        viewpoints(cameras, config).iter().map(|camera| target(scene, fitted.as_ref(), camera)).collect();
    let extent = camera_extent(&targets[..cameras.len()]);
    let views: Vec<TaskView> = targets.iter().filter_map(|view| task_view(view, first == 0)).collect();
    let schedule = Schedule {
        iterations: config.iterations,
        rates: &|iteration| config.rates(iteration, extent),
        ..Schedule::default()
    };
    let count = views.len();
    let mut layer = Arc::new(std::mem::take(gaussians));
    let task = LayerTask { fixed: first, ..LayerTask::new(&mut layer, views, Around::Sky(&scene.sky)) };
    let trained = backend.upload_layer(task).and_then(|mut training| {
        schedule.run(&mut training, &mut Epochs::new(count, config.seed), |_, _| Ok(()), report)?;
        training.download()
    });
    *gaussians = Arc::unwrap_or_clone(layer);
    trained
}

/// From where targets are rendered: the cameras, then those between them.
fn viewpoints(cameras: &[Camera], config: &FitConfig) -> Vec<Camera> {
    let pixels = cameras.iter().map(|camera| camera.size().pixels()).max().unwrap_or(1);
    let count = (config.iterations / VISITS).min(MOST_PIXELS / pixels);
    [cameras, &cameras_between(cameras, count.saturating_sub(cameras.len()), config.seed)].concat()
}

/// A target and which of it counts: everything, or what is near its mask.
fn task_view(view: &TrainingView, whole: bool) -> Option<TaskView<'_>> {
    if whole {
        return Some(TaskView { view, region: None, tiles: None });
    }
    (view.mask.count() > 0).then(|| TaskView {
        view,
        region: Some(view.mask.widened(LOSS_DILATION)),
        tiles: Some(TileMask::covering(&view.mask.widened(TILE_DILATION))),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::conserve_weight;
    use ffgs_core::{Dynamic, ImageSize, Intrinsics, PixelFilter, SkyCube};
    use ffgs_testkit::look_at;
    use ffgs_trainer::CpuBackend;
    use glam::DVec3;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn camera(angle: f64) -> Camera {
        let pose = look_at(DVec3::new(4.0 * angle.cos(), 4.0 * angle.sin(), 1.0), DVec3::ZERO);
        let lens = Intrinsics { fx: 60.0, fy: 60.0, cx: 16.0, cy: 16.0 };
        Camera::new(lens, pose, ImageSize { width: 32, height: 32 }).unwrap()
    }

    /// Discs of 5 cm that are 4 mm thick, in a cube of 1 m: at 4 m a pixel is 7 cm.
    fn discs(count: usize, seed: u64) -> Gaussians {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut number = || random.random::<f32>() - 0.5;
        let mut discs = Gaussians::zeros(count, 1);
        for i in 0..count {
            discs.means[i] = [0; 3].map(|_| number());
            discs.quats[i] = [0; 4].map(|_| number());
            discs.log_scales[i] = [0.05_f32, 0.05, 4e-3].map(f32::ln);
            discs.opacity_logits[i] = 2.0;
            discs.sh[4 * i] = [0; 3].map(|_| 3.0 * number());
        }
        discs
    }

    fn scene(statics: &Gaussians, moving: &Gaussians) -> Scene {
        let dynamic = Dynamic { gaussians: moving.clone(), ..Dynamic::default() };
        Scene::new(statics.clone(), dynamic, SkyCube::filled(4, [0.5; 3]))
    }

    /// Mean squared difference (0..=255 squared) of what is shown and what was trained, from cameras between those of the rig.
    fn difference(scene: &Scene, shown: &Gaussians) -> f64 {
        let shown = self::scene(shown, &shown.select(&[]));
        let of = |k: usize| {
            let camera = camera(0.5 + k as f64);
            let [a, b] = [scene, &shown].map(|scene| target(scene, None, &camera).image);
            let squares = a.data().iter().zip(b.data()).map(|(&a, &b)| f64::from(a.abs_diff(b)).powi(2));
            squares.sum::<f64>() / a.data().len() as f64
        };
        (0..6).map(of).sum::<f64>() / 6.0
    }

    const SHORT: usize = 300;

    #[test]
    fn what_is_fitted_looks_as_trained_from_between_the_cameras() {
        let cameras: Vec<Camera> = (0..6).map(|i| camera(f64::from(i))).collect();
        let trained = discs(600, 3);
        let scene = scene(&trained, &trained.select(&[]));
        let unchanged = trained.clone().with_filter(PixelFilter::Plain);
        let mut baked = unchanged.clone();
        conserve_weight(&mut baked, &trained, 0..600, &cameras);
        let conserved = difference(&scene, &baked);
        let config = FitConfig { iterations: SHORT, ..FitConfig::default() };
        let Ok(()) = fit(&CpuBackend, &mut baked, 0, &scene, &cameras, &config, &mut |_| {});
        let [before, fitted] = [&unchanged, &baked].map(|shown| difference(&scene, shown));
        assert!(difference(&scene, &trained) == 0.0 && before > 50.0, "{before}");
        assert!(conserved < 0.4 * before && fitted < 0.8 * conserved, "{before} {conserved} {fitted}");
    }

    #[test]
    fn what_stands_still_keeps_its_bytes_and_what_moves_is_fitted_before_it() {
        let cameras: Vec<Camera> = (0..6).map(|i| camera(f64::from(i))).collect();
        let (statics, moving) = (discs(400, 3), discs(200, 4));
        let scene = scene(&statics, &moving);
        let mut baked = scene.joint().with_filter(PixelFilter::Plain);
        let before = baked.clone();
        let config = FitConfig { iterations: SHORT, ..FitConfig::default() };
        let Ok(()) = fit(&CpuBackend, &mut baked, 400, &scene, &cameras, &config, &mut |_| {});
        let kept: Vec<usize> = (0..400).collect();
        assert!(baked.select(&kept) == before.select(&kept), "static Gaussians changed");
        let [before, after] = [&before, &baked].map(|shown| difference(&scene, shown));
        assert!(after < 0.7 * before, "{before} {after}");
    }

    #[test]
    fn one_camera_is_enough_and_nothing_to_fit_is_no_error() {
        let trained = discs(5, 3);
        let scene = scene(&trained, &trained.select(&[]));
        let config = FitConfig { iterations: 3, ..FitConfig::default() };
        let mut baked = trained.clone().with_filter(PixelFilter::Plain);
        let Ok(()) = fit(&CpuBackend, &mut baked, 0, &scene, &[camera(0.0)], &config, &mut |_| {});
        assert!(baked.is_finite() && baked.log_scales != trained.log_scales);
        let before = baked.clone();
        let Ok(()) = fit(&CpuBackend, &mut baked, 5, &scene, &[camera(0.0)], &config, &mut |_| {});
        assert!(baked == before);
    }
}
