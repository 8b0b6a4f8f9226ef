//! Cases from an independent float64 implementation (fixtures/reference).

mod yardstick;

use ffgs_arrays::NpzFile;
use ffgs_core::{Camera, EstimateStatus, ImageSize, Intrinsics, Observations};
use ffgs_triangulation::TriangulationConfig;
use glam::{DMat4, DVec2, DVec3};
use std::path::Path;
use yardstick::{Problem, judge, run};

fn open_case(stage: &str, name: &str) -> NpzFile {
    let root = concat!(env!("CARGO_MANIFEST_DIR"), "/../../fixtures/reference");
    NpzFile::open(&Path::new(root).join(stage).join(format!("{name}.npz"))).unwrap()
}

fn array(case: &NpzFile, key: &str) -> Vec<f64> {
    case.f64(key).unwrap().data
}

fn points(values: &[f64]) -> Vec<DVec3> {
    values.as_chunks::<3>().0.iter().map(|&p| DVec3::from(p)).collect()
}

fn problem(name: &str) -> Problem {
    let case = open_case("triangulate", name);
    let poses = array(&case, "camera_from_world");
    let intrinsics = array(&case, "intrinsics");
    let size = ImageSize { width: 640, height: 360 };
    let cameras: Vec<Camera> = (poses.as_chunks::<16>().0.iter().zip(intrinsics.as_chunks::<4>().0))
        .map(|(pose, &[fx, fy, cx, cy])| {
            let pose = DMat4::from_cols_array(pose).transpose();
            Camera::new(Intrinsics { fx, fy, cx, cy }, pose, size).unwrap()
        })
        .collect();
    let previous = points(&array(&case, "means"));
    let targets = array(&case, "targets").as_chunks::<2>().0.iter().map(|&p| DVec2::from(p)).collect();
    let weights = array(&case, "weights");
    let (views, gaussians) = (cameras.len(), previous.len());
    let observations = Observations { views, gaussians, targets, weights };
    Problem {
        previous,
        truth: points(&array(&case, "truth")),
        cameras,
        observations,
        noise: array(&case, "noise_px")[0],
    }
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
