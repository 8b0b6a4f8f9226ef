//! The normal equations of a rigid motion.

use nalgebra::{Matrix6, Vector6};

/// Distinct entries of the normal equations: 6 of the step, 9 between step and turn, 6 of the turn, 6 on the right.
pub(crate) const TERMS: usize = 27;

/// Where the entries are in the matrix; the right side follows.
#[rustfmt::skip]
const PLACES: [(usize, usize); 21] = [
    (0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2),
    (0, 3), (0, 4), (0, 5), (1, 3), (1, 4), (1, 5), (2, 3), (2, 4), (2, 5),
    (3, 3), (3, 4), (3, 5), (4, 4), (4, 5), (5, 5),
];

/// Normal equations over (step, rotation vector).
#[derive(Clone, Copy)]
pub(crate) struct Normal {
    pub a: Matrix6<f64>,
    pub b: Vector6<f64>,
}

impl Normal {
    pub(crate) fn zero() -> Self {
        Self { a: Matrix6::zeros(), b: Vector6::zeros() }
    }

    /// From the upper triangle block by block (step, step and turn, turn) and the right side.
    pub(crate) fn new(terms: &[f64; TERMS]) -> Self {
        let mut out = Self::zero();
        for (&(row, column), &value) in PLACES.iter().zip(terms) {
            (out.a[(row, column)], out.a[(column, row)]) = (value, value);
        }
        out.b.copy_from_slice(&terms[PLACES.len()..]);
        out
    }

    /// With a rotation that changes by no more than about 0.3 rad without evidence; the solution stays the same.
    pub(crate) fn damped(mut self) -> Self {
        (3..6).for_each(|k| self.a[(k, k)] += 11.0);
        self
    }

    pub(crate) fn merge(&mut self, other: &Self) {
        self.a += other.a;
        self.b += other.b;
    }

    pub(crate) fn solve(&self) -> Option<Vector6<f64>> {
        let x = self.a.cholesky()?.solve(&self.b);
        x.iter().all(|v| v.is_finite()).then_some(x)
    }
}
