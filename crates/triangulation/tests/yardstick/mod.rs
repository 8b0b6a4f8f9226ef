//! Random problems with known truth, and the maximum-likelihood estimate that solutions are measured by.

use ffgs_core::{Camera, EstimateStatus, Estimates, Observations};
use ffgs_triangulation::{TriangulationConfig, WeightedRays};
use glam::{DMat3, DVec2, DVec3};

/// A triangulation problem with known truth.
pub(crate) struct Problem {
    pub previous: Vec<DVec3>,
    pub truth: Vec<DVec3>,
    pub cameras: Vec<Camera>,
    pub observations: Observations,
    /// Standard deviation of the targets (px).
    pub noise: f64,
}

/// Errors against the maximum-likelihood estimate on the true inliers.
#[derive(Debug)]
pub(crate) struct Verdict {
    /// Ratio of the median errors.
    pub median: f64,
    /// Ratio of the 90th percentiles.
    pub p90: f64,
    /// Mean normalised estimation error squared, largest 1 % left out.
    pub nees: f64,
    /// Share of Gaussians with at least three views that failed.
    pub missed: f64,
}

pub(crate) fn run(problem: &Problem, config: TriangulationConfig) -> Estimates {
    let mut out = Estimates::default();
    let Problem { previous, cameras, observations, .. } = problem;
    WeightedRays { config }.triangulate(previous, cameras, observations, &mut out).unwrap();
    out
}

pub(crate) fn judge(problem: &Problem, config: TriangulationConfig) -> Verdict {
    let out = run(problem, config);
    let n = problem.previous.len();
    let (mut own, mut best, mut nees, mut missed) = (Vec::new(), Vec::new(), Vec::new(), 0);
    for i in 0..n {
        let views =
            (0..problem.cameras.len()).filter(|v| problem.observations.weights[v * n + i] > 0.0).count();
        if out.status[i] != EstimateStatus::Ok {
            assert_eq!(out.means[i], problem.previous[i]);
            missed += usize::from(views >= 3);
            continue;
        }
        let error = out.means[i] - problem.truth[i];
        own.push(error.length());
        nees.push(error.dot(out.covariances[i].inverse() * error));
        best.extend(maximum_likelihood(problem, i).map(|p| (p - problem.truth[i]).length()));
    }
    nees.sort_by(f64::total_cmp);
    let kept = (nees.len() * 99).div_ceil(100);
    Verdict {
        median: quantile(&mut own, 0.5) / quantile(&mut best, 0.5),
        p90: quantile(&mut own, 0.9) / quantile(&mut best, 0.9),
        nees: nees[..kept].iter().sum::<f64>() / kept as f64,
        missed: missed as f64 / n as f64,
    }
}

fn quantile(values: &mut [f64], q: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    values[((values.len() - 1) as f64 * q) as usize]
}

/// Gauss-Newton from the truth on the views within six standard deviations of it. Independent of the crate: the
/// derivative is a central difference.
fn maximum_likelihood(problem: &Problem, i: usize) -> Option<DVec3> {
    let n = problem.previous.len();
    let entries = (problem.cameras.iter().enumerate()).filter_map(|(v, camera)| {
        let (w, target) = (problem.observations.weights[v * n + i], problem.observations.targets[v * n + i]);
        let at_truth = camera.project(problem.truth[i])?.pixel;
        (w > 0.0 && (target - at_truth).length() <= 6.0 * problem.noise.max(1e-9))
            .then_some((camera, target, w))
    });
    let entries: Vec<(&Camera, DVec2, f64)> = entries.collect();
    let mut x = problem.truth[i];
    for _ in 0..15 {
        let (mut a, mut b) = (DMat3::ZERO, DVec3::ZERO);
        for (camera, target, w) in &entries {
            let r = *target - camera.project(x)?.pixel;
            let h = 1e-6 * (x - camera.center()).length();
            let d = |axis: DVec3| -> Option<DVec2> {
                Some((camera.project(x + axis * h)?.pixel - camera.project(x - axis * h)?.pixel) / (2.0 * h))
            };
            let (dx, dy, dz) = (d(DVec3::X)?, d(DVec3::Y)?, d(DVec3::Z)?);
            for row in [DVec3::new(dx.x, dy.x, dz.x), DVec3::new(dx.y, dy.y, dz.y)].iter().zip([r.x, r.y]) {
                a += DMat3::from_cols(*row.0 * row.0.x, *row.0 * row.0.y, *row.0 * row.0.z) * *w;
                b += *row.0 * row.1 * *w;
            }
        }
        x += a.inverse() * b;
    }
    x.is_finite().then_some(x)
}
