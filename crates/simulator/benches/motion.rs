//! Stages of the motion initialisation on simulated input: `cargo bench -p ffgs-simulator`.
//!
//! Sizes: the sample's (20 views of 320x180, 15 000 Gaussians) and the paper's (60 views of 1920x1080, 200 000).

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use ffgs_core::{DenseMotion, Estimates, ImageSize, Mask, TrackSet};
use ffgs_fusion::{FusionConfig, FusionInput, InformationFuser, MotionFuser};
use ffgs_simulator::{Recipe, Scenario, Simulation, simulate};
use ffgs_triangulation::{Triangulator, WeightedRays};
use ffgs_voronoi::{AgreementConfig, VoronoiConfig, agreement, densify_view};
use glam::DMat3;
use std::hint::black_box;

const SIZES: [(&str, usize, usize); 2] = [("sample", 20, 15_000), ("paper", 60, 200_000)];

fn scene(views: usize, gaussians: usize, trackers: usize) -> Simulation {
    let scenario = Scenario::TwoSpeeds;
    simulate(&Recipe { scenario, views, gaussians, trackers, smooth: 0.0, ..Recipe::default() })
}

fn estimate(scene: &Simulation, tracker: usize, out: &mut Estimates) {
    WeightedRays::default()
        .triangulate(&scene.previous, &scene.cameras, &scene.observations[tracker], out)
        .expect("the shapes match");
}

/// One tracker.
fn triangulation(c: &mut Criterion) {
    let mut group = c.benchmark_group("triangulation_one_tracker");
    group.sample_size(10);
    for (name, views, gaussians) in SIZES {
        let scene = scene(views, gaussians, 1);
        let mut out = Estimates::default();
        group.throughput(Throughput::Elements(scene.truth.len() as u64));
        let id = BenchmarkId::new(name, format!("{views}views_{gaussians}gaussians"));
        group.bench_function(id, |b| b.iter(|| estimate(&scene, 0, black_box(&mut out))));
    }
    group.finish();
}

/// Three trackers; the estimates of ten views serve both sizes.
fn fusion(c: &mut Criterion) {
    let mut group = c.benchmark_group("fusion_three_trackers");
    group.sample_size(10);
    for (name, _, gaussians) in SIZES {
        let scene = scene(10, gaussians, 3);
        let mut estimates = vec![Estimates::default(); 3];
        estimates.iter_mut().enumerate().for_each(|(l, out)| estimate(&scene, l, out));
        let covariances = vec![DMat3::ZERO; scene.previous.len()];
        group.throughput(Throughput::Elements(scene.truth.len() as u64));
        for (kind, config) in [("literal", FusionConfig::literal()), ("groups", FusionConfig::default())] {
            let input = FusionInput {
                prior_means: &scene.previous,
                prior_covariances: &covariances,
                estimates: &estimates,
                previous_steps: None,
                groups: None,
                last_q: 0.0,
                q_floor_m: 0.01,
            };
            let fuser = InformationFuser { config };
            group.bench_function(BenchmarkId::new(format!("{name}_{kind}"), gaussians), |b| {
                b.iter(|| black_box(fuser.fuse(&input).expect("the columns match")));
            });
        }
    }
    group.finish();
}

/// One view: 400 tracks inside a mask of 5 % of the image, then the agreement of three fields.
fn motion_fields(c: &mut Criterion) {
    for (width, height) in [(320, 180), (1920, 1080)] {
        let size = ImageSize { width, height };
        let inside = |p: usize| u8::from((p % width) * 9 / width == 4 && (p / width) * 9 / height < 8);
        let mask = Mask::new(size, (0..size.pixels()).map(inside).collect()).expect("one byte a pixel");
        let masked: Vec<usize> = (0..size.pixels()).filter(|&p| inside(p) != 0).collect();
        let mut tracks = TrackSet::default();
        for &p in masked.iter().step_by((masked.len() / 400).max(1)) {
            let src = [(p % width) as f32 + 0.5, (p / width) as f32 + 0.5];
            tracks.src.push(src);
            tracks.tgt.push([src[0] + 20.0, src[1] + 1.0]);
            tracks.visibility.push(1.0);
        }
        let mut field = DenseMotion::unknown(size);
        let mut group = c.benchmark_group("motion_fields_one_view");
        group.throughput(Throughput::Elements(masked.len() as u64));
        group.bench_function(BenchmarkId::new("densify", format!("{width}x{height}")), |b| {
            b.iter(|| densify_view(&VoronoiConfig::default(), &tracks, &mask, &mut field).expect("valid"));
        });
        let mut fields = vec![field.clone(); 3];
        group.bench_function(BenchmarkId::new("agreement", format!("{width}x{height}")), |b| {
            b.iter(|| agreement(&mut fields, None, &AgreementConfig::default()).expect("one size"));
        });
        group.finish();
    }
}

criterion_group!(benches, triangulation, fusion, motion_fields);
criterion_main!(benches);
