use crate::config::TriangulationConfig;
use crate::normal::{self, Normal, outer};
use crate::rays;
use crate::robust::{self, Scales};
use crate::views::View;
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

/// Solves for the Gaussian whose observations are `views`; views that contradict the others are removed from it.
pub fn solve(
    views: &mut Vec<View>,
    config: &TriangulationConfig,
    scales: Scales,
) -> Result<Solution, EstimateStatus> {
    if views.len() < 2 {
        return Err(EstimateStatus::TooFewViews);
    }
    let start = ray_start(views, config).ok_or(EstimateStatus::Degenerate)?;
    let start = if config.robust { keep_consistent(views, start, scales)? } else { start };
    if views.iter().any(|v| !(v.depth(start) > 0.0)) {
        return Err(EstimateStatus::BehindCamera);
    }
    let point = if config.robust {
        let rough = refine(views, start, config, ROUGH);
        settle(views, rough, config, scales)?
    } else {
        refine(views, start, config, CONVERGED)
    };
    let solution = summarise(views, point, config)?;
    Ok(drop_collinear(views, solution, config))
}

/// Plain rays, re-weighted once with the solution's own depths.
fn ray_start(views: &[View], config: &TriangulationConfig) -> Option<DVec3> {
    if !config.depth_weighting {
        return rays::solve(views, |_| 1.0);
    }
    let first = rays::solve(views, |v| rays::pixels_per_metre_squared(v, DVec3::ZERO))?;
    rays::solve(views, |v| rays::pixels_per_metre_squared(v, first))
}

/// Moves to the consensus and removes the views beyond the cut there.
fn keep_consistent(views: &mut Vec<View>, start: DVec3, scales: Scales) -> Result<DVec3, EstimateStatus> {
    let point = robust::locate(views, start, scales);
    // Twice the cut: the point is not refined yet, and a view lost here never returns.
    let cut2 = 4.0 * scales.cut * scales.cut;
    let kept = views.iter().filter(|v| v.error_squared(point) <= cut2).count();
    if kept >= 2 {
        views.retain(|v| v.error_squared(point) <= cut2);
        return Ok(point);
    }
    let in_front = views.iter().filter(|v| v.depth(point) > 0.0).count();
    Err(if in_front < 2 { EstimateStatus::BehindCamera } else { EstimateStatus::Residual })
}

/// Redescending rounds: drop the views beyond the cut, refine on the rest.
fn settle(
    views: &mut Vec<View>,
    mut point: DVec3,
    config: &TriangulationConfig,
    scales: Scales,
) -> Result<DVec3, EstimateStatus> {
    let cut2 = scales.cut * scales.cut;
    while let Some(worst) = worst_beyond(views, point, cut2) {
        if views.len() <= 2 {
            return Err(EstimateStatus::Residual);
        }
        views.swap_remove(worst);
        point = refine(views, point, config, ROUGH);
    }
    Ok(refine(views, point, config, CONVERGED))
}

fn worst_beyond(views: &[View], point: DVec3, cut2: f64) -> Option<usize> {
    let errors = views.iter().map(|v| v.error_squared(point)).enumerate();
    errors.filter(|(_, e)| *e > cut2).max_by(|a, b| a.1.total_cmp(&b.1)).map(|(i, _)| i)
}

/// The least-squares point of the given views, from `start`.
fn refine(views: &[View], start: DVec3, config: &TriangulationConfig, tolerance: f64) -> DVec3 {
    if config.refine {
        return gauss_newton(views, start, tolerance);
    }
    let again = if config.depth_weighting {
        rays::solve(views, |v| rays::pixels_per_metre_squared(v, start))
    } else {
        rays::solve(views, |_| 1.0)
    };
    again.unwrap_or(start)
}

/// Gauss-Newton steps, at most; four suffice from the rays' solution, the rest is for narrow baselines.
const MAX_STEPS: usize = 20;
/// Relative step (of the distance to the cameras) at which the iteration has converged.
const CONVERGED: f64 = 1e-12;
/// The same where only the choice of the views depends on it: a hundredth of a pixel at the least.
const ROUGH: f64 = 1e-6;

