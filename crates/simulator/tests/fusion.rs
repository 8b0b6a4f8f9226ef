//! The whole way from observations to the posterior on simulated scenes, against the literal fusion and the truth.

use ffgs_core::{Estimates, Observations};
use ffgs_fusion::{Fused, FusionConfig, FusionInput, InformationFuser, ViewObservations};
use ffgs_motion_eval::{Sample, Summary, summarise};
use ffgs_simulator::{Recipe, Rig, Scenario, Simulation, simulate};
use ffgs_triangulation::WeightedRays;
use glam::{DMat3, DVec2, DVec3};

fn fuse(scene: &Simulation, observations: &[Observations], config: FusionConfig) -> Fused {
    let estimates: Vec<Estimates> = (observations.iter())
        .map(|o| {
            let mut out = Estimates::default();
            WeightedRays::default().triangulate(&scene.previous, &scene.cameras, o, &mut out).unwrap();
            out
        })
        .collect();
    let input = FusionInput {
        prior_means: &scene.previous,
        prior_covariances: &vec![DMat3::ZERO; scene.previous.len()],
        estimates: &estimates,
        previous_steps: None,
        groups: None,
        last_q: 0.0,
        q_floor_m: 0.01,
        observed: Some(ViewObservations { cameras: &scene.cameras, observations }),
        flexibility: None,
    };
    InformationFuser { config }.fuse(&input).unwrap()
}

fn score(scene: &Simulation, fused: &Fused) -> Summary {
    let sample =
        |i: usize| Sample { error: fused.means[i] - scene.truth[i], covariance: fused.covariances[i] };
    summarise(&(0..scene.truth.len()).map(sample).collect::<Vec<_>>())
}

/// Both methods over a few seeds; returns (structure, seed).
fn compare(recipe: Recipe) -> (Summary, Summary) {
    let scene = simulate(&recipe);
    let with = score(&scene, &fuse(&scene, &scene.observations, FusionConfig::default()));
    let without = score(&scene, &fuse(&scene, &scene.observations, FusionConfig::literal()));
    println!("{:?} {:?} seed {}", recipe.scenario, recipe.rig, recipe.seed);
    for (name, s) in [("structure", &with), ("seed     ", &without)] {
        println!(
            "  {name} median {:.2} p95 {:.2} cm, NEES median {:.2}, in 90 %: {:.2}",
            s.median_cm,
            s.p95_cm,
            s.nees_median,
            s.coverage_at(0.9).unwrap()
        );
    }
    (with, without)
}

#[test]
fn structure_is_never_worse_than_the_seed() {
    let mut worse = Vec::new();
    for scenario in Scenario::ALL {
        for rig in [Rig::Trackside, Rig::Ring, Rig::Dome] {
            let (with, without) = compare(Recipe { scenario, rig, ..Recipe::default() });
            if with.median_cm > without.median_cm || with.p95_cm > without.p95_cm {
                worse.push((scenario, rig));
            }
        }
    }
    assert!(worse.is_empty(), "{worse:?}");
}

/// All Gaussians of a group share its error, so a scene is one or two draws; ten scenes show the calibration.
#[test]
fn rigid_objects_are_found_to_a_centimetre_and_the_posterior_holds_them() {
    let mut coverage = Vec::new();
    for seed in 1..=5 {
        for scenario in [Scenario::Car, Scenario::TwoSpeeds] {
            let (with, without) = compare(Recipe { scenario, seed, ..Recipe::default() });
            assert!(with.median_cm < 0.5 * without.median_cm);
            coverage.push(with.coverage_at(0.9).unwrap());
        }
    }
    let mean = coverage.iter().sum::<f64>() / coverage.len() as f64;
    println!("share in the 90 % ellipsoids: {mean:.2} of {coverage:.2?}");
    assert!((0.75..0.99).contains(&mean), "{mean}");
}

/// What goes wrong with trackers in practice: every posterior stays finite and symmetric, whatever they say.
#[test]
fn bad_input_gives_finite_posteriors() {
    let scene = simulate(&Recipe { gaussians: 600, ..Recipe::default() });
    let n = scene.truth.len();
    let good = scene.observations[0].clone();
    let with = |change: &dyn Fn(usize, &mut DVec2, &mut f64)| {
        let mut o = good.clone();
        for entry in 0..o.targets.len() {
            let (mut target, mut weight) = (o.targets[entry], o.weights[entry]);
            change(entry, &mut target, &mut weight);
            (o.targets[entry], o.weights[entry]) = (target, weight);
        }
        o
    };
    let wrong = with(&|_, target, _| *target += DVec2::new(15.0, 0.0));
    let nan = with(&|entry, target, _| {
        if entry % 3 == 0 {
            *target = DVec2::NAN;
        }
    });
    let one_view = with(&|entry, _, weight| {
        if entry / n != 3 {
            *weight = 0.0;
        }
    });
    let nothing = with(&|_, _, weight| *weight = 0.0);
    let cases: [(&str, Vec<Observations>); 7] = [
        ("one tracker", vec![good.clone()]),
        ("the same tracker twice", vec![good.clone(), good.clone()]),
        ("a constant wrong tracker", vec![good.clone(), wrong]),
        ("NaN", vec![nan]),
        ("one view", vec![one_view.clone(), one_view]),
        ("nothing", vec![nothing.clone(), nothing]),
        ("no tracker", Vec::new()),
    ];
    for (name, observations) in cases {
        for config in [FusionConfig::default(), FusionConfig::literal()] {
            let fused = fuse(&scene, &observations, config);
            assert!(fused.means.iter().all(|m: &DVec3| m.is_finite()), "{name}");
            for covariance in &fused.covariances {
                assert!(covariance.is_finite() && covariance.determinant() > 0.0, "{name}: {covariance}");
            }
        }
    }
}

#[test]
fn parallel_rays_and_one_camera_twice_are_finite() {
    let mut scene = simulate(&Recipe { rig: Rig::Narrow, views: 2, gaussians: 300, ..Recipe::default() });
    let fused = fuse(&scene, &scene.observations, FusionConfig::default());
    assert!(fused.means.iter().all(|m| m.is_finite()));
    scene.cameras[1] = scene.cameras[0];
    let fused = fuse(&scene, &scene.observations, FusionConfig::default());
    assert!(fused.means.iter().all(|m| m.is_finite()));
    assert!(fused.covariances.iter().all(DMat3::is_finite));
}
