//! The whole motion initialisation on a synthetic scene, and where its time goes: `cargo bench -p ffgs-bench --bench
//! initialisation`. Prints a table; the best of three passes after one that warms up. Files are not read: what stands for
//! loading is a copy of each dense field.

mod scene;

use ffgs_core::{DenseMotion, Estimates, Mask, Observations};
use ffgs_fusion::{
    FusionInput, InformationFuser, Slack, ViewObservations, count_views, second_chance, validate,
};
use ffgs_rasterizer::{Association, AssociationScene, AssociationScratch, Observed};
use ffgs_triangulation::WeightedRays;
use ffgs_voronoi::{AgreementConfig, VoronoiConfig, agreement, densify_view};
use glam::{DMat3, DVec3};
use rayon::prelude::*;
use scene::{PAPER, SAMPLE, Scene, SceneView};
use std::sync::Mutex;
use std::time::Instant;

const STAGES: [&str; 7] = [
    "copy of dense fields",
    "densification",
    "agreement",
    "association",
    "triangulation",
    "fusion",
    "validation",
];
const PASSES: usize = 3;

fn main() {
    let wanted: Vec<String> = std::env::args().skip(1).filter(|a| !a.starts_with('-')).collect();
    for scale in [SAMPLE, PAPER] {
        if !wanted.is_empty() && !wanted.iter().any(|w| w == scale.name) {
            continue;
        }
        let scene = scale.scene(scale.views);
        let foreground: usize = scene.views.iter().map(|v| v.mask.count()).sum();
        let share = foreground as f64 / (scene.views[0].mask.size().pixels() * scene.views.len()) as f64;
        println!("{}, masks of {:.1} %", scale.label(), 100.0 * share);
        let (mut best, mut error) = ([f64::INFINITY; STAGES.len()], 0.0);
        for pass in 0..=PASSES {
            let (seconds, median) = initialise(&scene);
            if pass > 0 && seconds.iter().sum::<f64>() < best.iter().sum::<f64>() {
                (best, error) = (seconds, median);
            }
        }
        STAGES.iter().zip(best).for_each(|(stage, seconds)| println!("{stage:>24} {seconds:8.3} s"));
        println!("{:>24} {:8.3} s, median error {:.2} cm", "in all", best.iter().sum::<f64>(), 100.0 * error);
    }
}

/// Stops the time of stage after stage.
struct Watch {
    seconds: [f64; STAGES.len()],
    since: Instant,
}

impl Watch {
    fn stop(&mut self, stage: usize) {
        self.seconds[stage] += self.since.elapsed().as_secs_f64();
        self.since = Instant::now();
    }
}

/// Seconds of each stage and the median error (m).
fn initialise(scene: &Scene) -> ([f64; STAGES.len()], f64) {
    let mut watch = Watch { seconds: [0.0; STAGES.len()], since: Instant::now() };
    let observations = observe(scene, &mut watch);
    let mut estimates = vec![Estimates::default(); observations.len()];
    for (observation, out) in observations.iter().zip(&mut estimates) {
        let solver = WeightedRays::default();
        solver.triangulate(&scene.previous, &scene.cameras, observation, out).expect("the shapes match");
    }
    watch.stop(4);
    let covariances = vec![DMat3::ZERO; scene.previous.len()];
    let fused = InformationFuser::default().fuse(&FusionInput {
        prior_means: &scene.previous,
        prior_covariances: &covariances,
        estimates: &estimates,
        previous_steps: None,
        groups: None,
        last_q: 0.0,
        q_floor_m: 0.01,
        observed: Some(ViewObservations { cameras: &scene.cameras, observations: &observations }),
        flexibility: None,
    });
    let fused = fused.expect("the columns match");
    let mut means = fused.means.clone();
    watch.stop(5);
    let masks: Vec<Mask> = scene.views.par_iter().map(|v| v.mask_now.dilated(2)).collect();
    let counts = count_views(&means, &scene.cameras, &masks).expect("one size");
    let valid: Vec<bool> =
        counts.into_iter().map(|c| validate(c, Slack { views: 0, share: 0.2, all_views: false })).collect();
    second_chance(&scene.previous, &mut means.clone(), &mut fused.covariances.clone(), &valid)
        .expect("the columns match");
    watch.stop(6);
    (watch.seconds, median_error(&mut means, &scene.truth))
}

fn median_error(means: &mut [DVec3], truth: &[DVec3]) -> f64 {
    let mut errors: Vec<f64> = means.iter().zip(truth).map(|(a, b)| (*a - *b).length()).collect();
    errors.sort_by(f64::total_cmp);
    errors[errors.len() / 2]
}

/// Views in groups whose fields take 1 GiB at most, as the pipeline does.
fn observe(scene: &Scene, watch: &mut Watch) -> Vec<Observations> {
    let (n, views) = (scene.previous.len(), scene.views.len());
    let mut observations: Vec<_> = (0..3).map(|_| Observations::unobserved(views, n)).collect();
    let mut rows: Vec<Vec<Observed>> = (0..views).map(|_| Vec::new()).collect();
    for observation in &mut observations {
        let columns = observation.targets.chunks_mut(n).zip(observation.weights.chunks_mut(n));
        rows.iter_mut()
            .zip(columns)
            .for_each(|(row, (targets, weights))| row.push(Observed { targets, weights }));
    }
    let gaussians = AssociationScene::new(&[&scene.joint], &scene.previous);
    watch.stop(3);
    let group = ((1 << 30) / (scene.views[0].mask.size().pixels() * 48)).clamp(1, views);
    let scratch = Mutex::new(Vec::<AssociationScratch>::new());
    let parts = scene.views.chunks(group).zip(scene.cameras.chunks(group));
    for ((views, cameras), rows) in parts.zip(rows.chunks_mut(group)) {
        let dense: Vec<DenseMotion> = views.par_iter().map(|v| v.dense.clone()).collect();
        watch.stop(0);
        let mut fields: Vec<Vec<DenseMotion>> = views.par_iter().zip(dense).map(fields).collect();
        watch.stop(1);
        views.par_iter().zip(&mut fields).for_each(|(view, fields)| {
            agreement(fields, Some(&view.mask), &AgreementConfig::default()).expect("one size");
        });
        watch.stop(2);
        views.par_iter().zip(cameras).zip(&fields).zip(rows).for_each(|(((view, camera), fields), out)| {
            let mask = &view.mask;
            let association = Association {
                camera,
                mask,
                fields,
                flow_floor_px: 0.25,
                min_coverage: 1e-3,
                min_hits: 2,
                min_transmittance: 1e-2,
                contributors: 0,
                normalise: true,
            };
            let mut own = scratch.lock().expect("no panic").pop().unwrap_or_default();
            association.observe(&gaussians, out, &mut own);
            scratch.lock().expect("no panic").push(own);
        });
        drop(fields);
        watch.stop(3);
    }
    observations
}

fn fields((view, dense): (&SceneView, DenseMotion)) -> Vec<DenseMotion> {
    let tracked = view
        .tracks
        .par_iter()
        .map(|tracks| densify_view(&VoronoiConfig::default(), tracks, &view.mask).expect("valid tracks"));
    let mut fields: Vec<DenseMotion> = tracked.collect();
    fields.push(dense);
    fields
}
