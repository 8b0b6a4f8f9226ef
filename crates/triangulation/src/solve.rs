//! The triangulation of one batch of Gaussians, one per SIMD lane: start, outliers, Gauss-Newton steps, covariance.

use crate::config::TriangulationConfig;
use crate::normal::Normal;
use crate::passes::{Fit, NEAR2, RayWeights};
use crate::robust::{self, Scales};
use crate::simd::{F64s, LaneMask, MAX_LANES, dot, plus};
use crate::views::Views;
use ffgs_core::EstimateStatus;
use glam::{DMat3, DVec3};
use pulp::Simd;

/// A solved Gaussian, before the noise scale is known.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Solution {
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

/// As [`Solution`], of the Gaussians of all lanes.
#[derive(Clone, Copy)]
struct Summary<S: Simd> {
    step: [F64s<S>; 3],
    /// xx, xy, xz, yy, yz, zz.
    unit_covariance: [F64s<S>; 6],
    residuals: F64s<S>,
    views: F64s<S>,
}

/// Which lanes are still being solved, and why the others are not.
struct LaneStates<S: Simd> {
    alive: LaneMask<S>,
    status: [EstimateStatus; MAX_LANES],
}

impl<S: Simd> LaneStates<S> {
    /// Every lane with a Gaussian is alive.
    #[inline(always)]
    fn new(views: &Views<S>) -> Self {
        let alive = views.count.gt(views.number(0.0));
        let mut status = [EstimateStatus::TooFewViews; MAX_LANES];
        alive.lanes().for_each(|lane| status[lane] = EstimateStatus::Ok);
        Self { alive, status }
    }

    /// The lanes that have a first guess are alive.
    #[inline(always)]
    fn after(views: &Views<S>, starts: &[Start]) -> (Self, [F64s<S>; 3]) {
        let mut status = [EstimateStatus::TooFewViews; MAX_LANES];
        let (mut alive, mut points) = ([0.0; MAX_LANES], [[0.0; MAX_LANES]; 3]);
        for (lane, start) in starts.iter().enumerate() {
            match start.point {
                Ok(point) => {
                    (alive[lane], status[lane]) = (1.0, EstimateStatus::Ok);
                    (0..3).for_each(|axis| points[axis][lane] = point[axis]);
                }
                Err(reason) => status[lane] = reason,
            }
        }
        let mut point = [views.number(0.0); 3];
        for axis in 0..3 {
            point[axis] = F64s::from_lanes(views.simd, &points[axis]);
        }
        (Self { alive: F64s::from_lanes(views.simd, &alive).gt(views.number(0.0)), status }, point)
    }

    #[inline(always)]
    fn outcome(&self, lane: usize) -> Result<(), EstimateStatus> {
        if self.status[lane] == EstimateStatus::Ok { Ok(()) } else { Err(self.status[lane]) }
    }

    /// Gives up the lanes among those alive.
    #[inline(always)]
    fn fail(&mut self, lanes: LaneMask<S>, status: EstimateStatus) {
        let lanes = lanes & self.alive;
        if lanes.any() {
            lanes.lanes().for_each(|lane| self.status[lane] = status);
            self.alive = self.alive.and_not(lanes);
        }
    }
}

/// Where a Gaussian's solution begins.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Start {
    /// The point (m from the previous mean), or why there is none.
    pub point: Result<[f64; 3], EstimateStatus>,
    /// Views that will probably be removed one after another.
    pub doubtful: u32,
}

impl Start {
    /// No Gaussian.
    pub(crate) const NONE: Self = Self { point: Err(EstimateStatus::TooFewViews), doubtful: 0 };
}

