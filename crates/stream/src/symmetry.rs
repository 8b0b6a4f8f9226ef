//! The 24 names of a Gaussian's shape: its axes in any order, each in either direction, as long as they stay right-handed. Keys
//! take the name that costs least, changes the one that is nearest to what the receiver has.

use crate::motion::product;
use crate::row::Row;
use crate::steps::{Measures, Steps};
use std::f64::consts::FRAC_1_SQRT_2;

/// Rotation (w, x, y, z), and scales along the axes that it turns.
#[derive(Clone, Copy)]
struct Shape {
    quat: [f64; 4],
    scales: [f64; 3],
}

/// For each order of the axes: which become the new ones, and a turn that makes them so.
const ORDERS: [([usize; 3], [f64; 4]); 6] = [
    ([0, 1, 2], [1.0, 0.0, 0.0, 0.0]),
    ([1, 0, 2], [FRAC_1_SQRT_2, 0.0, 0.0, FRAC_1_SQRT_2]),
    ([0, 2, 1], [FRAC_1_SQRT_2, FRAC_1_SQRT_2, 0.0, 0.0]),
    ([2, 1, 0], [FRAC_1_SQRT_2, 0.0, FRAC_1_SQRT_2, 0.0]),
    ([1, 2, 0], [0.5, 0.5, 0.5, 0.5]),
    ([2, 0, 1], [0.5, -0.5, -0.5, -0.5]),
];

impl Shape {
    fn of(m: &Measures) -> Self {
        Self { quat: m.quat, scales: m.scales }
    }

    /// A name for each order of the axes.
    fn orders(self) -> [Self; 6] {
        ORDERS
            .map(|(axes, turn)| Self { quat: product(self.quat, turn), scales: axes.map(|k| self.scales[k]) })
    }

    /// The names with the axes in this order: after half a turn about none, the first, the second, or the third.
    fn directions(self) -> [Self; 4] {
        let [w, x, y, z] = self.quat;
        [[w, x, y, z], [-x, w, z, -y], [-y, -z, w, x], [-z, y, -x, w]]
            .map(|quat| Self { quat, scales: self.scales })
    }

    /// Axes from the widest to the thinnest, and the direction with the least rotation: the real part of its quaternion is the largest.
    fn canonical(self) -> Self {
        let sorted = |s: &Self| s.scales[0] >= s.scales[1] && s.scales[1] >= s.scales[2];
        let ordered = self.orders().into_iter().find(sorted).unwrap_or(self);
        let real = |s: &Self| s.quat[0].abs();
        ordered.directions().into_iter().max_by(|a, b| real(a).total_cmp(&real(b))).unwrap_or(ordered)
    }

    /// The name that differs least from a row, in steps.
    fn like(self, row: &Row, steps: &Steps) -> Self {
        let quat = steps.quat(row);
        let far = |s: &Self| {
            let dot: f64 = s.quat.iter().zip(quat).map(|(a, b)| a * b).sum();
            let scales = [0, 1, 2].map(|k| (s.scales[k] - f64::from(row.scales[k])).powi(2));
            2.0 * f64::from(steps.rotation).powi(2) * (1.0 - dot * dot) + scales.iter().sum::<f64>()
        };
        let names = self.orders().into_iter().flat_map(Self::directions);
        names.min_by(|a, b| far(a).total_cmp(&far(b))).unwrap_or(self)
    }
}

impl Measures {
    fn named(&self, Shape { quat, scales }: Shape) -> Self {
        let mut out = *self;
        (out.quat, out.scales) = (quat, scales);
        out
    }

    /// The same Gaussian by the name that keys use: for the surfaces of a scene the thin axis is always the last, so that neighbours
    /// resemble each other, and which component of the quaternion is the largest costs nothing.
    pub(crate) fn canonical(&self) -> Self {
        self.named(Shape::of(self).canonical())
    }

    /// The same Gaussian by the name that differs least from a row.
    pub(crate) fn like(&self, row: &Row, steps: &Steps) -> Self {
        self.named(Shape::of(self).like(row, steps))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};

    fn covariance(s: &Shape) -> Matrix3<f64> {
        let [w, x, y, z] = s.quat;
        let rotation = UnitQuaternion::new_normalize(Quaternion::new(w, x, y, z)).to_rotation_matrix();
        let axes = Matrix3::from_diagonal(&Vector3::from(s.scales.map(f64::exp)));
        rotation.matrix() * axes * axes * rotation.matrix().transpose()
    }

    #[test]
    fn all_names_are_the_same_gaussian_and_the_canonical_one_is_sorted_with_the_real_part_largest() {
        let shapes =
            [([0.1, -0.7, 0.3, 0.64], [-1.0, 0.5, -0.2]), ([0.9, 0.1, -0.2, 0.37], [0.3, -2.0, 0.7])];
        for (quat, scales) in shapes {
            let quat = crate::steps::unit(quat);
            let shape = Shape { quat, scales };
            let truth = covariance(&shape);
            let names: Vec<Shape> = shape.orders().into_iter().flat_map(Shape::directions).collect();
            assert_eq!(names.len(), 24);
            names.iter().for_each(|name| assert!((covariance(name) - truth).norm() < 1e-12));
            for name in names {
                let Shape { quat, scales } = name.canonical();
                assert!(scales[0] >= scales[1] && scales[1] >= scales[2]);
                assert!(quat.iter().all(|v| v.abs() <= quat[0].abs()), "{quat:?}");
            }
        }
    }
}
