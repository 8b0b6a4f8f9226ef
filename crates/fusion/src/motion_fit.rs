//! Robust rigid motion of a set of Gaussians from the trackers' estimates with their covariances.

use crate::evidence::{Evidence, MEDIAN_CHI2, MIN_SCALE};
use crate::members::{Members, Residuals};
use crate::normal::Normal;
use crate::rigid::RigidMotion;
use crate::symmetric::Symmetric;
use ffgs_core::median;
use glam::{DMat3, DQuat, DVec3};
use nalgebra::{Matrix6, Vector6};

/// A fitted motion.
#[derive(Clone, Debug)]
pub(crate) struct MotionFit {
    /// The motion; its centre is the mean of the members at t-1.
    pub motion: RigidMotion,
    /// Per tracker: robust variance of its estimates about the motion over what they claim.
    pub scales: Vec<f64>,
    /// Normal matrix over (step, rotation vector) with the robust weights.
    pub information: Matrix6<f64>,
}

/// Most re-weighted Gauss-Newton steps.
const STEPS: usize = 6;
/// A change below this (rad, and at the members' typical distance from their centre) ends them; the next one would be far smaller than any tracker's error.
const CONVERGED: f64 = 1e-4;

/// Fits the motion of the members by re-weighted least squares from `start`; every tracker's noise is scaled to what
/// its estimates show. `None` when the members do not determine a motion.
pub(crate) fn fit_motion(members: &Members, start: RigidMotion) -> Option<MotionFit> {
    let (centre, extent) = (members.centre, members.extent());
    let mut motion = RigidMotion { centre, rotation: start.rotation, step: start.apply(centre) - centre };
    let mut residuals = members.residuals(&motion);
    let mut fit = MotionFit { motion, scales: Vec::new(), information: Matrix6::zeros() };
    for _ in 0..STEPS {
        fit.scales = noise_scales(&residuals, members.trackers());
        let normal = residuals.normal(&fit.scales);
        fit.information = normal.a;
        let x = normal.damped().solve()?;
        motion.step += DVec3::new(x[0], x[1], x[2]);
        let turn = DQuat::from_scaled_axis(DVec3::new(x[3], x[4], x[5]));
        motion.rotation = (turn * motion.rotation).normalize();
        let shift = x.fixed_rows::<3>(0).amax();
        if x.fixed_rows::<3>(3).amax() < CONVERGED && shift < CONVERGED * extent {
            break;
        }
        residuals.update(&motion);
    }
    let finite = motion.step.is_finite() && motion.rotation.is_finite();
    finite.then_some(MotionFit { motion, ..fit })
}

/// Per tracker, the median squared Mahalanobis distance to the motion over that of consistent estimates.
fn noise_scales(residuals: &Residuals, trackers: usize) -> Vec<f64> {
    let mut distances = Vec::new();
    let scale = |l: usize| {
        residuals.distances(l, &mut distances);
        (median(distances.iter().copied()).unwrap_or(MEDIAN_CHI2) / MEDIAN_CHI2).max(MIN_SCALE)
    };
    (0..trackers).map(scale).collect()
}

/// Members are cut into this many compact clusters, whose errors count as independent of each other.
const CLUSTERS: usize = 16;

/// Covariance of (step, rotation vector) by delete-one jackknife over compact clusters of the members (which must be
/// in spatial order), plus that over trackers: errors are shared over a surface and within a tracker, so formal
/// covariances are far too small.
pub(crate) fn jackknife(
    evidence: &Evidence,
    previous: &[DVec3],
    members: &[usize],
    fit: &MotionFit,
) -> Matrix6<f64> {
    let trackers = evidence.trackers();
    let mut by_tracker = vec![Normal::zero(); trackers];
    let mut by_cluster = Vec::with_capacity(CLUSTERS);
    for cluster in members.chunks(members.len().div_ceil(CLUSTERS).max(1)) {
        let cluster = Members::about(fit.motion.centre, evidence, previous, cluster);
        let residuals = cluster.residuals(&fit.motion);
        let mut all = Normal::zero();
        for (l, tracker) in by_tracker.iter_mut().enumerate() {
            let part = residuals.normal(&only(l, &fit.scales));
            tracker.merge(&part);
            all.merge(&part);
        }
        by_cluster.push(all);
    }
    delete_one(&by_cluster) + delete_one(&by_tracker)
}

/// The scale of one tracker; the others get no weight.
fn only(tracker: usize, scales: &[f64]) -> Vec<f64> {
    scales.iter().enumerate().map(|(l, &s)| if l == tracker { s } else { f64::INFINITY }).collect()
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
pub(crate) fn place_covariance(of_motion: &Matrix6<f64>, arm: DVec3) -> Symmetric {
    let block = |row: usize, column: usize| {
        DMat3::from_cols_slice(of_motion.fixed_view::<3, 3>(row, column).into_owned().as_slice())
    };
    let k = -skew(arm);
    let cross = block(0, 3) * k.transpose();
    Symmetric::from(block(0, 0) + cross + cross.transpose() + k * block(3, 3) * k.transpose())
}

/// `skew(a) b = a x b`.
fn skew(a: DVec3) -> DMat3 {
    DMat3::from_cols(DVec3::new(0.0, a.z, -a.y), DVec3::new(-a.z, 0.0, a.x), DVec3::new(a.y, -a.x, 0.0))
}