/// First guesses for the Gaussians whose observations are `views`: where most of them agree.
#[inline(always)]
pub(crate) fn begin<S: Simd>(
    views: &Views<S>,
    config: &TriangulationConfig,
    scales: Scales,
    out: &mut [Start],
) {
    let mut states = LaneStates::new(views);
    states.fail(views.number(2.0).gt(views.count), EstimateStatus::TooFewViews);
    let mut point = ray_start(views, config, &mut states);
    let mut doubtful = views.number(0.0);
    if config.robust {
        (point, doubtful) = consensus(views, point, scales, &mut states);
    }
    for (lane, out) in out.iter_mut().enumerate() {
        let start = [point[0].lane(lane), point[1].lane(lane), point[2].lane(lane)];
        *out = Start { point: states.outcome(lane).map(|()| start), doubtful: doubtful.lane(lane) as u32 };
    }
}

/// Solves for the Gaussians whose observations are `views`, from their first guesses; views that contradict the others are
/// removed from it.
#[inline(always)]
pub(crate) fn finish<S: Simd>(
    views: &mut Views<S>,
    starts: &[Start],
    config: &TriangulationConfig,
    scales: Scales,
    out: &mut [Result<Solution, EstimateStatus>],
) {
    let (mut states, point) = LaneStates::after(views, starts);
    let cut2 = config.robust.then_some(scales.cut * scales.cut);
    if let Some(cut2) = cut2 {
        views.remove_beyond(states.alive, point, views.number(NEAR2 * cut2));
    }
    let fit = settle(views, point, config, cut2, &mut states);
    let mut summary = summarise(views, &fit, &mut states);
    if config.collinear_degrees != 0.0 {
        summary = drop_collinear(views, summary, config, &states);
    }
    for (lane, out) in out.iter_mut().enumerate() {
        *out = states.outcome(lane).map(|()| summary.lane(lane));
    }
}

/// Plain rays, re-weighted once with the solution's own depths.
#[inline(always)]
fn ray_start<S: Simd>(
    views: &Views<S>,
    config: &TriangulationConfig,
    states: &mut LaneStates<S>,
) -> [F64s<S>; 3] {
    let weights = if config.depth_weighting { RayWeights::Depth } else { RayWeights::Plain };
    let mut point = [views.number(0.0); 3];
    for _ in 0..if config.depth_weighting { 2 } else { 1 } {
        let (next, solved) = views.meet(point, weights).solve(views.simd);
        states.fail(states.alive.and_not(solved), EstimateStatus::Degenerate);
        point = next;
    }
    point
}

/// Moves to the consensus, which needs two views near it; also the number of views between the cut and twice the cut there.
#[inline(always)]
fn consensus<S: Simd>(
    views: &Views<S>,
    start: [F64s<S>; 3],
    scales: Scales,
    states: &mut LaneStates<S>,
) -> ([F64s<S>; 3], F64s<S>) {
    let (point, agreement) = robust::locate(views, states.alive, start, scales);
    let two = views.number(2.0);
    let lost = two.gt(agreement.near);
    states.fail(lost & two.gt(agreement.in_front), EstimateStatus::BehindCamera);
    states.fail(lost, EstimateStatus::Residual);
    (point, agreement.near - agreement.agreeing)
}

/// Gauss-Newton steps, at most; four suffice from the rays' solution, the rest is for narrow baselines.
const MAX_STEPS: f64 = 20.0;
/// Relative step (of the distance to the cameras) at which the iteration has converged: nanometres at 1 m, and what is
/// left is a thousandth of the last step.
const CONVERGED: f64 = 1e-9;
/// The same where only the choice of the views depends on it: a hundredth of a pixel at the least.
const ROUGH: f64 = 1e-6;

/// The least-squares points, from `start`. With a cut, in redescending rounds: drop the worst view beyond it, refine on
/// the rest.
#[inline(always)]
fn settle<S: Simd>(
    views: &mut Views<S>,
    start: [F64s<S>; 3],
    config: &TriangulationConfig,
    cut2: Option<f64>,
    states: &mut LaneStates<S>,
) -> Fit<S> {
    if config.refine {
        gauss_newton(views, start, cut2, states)
    } else {
        rays_only(views, start, config, cut2, states)
    }
}

