//! The Gaussians that a motion is fitted to, in blocks of [`LANES`] side by side: each pass over them is one loop that
//! is compiled for the machine's widest instructions. Sums run over lanes first, so that they are the same on every
//! machine and for any number of threads.

use crate::evidence::{Evidence, robust_weight};
use crate::normal::{Normal, TERMS};
use crate::rigid::RigidMotion;
use ffgs_core::instructions;
use glam::{DMat3, DVec3};
use pulp::{Simd, WithSimd};

/// Gaussians of a block.
const LANES: usize = 8;
type Lanes = [f64; LANES];

/// What one tracker says of a block; lanes without a usable estimate are zero.
#[derive(Clone, Copy, Default)]
struct ToldBlock {
    /// Its places at t from the centre (m).
    places: [Lanes; 3],
    /// Upper triangles of the inverse covariances (1/m^2).
    information: [Lanes; 6],
}

/// A tracker's block about a motion.
#[derive(Clone, Copy, Default)]
struct Residual {
    /// Information times the offset from where the motion takes the Gaussian (1/m).
    pulls: [Lanes; 3],
    /// Squared Mahalanobis distances.
    distances: Lanes,
}

/// M members and what L trackers say of them, in B blocks.
pub(crate) struct Members {
    /// Their mean place at t-1 (m).
    pub centre: DVec3,
    count: usize,
    trackers: usize,
    /// (B) places at t-1 from the centre (m).
    places: Vec<[Lanes; 3]>,
    /// (B, L)
    told: Vec<ToldBlock>,
}

impl Members {
    /// Of `members`, at least one, with their places `previous` (N, m) at t-1.
    pub(crate) fn new(evidence: &Evidence, previous: &[DVec3], members: &[usize]) -> Self {
        let first = previous[members[0]];
        let offsets = members.iter().map(|&i| previous[i] - first).sum::<DVec3>();
        Self::about(first + offsets / members.len() as f64, evidence, previous, members)
    }

    /// About a given centre (m).
    pub(crate) fn about(centre: DVec3, evidence: &Evidence, previous: &[DVec3], members: &[usize]) -> Self {
        let (trackers, blocks) = (evidence.trackers(), members.len().div_ceil(LANES));
        let mut places = vec![[[0.0; LANES]; 3]; blocks];
        let mut told = vec![ToldBlock::default(); blocks * trackers];
        let put = |column: &mut [Lanes; 3], lane: usize, place: DVec3| {
            let offset = place - centre;
            (column[0][lane], column[1][lane], column[2][lane]) = (offset.x, offset.y, offset.z);
        };
        for (k, &i) in members.iter().enumerate() {
            let (block, lane) = (k / LANES, k % LANES);
            put(&mut places[block], lane, previous[i]);
            for (l, one) in evidence.of(i) {
                let to = &mut told[block * trackers + l];
                put(&mut to.places, lane, one.mean);
                to.information.iter_mut().zip(one.information.to_array()).for_each(|(c, v)| c[lane] = v);
            }
        }
        Self { centre, count: members.len(), trackers, places, told }
    }

    /// Root mean square distance from the centre at t-1 (m).
    pub(crate) fn extent(&self) -> f64 {
        let squares = self.places.iter().flatten().flatten().map(|v| v * v).sum::<f64>();
        (squares / self.count.max(1) as f64).sqrt()
    }

    /// Number of trackers L.
    pub(crate) fn trackers(&self) -> usize {
        self.trackers
    }

    /// The usable displacements of all trackers along an axis (m).
    pub(crate) fn steps(&self, axis: usize) -> Vec<f64> {
        let mut steps = Vec::with_capacity(self.told.len() * LANES);
        for (k, told) in self.told.iter().enumerate() {
            let from = &self.places[k / self.trackers][axis];
            let usable = (0..LANES).filter(|&lane| told.information[0][lane] > 0.0);
            steps.extend(usable.map(|lane| told.places[axis][lane] - from[lane]));
        }
        steps
    }

