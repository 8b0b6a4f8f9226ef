//! The lanes of a streamed frame on synthetic views.

use crate::parts::ellipse;
use crate::scene::{camera, contributions, discs, pool, training_view};
use criterion::{BenchmarkId, Criterion, Throughput};
use ffgs_core::{Gaussians, ImageSize, Mask, SkyCube, TrainingView};
use ffgs_rasterizer::TileMask;
use ffgs_trainer::{
    BackgroundConfig, CpuBackend, DynamicLaneConfig, StaticColours, StaticLane, StaticMethod, StaticTargets,
    Surroundings, train_dynamic,
};
use std::sync::Arc;

/// Steps of the dynamic lane that are timed, its caches included.
const STEPS: usize = 40;

/// The dynamic lane against the foreground's share of the image (percent). Elements = contributions of all steps.
pub(crate) fn dynamic(c: &mut Criterion) {
    let size = ImageSize { width: 640, height: 360 };
    let (all, sky) = (discs(100_000, 3, 0.45), SkyCube::filled(64, [0.5; 3]));
    let mut group = c.benchmark_group("dynamic_lane");
    for percent in [1, 5, 20, 50] {
        let mask = ellipse(size, f64::from(percent) / 100.0);
        let (moving, still) = split(&all, size, &mask);
        let views: Vec<TrainingView> =
            [-0.2, 0.0, 0.2].map(|x| training_view(&all, camera(size, x), mask.clone())).into();
        let tiles = TileMask::covering(&mask);
        let blended: u64 = views.iter().map(|v| contributions(&moving, &v.camera, Some(&tiles))).sum();
        group.throughput(Throughput::Elements(blended * STEPS as u64 / views.len() as u64));
        let config = DynamicLaneConfig { iterations: STEPS, ..DynamicLaneConfig::default() };
        let still = Arc::new(still);
        let around = Surroundings { static_layer: &still, sky: &sky, prior: None };
        for threads in [1, 2] {
            let pool = pool(threads);
            group.bench_function(BenchmarkId::new(format!("{percent}%"), format!("{threads}t")), |b| {
                b.iter(|| {
                    let mut layer = moving.clone();
                    let run =
                        || train_dynamic(&CpuBackend, &config, &views, around, &mut layer, 1, &mut |_| {});
                    let Ok(_) = pool.install(run);
                });
            });
        }
    }
    group.finish();
}

/// Gaussians whose centres fall into the mask of the middle camera, and the others.
fn split(all: &Gaussians, size: ImageSize, mask: &Mask) -> (Gaussians, Gaussians) {
    let camera = camera(size, 0.0);
    let inside = |i: &usize| {
        let mean = glam::Vec3::from(all.means[*i]).as_dvec3();
        camera.pixel_of(mean).is_some_and(|(x, y)| mask.contains(x, y))
    };
    let (moving, still): (Vec<usize>, Vec<usize>) = (0..all.len()).partition(inside);
    (all.select(&moving), all.select(&still))
}

/// The static lane's linear solve against 500 plain steps, on the same views.
pub(crate) fn static_lane(c: &mut Criterion) {
    let size = ImageSize { width: 160, height: 96 };
    let (layer, sky) = (discs(10_000, 3, 0.45), SkyCube::filled(16, [0.3; 3]));
    let views: Vec<TrainingView> = [-1.0, -0.5, 0.0, 0.5, 1.0]
        .map(|x| training_view(&layer, camera(size, x), Mask::filled(size, false)))
        .into();
    let blended: u64 = views.iter().map(|v| contributions(&layer, &v.camera, None)).sum();
    let mut group = c.benchmark_group("static_lane");
    for (name, static_method) in [("solve", StaticMethod::Solve), ("500_steps", StaticMethod::Steps)] {
        let config = BackgroundConfig { static_method, ..BackgroundConfig::default() };
        let bytes = size.pixels() * views.len() * 16 * 8 * config.solve_iterations;
        group.throughput(match static_method {
            StaticMethod::Solve => Throughput::Bytes(bytes as u64),
            StaticMethod::Steps => Throughput::Elements(blended * 500 / views.len() as u64),
        });
        for threads in [1, 2] {
            let pool = pool(threads);
            group.bench_function(BenchmarkId::new(name, format!("{threads}t")), |b| {
                b.iter(|| {
                    let (mut lane, mut layer) = (StaticLane::default(), Arc::new(layer.clone()));
                    let seen = StaticTargets { views: &views, sky: &sky };
                    let run = || {
                        lane.train(
                            &CpuBackend,
                            &config,
                            seen,
                            StaticColours {
                                layer: &mut layer,
                                variances: &mut Vec::new(),
                                passing: &mut Vec::new(),
                            },
                            1,
                            &mut |_| {},
                        )
                    };
                    let Ok(()) = pool.install(run);
                });
            });
        }
    }
    group.finish();
}