/// Minimises the weighted reprojection error; a step that raises it is damped (Levenberg-Marquardt). Every lane is in a
/// round of its own: roughly converged, it removes a view and begins anew, or goes on to the end.
#[inline(always)]
fn gauss_newton<S: Simd>(
    views: &mut Views<S>,
    start: [F64s<S>; 3],
    cut2: Option<f64>,
    states: &mut LaneStates<S>,
) -> Fit<S> {
    let simd = views.simd;
    let (zero, one) = (views.number(0.0), views.number(1.0));
    let (mut fit, hidden) = views.reproject(start);
    states.fail(hidden, EstimateStatus::BehindCamera);
    let nowhere = LaneMask::nowhere(simd);
    let rough = if cut2.is_some() { states.alive } else { nowhere };
    let mut rounds = Rounds { running: states.alive, rough, stale: nowhere, damping: zero, steps: zero };
    let cut2 = views.number(cut2.unwrap_or(f64::INFINITY));
    // Lanes whose views changed after their last step: their normal equations are summed once more at the same point.
    let mut again = nowhere;
    while rounds.running.any() {
        let (mut step, mut solved) = fit.normal.damped(simd, rounds.damping).solve(simd);
        let mut small = dot(step, step).sqrt().le(rounds.tolerance(views));
        let converged = (rounds.running & rounds.rough & solved & small).and_not(rounds.stale | again);
        let converged = converged & fit.certain(views, step, cut2);
        if converged.any() {
            rounds.next_round(converged, views, &mut fit, cut2, states);
            (step, solved) = fit.normal.damped(simd, rounds.damping).solve(simd);
            small = dot(step, step).sqrt().le(rounds.tolerance(views));
        }
        let stepping = (rounds.running & solved).and_not(again);
        let (trial, hidden) = views.reproject(stepping.select3(plus(fit.point, step), fit.point));
        let better = (stepping & trial.cost.le(fit.cost)).and_not(hidden);
        fit = Fit::select(better | again, trial, fit);
        rounds.stale = rounds.stale.and_not(better | again);
        let less = rounds.damping.gt(views.number(1e-6)).select(rounds.damping * views.number(0.1), zero);
        let more = (rounds.damping * views.number(10.0)).max(views.number(1e-3));
        rounds.damping = better.select(less, stepping.select(more, rounds.damping));
        rounds.steps = stepping.select(rounds.steps + one, rounds.steps);
        small = small | views.number(MAX_STEPS).le(rounds.steps);
        let ended = again | (stepping & small) | rounds.running.and_not(stepping);
        rounds.running = rounds.running.and_not(ended.and_not(rounds.rough));
        let converged = ended & rounds.running & rounds.rough;
        again = converged & rounds.stale;
        let converged = converged.and_not(again);
        if converged.any() {
            rounds.next_round(converged, views, &mut fit, cut2, states);
        }
    }
    fit
}

/// The round each lane is in.
struct Rounds<S: Simd> {
    running: LaneMask<S>,
    /// Lanes whose views are still being chosen.
    rough: LaneMask<S>,
    /// Lanes that lost a view since their last full sum.
    stale: LaneMask<S>,
    damping: F64s<S>,
    /// Steps in this round.
    steps: F64s<S>,
}

impl<S: Simd> Rounds<S> {
    /// Length of a last step (m).
    #[inline(always)]
    fn tolerance(&self, views: &Views<S>) -> F64s<S> {
        self.rough.select(views.number(ROUGH), views.number(CONVERGED)) * views.scale
    }

    /// Ends the rough round of the lanes: the worst view goes if it is beyond the cut, or else the last round begins.
    #[inline(always)]
    fn next_round(
        &mut self,
        lanes: LaneMask<S>,
        views: &mut Views<S>,
        fit: &mut Fit<S>,
        cut2: F64s<S>,
        states: &mut LaneStates<S>,
    ) {
        let beyond = lanes & fit.worst.gt(cut2);
        let lost = beyond & views.count.le(views.number(2.0));
        states.fail(lost, EstimateStatus::Residual);
        self.running = self.running.and_not(lost);
        let fewer = beyond.and_not(lost);
        if fewer.any() {
            views.remove_worst(fewer, fit);
        }
        self.stale = self.stale | fewer;
        self.rough = self.rough.and_not(lanes.and_not(beyond));
        self.damping = lanes.select(views.number(0.0), self.damping);
        self.steps = lanes.select(views.number(0.0), self.steps);
    }
}