    /// The members about a motion around their centre.
    pub(crate) fn residuals(&self, motion: &RigidMotion) -> Residuals<'_> {
        let arms = vec![[[0.0; LANES]; 3]; self.places.len()];
        let mut out = Residuals { members: self, arms, blocks: vec![Residual::default(); self.told.len()] };
        out.update(motion);
        out
    }
}

/// Members about a motion.
pub(crate) struct Residuals<'a> {
    members: &'a Members,
    /// (B) turned places at t-1 from the centre (m).
    arms: Vec<[Lanes; 3]>,
    /// (B, L)
    blocks: Vec<Residual>,
}

impl Residuals<'_> {
    /// About another motion.
    pub(crate) fn update(&mut self, motion: &RigidMotion) {
        let rotation = DMat3::from_quat(motion.rotation).transpose();
        let rows = [rotation.x_axis, rotation.y_axis, rotation.z_axis].map(|r| r.to_array());
        let step = motion.step + (motion.centre - self.members.centre);
        instructions().dispatch(Update { rows, step: step.to_array(), of: self });
    }

    /// Squared Mahalanobis distances of one tracker's usable estimates, in `out`.
    pub(crate) fn distances(&self, tracker: usize, out: &mut Vec<f64>) {
        out.clear();
        let trackers = self.members.trackers;
        let mine = self.members.told.iter().zip(&self.blocks).skip(tracker).step_by(trackers.max(1));
        for (told, residual) in mine {
            let usable = (0..LANES).filter(|&lane| told.information[0][lane] > 0.0);
            out.extend(usable.map(|lane| residual.distances[lane]));
        }
    }

    /// Robustly weighted normal equations with (L) factors `scales` on the trackers' covariances.
    pub(crate) fn normal(&self, scales: &[f64]) -> Normal {
        let mut sums = [[0.0; LANES]; TERMS];
        instructions().dispatch(Sum { of: self, scales, sums: &mut sums });
        Normal::new(&sums.map(|lanes| lanes.iter().sum::<f64>()))
    }
}

struct Update<'a, 'b> {
    /// Rows of the rotation.
    rows: [[f64; 3]; 3],
    step: [f64; 3],
    of: &'a mut Residuals<'b>,
}

impl WithSimd for Update<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let members = self.of.members;
        for (block, arms) in self.of.arms.iter_mut().enumerate() {
            turn(&self.rows, &members.places[block], arms);
            for k in block * members.trackers..(block + 1) * members.trackers {
                residual(&self.step, arms, &members.told[k], &mut self.of.blocks[k]);
            }
        }
    }
}

#[inline(always)]
fn turn(rows: &[[f64; 3]; 3], places: &[Lanes; 3], arms: &mut [Lanes; 3]) {
    for axis in 0..3 {
        let [x, y, z] = rows[axis];
        for k in 0..LANES {
            arms[axis][k] = x * places[0][k] + y * places[1][k] + z * places[2][k];
        }
    }
}

#[inline(always)]
fn residual(step: &[f64; 3], arms: &[Lanes; 3], told: &ToldBlock, out: &mut Residual) {
    let [xx, xy, xz, yy, yz, zz] = &told.information;
    for k in 0..LANES {
        let x = told.places[0][k] - (arms[0][k] + step[0]);
        let y = told.places[1][k] - (arms[1][k] + step[1]);
        let z = told.places[2][k] - (arms[2][k] + step[2]);
        let px = xx[k] * x + xy[k] * y + xz[k] * z;
        let py = xy[k] * x + yy[k] * y + yz[k] * z;
        let pz = xz[k] * x + yz[k] * y + zz[k] * z;
        out.pulls[0][k] = px;
        out.pulls[1][k] = py;
        out.pulls[2][k] = pz;
        out.distances[k] = x * px + y * py + z * pz;
    }
}

struct Sum<'a, 'b> {
    of: &'a Residuals<'b>,
    scales: &'a [f64],
    sums: &'a mut [Lanes; TERMS],
}

