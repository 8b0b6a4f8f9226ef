//! Whether a body counts as rigid: whatever the trackers claim, however precise they are, and with a memory.

use ffgs_core::Estimates;
use ffgs_fusion::{Fused, FusionConfig, FusionInput, InformationFuser, ViewObservations};
use ffgs_motion_eval::{Sample, Summary, summarise};
use ffgs_simulator::{Recipe, Rig, Scenario, Simulation, simulate};
use ffgs_triangulation::WeightedRays;
use glam::DMat3;

/// The fusion with the trackers' covariances times `claims`, after a frame that left `flexibility`.
fn fuse(scene: &Simulation, claims: f64, flexibility: Option<&[f64]>) -> Fused {
    fuse_with(scene, claims, flexibility, 0.0)
}

/// As [`fuse`], with photographs that say the same of every cell: `odds` is the logarithm of the odds that it departs.
fn fuse_with(scene: &Simulation, claims: f64, flexibility: Option<&[f64]>, odds: f64) -> Fused {
    let estimate = |o| {
        let mut out = Estimates::default();
        WeightedRays::default().triangulate(&scene.previous, &scene.cameras, o, &mut out).unwrap();
        out.covariances.iter_mut().for_each(|c| *c *= claims);
        out
    };
    let estimates: Vec<Estimates> = scene.observations.iter().map(estimate).collect();
    let input = FusionInput {
        prior_means: &scene.previous,
        prior_covariances: &vec![DMat3::ZERO; scene.previous.len()],
        estimates: &estimates,
        previous_steps: None,
        groups: None,
        last_q: 0.0,
        q_floor_m: 0.01,
        observed: Some(ViewObservations { cameras: &scene.cameras, observations: &scene.observations }),
        flexibility,
    };
    let fuser = InformationFuser { config: FusionConfig::default() };
    let prediction = fuser.predict(&input).unwrap();
    let mut departures = prediction.departures();
    departures.odds = departures.offsets().iter().map(|offset| offset.map_or(0.0, |_| odds)).collect();
    fuser.update(prediction, &departures).unwrap()
}

fn samples(scene: &Simulation, fused: &Fused, keep: impl Fn(usize) -> bool) -> Vec<Sample> {
    let sample =
        |i: usize| Sample { error: fused.means[i] - scene.truth[i], covariance: fused.covariances[i] };
    (0..scene.truth.len()).filter(|&i| keep(i)).map(sample).collect()
}

fn share_that_departs(fused: &Fused) -> f64 {
    fused.group_of.iter().filter(|g| g.is_none()).count() as f64 / fused.group_of.len() as f64
}

/// Of 2000 Gaussians in each of 3 rigs and 3 seeds.
fn all(scenario: Scenario, recipe: Recipe) -> Summary {
    let mut all = Vec::new();
    for (rig, seed) in RIGS.into_iter().flat_map(|rig| (1..=3).map(move |seed| (rig, seed))) {
        let scene = simulate(&Recipe { scenario, rig, seed, ..recipe });
        all.extend(samples(&scene, &fuse(&scene, 1.0, None), |_| true));
    }
    let summary = summarise(&all);
    println!(
        "{scenario:?}: median {:.2}, 95 % {:.2} cm, in 90 %: {:.2}",
        summary.median_cm,
        summary.p95_cm,
        summary.coverage_at(0.9).unwrap()
    );
    summary
}

const RIGS: [Rig; 3] = [Rig::Trackside, Rig::Ring, Rig::Dome];

/// Errors as classical trackers make them on a good texture: small, and nearly the same for a whole neighbourhood.
fn precise() -> Recipe {
    Recipe { noise_px: 0.3, smooth: 0.95, ..Recipe::default() }
}

#[test]
fn a_common_factor_on_what_all_trackers_claim_changes_nothing() {
    for scenario in Scenario::ALL {
        let scene = simulate(&Recipe { scenario, ..Recipe::default() });
        let honest = fuse(&scene, 1.0, None);
        for claims in [0.1, 10.0] {
            let other = fuse(&scene, claims, None);
            assert_eq!(other.group_of, honest.group_of, "{scenario:?}, claims x {claims}");
            for i in 0..honest.means.len() {
                let apart = (other.means[i] - honest.means[i]).length();
                let (a, b) = (honest.covariances[i], other.covariances[i]);
                let change = (b - a).to_cols_array().iter().fold(0.0, |m: f64, v| m.max(v.abs()));
                assert!(apart < 1e-6, "{scenario:?}, claims x {claims}: {apart} m");
                assert!(change < 1e-4 * a.x_axis.x.max(a.y_axis.y).max(a.z_axis.z), "{scenario:?}: {a} {b}");
            }
        }
    }
}

