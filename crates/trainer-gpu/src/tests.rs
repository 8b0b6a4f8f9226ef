//! The GPU's training against its CPU twin, on a small scene.

use crate::GpuBackend;
use crate::optimiser::Optimiser;
use crate::prior::GpuPrior;
use crate::sky::GpuSky;
use crate::target::{Selection, Target};
use crate::workspace::{OPTIONS, Workspace, largest_view};
use ffgs_core::{
    Camera, Gaussians, ImageRgb8, ImageSize, Intrinsics, Mask, PlanarImage, SkyCube, TrainingView,
};
use ffgs_gpu::{Gpu, GpuError};
use ffgs_rasterizer::{
    Background, CpuRasterizer, Information, Rasterizer, RenderOptions, RenderTape, TileMask, View,
};
use ffgs_rasterizer_gpu::{GpuScene, Ledger, SceneDevice, count_views, deal, prepare};
use ffgs_trainer::{
    Adam, BackgroundConfig, Columns, CpuBackend, DynamicLaneConfig, FirstFrame, FirstFrameConfig, IndexMap,
    LearningRates, LossRegion, Photographed, PhotometricLoss, PixelNoise, Prior, SkyView, StaticLane,
    StaticMethod, Surroundings, TaskView, TrainBackend, Update, train_dynamic, train_first_frame, train_sky,
};
use glam::{DMat3, DMat4, DVec3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;

const SIZE: ImageSize = ImageSize { width: 45, height: 35 };
const SKY: [f32; 3] = [0.5, 0.6, 0.8];

fn camera(angle: f64) -> Camera {
    let intrinsics = Intrinsics { fx: 40.0, fy: 42.0, cx: 22.3, cy: 17.8 };
    let pose = DMat4::from_translation(DVec3::new(0.0, 0.0, 4.0)) * DMat4::from_rotation_y(angle);
    Camera::new(intrinsics, pose, SIZE).unwrap()
}

fn cameras() -> [Camera; 4] {
    [-0.4, -0.1, 0.2, 0.5].map(camera)
}

/// A blob of Gaussians around `center`.
fn blob(n: usize, center: [f32; 3], radius: f32, seed: u64) -> Gaussians {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut out = Gaussians::zeros(n, 1);
    for i in 0..n {
        out.means[i] = center.map(|c| c + rng.random_range(-radius..radius));
        out.quats[i] = [0; 4].map(|_| rng.random_range(-1.0..1.0));
        out.log_scales[i] = [0; 3].map(|_| rng.random_range(-3.0..-1.3));
        out.opacity_logits[i] = rng.random_range(-1.0..3.0);
    }
    out.sh.as_flattened_mut().iter_mut().for_each(|v| *v = rng.random_range(-0.7..0.7));
    out
}

/// As an optimiser finds it: moved and recoloured.
fn perturbed(g: &Gaussians, seed: u64) -> Gaussians {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut out = g.clone();
    out.means.as_flattened_mut().iter_mut().for_each(|v| *v += rng.random_range(-0.03..0.03));
    out.sh.as_flattened_mut().iter_mut().for_each(|v| *v += rng.random_range(-0.2..0.2));
    out
}

fn render(g: &Gaussians, sky: &SkyCube, camera: &Camera) -> PlanarImage {
    let mut behind = PlanarImage::zeros(SIZE);
    SkyView::new(camera, sky.face_size()).render(sky, &mut behind);
    let view = View { camera, background: Background::Image(&behind), tiles: None };
    let mut tape = RenderTape::default();
    CpuRasterizer::new(RenderOptions { antialiased: true, sh_degree: None }).render(g, &view, &mut tape);
    tape.image().clone()
}

/// Photographs of `truth`, with the pixels that `moving` covers as masks.
fn photographs(truth: &Gaussians, moving: &Gaussians) -> Vec<TrainingView> {
    let (sky, black) = (SkyCube::filled(8, SKY), SkyCube::filled(8, [0.0; 3]));
    let mut white = moving.clone();
    let stride = white.sh_stride();
    white.sh.iter_mut().step_by(stride).for_each(|sh0| *sh0 = [10.0; 3]);
    let view = |camera: Camera| {
        let covered = render(&white, &black, &camera);
        let mask = covered.plane(0).iter().map(|&v| u8::from(v > 0.4)).collect();
        TrainingView {
            camera,
            image: ImageRgb8::from(&render(truth, &sky, &camera)),
            mask: Mask::new(SIZE, mask).unwrap(),
        }
    };
    cameras().into_iter().map(view).collect()
}

fn mean_psnr(g: &Gaussians, sky: &SkyCube, views: &[TrainingView]) -> f64 {
    let psnr = |v: &TrainingView| {
        let (found, truth) = (render(g, sky, &v.camera), PlanarImage::from(&v.image));
        let squares: f64 = found.data().iter().zip(truth.data()).map(|(a, b)| f64::from(a - b).powi(2)).sum();
        -10.0 * (squares / found.data().len() as f64).log10()
    };
    views.iter().map(psnr).sum::<f64>() / views.len() as f64
}

fn joint(a: &Gaussians, b: &Gaussians) -> Gaussians {
    let mut out = a.clone();
    out.extend(b);
    out
}

/// Both end within 0.1 dB of each other and better than they began.
fn assert_equal_quality(what: &str, before: f64, cpu: f64, gpu: f64) {
    println!("{what}: {before:.3} dB at first, CPU {cpu:.3} dB, GPU {gpu:.3} dB");
    assert!(cpu > before + 0.2 && (cpu - gpu).abs() < 0.1, "{what}: {before} dB, CPU {cpu}, GPU {gpu}");
}

fn half(first: usize) -> Mask {
    let inside = |i: usize| u8::from(i % SIZE.width >= first && i / SIZE.width > 4 && i != 700);
    Mask::new(SIZE, (0..SIZE.pixels()).map(inside).collect()).unwrap()
}

#[test]
#[ignore = "needs a GPU"]
fn the_loss_and_its_gradient_agree() {
    let gpu = Gpu::for_test();
    let views = photographs(&blob(40, [0.0; 3], 1.0, 1), &blob(1, [0.0; 3], 0.1, 2));
    let rendered = render(&blob(40, [0.1, 0.0, 0.0], 1.0, 1), &SkyCube::filled(8, SKY), &views[0].camera);
    let pixels: Vec<[f32; 4]> =
        (0..SIZE.pixels()).map(|p| rendered.pixel(p)).map(|[r, g, b]| [r, g, b, 1.0]).collect();
    for region in [None, Some(half(13)), Some(Mask::filled(SIZE, false))] {
        let selection = Selection { region: region.as_ref(), tiles: None, layers: None };
        let target = Target::new(&gpu, &views[0].camera, &views[0].image, &selection).unwrap();
        let workspace = Workspace::new(&gpu, 1, SIZE.pixels()).unwrap();
        gpu.write(&workspace.scratch.pixels, &pixels);
        let mut commands = gpu.commands();
        workspace.loss(&mut commands, &target);
        gpu.submit(commands).unwrap();
        let found: Vec<[f32; 4]> = gpu.download(&workspace.scratch.upstream, SIZE.pixels()).unwrap();
        let mut expected = PlanarImage::zeros(SIZE);
        let whole = region.as_ref().map_or(LossRegion::Full, LossRegion::Mask);
        let value = PhotometricLoss::new().evaluate(&rendered, &views[0].image, whole, &mut expected);
        let largest = expected.data().iter().fold(1e-9_f32, |m, v| m.max(v.abs()));
        for (p, rgbt) in found.iter().enumerate() {
            for (found, expected) in rgbt.iter().zip(expected.pixel(p)) {
                assert!((found - expected).abs() < 2e-4 * largest, "pixel {p}: {found}, not {expected}");
            }
            assert_eq!(rgbt[3], 0.0);
        }
        let [loss, mse] = workspace.running().unwrap();
        assert!(
            (loss - value.total).abs() < 1e-5 && (mse - value.mse).abs() < 1e-6,
            "{loss} {mse} {value:?}"
        );
    }
}

#[test]
#[ignore = "needs a GPU"]
fn steps_of_the_optimiser_agree() {
    let gpu = Gpu::for_test();
    let mut expected = blob(50, [0.0; 3], 1.0, 3);
    let scene = GpuScene::upload(&gpu, &expected).unwrap();
    let optimiser = Optimiser::new(&gpu, scene, Columns::ALL).unwrap();
    let mut adam = Adam::new(expected.len(), expected.sh_degree());
    let rates = LearningRates { quats: 0.0, ..LearningRates::with_means(1e-3) };
    for step in 1..=5_u32 {
        let gradient = blob(50, [0.0; 3], 1e-6, 10 + u64::from(step));
        let touched: Vec<bool> = (0..50).map(|i| i % (step as usize + 1) != 0).collect();
        adam.step(&mut expected, &gradient, &rates, Update::Touched(&touched));
        let rows: Vec<_> = (0..50).map(|i| ffgs_rasterizer_gpu::Geometry::of(&gradient, i)).collect();
        gpu.write(&optimiser.gradients.scene.geometry, &rows);
        gpu.write(&optimiser.gradients.scene.sh, &gradient.sh);
        let ledger: Vec<Ledger> = (0..50)
            .map(|i| Ledger {
                stamp: if touched[i] { step } else { 0 },
                steps: adam.steps()[i],
                ..Ledger::default()
            })
            .collect();
        gpu.write(&optimiser.gradients.ledger, &ledger);
        optimiser.prepare(&rates, step);
        let mut commands = gpu.commands();
        optimiser.step(&mut commands);
        gpu.submit(commands).unwrap();
    }
    let found = optimiser.download().unwrap();
    let close = |a: &[f32], b: &[f32]| a.iter().zip(b).all(|(a, b)| (a - b).abs() <= 2e-6 * (1.0 + b.abs()));
    assert!(close(found.means.as_flattened(), expected.means.as_flattened()));
    assert_eq!(found.quats, expected.quats);
    assert!(close(found.log_scales.as_flattened(), expected.log_scales.as_flattened()));
    assert!(close(&found.opacity_logits, &expected.opacity_logits));
    assert!(close(found.sh.as_flattened(), expected.sh.as_flattened()));
}

/// Moments after a step and a round of density control, with and without a reset of the opacities.
#[test]
#[ignore = "needs a GPU"]
fn moments_are_carried_over_a_round_of_density_control() {
    let gpu = Gpu::for_test();
    let (start, gradient) = (blob(5, [0.0; 3], 1.0, 3), blob(5, [0.0; 3], 1.0, 4));
    let map = IndexMap { sources: vec![0, 2, 3, 2, 4], keeps_moments: vec![true, true, true, false, false] };
    for keep_opacity in [true, false] {
        let scene = GpuScene::upload(&gpu, &start).unwrap();
        let mut optimiser = Optimiser::new(&gpu, scene, Columns::ALL).unwrap();
        let mut adam = Adam::new(start.len(), start.sh_degree());
        let rates = LearningRates::with_means(1e-3);
        adam.step(&mut start.clone(), &gradient, &rates, Update::Dense);
        let rows: Vec<_> = (0..5).map(|i| ffgs_rasterizer_gpu::Geometry::of(&gradient, i)).collect();
        gpu.write(&optimiser.gradients.scene.geometry, &rows);
        gpu.write(&optimiser.gradients.scene.sh, &gradient.sh);
        gpu.write(&optimiser.gradients.ledger, &[Ledger { stamp: 1, steps: 1, ..Ledger::default() }; 5]);
        optimiser.prepare(&rates, 1);
        let mut commands = gpu.commands();
        optimiser.step(&mut commands);
        gpu.submit(commands).unwrap();
        optimiser.replace(&start, &map, (keep_opacity, false)).unwrap();
        adam.remap(&map);
        if !keep_opacity {
            adam.reset_opacity();
        }
        let expected = [adam.first_moments(), adam.second_moments()];
        for (found, expected) in optimiser.moments().unwrap().iter().zip(expected) {
            let close = |a: &[f32], b: &[f32]| a.iter().zip(b).all(|(a, b)| (a - b).abs() <= 1e-6 * b.abs());
            assert!(close(found.means.as_flattened(), expected.means.as_flattened()));
            assert!(close(found.quats.as_flattened(), expected.quats.as_flattened()));
            assert!(close(found.log_scales.as_flattened(), expected.log_scales.as_flattened()));
            assert!(close(&found.opacity_logits, &expected.opacity_logits));
            assert!(close(found.sh.as_flattened(), expected.sh.as_flattened()));
            assert!(found.means[0] != [0.0; 3] && found.means[3] == [0.0; 3]);
        }
    }
}

/// A scene with everything that the lanes need.
struct World {
    moving: Gaussians,
    fixed: Arc<Gaussians>,
    sky: SkyCube,
    views: Vec<TrainingView>,
}

fn world() -> World {
    let (moving, fixed) = (blob(30, [0.0; 3], 0.4, 6), blob(60, [0.0, 0.2, 0.3], 1.6, 7));
    let views = photographs(&joint(&moving, &fixed), &moving);
    World { moving, fixed: Arc::new(fixed), sky: SkyCube::filled(8, SKY), views }
}

impl World {
    fn around(&self) -> Surroundings<'_> {
        Surroundings { static_layer: &self.fixed, sky: &self.sky, prior: None }
    }

    fn dynamic<B: TrainBackend>(
        &self,
        backend: &B,
        config: &DynamicLaneConfig,
        around: Surroundings,
        layer: &mut Gaussians,
    ) -> Result<(), B::Error> {
        train_dynamic(backend, config, &self.views, around, layer, 9, &mut |_| {})
    }

    fn quality(&self, moving: &Gaussians) -> f64 {
        mean_psnr(&joint(moving, &self.fixed), &self.sky, &self.views)
    }
}