/// As [`gauss_newton`] with the weighted rays alone: a re-weighting a round.
#[inline(always)]
fn rays_only<S: Simd>(
    views: &mut Views<S>,
    start: [F64s<S>; 3],
    config: &TriangulationConfig,
    cut2: Option<f64>,
    states: &mut LaneStates<S>,
) -> Fit<S> {
    let simd = views.simd;
    let weights = if config.depth_weighting { RayWeights::Depth } else { RayWeights::Plain };
    let mut point = start;
    let mut moving = states.alive;
    let mut agreement = None;
    loop {
        let (next, solved) = views.meet(point, weights).solve(simd);
        point = (moving & solved).select3(next, point);
        let Some(cut2) = cut2.filter(|_| agreement.is_none()) else { break };
        let found = views.agreement(point, views.number(cut2));
        moving = states.alive & found.worst.gt(views.number(cut2));
        let lost = moving & views.count.le(views.number(2.0));
        states.fail(lost, EstimateStatus::Residual);
        moving = moving.and_not(lost);
        views.remove(moving, found.worst_row);
        if !moving.any() {
            moving = states.alive;
            agreement = Some(found);
        }
    }
    let zero = views.number(0.0);
    let normal = views.meet(point, RayWeights::Depth);
    let cost = views.ray_cost(point);
    Fit { point, normal, cost, worst: zero, worst_row: zero, second: zero, reach2: zero }
}

/// Covariance for 1 px of noise, residuals and degrees of freedom at the solution.
#[inline(always)]
fn summarise<S: Simd>(views: &Views<S>, fit: &Fit<S>, states: &mut LaneStates<S>) -> Summary<S> {
    let mean = views.mean_weight();
    states.fail(states.alive.and_not(fit.cost.finite()), EstimateStatus::BehindCamera);
    let (mut unit_covariance, sound) = fit.normal.inverse(views.simd);
    states.fail(states.alive.and_not(sound), EstimateStatus::Degenerate);
    for entry in &mut unit_covariance {
        *entry = *entry * mean;
    }
    Summary { step: fit.point, unit_covariance, residuals: fit.cost / mean, views: views.count }
}

impl<S: Simd> Summary<S> {
    /// Degrees of freedom, 2 V - 3.
    #[inline(always)]
    fn lane(&self, lane: usize) -> Solution {
        let [xx, xy, xz, yy, yz, zz] = self.unit_covariance;
        let columns = [xx, xy, xz, xy, yy, yz, xz, yz, zz];
        let (mut step, mut unit_covariance) = ([0.0; 3], [0.0; 9]);
        for k in 0..3 {
            step[k] = self.step[k].lane(lane);
        }
        for k in 0..9 {
            unit_covariance[k] = columns[k].lane(lane);
        }
        let views = self.views.lane(lane);
        Solution {
            step: step.into(),
            unit_covariance: DMat3::from_cols_array(&unit_covariance),
            residuals: self.residuals.lane(lane),
            degrees: 2.0 * views - 3.0,
            views: views as usize,
        }
    }

    #[inline(always)]
    fn select(place: LaneMask<S>, yes: Self, no: Self) -> Self {
        let mut out = no;
        out.step = place.select3(yes.step, no.step);
        for k in 0..6 {
            out.unit_covariance[k] = place.select(yes.unit_covariance[k], no.unit_covariance[k]);
        }
        out.residuals = place.select(yes.residuals, no.residuals);
        out.views = place.select(yes.views, no.views);
        out
    }