/// Odds of more than ten that what is rigid is rigid, and for what walks that it is not, in the second of two frames alike.
#[test]
fn the_verdict_has_a_margin_of_ten() {
    for recipe in [Recipe::default(), precise()] {
        for scenario in [Scenario::Car, Scenario::TwoSpeeds, Scenario::MostlyStatic, Scenario::Walker] {
            let scene = simulate(&Recipe { scenario, ..recipe });
            let first = fuse(&scene, 1.0, None);
            let groups = fuse(&scene, 1.0, Some(&first.flexibility)).groups;
            let largest = groups.iter().max_by_key(|group| group.cells).unwrap();
            println!("{scenario:?}: log odds {:.1}", largest.flexibility);
            let ten = 10_f64.ln();
            let soft = scenario == Scenario::Walker;
            assert!(
                if soft { largest.flexibility > ten } else { largest.flexibility < -ten },
                "{scenario:?}"
            );
        }
    }
}

#[test]
fn precise_trackers_that_err_alike_nearby_leave_a_rigid_body_rigid() {
    for scenario in [Scenario::Car, Scenario::TwoSpeeds, Scenario::MostlyStatic] {
        let summary = all(scenario, precise());
        assert!(summary.median_cm < 0.35 && summary.p95_cm < 0.7, "{scenario:?}");
    }
}

/// Rather too wide than too narrow: see docs/motion.md.
#[test]
fn posteriors_of_what_deforms_hold_the_truth() {
    for (scenario, least) in [(Scenario::Walker, 0.9), (Scenario::Bending, 0.85), (Scenario::Board, 0.8)] {
        let coverage = all(scenario, Recipe::default()).coverage_at(0.9).unwrap();
        assert!((least..0.995).contains(&coverage), "{scenario:?}: {coverage}");
    }
}

/// As a group of its own it is found in some scenes only (docs/motion.md); its motion is found in all.
#[test]
fn a_rigid_board_in_a_walkers_hands_is_followed_to_a_centimetre() {
    const FIRST_OF_BOARD: u32 = 5;
    for seed in 1..=3 {
        let scene = simulate(&Recipe { scenario: Scenario::Board, seed, ..precise() });
        let fused = fuse(&scene, 1.0, None);
        let summary = summarise(&samples(&scene, &fused, |i| scene.parts[i] >= FIRST_OF_BOARD));
        println!("seed {seed}: median {:.2} cm", summary.median_cm);
        assert!(summary.median_cm < 1.0);
    }
}

#[test]
fn what_was_rigid_stays_rigid_and_what_moves_its_limbs_is_seen_to_within_three_frames() {
    let walker = simulate(&Recipe { scenario: Scenario::Walker, ..Recipe::default() });
    let at_once = fuse(&walker, 1.0, None);
    let mut remembered = vec![-12.0; walker.truth.len()];
    let doubting = fuse(&walker, 1.0, Some(&remembered));
    assert!(share_that_departs(&doubting) < share_that_departs(&at_once));
    for _ in 0..3 {
        remembered = fuse(&walker, 1.0, Some(&remembered)).flexibility;
    }
    let convinced = fuse(&walker, 1.0, Some(&remembered));
    assert!(share_that_departs(&convinced) >= share_that_departs(&at_once));
}

/// Where all trackers fail alike, a rigid body seems to deform, and the photographs contradict that. Photographs that agree with
/// departures do not make a rigid body flexible.
#[test]
fn photographs_overrule_departures_but_make_no_rigid_body_flexible() {
    let largest = |scenario, odds| {
        let scene = simulate(&Recipe { scenario, ..Recipe::default() });
        let groups = fuse_with(&scene, 1.0, None, odds).groups;
        groups.iter().max_by_key(|group| group.cells).unwrap().flexibility
    };
    let (walker, car) = (largest(Scenario::Walker, 0.0), largest(Scenario::Car, 0.0));
    assert!(walker > 0.0 && car < 0.0);
    assert!(largest(Scenario::Walker, -10.0) < 0.0);
    assert!((largest(Scenario::Walker, 10.0) - walker).abs() < 1e-9);
    assert!((largest(Scenario::Car, 10.0) - car).abs() < 1e-9);
}
