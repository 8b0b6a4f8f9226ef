//! Stages of the motion initialisation on simulated input: `cargo bench -p ffgs-bench --bench motion`.
//!
//! Sizes: the sample's (20 views of 320x180, 23 000 moving and 66 000 standing Gaussians) and the paper's (60 views of
//! 1920x1080, 200 000 and 200 000). Stages that work view by view are measured on one view.

mod scene;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use ffgs_core::{Estimates, Mask};
use ffgs_fusion::{FusionConfig, FusionInput, InformationFuser, ViewObservations, count_views};
use ffgs_rasterizer::{Association, AssociationScene, AssociationScratch, Observed};
use ffgs_simulator::{Recipe, Scenario, Simulation, simulate};
use ffgs_triangulation::WeightedRays;
use ffgs_voronoi::{AgreementConfig, VoronoiConfig, agreement, densify_view};
use glam::{DMat3, DVec2};
use scene::{PAPER, SAMPLE, Scale, Scene, SceneView};
use std::hint::black_box;

const SCALES: [Scale; 2] = [SAMPLE, PAPER];

/// Densification, agreement and association of the view in the middle.
///
/// Floors, P = masked pixels, about 5 %. Densification: 8 distances, 8 exponentials and 32 products per pixel, 16 bytes
/// written. Agreement of 3 trackers: 6 lengths and 3 exponentials per pixel, 36 bytes read, 12 written. Association: a
/// splat is 56 bytes read and about 100 operations to project; then 13 multiplications and additions for each pixel
/// under each splat.
fn one_view(c: &mut Criterion) {
    for scale in SCALES {
        let whole = scale.scene(scale.views / 2 + 1);
        let (Some(view), Some(camera)) = (whole.views.last(), whole.cameras.last()) else { continue };
        let mut group = c.benchmark_group("one_view");
        group.sample_size(20).throughput(Throughput::Elements(view.mask.count() as u64));
        let mut fields = vec![view.dense.clone(); 3];
        let config = VoronoiConfig::default();
        for (tracker, tracks) in view.tracks.iter().enumerate() {
            let id = BenchmarkId::new(format!("densify_{}tracks", tracks.src.len()), scale.label());
            group.bench_function(id, |b| {
                b.iter(|| fields[tracker] = densify_view(&config, tracks, &view.mask).expect("valid"));
            });
        }
        group.bench_function(BenchmarkId::new("agreement", scale.label()), |b| {
            let mut fields = fields.clone();
            b.iter(|| {
                agreement(&mut fields, Some(&view.mask), &AgreementConfig::default()).expect("one size");
            });
        });
        let association = Association {
            camera,
            mask: &view.mask,
            fields: &fields,
            flow_floor_px: 0.25,
            min_coverage: 1e-3,
            min_hits: 2,
            min_transmittance: 1e-2,
            contributors: 0,
            normalise: true,
        };
        group.bench_function(BenchmarkId::new("association", scale.label()), |b| {
            associate(b, &association, &whole);
        });
        group.finish();
    }
}

fn associate(b: &mut criterion::Bencher, association: &Association, scene: &Scene) {
    let n = scene.previous.len();
    let mut columns = vec![(vec![DVec2::ZERO; n], vec![0.0; n]); association.fields.len()];
    let mut scratch = AssociationScratch::default();
    let gaussians = AssociationScene::new(&[&scene.joint], &scene.previous);
    b.iter(|| {
        let mut out: Vec<Observed> =
            columns.iter_mut().map(|(targets, weights)| Observed { targets, weights }).collect();
        association.observe(&gaussians, &mut out, &mut scratch);
    });
}

fn observations(scale: Scale, trackers: usize) -> Simulation {
    let Scale { views, moving: gaussians, .. } = scale;
    let scenario = Scenario::TwoSpeeds;
    simulate(&Recipe { scenario, views, gaussians, trackers, smooth: 0.0, ..Recipe::default() })
}

fn estimate(scene: &Simulation, tracker: usize, out: &mut Estimates) {
    WeightedRays::default()
        .triangulate(&scene.previous, &scene.cameras, &scene.observations[tracker], out)
        .expect("the shapes match");
}

/// One tracker. Floor: 24 bytes for each Gaussian and view; for each observation about 11 sums of 60 operations.
fn triangulation(c: &mut Criterion) {
    let mut group = c.benchmark_group("triangulation_one_tracker");
    group.sample_size(10);
    for scale in SCALES {
        let scene = observations(scale, 1);
        let mut out = Estimates::default();
        group.throughput(Throughput::Elements(scene.truth.len() as u64));
        group.bench_function(scale.label(), |b| b.iter(|| estimate(&scene, 0, black_box(&mut out))));
    }
    group.finish();
}

/// Three trackers; the estimates of ten views serve both sizes. Floor of the literal one: three inverses of symmetric
/// 3x3 matrices and 300 bytes per Gaussian.
fn fusion(c: &mut Criterion) {
    let mut group = c.benchmark_group("fusion_three_trackers");
    group.sample_size(10);
    for scale in SCALES {
        let scene = observations(Scale { views: 10, ..scale }, 3);
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
                observed: Some(ViewObservations {
                    cameras: &scene.cameras,
                    observations: &scene.observations,
                }),
                flexibility: None,
            };
            let fuser = InformationFuser { config };
            let id = BenchmarkId::new(kind, format!("{}_{}gaussians", scale.name, scale.moving));
            group.bench_function(id, |b| {
                b.iter(|| black_box(fuser.fuse(&input).expect("the columns match")));
            });
        }
    }
    group.finish();
}

/// In how many masks each place lies, and growing the masks. Floor: a projection of 20 operations and one byte read at
/// a random place for each Gaussian and view.
fn validation(c: &mut Criterion) {
    let mut group = c.benchmark_group("validation");
    group.sample_size(10);
    for scale in SCALES {
        // Every view sees the cars much as the first four do.
        let scene = scale.scene(4);
        let view = |v: usize| -> (_, &SceneView) { (scene.cameras[v % 4], &scene.views[v % 4]) };
        let (cameras, masks): (Vec<_>, Vec<Mask>) =
            (0..scale.views).map(view).map(|(camera, view)| (camera, view.mask_now.clone())).unzip();
        group.bench_function(BenchmarkId::new("count", scale.label()), |b| {
            b.iter(|| black_box(count_views(&scene.truth, &cameras, &masks).expect("one size")));
        });
        group.bench_function(BenchmarkId::new("grow_one_mask", scale.label()), |b| {
            b.iter(|| black_box(masks[0].dilated(2)));
        });
    }
    group.finish();
}

criterion_group!(benches, one_view, triangulation, fusion, validation);
criterion_main!(benches);
