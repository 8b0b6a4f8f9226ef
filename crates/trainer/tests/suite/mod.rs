//! What every training backend owes, on a small scene whose photographs are renders: what a step does, that errors fall,
//! that what is fixed stays, and that equal inputs give equal bytes. The same assertions hold for the CPU and for a GPU.

use ffgs_core::{
    Camera, Gaussians, ImageRgb8, ImageSize, Intrinsics, Mask, PixelFilter, PlanarImage, SkyCube, StageLog,
    TrainingView,
};
use ffgs_rasterizer::{Background, CpuRasterizer, RenderTape, View};
use ffgs_trainer::{
    Around, BackgroundConfig, Columns, DynamicLaneConfig, Epochs, FirstFrame, FirstFrameConfig,
    FirstFrameTask, Gain, LayerTask, LayerTraining, LearningRates, LossRegion, PhotometricLoss, Prior,
    Schedule, SkyView, StaticColours, StaticLane, StaticMethod, StaticTargets, Surroundings, TaskView,
    TrainBackend, information_gain, pixel_length, train_dynamic, train_first_frame, train_sky,
};
use glam::{DMat4, DVec3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;

const SIZE: ImageSize = ImageSize { width: 48, height: 36 };
const SEED: u64 = 7;

pub(crate) struct World {
    pub(crate) fixed: Arc<Gaussians>,
    pub(crate) moving: Gaussians,
    pub(crate) sky: SkyCube,
    pub(crate) views: Vec<TrainingView>,
}

/// Gaussians around `centre` (m); degree 1.
fn blob(count: usize, centre: [f32; 3], radius: f32) -> Gaussians {
    let mut out = Gaussians::zeros(count, 1);
    for i in 0..count {
        let wave = |k: usize| (1.3 * (i * k) as f32 + k as f32).sin();
        out.means[i] = [0, 1, 2].map(|a| centre[a] + radius * wave(a + 1));
        out.quats[i] = [1.0, 0.3 * wave(5), 0.3 * wave(6), 0.3 * wave(7)];
        out.log_scales[i] = [wave(8), wave(9), wave(10)].map(|v| -1.9 + 0.3 * v);
        out.opacity_logits[i] = 1.0 + wave(11);
        for k in 0..4 {
            let scale = if k == 0 { 1.0 } else { 0.1 };
            out.sh[4 * i + k] = [12, 13, 14].map(|c| scale * wave(c + k));
        }
    }
    out
}

fn camera(angle: f64) -> Camera {
    let intrinsics = Intrinsics { fx: 45.0, fy: 46.0, cx: 24.3, cy: 17.6 };
    let pose = DMat4::from_translation(DVec3::new(0.0, 0.0, 4.0)) * DMat4::from_rotation_y(angle);
    Camera::new(intrinsics, pose, SIZE).unwrap()
}

pub(crate) fn joint(fixed: &Gaussians, moving: &Gaussians) -> Gaussians {
    let mut joint = fixed.clone();
    joint.extend(moving);
    joint
}

/// All layers at once, with the rasterizer alone.
fn render(gaussians: &Gaussians, sky: &SkyCube, camera: &Camera) -> PlanarImage {
    let mut behind = PlanarImage::zeros(SIZE);
    SkyView::new(camera, sky.face_size()).render(sky, &mut behind);
    let view = View { camera, background: Background::Image(&behind), tiles: None };
    let mut tape = RenderTape::default();
    CpuRasterizer::default().render(gaussians, &view, &mut tape);
    tape.image().clone()
}

/// A disc in the middle of the image, larger than the moving blob.
fn disc() -> Mask {
    let inside = |p: usize| {
        let (x, y) = ((p % SIZE.width) as f64 - 23.5, (p / SIZE.width) as f64 - 17.5);
        u8::from(x.hypot(y) < 11.0)
    };
    Mask::new(SIZE, (0..SIZE.pixels()).map(inside).collect()).unwrap()
}

pub(crate) fn world() -> World {
    let (moving, fixed) = (blob(40, [0.0; 3], 0.5), blob(60, [0.0, 0.0, 3.0], 2.5));
    let mut sky = SkyCube::filled(8, [0.3, 0.5, 0.8]);
    for (i, texel) in sky.texels.iter_mut().enumerate() {
        texel[0] += 0.2 * (0.7 * i as f32).sin();
    }
    let view = |angle: f64| {
        let camera = camera(angle);
        let image = ImageRgb8::from(&render(&joint(&fixed, &moving), &sky, &camera));
        TrainingView { camera, image, mask: disc() }
    };
    let views = [-0.3, -0.1, 0.1, 0.3].map(view).to_vec();
    World { fixed: Arc::new(fixed), moving, sky, views }
}

impl World {
    fn around(&self) -> Surroundings<'_> {
        Surroundings { static_layer: &self.fixed, sky: &self.sky, prior: None }
    }

    /// Mean squared error over the pixels in or outside the masks.
    fn error(&self, fixed: &Gaussians, moving: &Gaussians, sky: &SkyCube, foreground: bool) -> f64 {
        let gaussians = joint(fixed, moving);
        let (mut sum, mut count) = (0.0, 0.0);
        for view in &self.views {
            let image = render(&gaussians, sky, &view.camera);
            for p in (0..SIZE.pixels()).filter(|&p| (view.mask.data()[p] != 0) == foreground) {
                let pairs = image.pixel(p).into_iter().zip(view.image.pixel(p));
                sum += pairs.map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>();
                count += 3.0;
            }
        }
        sum / count
    }

    /// The dynamic lane.
    pub(crate) fn train<B: TrainBackend>(
        &self,
        backend: &B,
        config: &DynamicLaneConfig,
        layer: &mut Gaussians,
    ) {
        train_dynamic(backend, config, &self.views, self.around(), layer, SEED, &mut |_| {}).unwrap();
    }

    /// The static lane, from wrong colours.
    pub(crate) fn recolour<B: TrainBackend>(&self, backend: &B, method: StaticMethod) -> Gaussians {
        let mut layer = Arc::new(recoloured(&self.fixed));
        let targets = StaticTargets { views: &self.views, sky: &self.sky };
        let (config, mut lane) = (static_config(method), StaticLane::default());
        lane.train(
            backend,
            &config,
            targets,
            StaticColours { layer: &mut layer, variances: &mut Vec::new(), passing: &mut Vec::new() },
            SEED,
            &mut |_| {},
        )
        .unwrap();
        Arc::unwrap_or_clone(layer)
    }

    /// The sky lane.
    pub(crate) fn train_sky<B: TrainBackend>(&self, backend: &B, sky: &mut SkyCube) {
        let config = static_config(StaticMethod::Solve);
        train_sky(backend, &config, &self.views, &self.fixed, sky, SEED).unwrap();
    }

    /// The moving layer a little off its place and in wrong colours.
    pub(crate) fn disturbed(&self) -> Gaussians {
        let mut out = self.moving.clone();
        out.means.iter_mut().for_each(|m| *m = [m[0] + 0.06, m[1] - 0.04, m[2] + 0.03]);
        out.sh.iter_mut().for_each(|c| *c = c.map(|v| 0.8 * v + 0.1));
        out
    }
}