fn static_steps<B: TrainBackend>(
    backend: &B,
    config: &BackgroundConfig,
    (views, sky): (&[TrainingView], &SkyCube),
    layer: &mut Arc<Gaussians>,
) -> Result<(), B::Error> {
    let photographed = Photographed { views, sky };
    StaticLane::default().train(backend, config, photographed, layer, 3, &mut |_| {})
}

#[test]
#[ignore = "needs a GPU"]
fn the_sky_agrees() {
    let device = SceneDevice::new(Gpu::for_test());
    let truth = Arc::new(blob(20, [0.0; 3], 0.5, 4));
    let views = photographs(&truth, &blob(1, [9.0, 9.0, -3.0], 0.1, 2));
    let start = SkyCube::filled(8, [0.4, 0.7, 0.6]);
    let config = BackgroundConfig { sky_iterations: 25, sky_rate: 1e-2, ..BackgroundConfig::default() };
    let (mut cpu, mut found) = (start.clone(), start.clone());
    let Ok(()) = train_sky(&CpuBackend, &config, &views, &truth, &mut cpu, 5);
    train_sky(&GpuBackend(&device), &config, &views, &truth, &mut found, 5).unwrap();
    for (t, (a, b)) in found.texels.iter().zip(&cpu.texels).enumerate() {
        assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() < 2e-3), "texel {t}: {a:?}, not {b:?}");
    }
    assert!(found.texels != start.texels);
    let mut same = start.clone();
    let sky = GpuSky::fixed(&device.gpu, &start).unwrap();
    sky.download(&device.gpu, &mut same).unwrap();
    assert_eq!(same, start);
}