    /// Standard deviation along a unit vector (m), for a noise variance (px^2).
    #[inline(always)]
    fn sigma(&self, direction: [F64s<S>; 3], variance: F64s<S>) -> F64s<S> {
        let [xx, xy, xz, yy, yz, zz] = self.unit_covariance;
        let across = [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]];
        let along = [dot(across[0], direction), dot(across[1], direction), dot(across[2], direction)];
        (variance * dot(direction, along)).sqrt()
    }
}

/// Discards the views whose ray is nearly parallel to the motion (Algorithm 1, line 22) and solves again.
#[inline(always)]
fn drop_collinear<S: Simd>(
    views: &mut Views<S>,
    first: Summary<S>,
    config: &TriangulationConfig,
    states: &LaneStates<S>,
) -> Summary<S> {
    let (zero, one) = (views.number(0.0), views.number(1.0));
    let length = dot(first.step, first.step).sqrt();
    let direction = [first.step[0] / length, first.step[1] / length, first.step[2] / length];
    // Without a pooled scale yet, 1 px counts as much as the Gaussian's own residuals.
    let degrees = views.number(2.0) * first.views - views.number(3.0);
    let variance = (one + first.residuals) / (one + degrees);
    let shortest = views.number(config.collinear_min_sigma) * first.sigma(direction, variance);
    let limit = views.number(config.collinear_degrees.to_radians().cos());
    let mut remaining = zero;
    for row in &mut views.rows {
        let across = row.weight.gt(zero) & dot(row.ray, direction).abs().le(limit);
        row.weight = across.select(row.weight, zero);
        remaining = remaining + across.select(one, zero);
    }
    let fewer = views.number(1.5).le(remaining) & first.views.gt(remaining);
    let lanes = (states.alive & length.gt(zero) & fewer).and_not(shortest.gt(length));
    if !lanes.any() {
        return first;
    }
    views.count = remaining;
    // Fewer views may no longer fix the point; then the solution with all of them stands.
    let mut again = LaneStates { alive: lanes, status: states.status };
    let fit = settle(views, first.step, config, None, &mut again);
    let second = summarise(views, &fit, &mut again);
    Summary::select(again.alive, second, first)
}

impl<S: Simd> Fit<S> {
    /// Where a step cannot change which view is the worst, nor whether it is within the cut: then it need not be taken to
    /// tell.
    ///
    /// A step `s` from depth `z` with slopes `a = x / z`, `b = y / z` moves a projection by exactly
    /// `(f_x (s_x - a s_z), f_y (s_y - b s_z)) / (z + s_z)`, which is at most `|J| |s| / (1 - |s| / z)`, where
    /// `|J|^2 = (f_x^2 (1 + a^2) + f_y^2 (1 + b^2)) / z^2`, and a residual changes by no more than that. As `|J|` is at
    /// least `f sqrt(2) / z`, twice `|J| |s|` is an upper bound wherever it is within the shortest focal length.
    #[inline(always)]
    fn certain(&self, views: &Views<S>, step: [F64s<S>; 3], cut2: F64s<S>) -> LaneMask<S> {
        let margin = views.number(2.0) * (dot(step, step) * self.reach2).sqrt();
        let (worst, second, cut) = (self.worst.sqrt(), self.second.sqrt(), cut2.sqrt());
        let first = (worst - second).gt(margin + margin);
        let decided = cut.gt(worst + margin) | (first & (worst - margin).gt(cut));
        decided & margin.le(views.number(views.least_focal))
    }

    #[inline(always)]
    fn select(place: LaneMask<S>, yes: Self, no: Self) -> Self {
        Self {
            point: place.select3(yes.point, no.point),
            normal: Normal::select(place, yes.normal, no.normal),
            cost: place.select(yes.cost, no.cost),
            worst: place.select(yes.worst, no.worst),
            worst_row: place.select(yes.worst_row, no.worst_row),
            second: place.select(yes.second, no.second),
            reach2: place.select(yes.reach2, no.reach2),
        }
    }
}

#[cfg(test)]
mod tests;