fn static_config(method: StaticMethod) -> BackgroundConfig {
    let (static_iterations, sky_iterations) = (80, 80);
    BackgroundConfig {
        static_method: method,
        static_iterations,
        sky_iterations,
        ..BackgroundConfig::default()
    }
}

fn recoloured(gaussians: &Gaussians) -> Gaussians {
    let mut out = gaussians.clone();
    out.sh.iter_mut().for_each(|c| *c = c.map(|v| v + 0.15));
    out
}

/// The first step of Adam is the rate against the sign of the gradient. The sign is that of finite differences of the
/// loss of a plain render of everything: neither the cache, nor the cut at a depth, nor the backward pass is in it.
pub(crate) fn a_step_of_the_dynamic_lane_goes_against_the_slope_of_the_loss<B: TrainBackend>(backend: &B) {
    let mut world = world();
    world.views.truncate(1);
    let start = world.disturbed();
    let config = DynamicLaneConfig { iterations: 1, outside_alpha: 0.0, ..DynamicLaneConfig::default() };
    let mut moved = start.clone();
    world.train(backend, &config, &mut moved);

    let view = &world.views[0];
    let region = view.mask.widened(config.loss_dilation);
    let (mut loss, mut gradient) = (PhotometricLoss::new(), PlanarImage::zeros(SIZE));
    let mut value = |gaussians: &Gaussians| {
        let image = render(&joint(&world.fixed, gaussians), &world.sky, &view.camera);
        loss.evaluate(&image, &view.image, LossRegion::Mask(&region), &mut gradient).total
    };
    let rate = config.rates(0, pixel_length(&start, [&view.camera])).means;
    let mut judged = 0;
    for i in 0..start.len() {
        for axis in 0..3 {
            let mut at = |step: f32| {
                let mut gaussians = start.clone();
                gaussians.means[i][axis] += step;
                value(&gaussians)
            };
            let mut slope = |h: f32| (at(h) - at(-h)) / f64::from(2.0 * h);
            let (slope, nearer) = (slope(2e-3), slope(5e-4));
            let step = moved.means[i][axis] - start.means[i][axis];
            // Elsewhere rounding decides, or a kink: of the absolute difference, or where a splat becomes too faint.
            if slope.abs() > 2e-3 && (nearer / slope - 1.0).abs() < 0.1 {
                judged += 1;
                assert!(
                    f64::from(step) * slope < 0.0,
                    "Gaussian {i}, axis {axis}: slope {slope:.1e}, step {step:.1e}"
                );
                assert!((step.abs() / rate - 1.0).abs() < 0.05, "{step:.1e} is no step of {rate:.1e}");
            }
        }
    }
    assert!(judged > 30, "{judged} slopes are large enough");
}