#[test]
#[ignore = "needs a GPU"]
fn the_dynamic_lane_agrees_and_a_step_reads_nothing_back() {
    let (device, world) = (SceneDevice::new(Gpu::for_test()), world());
    let start = perturbed(&world.moving, 8);
    let config = DynamicLaneConfig { iterations: 60, position_rate: 2e-3, ..DynamicLaneConfig::default() };
    let (mut cpu, mut found) = (start.clone(), start.clone());
    let Ok(()) = world.dynamic(&CpuBackend, &config, world.around(), &mut cpu);
    let mut last = None;
    let (backend, views) = (GpuBackend(&device), &world.views);
    train_dynamic(&backend, &config, views, world.around(), &mut found, 9, &mut |p| last = Some(p)).unwrap();
    assert_eq!(last.map(|p| p.iteration), Some(60));
    assert_equal_quality("dynamic", world.quality(&start), world.quality(&cpu), world.quality(&found));

    // 61 steps more read exactly as many bytes as 2 did: those of the report and of the result.
    let bytes = |iterations: usize| {
        let before = device.gpu.traffic().down;
        let config = DynamicLaneConfig { iterations, ..config };
        world.dynamic(&backend, &config, world.around(), &mut start.clone()).unwrap();
        device.gpu.traffic().down - before
    };
    let reports = 16;
    assert_eq!(bytes(63), bytes(2));
    assert_eq!(bytes(65), bytes(2) + reports);
}

