use crate::config::TriangulationConfig;
use crate::normal::Normal;
use crate::robust::{self, Scales};
use crate::views::{RayWeights, Views};
use ffgs_core::EstimateStatus;
use glam::{DMat3, DVec3};

/// A solved Gaussian, before the noise scale is known.
#[derive(Clone, Copy, Debug)]
pub struct Solution {
    /// Displacement from the previous mean (m).
    pub step: DVec3,
    /// Inverse of the normal matrix with weights of mean 1: the covariance for a noise of 1 px (m^2).
    pub unit_covariance: DMat3,
    /// Weighted sum of squared residuals (px^2).
    pub residuals: f64,
    /// Degrees of freedom, 2 V - 3.
    pub degrees: f64,
    /// Views that count.
    pub views: usize,
}

/// A point with its normal system and weighted squared residuals (px^2).
#[derive(Clone, Copy)]
struct Fit {
    point: DVec3,
    normal: Normal,
    cost: f64,
}

/// Solves for the Gaussian whose observations are `views`; views that contradict the others are removed from it.
pub fn solve(
    views: &mut Views,
    config: &TriangulationConfig,
    scales: Scales,
) -> Result<Solution, EstimateStatus> {
    if views.len() < 2 {
        return Err(EstimateStatus::TooFewViews);
    }
    let start = ray_start(views, config).ok_or(EstimateStatus::Degenerate)?;
    let start = if config.robust { keep_consistent(views, start, scales)? } else { start };
    let fit = if config.robust {
        let rough = refine(views, start, config, ROUGH)?;
        settle(views, rough, config, scales)?
    } else {
        refine(views, start, config, CONVERGED)?
    };
    let solution = summarise(views, &fit)?;
    Ok(drop_collinear(views, solution, config))
}

/// Plain rays, re-weighted once with the solution's own depths.
fn ray_start(views: &Views, config: &TriangulationConfig) -> Option<DVec3> {
    if !config.depth_weighting {
        return views.rays(DVec3::ZERO, RayWeights::Plain).solve();
    }
    let first = views.rays(DVec3::ZERO, RayWeights::Depth).solve()?;
    views.rays(first, RayWeights::Depth).solve()
}

/// Moves to the consensus and removes the views beyond the cut there.
fn keep_consistent(views: &mut Views, start: DVec3, scales: Scales) -> Result<DVec3, EstimateStatus> {
    let point = robust::locate(views, start, scales);
    // Twice the cut: the point is not refined yet, and a view lost here never returns.
    let cut2 = 4.0 * scales.cut * scales.cut;
    let (mut kept, mut in_front) = (0, 0);
    for error in views.errors(point) {
        kept += usize::from(error <= cut2);
        in_front += usize::from(error < f64::INFINITY);
    }
    if kept < 2 {
        let hidden = in_front < 2;
        return Err(if hidden { EstimateStatus::BehindCamera } else { EstimateStatus::Residual });
    }
    if kept < views.len() {
        views.remove_where(point, |error| !(error <= cut2));
    }
    Ok(point)
}

/// Redescending rounds: drop the views beyond the cut, refine on the rest.
fn settle(
    views: &mut Views,
    mut fit: Fit,
    config: &TriangulationConfig,
    scales: Scales,
) -> Result<Fit, EstimateStatus> {
    let cut2 = scales.cut * scales.cut;
    while let Some(worst) = worst_beyond(views, fit.point, cut2) {
        if views.len() <= 2 {
            return Err(EstimateStatus::Residual);
        }
        views.remove(|view| view == worst);
        fit = refine(views, fit.point, config, ROUGH)?;
    }
    if config.refine {
        Ok(gauss_newton(views, fit, CONVERGED))
    } else {
        refine(views, fit.point, config, CONVERGED)
    }
}

fn worst_beyond(views: &mut Views, point: DVec3, cut2: f64) -> Option<usize> {
    let errors = views.errors(point).enumerate();
    errors.filter(|(_, e)| *e > cut2).max_by(|a, b| a.1.total_cmp(&b.1)).map(|(i, _)| i)
}