pub(crate) fn the_dynamic_lane_brings_a_disturbed_layer_back<B: TrainBackend>(backend: &B) {
    let world = world();
    let mut layer = world.disturbed();
    let before = world.error(&world.fixed, &layer, &world.sky, true);
    let config = DynamicLaneConfig { iterations: 200, ..DynamicLaneConfig::default() };
    world.train(backend, &config, &mut layer);
    let after = world.error(&world.fixed, &layer, &world.sky, true);
    println!("{before:.2e} -> {after:.2e}");
    assert!(after < 0.5 * before, "{before:.2e} -> {after:.2e}");
}

/// Of a layer that is off its place and in wrong colours, steps along the natural gradient mend both. As many of Adam show the
/// photographs as well, but with colours and shapes alone: the Gaussians end farther from their places than they began.
pub(crate) fn natural_steps_lead_to_the_true_places<B: TrainBackend>(backend: &B) {
    let world = world();
    let layers = [&world.fixed, &world.disturbed()];
    let Gain { information, noise } = information_gain(&layers, &world.sky, &world.views);
    let prior = Some(Prior { information: &information, noise, weight: 0.0, curvature: &information });
    let around = Surroundings { prior, ..world.around() };
    let judged = |layer: &Gaussians| {
        let off =
            layer.positions().into_iter().zip(world.moving.positions()).map(|(a, b)| a.distance_squared(b));
        let off = (off.sum::<f64>() / layer.len() as f64).sqrt();
        (world.error(&world.fixed, layer, &world.sky, true), off)
    };
    let after = |natural_step: f32| {
        let usual = DynamicLaneConfig::default();
        let config = DynamicLaneConfig { iterations: 100, settled: 0.0, natural_step, ..usual };
        let mut layer = world.disturbed();
        train_dynamic(backend, &config, &world.views, around, &mut layer, SEED, &mut |_| {}).unwrap();
        judged(&layer)
    };
    let (before, adam, natural) = (judged(&world.disturbed()), after(0.0), after(0.5));
    println!("(error, m off) {before:?}, Adam {adam:?}, natural {natural:?}");
    assert!(natural.0 < 0.25 * before.0 && natural.1 < 0.9 * before.1, "{before:?}, natural {natural:?}");
    assert!(adam.0 < 0.25 * before.0 && adam.1 > before.1, "{before:?}, Adam {adam:?}");
}