/// Diagonals as large as photographs make them, blocks that are no diagonals.
fn information(n: usize) -> Information {
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let block = |rng: &mut ChaCha8Rng| {
        let root = DMat3::from_cols_array(&[(); 9].map(|()| rng.random_range(-1.0..1.0)));
        (root * root.transpose()) * 3e5
    };
    let mut others = Gaussians::zeros(n, 1);
    let mut fill = |column: &mut [f32]| column.iter_mut().for_each(|v| *v = rng.random_range(2e3..2e5));
    fill(others.quats.as_flattened_mut());
    fill(others.log_scales.as_flattened_mut());
    fill(&mut others.opacity_logits);
    fill(others.sh.as_flattened_mut());
    others.quats.iter_mut().for_each(|q| q[0] = 0.0);
    Information { positions: (0..n).map(|_| block(&mut rng)).collect(), others }
}

/// In a step of which the loss has no gradient, all that moves the layer is the prior: against the CPU, value by value.
#[test]
#[ignore = "needs a GPU"]
fn the_pull_of_the_prior_agrees() {
    let gpu = Gpu::for_test();
    let (start, views) = (blob(50, [0.0; 3], 1.0, 3), world().views);
    let mut now = perturbed(&start, 4);
    now.quats.as_flattened_mut().iter_mut().for_each(|v| *v += 0.05);
    now.log_scales.as_flattened_mut().iter_mut().for_each(|v| *v -= 0.1);
    now.opacity_logits.iter_mut().for_each(|v| *v += 0.3);
    let information = information(50);
    let noise = PixelNoise { sigma: 0.04, correlated: 9.0 };
    let prior = Prior { information: &information, noise, weight: 0.1 };
    let seen: Vec<u32> = (0..50).map(|i| i % 4).collect();
    let optimiser = Optimiser::new(&gpu, GpuScene::upload(&gpu, &now).unwrap(), Columns::ALL).unwrap();
    let on_device = GpuPrior::new(
        &gpu,
        &prior,
        &GpuScene::upload(&gpu, &start).unwrap(),
        gpu.upload("views", &seen).unwrap(),
    );
    let region = half(13);
    let selection = Selection { region: Some(&region), tiles: None, layers: None };
    let target = Target::new(&gpu, &views[0].camera, &views[0].image, &selection).unwrap();
    let drawn = |i: usize| i % 3 != 0;
    let ledger: Vec<Ledger> =
        (0..50).map(|i| Ledger { stamp: u32::from(drawn(i)), ..Ledger::default() }).collect();
    gpu.write(&optimiser.gradients.ledger, &ledger);
    let scratch = Workspace::new(&gpu, 50, SIZE.pixels()).unwrap().scratch;
    prepare(&gpu, &optimiser.scene, &target.view, &scratch, OPTIONS, 1);
    let mut commands = gpu.commands();
    on_device.unwrap().pull(&mut commands, &target, &optimiser);
    gpu.submit(commands).unwrap();
    let found = optimiser.gradients.scene.download(&gpu).unwrap();
    let touched: Vec<bool> = (0..50).map(drawn).collect();
    let expected = prior.pull(&start, seen, &now, region.count(), &touched);
    let close = |a: &[f32], b: &[f32]| {
        let largest = b.iter().fold(0.0_f32, |m, v| m.max(v.abs()));
        largest > 0.0 && a.iter().zip(b).all(|(a, b)| (a - b).abs() <= 2e-5 * largest)
    };
    assert!(close(found.means.as_flattened(), expected.means.as_flattened()));
    assert!(close(found.quats.as_flattened(), expected.quats.as_flattened()));
    assert!(close(found.log_scales.as_flattened(), expected.log_scales.as_flattened()));
    assert!(close(&found.opacity_logits, &expected.opacity_logits));
    assert!(close(found.sh.as_flattened(), expected.sh.as_flattened()));
}

