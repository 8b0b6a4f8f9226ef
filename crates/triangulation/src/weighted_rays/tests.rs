//! The same problems with every instruction set this machine has.

use super::*;
use crate::problems::{Difficulty, Problems, difficult};
use ffgs_testkit::vectorised;

const COUNT: usize = 600;

/// Does something with the problems as a batch.
fn with_batch<T>(problems: &Problems, config: &TriangulationConfig, op: impl FnOnce(&Batch) -> T) -> T {
    let view_cameras: Vec<ViewCamera> = problems.cameras.iter().map(ViewCamera::from).collect();
    let Problems { previous, observations, .. } = problems;
    op(&Batch { config, previous, view_cameras: &view_cameras, observations })
}

fn solve(set: usize, batch: &Batch, scales: Scales) -> Option<Vec<Outcome>> {
    let mut all = vec![Err(EstimateStatus::TooFewViews); batch.previous.len()];
    for (chunk, out) in all.chunks_mut(CHUNK).enumerate() {
        vectorised(set, SolveChunk { batch, scales, first: chunk * CHUNK, out })?;
    }
    Some(all)
}

/// Whether a solution is in the centre of a camera, whose pixel may then be any: rounding decides.
fn in_a_camera(problems: &Problems, i: usize, outcome: &Outcome) -> bool {
    let place = |s: &Solution| problems.previous[i] + s.step;
    outcome.as_ref().is_ok_and(|s| problems.cameras.iter().any(|c| c.center().distance(place(s)) < 1e-6))
}

/// Within a millionth of a standard deviation, from the same views.
fn same(a: &Outcome, b: &Outcome) -> bool {
    match (a, b) {
        (Ok(a), Ok(b)) => {
            let m = a.unit_covariance;
            let sigma = (m.x_axis.x + m.y_axis.y + m.z_axis.z).sqrt();
            let residuals = (a.residuals - b.residuals).abs() <= 1e-6 * (a.residuals + 1e-6);
            let covariances = (m - b.unit_covariance).to_cols_array().map(f64::abs);
            let covariance = covariances.iter().all(|v| *v <= 1e-6 * sigma * sigma);
            a.views == b.views && a.step.distance(b.step) <= 1e-6 * sigma && residuals && covariance
        }
        (Err(a), Err(b)) => a == b,
        _ => false,
    }
}

#[test]
fn every_instruction_set_finds_the_same() {
    let rays = TriangulationConfig { refine: false, ..TriangulationConfig::default() };
    let rule = TriangulationConfig { collinear_degrees: 25.0, ..TriangulationConfig::default() };
    let configs = [TriangulationConfig::default(), rays, rule, TriangulationConfig::literal()];
    let cases = configs.iter().flat_map(|config| [(config, 0.15), (config, 0.3)]);
    for (case, (config, outliers)) in cases.enumerate() {
        let problems = difficult(case as u64, COUNT, outliers);
        with_batch(&problems, config, |batch| {
            let scales = batch.scales();
            let expected = solve(0, batch, scales).unwrap();
            assert!(expected.iter().filter(|o| o.is_ok()).count() > COUNT / 2, "case {case}");
            for found in (1..3).filter_map(|set| solve(set, batch, scales)) {
                let mut excused = 0;
                for (i, (a, b)) in expected.iter().zip(&found).enumerate() {
                    if in_a_camera(&problems, i, a) || in_a_camera(&problems, i, b) {
                        excused += 1;
                    } else {
                        assert!(same(a, b), "case {case}, {i} ({:?}): {a:?} {b:?}", Difficulty::of(i));
                    }
                }
                assert!(excused <= COUNT / 100, "case {case}: {excused} points in cameras");
            }
        });
    }
}

#[test]
fn every_instruction_set_measures_the_same_noise() {
    let problems = difficult(3, COUNT, 0.15);
    let samples: Vec<u32> = (0..COUNT as u32).collect();
    with_batch(&problems, &TriangulationConfig::default(), |batch| {
        let residuals = |set| vectorised(set, SoftResiduals { batch, soft: 2.0, samples: &samples });
        let expected = residuals(0).unwrap();
        assert!(expected.len() > 2 * COUNT);
        for found in (1..3).filter_map(residuals) {
            assert_eq!(found.len(), expected.len());
            let near = |a: f64, b: f64| a == b || (a - b).abs() <= 1e-6 * (a + 1e-3);
            let differ = expected.iter().zip(&found).filter(|(a, b)| !near(**a, **b)).count();
            assert_eq!(differ, 0);
        }
    });
}

/// Their normal matrices are singular but for rounding, wherever the rays point.
#[test]
fn parallel_rays_and_cameras_at_one_place_are_degenerate() {
    for config in [TriangulationConfig::default(), TriangulationConfig::literal()] {
        let problems = difficult(5, 10 * COUNT, 0.0);
        let outcomes = with_batch(&problems, &config, |batch| solve(0, batch, batch.scales()).unwrap());
        for (i, outcome) in outcomes.iter().enumerate() {
            if matches!(Difficulty::of(i), Difficulty::ParallelRays | Difficulty::OnePlace) {
                assert_eq!(outcome.as_ref().err(), Some(&EstimateStatus::Degenerate), "{i}");
            }
        }
    }
}