/// The least-squares point of the given views, from `start`.
fn refine(
    views: &Views,
    start: DVec3,
    config: &TriangulationConfig,
    tolerance: f64,
) -> Result<Fit, EstimateStatus> {
    if config.refine {
        let (normal, cost) = views.reprojection(start).ok_or(EstimateStatus::BehindCamera)?;
        return Ok(gauss_newton(views, Fit { point: start, normal, cost }, tolerance));
    }
    let weights = if config.depth_weighting { RayWeights::Depth } else { RayWeights::Plain };
    let point = views.rays(start, weights).solve().unwrap_or(start);
    Ok(Fit { point, normal: views.rays(point, RayWeights::Depth), cost: views.ray_cost(point) })
}

/// Gauss-Newton steps, at most; four suffice from the rays' solution, the rest is for narrow baselines.
const MAX_STEPS: usize = 20;
/// Relative step (of the distance to the cameras) at which the iteration has converged: nanometres at 1 m, and what is
/// left is a thousandth of the last step.
const CONVERGED: f64 = 1e-9;
/// The same where only the choice of the views depends on it: a hundredth of a pixel at the least.
const ROUGH: f64 = 1e-6;

/// Minimises the weighted reprojection error; a step that raises it is damped (Levenberg-Marquardt).
fn gauss_newton(views: &Views, start: Fit, tolerance: f64) -> Fit {
    let (mut best, mut damping) = (start, 0.0_f64);
    for _ in 0..MAX_STEPS {
        let Some(step) = best.normal.damped(damping).solve() else { break };
        let point = best.point + step;
        let small = step.length() <= tolerance * views.scale;
        match views.reprojection(point) {
            Some((normal, cost)) if cost <= best.cost => {
                best = Fit { point, normal, cost };
                damping = if damping > 1e-6 { damping * 0.1 } else { 0.0 };
            }
            _ => damping = (damping * 10.0).max(1e-3),
        }
        if small {
            break;
        }
    }
    best
}

/// Covariance for 1 px of noise, residuals and degrees of freedom at the solution.
fn summarise(views: &Views, fit: &Fit) -> Result<Solution, EstimateStatus> {
    let (n, mean) = (views.len(), views.mean_weight());
    if !fit.cost.is_finite() {
        return Err(EstimateStatus::BehindCamera);
    }
    let unit_covariance = fit.normal.inverse().ok_or(EstimateStatus::Degenerate)? * mean;
    let residuals = fit.cost / mean;
    Ok(Solution { step: fit.point, unit_covariance, residuals, degrees: 2.0 * n as f64 - 3.0, views: n })
}

/// Discards the views whose ray is nearly parallel to the motion (Algorithm 1, line 22) and solves again.
fn drop_collinear(views: &mut Views, solution: Solution, config: &TriangulationConfig) -> Solution {
    let length = solution.step.length();
    if config.collinear_degrees == 0.0 || length == 0.0 {
        return solution;
    }
    let direction = solution.step / length;
    // Without a pooled scale yet, 1 px counts as much as the Gaussian's own residuals.
    let variance = (1.0 + solution.residuals) / (1.0 + solution.degrees);
    let sigma = (variance * direction.dot(solution.unit_covariance * direction)).sqrt();
    let limit = config.collinear_degrees.to_radians().cos();
    let along: Vec<bool> = (0..views.len()).map(|v| !(views.ray(v).dot(direction).abs() <= limit)).collect();
    let remaining = along.iter().filter(|a| !**a).count();
    if length < config.collinear_min_sigma * sigma || remaining < 2 || remaining == views.len() {
        return solution;
    }
    views.remove(|view| along[view]);
    // Fewer views may no longer fix the point; then the solution with all of them stands.
    let again = refine(views, solution.step, config, CONVERGED);
    again.and_then(|fit| summarise(views, &fit)).unwrap_or(solution)
}