#[test]
#[ignore = "needs a GPU"]
fn views_that_see_a_gaussian_are_counted_as_on_the_cpu() {
    let (gpu, world) = (Gpu::for_test(), world());
    let layer = joint(&world.moving, &world.fixed);
    let scene = GpuScene::upload(&gpu, &layer).unwrap();
    let counts = gpu.buffer("counts", 4 * layer.len() as u64).unwrap();
    let mut expected = vec![0; layer.len()];
    for view in &world.views {
        let tiles = TileMask::covering(&view.mask);
        let selection = Selection { region: None, tiles: Some(&tiles), layers: None };
        let target = Target::new(&gpu, &view.camera, &view.image, &selection).unwrap();
        let tasks = [TaskView { view, region: None, tiles: None }];
        let mut workspace = Workspace::new(&gpu, layer.len(), largest_view(&tasks)).unwrap();
        workspace.fit(&scene, std::slice::from_ref(&target), OPTIONS).unwrap();
        prepare(&gpu, &scene, &target.view, &workspace.scratch, OPTIONS, 0);
        let mut commands = gpu.commands();
        deal(&mut commands, &scene, &target.view, &workspace.scratch);
        count_views(&mut commands, &scene, &target.view, &workspace.scratch, &counts);
        gpu.submit(commands).unwrap();
        let frame =
            View { camera: &view.camera, background: Background::Colour([0.0; 3]), tiles: Some(&tiles) };
        let mut tape = RenderTape::default();
        CpuRasterizer::new(OPTIONS).render(&layer, &frame, &mut tape);
        tape.visible_indices().for_each(|i| expected[i] += 1);
    }
    assert_eq!(gpu.download::<u32>(&counts, layer.len()).unwrap(), expected);
    assert!(expected.iter().any(|&n| n == 4) && expected.iter().any(|&n| n < 4), "{expected:?}");
}

