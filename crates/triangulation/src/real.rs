//! A vector of f64 with operators, so that formulas read as formulas.

use pulp::Simd;
use std::ops::{Add, Div, Mul, Sub};

/// One number a lane, of whatever number of lanes the dispatched instruction set has.
#[derive(Clone, Copy)]
pub struct Real<S: Simd> {
    simd: S,
    lanes: S::f64s,
}

impl<S: Simd> Real<S> {
    /// The same number in every lane.
    #[inline(always)]
    pub fn all(simd: S, value: f64) -> Self {
        Self { simd, lanes: simd.splat_f64s(value) }
    }

    /// The `part`-th vector of a column.
    #[inline(always)]
    pub fn load(simd: S, column: &[f64], part: usize) -> Self {
        Self { simd, lanes: S::as_simd_f64s(column).0[part] }
    }

    /// Writes the `part`-th vector of a column.
    #[inline(always)]
    pub fn store(self, column: &mut [f64], part: usize) {
        S::as_mut_simd_f64s(column).0[part] = self.lanes;
    }

    /// `self * factor + addend`, fused where the instruction set can.
    #[inline(always)]
    pub fn times_plus(self, factor: Self, addend: Self) -> Self {
        Self { lanes: self.simd.mul_add_e_f64s(self.lanes, factor.lanes, addend.lanes), ..self }
    }

    /// `yes` in the lanes where this is greater than `bound`, elsewhere `no`; NaN is not greater.
    #[inline(always)]
    pub fn select_above(self, bound: Self, yes: Self, no: Self) -> Self {
        let above = self.simd.greater_than_f64s(self.lanes, bound.lanes);
        Self { lanes: self.simd.select_f64s(above, yes.lanes, no.lanes), ..self }
    }

    /// The greater of two, lane by lane.
    #[inline(always)]
    pub fn or_greater(self, other: Self) -> Self {
        Self { lanes: self.simd.max_f64s(self.lanes, other.lanes), ..self }
    }

    /// Sum over the lanes.
    #[inline(always)]
    pub fn total(self) -> f64 {
        self.simd.reduce_sum_f64s(self.lanes)
    }
}

impl<S: Simd> Add for Real<S> {
    type Output = Self;

    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Self { lanes: self.simd.add_f64s(self.lanes, other.lanes), ..self }
    }
}

impl<S: Simd> Sub for Real<S> {
    type Output = Self;

    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Self { lanes: self.simd.sub_f64s(self.lanes, other.lanes), ..self }
    }
}

impl<S: Simd> Mul for Real<S> {
    type Output = Self;

    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        Self { lanes: self.simd.mul_f64s(self.lanes, other.lanes), ..self }
    }
}

impl<S: Simd> Div for Real<S> {
    type Output = Self;

    #[inline(always)]
    fn div(self, other: Self) -> Self {
        Self { lanes: self.simd.div_f64s(self.lanes, other.lanes), ..self }
    }
}

/// `a . b`.
#[inline(always)]
pub fn dot<S: Simd>(a: [Real<S>; 3], b: [Real<S>; 3]) -> Real<S> {
    a[2].times_plus(b[2], a[1].times_plus(b[1], a[0] * b[0]))
}