impl WithSimd for Sum<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let members = self.of.members;
        for (block, arms) in self.of.arms.iter().enumerate() {
            // Information, then information times offset.
            let mut weighted = [[0.0; LANES]; 9];
            for (l, scale) in self.scales.iter().enumerate() {
                let k = block * members.trackers + l;
                add_weighted(scale.recip(), &members.told[k], &self.of.blocks[k], &mut weighted);
            }
            add_terms(arms, &weighted, self.sums);
        }
    }
}

#[inline(always)]
fn add_weighted(precision: f64, told: &ToldBlock, residual: &Residual, sums: &mut [Lanes; 9]) {
    for k in 0..LANES {
        let weight = precision * robust_weight(residual.distances[k] * precision);
        for j in 0..6 {
            sums[j][k] += told.information[j][k] * weight;
        }
        for j in 0..3 {
            sums[6 + j][k] += residual.pulls[j][k] * weight;
        }
    }
}

/// A small turn `w` moves a place at `arm` by `w x arm`: the normal equations of (step, w).
#[inline(always)]
fn add_terms(arms: &[Lanes; 3], weighted: &[Lanes; 9], sums: &mut [Lanes; TERMS]) {
    let [xx, xy, xz, yy, yz, zz, px, py, pz] = weighted;
    for k in 0..LANES {
        let (x, y, z) = (arms[0][k], arms[1][k], arms[2][k]);
        // Rows of the information times the cross product with the arm.
        let (a0, a1, a2) = (xz[k] * y - xy[k] * z, xx[k] * z - xz[k] * x, xy[k] * x - xx[k] * y);
        let (b0, b1, b2) = (yz[k] * y - yy[k] * z, xy[k] * z - yz[k] * x, yy[k] * x - xy[k] * y);
        let (c0, c1, c2) = (zz[k] * y - yz[k] * z, xz[k] * z - zz[k] * x, yz[k] * x - xz[k] * y);
        #[rustfmt::skip]
        let terms = [
            xx[k], xy[k], xz[k], yy[k], yz[k], zz[k],
            a0, a1, a2, b0, b1, b2, c0, c1, c2,
            y * c0 - z * b0, y * c1 - z * b1, y * c2 - z * b2,
            z * a1 - x * c1, z * a2 - x * c2, x * b2 - y * a2,
            px[k], py[k], pz[k], y * pz[k] - z * py[k], z * px[k] - x * pz[k], x * py[k] - y * px[k],
        ];
        for j in 0..TERMS {
            sums[j][k] += terms[j];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion_fit::fit_motion;
    use ffgs_core::{EstimateStatus, Estimates};
    use ffgs_testkit::vectorised;
    use glam::DQuat;
    use nalgebra::{Matrix3x6, Vector3};

    /// 13 places, so that the second block is not full.
    fn places() -> Vec<DVec3> {
        (0..13).map(|i| DVec3::new(f64::from(i % 3), f64::from(i * i % 5), 0.3 * f64::from(i % 4))).collect()
    }

    /// Of places moved by `motion` and `off` (m); the tracker misses every fifth.
    fn tracker(motion: &RigidMotion, off: f64) -> Estimates {
        let covariance = DMat3::from_cols_array(&[4e-4, 1e-4, 0.0, 1e-4, 3e-4, 5e-5, 0.0, 5e-5, 2e-4]);
        let mut out = Estimates::default();
        for (i, place) in places().into_iter().enumerate() {
            let error = DVec3::new((i as f64).sin(), (1.7 * i as f64).cos(), (2.3 * i as f64).sin()) * off;
            out.means.push(motion.apply(place) + error);
            out.covariances.push(covariance * (1.0 + off));
            out.status.push(if i % 5 == 4 { EstimateStatus::Residual } else { EstimateStatus::Ok });
        }
        out
    }

    fn motion() -> RigidMotion {
        let rotation = DQuat::from_euler(glam::EulerRot::XYZ, 0.1, -0.05, 0.2);
        RigidMotion { centre: DVec3::new(1.0, 2.0, 0.4), rotation, step: DVec3::new(0.7, -0.2, 0.1) }
    }

    /// The normal equations are the sum of `J^T W J` and `J^T W r` of single estimates.
    #[test]
    fn normal_equations_are_those_of_single_estimates() {
        let estimates = [tracker(&motion(), 0.02), tracker(&motion(), 0.05)];
        let (evidence, previous, scales) = (Evidence::new(&estimates), places(), [1.5, 0.8]);
        let members = Members::new(&evidence, &previous, &(0..13).collect::<Vec<_>>());
        let about = RigidMotion { centre: members.centre, ..motion() };
        let found = members.residuals(&about).normal(&scales);
        let mut expected = Normal::zero();
        for (i, &place) in previous.iter().enumerate() {
            let arm = about.rotation * (place - about.centre);
            for (l, told) in evidence.of(i) {
                let r = told.mean - about.apply(place);
                let d = told.information.quadratic(r) / scales[l];
                let w = DMat3::from(told.information) * (robust_weight(d) / scales[l]);
                let mut j = Matrix3x6::<f64>::identity();
                for k in 0..3 {
                    let turned = DVec3::AXES[k].cross(arm).to_array();
                    j.set_column(3 + k, &Vector3::from(turned));
                }
                let w = nalgebra::Matrix3::from_column_slice(&w.to_cols_array());
                expected.a += j.transpose() * w * j;
                expected.b += j.transpose() * w * Vector3::from(r.to_array());
            }
        }
        assert!((found.a - expected.a).amax() < 1e-11 * expected.a.amax());
        assert!((found.b - expected.b).amax() < 1e-11 * expected.b.amax());
    }

    #[test]
    fn every_instruction_set_sums_the_same_bits() {
        let estimates = [tracker(&motion(), 0.02), tracker(&motion(), 0.05)];
        let (evidence, previous) = (Evidence::new(&estimates), places());
        let members = Members::new(&evidence, &previous, &(0..13).collect::<Vec<_>>());
        let mut of = members.residuals(&motion());
        let rows = [[0.99, -0.1, 0.02], [0.1, 0.98, 0.3], [-0.02, -0.3, 0.97]];
        let mut sum = |set| {
            // What an instruction set leaves out shows.
            of.arms.fill([[f64::NAN; LANES]; 3]);
            of.blocks.fill(Residual { pulls: [[f64::NAN; LANES]; 3], distances: [f64::NAN; LANES] });
            vectorised(set, Update { rows, step: [0.6, -0.1, 0.2], of: &mut of })?;
            let mut sums = [[0.0; LANES]; TERMS];
            vectorised(set, Sum { of: &of, scales: &[1.5, 0.8], sums: &mut sums })?;
            Some(sums)
        };
        let expected = sum(0).unwrap();
        assert!(expected.as_flattened().iter().all(|v| v.is_finite()) && expected[0][0] > 0.0);
        assert!((1..3).filter_map(sum).all(|other| other == expected));
    }

    #[test]
    fn an_exact_motion_is_found_and_missing_estimates_do_not_count() {
        let mut estimates = [tracker(&motion(), 0.0), tracker(&motion(), 0.0)];
        // Not usable, so that its place must not matter.
        estimates.iter_mut().for_each(|e| e.means[4] += DVec3::splat(100.0));
        let (evidence, previous) = (Evidence::new(&estimates), places());
        let members = Members::new(&evidence, &previous, &(0..13).collect::<Vec<_>>());
        assert_eq!(members.steps(0).len(), 2 * 11);
        let start = RigidMotion { centre: DVec3::ZERO, rotation: DQuat::IDENTITY, step: DVec3::ZERO };
        let fit = fit_motion(&members, start).unwrap();
        let error = |&p: &DVec3| (fit.motion.apply(p) - motion().apply(p)).length();
        assert!(
            previous.iter().all(|p| error(p) < 1e-6),
            "{:?}",
            previous.iter().map(error).collect::<Vec<_>>()
        );
    }
}
