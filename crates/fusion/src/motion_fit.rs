//! Robust rigid motion of a set of Gaussians from the trackers' estimates with their covariances.

use crate::evidence::{Evidence, MEDIAN_CHI2, MIN_SCALE, robust_weight};
use crate::process_noise::median;
use crate::rigid::RigidMotion;
use glam::{DMat3, DQuat, DVec3};
use nalgebra::{Matrix3, Matrix6, Vector6};

/// A fitted motion.
#[derive(Clone, Debug)]
pub struct MotionFit {
    /// The motion; its centre is the mean of the members at t-1.
    pub motion: RigidMotion,
    /// Per tracker: robust variance of its estimates about the motion over what they claim.
    pub scales: Vec<f64>,
    /// Normal matrix over (step, rotation vector) with the robust weights.
    pub information: Matrix6<f64>,
}

/// Normal equations over (step, rotation vector).
#[derive(Clone, Copy)]
struct Normal {
    a: Matrix6<f64>,
    b: Vector6<f64>,
}

impl Normal {
    fn zero() -> Self {
        Self { a: Matrix6::zeros(), b: Vector6::zeros() }
    }

    /// One Gaussian at `arm` from the centre of rotation, with information `w` and `w` times its residual.
    fn add(&mut self, arm: DVec3, w: DMat3, wr: DVec3) {
        let k = skew(arm);
        let blocks = [(0, 0, w), (0, 3, -(w * k)), (3, 3, k.transpose() * w * k)];
        for (row, column, block) in blocks {
            let mut view = self.a.fixed_view_mut::<3, 3>(row, column);
            view += Matrix3::from_column_slice(&block.to_cols_array());
        }
        let torque = arm.cross(wr);
        self.b += Vector6::new(wr.x, wr.y, wr.z, torque.x, torque.y, torque.z);
    }

    /// With a rotation that changes by no more than about 0.3 rad without evidence; the solution stays the same.
    fn damped(mut self) -> Self {
        (3..6).for_each(|k| self.a[(k, k)] += 11.0);
        self
    }

    fn merge(&mut self, other: &Self) {
        self.a += other.a;
        self.b += other.b;
    }

    /// The matrix with its lower triangle filled in.
    fn matrix(&self) -> Matrix6<f64> {
        let mut a = self.a;
        a.fill_lower_triangle_with_upper_triangle();
        a
    }

    fn solve(&self) -> Option<Vector6<f64>> {
        let x = self.matrix().cholesky()?.solve(&self.b);
        x.iter().all(|v| v.is_finite()).then_some(x)
    }
}

/// `skew(a) b = a x b`.
pub fn skew(a: DVec3) -> DMat3 {
    DMat3::from_cols(DVec3::new(0.0, a.z, -a.y), DVec3::new(-a.z, 0.0, a.x), DVec3::new(a.y, -a.x, 0.0))
}

/// Most re-weighted Gauss-Newton steps.
const STEPS: usize = 6;
/// A change below this (m, rad) ends them; the next one would be far smaller than any tracker's error.
const CONVERGED: f64 = 1e-4;

/// Fits the motion of `members` by re-weighted least squares from `start`; every tracker's noise is scaled to what its
/// estimates show. `None` when the members do not determine a motion.
pub fn fit_motion(
    evidence: &Evidence,
    previous: &[DVec3],
    members: &[usize],
    start: RigidMotion,
) -> Option<MotionFit> {
    let centre = members.iter().map(|&i| previous[i] - start.centre).sum::<DVec3>() / members.len() as f64
        + start.centre;
    let mut motion = RigidMotion { centre, rotation: start.rotation, step: start.apply(centre) - centre };
    let mut scales = Vec::new();
    let mut normal = Normal::zero();
    for _ in 0..STEPS {
        scales = noise_scales(evidence, previous, members, &motion);
        normal = Normal::zero();
        for &i in members {
            let arm = motion.rotation * (previous[i] - motion.centre);
            let predicted = arm + motion.centre + motion.step;
            let terms =
                scales.iter().enumerate().filter_map(|(l, s)| weighted(evidence, l, i, predicted, *s));
            let (w, wr) = terms.fold((DMat3::ZERO, DVec3::ZERO), |sum, t| (sum.0 + t.0, sum.1 + t.1));
            normal.add(arm, w, wr);
        }
        let x = normal.damped().solve()?;
        motion.step += DVec3::new(x[0], x[1], x[2]);
        let turn = DQuat::from_scaled_axis(DVec3::new(x[3], x[4], x[5]));
        motion.rotation = (turn * motion.rotation).normalize();
        if x.amax() < CONVERGED {
            break;
        }
    }
    let finite = motion.step.is_finite() && motion.rotation.is_finite();
    finite.then(|| MotionFit { motion, scales, information: normal.matrix() })
}

