//! How much of some cells a motion explains, eight cells side by side.

use crate::rigid::RigidMotion;
use crate::symmetric::Symmetric;
use ffgs_core::instructions;
use glam::{DMat3, DVec3};
use pulp::{Simd, WithSimd};

const LANES: usize = 8;
/// Centre, centre at t, information about it, weight.
const COLUMNS: usize = 13;
type Block = [[f64; LANES]; COLUMNS];

/// A cell's own motion.
pub(crate) struct Voter {
    /// Mean place at t-1 (m).
    pub centre: DVec3,
    /// Where its centre goes (m).
    pub place: DVec3,
    /// Inverse covariance of that (1/m^2).
    pub information: Symmetric,
    /// Its Gaussians.
    pub weight: f64,
    /// Per tracker: factor on its covariances within the cell.
    pub scales: Vec<f64>,
}

impl Voter {
    pub(crate) fn scale(&self) -> f64 {
        self.scales.iter().sum::<f64>() / self.scales.len().max(1) as f64
    }

    pub(crate) fn inflate(&mut self, factor: f64) {
        self.information = self.information * factor.recip();
    }

    /// Squared Mahalanobis distance of a motion from the cell's own.
    pub(crate) fn distance(&self, motion: &RigidMotion) -> f64 {
        let e = motion.apply(self.centre) - self.place;
        self.information.quadratic(e)
    }
}

/// Cells with their own motions; places are relative to an origin, which keeps coordinates of any size exact.
pub(crate) struct Votes {
    origin: DVec3,
    /// The last one is filled up with cells without weight.
    blocks: Vec<Block>,
}

impl Votes {
    /// Of some cells.
    pub(crate) fn new<'a>(voters: impl Iterator<Item = &'a Voter>) -> Self {
        let mut out = Self { origin: DVec3::ZERO, blocks: Vec::new() };
        for (k, voter) in voters.enumerate() {
            if k == 0 {
                out.origin = voter.centre;
            }
            if k % LANES == 0 {
                out.blocks.push([[0.0; LANES]; COLUMNS]);
            }
            let places = [voter.centre - out.origin, voter.place - out.origin].map(|p| p.to_array());
            let (information, weight) = (voter.information.to_array(), [voter.weight]);
            let values = places.as_flattened().iter().chain(&information).chain(&weight);
            out.blocks[k / LANES].iter_mut().zip(values).for_each(|(column, &v)| column[k % LANES] = v);
        }
        out
    }

    /// Sum of the cells' weights, each less the more it disagrees: none of it is left at a squared Mahalanobis distance
    /// of `limit`.
    pub(crate) fn explained(&self, motion: &RigidMotion, limit: f64) -> f64 {
        let rotation = DMat3::from_quat(motion.rotation).transpose();
        let rows = [rotation.x_axis, rotation.y_axis, rotation.z_axis].map(|r| r.to_array());
        let centre = motion.centre - self.origin;
        let target = (centre + motion.step).to_array();
        let sum = Sum { blocks: &self.blocks, rows, centre: centre.to_array(), target, scale: limit.recip() };
        instructions().dispatch(sum).iter().sum()
    }
}

struct Sum<'a> {
    blocks: &'a [Block],
    /// Rows of the rotation.
    rows: [[f64; 3]; 3],
    centre: [f64; 3],
    target: [f64; 3],
    scale: f64,
}

impl WithSimd for Sum<'_> {
    type Output = [f64; LANES];

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> [f64; LANES] {
        let mut sums = [0.0; LANES];
        for block in self.blocks {
            add(&self, block, &mut sums);
        }
        sums
    }
}

#[inline(always)]
fn add(motion: &Sum, block: &Block, sums: &mut [f64; LANES]) {
    let [cx, cy, cz, px, py, pz, xx, xy, xz, yy, yz, zz, weight] = block;
    let [rx, ry, rz] = &motion.rows;
    let [tx, ty, tz] = motion.target;
    for k in 0..LANES {
        let (x, y, z) = (cx[k] - motion.centre[0], cy[k] - motion.centre[1], cz[k] - motion.centre[2]);
        let ex = rx[0] * x + rx[1] * y + rx[2] * z + tx - px[k];
        let ey = ry[0] * x + ry[1] * y + ry[2] * z + ty - py[k];
        let ez = rz[0] * x + rz[1] * y + rz[2] * z + tz - pz[k];
        let diagonal = xx[k] * ex * ex + yy[k] * ey * ey + zz[k] * ez * ez;
        let distance = diagonal + 2.0 * (xy[k] * ex * ey + xz[k] * ex * ez + yz[k] * ey * ez);
        sums[k] += weight[k] * (1.0 - distance * motion.scale).max(0.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::symmetric::Symmetric;
    use ffgs_testkit::vectorised;
    use glam::DQuat;

    fn voters() -> Vec<Voter> {
        (0..11_i32)
            .map(|i| {
                let x = f64::from(i);
                let centre = DVec3::new(5e5 + x, 3.0 - x, x.sin());
                let place = centre + DVec3::new(0.1 * x.cos(), 0.5, -0.02 * x);
                let information = Symmetric { xy: 3.0, yz: -2.0, ..Symmetric::scalar(40.0 + x) };
                Voter { centre, place, information, weight: 60.0 + x, scales: Vec::new() }
            })
            .collect()
    }

    #[test]
    fn every_instruction_set_counts_the_same_bits() {
        let Votes { blocks, .. } = Votes::new(voters().iter());
        let sum = |set| {
            let rows = [[1.0, -0.01, 0.0], [0.01, 1.0, 0.0], [0.0, 0.0, 1.0]];
            let (centre, target) = ([0.1, 0.2, 0.3], [0.1, 0.7, 0.3]);
            vectorised(set, Sum { blocks: &blocks, rows, centre, target, scale: 0.1 })
        };
        let expected = sum(0).unwrap();
        assert!(expected.iter().sum::<f64>() > 10.0);
        assert!((1..3).filter_map(sum).all(|other| other == expected));
    }

    #[test]
    fn what_is_explained_is_the_sum_over_single_cells() {
        let voters = voters();
        let centre = DVec3::new(5e5, 0.0, 0.0);
        let motion = RigidMotion { centre, rotation: DQuat::from_rotation_z(0.01), step: DVec3::Y * 0.5 };
        let limit = 2.0;
        let gain = |v: &Voter| v.weight * (1.0 - v.distance(&motion) / limit).max(0.0);
        let expected: f64 = voters.iter().map(gain).sum();
        let nothing = voters.iter().filter(|v| gain(v) == 0.0).count();
        assert!((1..8).contains(&nothing), "some cells agree, some do not: {nothing}");
        assert!((Votes::new(voters.iter()).explained(&motion, limit) - expected).abs() < 1e-6);
        assert_eq!(Votes::new([].iter()).explained(&motion, limit), 0.0);
    }
}