/// Minimises the weighted reprojection error; a step that raises it is damped (Levenberg-Marquardt).
fn gauss_newton(views: &[View], start: DVec3, tolerance: f64) -> DVec3 {
    let scale = views.iter().map(|v| v.center.length()).fold(0.0, f64::max);
    let (mut point, mut damping) = (start, 0.0);
    let mut cost = reprojection_cost(views, point);
    for _ in 0..MAX_STEPS {
        let Some(step) = damped_step(views, point, damping) else { break };
        let next = reprojection_cost(views, point + step);
        if next <= cost {
            point += step;
            cost = next;
            damping = if damping > 1e-6 { damping * 0.1 } else { 0.0 };
            if step.length() <= tolerance * scale {
                break;
            }
        } else if step.length() <= tolerance * scale {
            break;
        } else {
            damping = (damping * 10.0).max(1e-3);
        }
    }
    point
}

fn reprojection_cost(views: &[View], point: DVec3) -> f64 {
    views.iter().map(|v| v.weight * v.error_squared(point)).sum()
}

fn damped_step(views: &[View], point: DVec3, damping: f64) -> Option<DVec3> {
    let mut normal = reprojection_normal(views, point)?;
    let diagonal = DVec3::new(normal.a.0.x_axis.x, normal.a.0.y_axis.y, normal.a.0.z_axis.z);
    normal.a.0 += DMat3::from_diagonal(diagonal * damping);
    normal.solve()
}

/// `sum w J^T J` and `sum w J^T r`; `None` behind a camera.
fn reprojection_normal(views: &[View], point: DVec3) -> Option<Normal> {
    let mut normal = Normal::default();
    for view in views {
        let r = view.linearise(point)?;
        let [jx, jy] = r.jacobian;
        normal.add((outer(jx) + outer(jy)) * view.weight, (jx * r.pixel.x + jy * r.pixel.y) * view.weight);
    }
    Some(normal)
}

/// Covariance for 1 px of noise, residuals and degrees of freedom at the solution.
fn summarise(views: &[View], step: DVec3, config: &TriangulationConfig) -> Result<Solution, EstimateStatus> {
    let n = views.len();
    let mean = views.iter().map(|v| v.weight).sum::<f64>() / n as f64;
    let (information, residuals): (DMat3, f64) = if config.refine {
        let normal = reprojection_normal(views, step).ok_or(EstimateStatus::BehindCamera)?;
        (normal.a.0, reprojection_cost(views, step))
    } else {
        let normal = rays::normal(views, |v| rays::pixels_per_metre_squared(v, step));
        (normal.a.0, views.iter().map(|v| v.weight * rays::residual_squared(v, step)).sum())
    };
    let information = information * mean.recip();
    let residuals = residuals / mean;
    let unit_covariance = normal::inverse(&information).ok_or(EstimateStatus::Degenerate)?;
    if !residuals.is_finite() {
        return Err(EstimateStatus::BehindCamera);
    }
    Ok(Solution { step, unit_covariance, residuals, degrees: 2.0 * n as f64 - 3.0, views: n })
}

/// Discards the views whose ray is nearly parallel to the motion (Algorithm 1, line 22) and solves again.
fn drop_collinear(views: &mut Vec<View>, solution: Solution, config: &TriangulationConfig) -> Solution {
    let length = solution.step.length();
    if config.collinear_degrees == 0.0 || length == 0.0 {
        return solution;
    }
    let direction = solution.step / length;
    // Without a pooled scale yet, 1 px counts as much as the Gaussian's own residuals.
    let variance = (1.0 + solution.residuals) / (1.0 + solution.degrees);
    let sigma = (variance * direction.dot(solution.unit_covariance * direction)).sqrt();
    let limit = config.collinear_degrees.to_radians().cos();
    let kept = |v: &View| v.ray.dot(direction).abs() <= limit;
    let remaining = views.iter().filter(|v| kept(v)).count();
    if length < config.collinear_min_sigma * sigma || remaining < 2 || remaining == views.len() {
        return solution;
    }
    views.retain(kept);
    // Fewer views may no longer fix the point; then the solution with all of them stands.
    let point = refine(views, solution.step, config, CONVERGED);
    summarise(views, point, config).unwrap_or(solution)
}