/// The photographs, every value of them up to 12 grey levels off.
fn noisy(views: &[TrainingView]) -> Vec<TrainingView> {
    let mut rng = ChaCha8Rng::seed_from_u64(SEED);
    let mut off = |value: &u8| value.saturating_add_signed(rng.random_range(-12..=12));
    let mut view = |view: &TrainingView| {
        let data = view.image.data().iter().map(&mut off).collect();
        TrainingView { image: ImageRgb8::new(view.image.size(), data).unwrap(), ..view.clone() }
    };
    views.iter().map(&mut view).collect()
}

/// A layer that many frames know and that is where it was photographed, but for the noise of the photographs, needs little more than half
/// of the steps; one that is not takes all.
pub(crate) fn what_has_settled_takes_fewer_steps<B: TrainBackend>(backend: &B) {
    let world = world();
    let views = noisy(&world.views);
    let Gain { mut information, noise } =
        information_gain(&[&world.fixed, &world.moving], &world.sky, &views);
    information.positions.iter_mut().for_each(|of_a_frame| *of_a_frame *= 1000.0);
    let prior = Some(Prior { information: &information, noise, weight: 0.0, curvature: &information });
    let around = Surroundings { prior, ..world.around() };
    let steps = |layer: &Gaussians, config: DynamicLaneConfig| {
        let mut layer = layer.clone();
        train_dynamic(backend, &config, &views, around, &mut layer, SEED, &mut |_| {}).unwrap()
    };
    let usual = DynamicLaneConfig::default();
    let (settled, off) = (steps(&world.moving, usual), steps(&world.disturbed(), usual));
    println!("steps in place {settled}, off {off}; {noise:?}");
    assert!(settled < 7 * usual.iterations / 10, "{settled} steps");
    assert_eq!(off, usual.iterations);
    assert_eq!(steps(&world.moving, DynamicLaneConfig { settled: 0.0, ..usual }), usual.iterations);
    let adam = DynamicLaneConfig { natural_step: 0.0, ..usual };
    assert_eq!(steps(&world.moving, adam), usual.iterations, "steps of Adam expect nothing");
}

pub(crate) fn both_methods_of_the_static_lane_restore_colours<B: TrainBackend>(backend: &B) {
    let world = world();
    let nothing = Gaussians::zeros(0, 1);
    for method in [StaticMethod::Solve, StaticMethod::Steps] {
        let before = world.error(&recoloured(&world.fixed), &nothing, &world.sky, false);
        let layer = world.recolour(backend, method);
        let after = world.error(&layer, &nothing, &world.sky, false);
        println!("{method:?}: {before:.2e} -> {after:.2e}");
        assert!(after < 0.7 * before, "{method:?}: {before:.2e} -> {after:.2e}");
        assert_eq!(layer.means, world.fixed.means, "only colours change");
    }
}

pub(crate) fn the_sky_lane_restores_texels<B: TrainBackend>(backend: &B) {
    let world = world();
    let nothing = Gaussians::zeros(0, 1);
    let mut sky = SkyCube::filled(8, [0.5; 3]);
    let before = world.error(&world.fixed, &nothing, &sky, false);
    world.train_sky(backend, &mut sky);
    let after = world.error(&world.fixed, &nothing, &sky, false);
    println!("{before:.2e} -> {after:.2e}");
    assert!(after < 0.7 * before, "{before:.2e} -> {after:.2e}");
}

pub(crate) fn first_frame<B: TrainBackend>(backend: &B, world: &World) -> FirstFrame {
    let config = FirstFrameConfig { iterations: 120, ..FirstFrameConfig::default() };
    let start = joint(&recoloured(&world.fixed), &world.disturbed());
    let sky = SkyCube::filled(8, [0.5; 3]);
    let start = FirstFrame { gaussians: start, sky };
    let task = FirstFrameTask { views: &world.views, start, extent: 4.0, seed: SEED };
    train_first_frame(backend, &config, task, &mut |_| None, &mut StageLog::default(), &mut |_| {}).unwrap()
}