/// Robustly weighted information of one estimate about a predicted place, and its product with the residual.
fn weighted(evidence: &Evidence, l: usize, i: usize, predicted: DVec3, scale: f64) -> Option<(DMat3, DVec3)> {
    let (mean, information) = evidence.of(l, i)?;
    let r = mean - predicted;
    let scaled = information * scale.recip();
    let w = scaled * robust_weight(r.dot(scaled * r));
    Some((w, w * r))
}

/// Per tracker, the median squared Mahalanobis distance to the motion over that of consistent estimates.
pub fn noise_scales(
    evidence: &Evidence,
    previous: &[DVec3],
    members: &[usize],
    motion: &RigidMotion,
) -> Vec<f64> {
    let scale = |l: usize| {
        let distance = |&i: &usize| {
            let (mean, information) = evidence.of(l, i)?;
            let r = mean - motion.apply(previous[i]);
            Some(r.dot(information * r))
        };
        let mut distances: Vec<f64> = members.iter().filter_map(distance).collect();
        (median(&mut distances).unwrap_or(MEDIAN_CHI2) / MEDIAN_CHI2).max(MIN_SCALE)
    };
    (0..evidence.trackers()).map(scale).collect()
}

/// Members are cut into this many compact clusters, whose errors count as independent of each other.
const CLUSTERS: usize = 16;

/// Covariance of (step, rotation vector) by delete-one jackknife over compact clusters of the members (which must be
/// in spatial order), plus that over trackers: errors are shared over a surface and within a tracker, so formal
/// covariances are far too small.
pub fn jackknife(
    evidence: &Evidence,
    previous: &[DVec3],
    members: &[usize],
    fit: &MotionFit,
) -> Matrix6<f64> {
    let trackers = evidence.trackers();
    let chunk = members.len().div_ceil(CLUSTERS).max(1);
    let mut by_cluster = vec![Normal::zero(); members.len().div_ceil(chunk)];
    let mut by_tracker = vec![Normal::zero(); trackers];
    for (k, &i) in members.iter().enumerate() {
        let arm = fit.motion.rotation * (previous[i] - fit.motion.centre);
        let predicted = arm + fit.motion.centre + fit.motion.step;
        for (l, tracker) in by_tracker.iter_mut().enumerate() {
            if let Some((w, wr)) = weighted(evidence, l, i, predicted, fit.scales[l]) {
                tracker.add(arm, w, wr);
                by_cluster[k / chunk].add(arm, w, wr);
            }
        }
    }
    delete_one(&by_cluster) + delete_one(&by_tracker)
}

/// `(n - 1) / n` times the sum of the squared changes when one group is left out; zero with one group.
fn delete_one(groups: &[Normal]) -> Matrix6<f64> {
    let mut total = Normal::zero();
    groups.iter().for_each(|g| total.merge(g));
    let centre = total.solve().unwrap_or_else(Vector6::zeros);
    let n = groups.len() as f64;
    let change = |g: &Normal| Normal { a: total.a - g.a, b: total.b - g.b }.solve().map(|x| x - centre);
    let squares = groups.iter().filter_map(change).map(|d| d * d.transpose());
    squares.fold(Matrix6::zeros(), |sum, s| sum + s) * ((n - 1.0) / n.max(1.0))
}

/// Covariance (m^2) of a place moved by a motion with covariance `of_motion`, at `arm` from its centre.
pub fn place_covariance(of_motion: &Matrix6<f64>, arm: DVec3) -> DMat3 {
    let block = |row: usize, column: usize| {
        DMat3::from_cols_slice(of_motion.fixed_view::<3, 3>(row, column).into_owned().as_slice())
    };
    let k = -skew(arm);
    let cross = block(0, 3) * k.transpose();
    let sum = block(0, 0) + cross + cross.transpose() + k * block(3, 3) * k.transpose();
    (sum + sum.transpose()) * 0.5
}