/// A strong prior holds the layer where it starts, a weak one lets it go; both as on the CPU.
#[test]
#[ignore = "needs a GPU"]
fn the_dynamic_lane_with_a_prior_agrees() {
    let (device, world) = (SceneDevice::new(Gpu::for_test()), world());
    let start = perturbed(&world.moving, 8);
    let information = information(start.len());
    let config = DynamicLaneConfig { iterations: 60, position_rate: 2e-3, ..DynamicLaneConfig::default() };
    let moved = |g: &Gaussians| {
        let squares =
            g.means.iter().zip(&start.means).flat_map(|(a, b)| [0, 1, 2].map(|k| (a[k] - b[k]).powi(2)));
        f64::from(squares.sum::<f32>()).sqrt()
    };
    let trained = |weight: f32| {
        let noise = PixelNoise { sigma: 0.04, correlated: 9.0 };
        let prior = (weight > 0.0).then_some(Prior { information: &information, noise, weight });
        let around = Surroundings { prior, ..world.around() };
        let (mut cpu, mut gpu) = (start.clone(), start.clone());
        let Ok(()) = world.dynamic(&CpuBackend, &config, around, &mut cpu);
        world.dynamic(&GpuBackend(&device), &config, around, &mut gpu).unwrap();
        let quality = [&cpu, &gpu].map(|g| world.quality(g));
        println!("weight {weight}: {quality:?} dB, moved {} and {} m", moved(&cpu), moved(&gpu));
        assert!((quality[0] - quality[1]).abs() < 0.1 && (moved(&gpu) / moved(&cpu) - 1.0).abs() < 0.05);
        moved(&gpu)
    };
    let (free, held) = (trained(0.0), trained(1.0));
    assert!(held < 0.7 * free, "{held} m against {free} m");
}

