//! The motion initialisation gives the same bits on any number of threads.

#[path = "../../bench/benches/scene/mod.rs"]
#[allow(dead_code, reason = "the sizes of the benchmarks are not used here")]
mod scene;

use ffgs_core::{DenseMotion, Estimates, Mask, Observations};
use ffgs_fusion::{FusionInput, InformationFuser, ViewCounts, ViewObservations, count_views};
use ffgs_rasterizer::{Association, AssociationScene, AssociationScratch, Observed};
use ffgs_triangulation::WeightedRays;
use ffgs_voronoi::{AgreementConfig, VoronoiConfig, agreement, densify_view};
use glam::{DMat3, DVec2, DVec3};
use rayon::prelude::*;
use scene::{Scale, Scene};

const SMALL: Scale =
    Scale { name: "small", views: 6, width: 320, moving: 3000, fixed: 2000, tracks: [60, 200] };

/// Everything that one frame's initialisation computes.
#[derive(Debug, PartialEq)]
struct Outcome {
    observations: Vec<(Vec<DVec2>, Vec<f64>)>,
    /// With the three heaviest contributors of each pixel.
    heaviest: Vec<(Vec<DVec2>, Vec<f64>)>,
    estimates: Vec<(Vec<DVec3>, Vec<DMat3>)>,
    means: Vec<DVec3>,
    covariances: Vec<DMat3>,
    counts: Vec<ViewCounts>,
}

#[test]
fn the_initialisation_does_not_depend_on_the_number_of_threads() {
    let scene = SMALL.scene(SMALL.views);
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| initialise(&scene))
    };
    let one = run(1);
    assert!(one.counts.iter().filter(|c| c.inside > 0).count() > 2000, "the scene shows what moves");
    let moved = one.means.iter().zip(&scene.previous).filter(|(a, b)| a.distance(**b) > 0.01).count();
    assert!(moved > 500, "{moved} Gaussians move");
    assert!(one == run(2), "two threads give other bits");
}

fn initialise(scene: &Scene) -> Outcome {
    let fields: Vec<Vec<DenseMotion>> = scene.views.par_iter().map(fields).collect();
    let observations = observe(scene, &fields, 0);
    let estimate = |observation| {
        let mut out = Estimates::default();
        WeightedRays::default()
            .triangulate(&scene.previous, &scene.cameras, observation, &mut out)
            .expect("the shapes match");
        out
    };
    let estimates: Vec<Estimates> = observations.iter().map(estimate).collect();
    let input = FusionInput {
        prior_means: &scene.previous,
        prior_covariances: &vec![DMat3::ZERO; scene.previous.len()],
        estimates: &estimates,
        previous_steps: None,
        groups: None,
        last_q: 0.0,
        q_floor_m: 0.01,
        observed: Some(ViewObservations { cameras: &scene.cameras, observations: &observations }),
        flexibility: None,
    };
    let fused = InformationFuser::default().fuse(&input).expect("the columns match");
    let masks: Vec<Mask> = scene.views.iter().map(|v| v.mask_now.clone()).collect();
    let counts = count_views(&fused.means, &scene.cameras, &masks).expect("one size");
    let estimates = estimates.into_iter().map(|e| (e.means, e.covariances)).collect();
    let columns = |all: Vec<Observations>| all.into_iter().map(|o| (o.targets, o.weights)).collect();
    let (observations, heaviest) = (columns(observations), columns(observe(scene, &fields, 3)));
    Outcome { observations, heaviest, estimates, means: fused.means, covariances: fused.covariances, counts }
}

fn fields(view: &scene::SceneView) -> Vec<DenseMotion> {
    let mut fields: Vec<DenseMotion> = (view.tracks.iter())
        .map(|tracks| densify_view(&VoronoiConfig::default(), tracks, &view.mask).expect("valid tracks"))
        .collect();
    fields.push(view.dense.clone());
    agreement(&mut fields, Some(&view.mask), &AgreementConfig::default()).expect("one size");
    fields
}

/// (L) observations of all views, with so many contributors per pixel.
fn observe(scene: &Scene, fields: &[Vec<DenseMotion>], contributors: usize) -> Vec<Observations> {
    let n = scene.previous.len();
    let mut observations = vec![Observations::unobserved(scene.views.len(), n); fields[0].len()];
    for (v, (view, fields)) in scene.views.iter().zip(fields).enumerate() {
        let range = v * n..(v + 1) * n;
        let mut out: Vec<Observed> = (observations.iter_mut())
            .map(|o| Observed {
                targets: &mut o.targets[range.clone()],
                weights: &mut o.weights[range.clone()],
            })
            .collect();
        let (camera, mask) = (&scene.cameras[v], &view.mask);
        let association = Association {
            camera,
            mask,
            fields,
            flow_floor_px: 0.25,
            min_coverage: 1e-3,
            min_hits: 2,
            min_transmittance: 1e-2,
            contributors,
            normalise: true,
        };
        let joint = AssociationScene::new(&[&scene.joint], &scene.previous);
        association.observe(&joint, &mut out, &mut AssociationScratch::default());
    }
    observations
}