pub(crate) fn the_first_frame_comes_nearer_to_the_photographs<B: TrainBackend>(backend: &B) {
    let world = world();
    let nothing = Gaussians::zeros(0, 1);
    let start = joint(&recoloured(&world.fixed), &world.disturbed());
    let sky = SkyCube::filled(8, [0.5; 3]);
    let error = |g: &Gaussians, sky: &SkyCube| {
        world.error(g, &nothing, sky, true) + world.error(g, &nothing, sky, false)
    };
    let trained = first_frame(backend, &world);
    let (before, after) = (error(&start, &sky), error(&trained.gaussians, &trained.sky));
    println!("{before:.2e} -> {after:.2e}");
    assert!(after < 0.5 * before, "{before:.2e} -> {after:.2e}");
}

/// Gaussians at the front stay, bit by bit; of the others only the columns that move do. Without compensation, as exports
/// are fitted.
pub(crate) fn what_is_fixed_stays<B: TrainBackend>(backend: &B) {
    let world = world();
    let mut start = joint(&recoloured(&world.fixed), &world.disturbed());
    start.filter = PixelFilter::Plain;
    let (mut layer, fixed) = (Arc::new(start.clone()), world.fixed.len());
    let views = world.views.iter().map(|view| TaskView { view, region: None, tiles: None }).collect();
    let task = LayerTask {
        columns: Columns::IN_PLACE,
        fixed,
        ..LayerTask::new(&mut layer, views, Around::Sky(&world.sky))
    };
    let mut training = backend.upload_layer(task).unwrap();
    let rates =
        LearningRates { means: 0.0, quats: 0.0, scales: 1e-2, opacities: 1e-2, sh0: 1e-2, sh_rest: 1e-3 };
    let schedule = Schedule { iterations: 12, rates: &|_| rates, ..Schedule::default() };
    schedule
        .run(&mut training, &mut Epochs::new(world.views.len(), SEED), |_, _| Ok(()), &mut |_| {})
        .unwrap();
    training.download().unwrap();
    let [front, before] = [&*layer, &start].map(|g| g.select(&(0..fixed).collect::<Vec<_>>()));
    assert!(front == before, "the Gaussians at the front");
    assert!(layer.means == start.means && layer.quats == start.quats, "the columns that do not move");
    let moved = |a: &[f32], b: &[f32]| a.iter().zip(b).filter(|(a, b)| a != b).count();
    let scales = moved(layer.log_scales.as_flattened(), start.log_scales.as_flattened());
    assert!(scales > 3 * world.moving.len() / 2, "{scales} scales moved");
}

pub(crate) fn equal_inputs_give_equal_bytes<B: TrainBackend>(backend: &B) {
    let world = world();
    let config = DynamicLaneConfig { iterations: 30, ..DynamicLaneConfig::default() };
    let [first, second] = [(); 2].map(|()| {
        let mut layer = world.disturbed();
        world.train(backend, &config, &mut layer);
        layer
    });
    assert!(first == second && first != world.disturbed());
}

/// Without a step everything is as it was.
pub(crate) fn no_step_changes_nothing<B: TrainBackend>(backend: &B) {
    let world = world();
    let mut layer = world.disturbed();
    let config = DynamicLaneConfig { iterations: 0, ..DynamicLaneConfig::default() };
    world.train(backend, &config, &mut layer);
    assert!(layer == world.disturbed());
}

/// A test per duty, on the backend that the expression makes; the attributes in braces are those of each test.
macro_rules! backend_suite {
    (@test { $(#[$attribute:meta])* } $backend:expr, $duty:ident) => {
        #[test]
        $(#[$attribute])*
        fn $duty() {
            suite::$duty($backend);
        }
    };
    ($attributes:tt $backend:expr; $($duty:ident),* $(,)?) => {
        $(suite::backend_suite!(@test $attributes $backend, $duty);)*
    };
}
pub(crate) use backend_suite;