#[test]
#[ignore = "needs a GPU"]
fn the_static_lane_agrees_and_its_layer_stays_on_the_device() {
    let device = SceneDevice::new(Gpu::for_test());
    let truth = blob(60, [0.0, 0.2, 0.3], 1.6, 7);
    let sky = SkyCube::filled(8, SKY);
    let views = photographs(&truth, &blob(3, [0.0; 3], 0.2, 6));
    let mut start = perturbed(&truth, 8);
    start.means.clone_from(&truth.means);
    let start = Arc::new(start);
    let config = BackgroundConfig {
        static_method: StaticMethod::Steps,
        static_iterations: 60,
        sh0_rate: 1e-2,
        ..BackgroundConfig::default()
    };
    let (mut cpu, mut found) = (start.clone(), start.clone());
    let Ok(()) = static_steps(&CpuBackend, &config, (&views, &sky), &mut cpu);
    static_steps(&GpuBackend(&device), &config, (&views, &sky), &mut found).unwrap();
    assert_eq!(found.means, start.means);
    let quality = |g: &Gaussians| mean_psnr(g, &sky, &views);
    assert_equal_quality("static", quality(&start), quality(&cpu), quality(&found));
    assert_eq!(device.layer(&found).unwrap().download(&device.gpu).unwrap(), *found);
    assert_eq!(device.layer(&start).unwrap().download(&device.gpu).unwrap(), *start, "as it was");
    assert_eq!(device.uploads(), 1, "only the start came from the host");
}

/// What a frame does with the static layer: it is drawn around the dynamic one, before the sky, trained, and drawn again.
#[test]
#[ignore = "needs a GPU"]
fn the_static_layer_crosses_to_the_device_once_over_all_lanes() {
    let (device, mut world) = (SceneDevice::new(Gpu::for_test()), world());
    let backend = GpuBackend(&device);
    let dynamic = DynamicLaneConfig { iterations: 2, ..DynamicLaneConfig::default() };
    let background = BackgroundConfig {
        static_method: StaticMethod::Steps,
        static_iterations: 2,
        sky_iterations: 2,
        ..BackgroundConfig::default()
    };
    for _ in 0..3 {
        let mut layer = world.moving.clone();
        world.dynamic(&backend, &dynamic, world.around(), &mut layer).unwrap();
        let mut fixed = world.fixed.clone();
        static_steps(&backend, &background, (&world.views, &world.sky), &mut fixed).unwrap();
        train_sky(&backend, &background, &world.views, &world.fixed, &mut world.sky, 5).unwrap();
        assert!(fixed.sh != world.fixed.sh);
        world.fixed = fixed;
    }
    assert_eq!(device.uploads(), 1, "not once per lane and frame");
}

