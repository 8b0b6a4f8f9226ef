//! Cases from an independent float64 implementation (fixtures/reference).

mod yardstick;

use ffgs_core::{EstimateStatus, ImageSize, Observations};
use ffgs_testkit::case;
use ffgs_triangulation::TriangulationConfig;
use glam::DVec2;
use yardstick::{Problem, judge, run};

fn problem(name: &str) -> Problem {
    let case = case("triangulate", name);
    let cameras = case.cameras(ImageSize { width: 640, height: 360 });
    let previous = case.points("means");
    let targets = case.rows::<2>("targets").into_iter().map(DVec2::from).collect();
    let weights = case.array("weights");
    let (views, gaussians) = (cameras.len(), previous.len());
    let observations = Observations { views, gaussians, targets, weights };
    Problem { previous, truth: case.points("truth"), cameras, observations, noise: case.scalar("noise_px") }
}

#[test]
fn exact_observations_give_exact_positions() {
    let problem = problem("exact");
    let out = run(&problem, TriangulationConfig::default());
    for (i, status) in out.status.iter().enumerate() {
        assert_eq!(*status, EstimateStatus::Ok);
        assert!((out.means[i] - problem.truth[i]).length() < 1e-9);
        assert!(out.covariances[i].inverse().is_finite());
    }
}

#[test]
fn noisy_observations_are_near_maximum_likelihood_and_calibrated() {
    for name in ["noise_1px", "three_views", "wide_baseline", "outliers_15pct"] {
        let verdict = judge(&problem(name), TriangulationConfig::default());
        println!("{name}: {verdict:.3?}");
        assert!(verdict.median < 1.05 && verdict.p90 < 1.1 && verdict.missed < 0.01, "{name}: {verdict:?}");
        assert!((2.2..3.7).contains(&verdict.nees), "{name}: {verdict:?}");
    }
}
