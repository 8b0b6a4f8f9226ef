//! The lanes on a GPU against the same lanes on the CPU, on a small scene.

mod scene;

use ffgs_core::{Gaussians, SkyCube, StageLog, TrainingView};
use ffgs_gpu::{Gpu, GpuError};
use ffgs_rasterizer_gpu::{Place, SceneDevice};
use ffgs_trainer::{
    BackgroundConfig, CpuBackend, DynamicLaneConfig, FirstFrame, FirstFrameConfig, FirstFrameTask,
    PixelNoise, Prior, StaticColours, StaticLane, StaticMethod, StaticTargets, Surroundings, TrainBackend,
    train_dynamic, train_first_frame, train_sky,
};
use ffgs_trainer_gpu::GpuBackend;
use scene::{SKY, World, blob, information, joint, mean_psnr, perturbed, photographs, world};
use std::sync::Arc;

/// Both end within 0.1 dB of each other and better than they began.
fn assert_equal_quality(what: &str, before: f64, cpu: f64, gpu: f64) {
    println!("{what}: {before:.3} dB at first, CPU {cpu:.3} dB, GPU {gpu:.3} dB");
    assert!(cpu > before + 0.2 && (cpu - gpu).abs() < 0.1, "{what}: {before} dB, CPU {cpu}, GPU {gpu}");
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
        train_dynamic(backend, config, &self.views, around, layer, 9, &mut |_| {}).map(drop)
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
    let targets = StaticTargets { views, sky };
    StaticLane::default().train(
        backend,
        config,
        targets,
        StaticColours { layer, variances: &mut Vec::new(), passing: &mut Vec::new() },
        3,
        &mut |_| {},
    )
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
}

#[test]
#[ignore = "needs a GPU"]
fn the_dynamic_lane_agrees_and_a_step_reads_nothing_back() {
    let (device, world) = (SceneDevice::new(Gpu::for_test()), world());
    let start = perturbed(&world.moving, 8);
    let config = DynamicLaneConfig { iterations: 60, ..DynamicLaneConfig::default() };
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

/// A strong prior holds the layer where it starts, a weak one lets it go; both as on the CPU.
#[test]
#[ignore = "needs a GPU"]
fn the_dynamic_lane_with_a_prior_agrees() {
    let (device, world) = (SceneDevice::new(Gpu::for_test()), world());
    let start = perturbed(&world.moving, 8);
    let information = information(start.len());
    let config = DynamicLaneConfig { iterations: 60, ..DynamicLaneConfig::default() };
    let moved = |g: &Gaussians| {
        let squares =
            g.means.iter().zip(&start.means).flat_map(|(a, b)| [0, 1, 2].map(|k| (a[k] - b[k]).powi(2)));
        f64::from(squares.sum::<f32>()).sqrt()
    };
    let trained = |weight: f32| {
        let noise = PixelNoise { sigma: 0.04, correlated: 9.0 };
        let prior = (weight > 0.0).then_some(Prior {
            information: &information,
            noise,
            weight,
            curvature: &information,
        });
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
    let task = || FirstFrameTask { views: &views, start: start.clone(), extent: 2.0, seed: 4 };
    let log = &mut StageLog::default();
    let Ok(cpu) = train_first_frame(&CpuBackend, &config, task(), &mut |_| None, log, &mut |_| {});
    let found =
        train_first_frame(&GpuBackend(&device), &config, task(), &mut |_| None, log, &mut |_| {}).unwrap();
    assert!(found.gaussians.len() > start.gaussians.len() && found.gaussians.is_finite());
    let quality = |f: &FirstFrame| mean_psnr(&f.gaussians, &f.sky, &views);
    assert_equal_quality("first frame", quality(&start), quality(&cpu), quality(&found));
    let furthest = |a: &SkyCube, b: &SkyCube| {
        let apart = |(a, b): (&[f32; 3], &[f32; 3])| (0..3).map(|c| (a[c] - b[c]).abs()).fold(0.0, f32::max);
        a.texels.iter().zip(&b.texels).map(apart).fold(0.0, f32::max)
    };
    assert!(furthest(&found.sky, &start.sky) > 0.1, "the sky is filled where no view sees it");
    assert!(furthest(&found.sky, &cpu.sky) < 0.05, "{} apart", furthest(&found.sky, &cpu.sky));
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
    let task = FirstFrameTask { views: &world.views, start, extent: 2.0, seed: 4 };
    let log = &mut StageLog::default();
    let error =
        train_first_frame(&backend, &config, task, &mut |_| None, log, &mut |_| {}).expect_err("a fault");
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

/// Every lane on a device: dynamic, static and sky, and a first frame that grows.
fn all_lanes(device: &SceneDevice) -> Result<([Gaussians; 3], [SkyCube; 2]), GpuError> {
    let (backend, world) = (GpuBackend(device), world());
    let config = DynamicLaneConfig { iterations: 12, ..DynamicLaneConfig::default() };
    let mut moving = perturbed(&world.moving, 8);
    world.dynamic(&backend, &config, world.around(), &mut moving)?;
    let config = BackgroundConfig {
        static_method: StaticMethod::Steps,
        static_iterations: 12,
        sky_iterations: 12,
        ..BackgroundConfig::default()
    };
    let (mut layer, mut cube) = (world.fixed.clone(), world.sky.clone());
    static_steps(&backend, &config, (&world.views, &world.sky), &mut layer)?;
    train_sky(&backend, &config, &world.views, &world.fixed, &mut cube, 5)?;
    let config = FirstFrameConfig { iterations: 60, densify_every: 10, ..FirstFrameConfig::default() };
    let start = FirstFrame { gaussians: world.moving, sky: world.sky };
    let task = FirstFrameTask { views: &world.views, start, extent: 2.0, seed: 4 };
    let log = &mut StageLog::default();
    let first = train_first_frame(&backend, &config, task, &mut |_| None, log, &mut |_| {})?;
    Ok(([moving, (*layer).clone(), first.gaussians], [cube, first.sky]))
}

#[test]
#[ignore = "needs a GPU"]
fn photographs_that_do_not_fit_cross_one_by_one_to_the_same_bits() {
    let with_limit = |limit: u64| {
        let device = SceneDevice::new(Gpu::for_test().with_memory_limit(limit));
        (all_lanes(&device), device)
    };
    let (expected, roomy) = with_limit(u64::MAX);
    let expected = expected.unwrap();
    assert_eq!(roomy.place_of_photographs(), Place::Device);
    let peak = roomy.gpu.memory_peak();
    let (found, short) = with_limit(peak - 1);
    assert!(found.unwrap() == expected, "other results");
    assert_eq!(short.place_of_photographs(), Place::Host);
    assert!(short.gpu.memory_peak() < peak);
    assert!(short.gpu.traffic().up > roomy.gpu.traffic().up, "photographs cross more than once");
    let never = SceneDevice::new(Gpu::for_test());
    never.leave_photographs();
    assert!(all_lanes(&never).unwrap() == expected, "other results where no lane begins with photographs");
    assert!(never.gpu.memory_peak() < peak);
}