#[test]
#[ignore = "needs a GPU"]
fn the_first_frame_agrees() {
    let device = SceneDevice::new(Gpu::for_test());
    let truth = blob(80, [0.0, 0.2, 0.3], 1.4, 7);
    let views = photographs(&truth, &blob(3, [0.0; 3], 0.2, 6));
    let start = FirstFrame { gaussians: perturbed(&truth, 8), sky: SkyCube::filled(8, [0.4, 0.5, 0.7]) };
    let config = FirstFrameConfig {
        iterations: 120,
        densify_every: 30,
        grow_gradient: 1e-4,
        max_gaussians: 120,
        ..FirstFrameConfig::default()
    };
    let Ok(cpu) = train_first_frame(&CpuBackend, &config, &views, start.clone(), 2.0, 4, &mut |_| {});
    let found =
        train_first_frame(&GpuBackend(&device), &config, &views, start.clone(), 2.0, 4, &mut |_| {}).unwrap();
    assert!(found.gaussians.len() > start.gaussians.len() && found.gaussians.is_finite());
    let quality = |f: &FirstFrame| mean_psnr(&f.gaussians, &f.sky, &views);
    assert_equal_quality("first frame", quality(&start), quality(&cpu), quality(&found));
}

/// Every lane on a device that cannot finish any: the error, and what it worked on must be as it was.
fn assert_lanes_fail_cleanly(device: &SceneDevice, is_expected: fn(&GpuError) -> bool) {
    let (world, backend) = (world(), GpuBackend(device));
    let config = DynamicLaneConfig { iterations: 40, ..DynamicLaneConfig::default() };
    let mut layer = world.moving.clone();
    let error = world.dynamic(&backend, &config, world.around(), &mut layer).expect_err("a fault");
    assert!(is_expected(&error) && layer == world.moving, "dynamic: {error}");
    let config = BackgroundConfig {
        static_method: StaticMethod::Steps,
        static_iterations: 40,
        sky_iterations: 40,
        ..BackgroundConfig::default()
    };
    let mut layer = world.fixed.clone();
    let error = static_steps(&backend, &config, (&world.views, &world.sky), &mut layer).expect_err("a fault");
    assert!(is_expected(&error) && layer == world.fixed, "static: {error}");
    let mut cube = world.sky.clone();
    let error = train_sky(&backend, &config, &world.views, &world.fixed, &mut cube, 5).expect_err("a fault");
    assert!(is_expected(&error) && cube == world.sky, "sky: {error}");
    let config = FirstFrameConfig { iterations: 40, ..FirstFrameConfig::default() };
    let start = FirstFrame { gaussians: world.moving, sky: world.sky };
    let error =
        train_first_frame(&backend, &config, &world.views, start, 2.0, 4, &mut |_| {}).expect_err("a fault");
    assert!(is_expected(&error), "first frame: {error}");
}

#[test]
#[ignore = "needs a GPU"]
fn a_lane_whose_device_is_lost_ends_with_an_error_and_leaves_its_layer_alone() {
    let is_loss = |e: &GpuError| matches!(e, GpuError::Lost(_));
    for submissions in [0, 1, 7, 30] {
        let device = SceneDevice::new(Gpu::for_test());
        device.gpu.lose_after(submissions);
        assert_lanes_fail_cleanly(&device, is_loss);
    }
}

#[test]
#[ignore = "needs a GPU"]
fn a_lane_without_memory_ends_with_an_error_and_leaves_its_layer_alone() {
    for limit in [1_000, 100_000, 400_000] {
        let device = SceneDevice::new(Gpu::for_test().with_memory_limit(limit));
        assert_lanes_fail_cleanly(&device, |e| *e == GpuError::OutOfMemory);
        device.forget();
        assert_eq!(device.gpu.memory_held(), 0, "a lane that failed keeps nothing");
    }
}
