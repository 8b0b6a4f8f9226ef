//! Vectors of f64 and their comparisons with operators, so that formulas read as formulas.

use pulp::{Simd, bytemuck};
use std::ops::{Add, BitAnd, BitOr, Div, Mul, Sub};

/// Lanes of the widest instruction set: one AVX-512 register.
pub(crate) const MAX_LANES: usize = 8;

/// One number per SIMD lane, for the widest vector there is.
pub(crate) type Lanes = [f64; MAX_LANES];

/// One number per SIMD lane; the dispatched instruction set decides how many.
#[derive(Clone, Copy)]
pub(crate) struct F64s<S: Simd> {
    simd: S,
    lanes: S::f64s,
}

/// One truth value per SIMD lane.
#[derive(Clone, Copy)]
pub(crate) struct LaneMask<S: Simd> {
    simd: S,
    lanes: S::m64s,
}

impl<S: Simd> F64s<S> {
    /// The same number in every lane.
    #[inline(always)]
    pub(crate) fn all(simd: S, value: f64) -> Self {
        Self { simd, lanes: simd.splat_f64s(value) }
    }

    /// The first entries, one per lane.
    #[inline(always)]
    pub(crate) fn from_lanes(simd: S, values: &Lanes) -> Self {
        Self { simd, lanes: S::as_simd_f64s(values).0[0] }
    }

    /// One number per SIMD lane, then zeros.
    #[inline(always)]
    pub(crate) fn to_lanes(self) -> Lanes {
        let mut out = [0.0; MAX_LANES];
        S::as_mut_simd_f64s(&mut out).0[0] = self.lanes;
        out
    }

    /// The number of one lane.
    #[inline(always)]
    pub(crate) fn lane(&self, lane: usize) -> f64 {
        bytemuck::cast_slice::<S::f64s, f64>(std::slice::from_ref(&self.lanes))[lane]
    }

    /// Sets the number of one lane.
    #[inline(always)]
    pub(crate) fn set_lane(&mut self, lane: usize, value: f64) {
        bytemuck::cast_slice_mut::<S::f64s, f64>(std::slice::from_mut(&mut self.lanes))[lane] = value;
    }

    /// `self * factor + addend`, fused where the instruction set can.
    #[inline(always)]
    pub(crate) fn mul_add(self, factor: Self, addend: Self) -> Self {
        Self { lanes: self.simd.mul_add_e_f64s(self.lanes, factor.lanes, addend.lanes), ..self }
    }

    /// `minuend - self * factor`, fused where the instruction set can.
    #[inline(always)]
    pub(crate) fn neg_mul_add(self, factor: Self, minuend: Self) -> Self {
        Self { lanes: self.simd.negate_mul_add_e_f64s(self.lanes, factor.lanes, minuend.lanes), ..self }
    }

    /// Where this is greater than `bound`; NaN is not.
    #[inline(always)]
    pub(crate) fn gt(self, bound: Self) -> LaneMask<S> {
        LaneMask { simd: self.simd, lanes: self.simd.greater_than_f64s(self.lanes, bound.lanes) }
    }

    /// Where this is at most `bound`; NaN is not.
    #[inline(always)]
    pub(crate) fn le(self, bound: Self) -> LaneMask<S> {
        LaneMask { simd: self.simd, lanes: self.simd.less_than_or_equal_f64s(self.lanes, bound.lanes) }
    }

    /// The greater of two, lane by lane.
    #[inline(always)]
    pub(crate) fn max(self, other: Self) -> Self {
        Self { lanes: self.simd.max_f64s(self.lanes, other.lanes), ..self }
    }

    /// The absolute value.
    #[inline(always)]
    pub(crate) fn abs(self) -> Self {
        Self { lanes: self.simd.abs_f64s(self.lanes), ..self }
    }

    /// Where this is a number and not infinite.
    #[inline(always)]
    pub(crate) fn finite(self) -> LaneMask<S> {
        let infinity = Self::all(self.simd, f64::INFINITY);
        LaneMask {
            simd: self.simd,
            lanes: self.simd.less_than_f64s(self.simd.abs_f64s(self.lanes), infinity.lanes),
        }
    }

    /// The square root.
    #[inline(always)]
    pub(crate) fn sqrt(self) -> Self {
        Self { lanes: self.simd.sqrt_f64s(self.lanes), ..self }
    }
}

impl<S: Simd> LaneMask<S> {
    /// `yes` where true, elsewhere `no`.
    #[inline(always)]
    pub(crate) fn select(self, yes: F64s<S>, no: F64s<S>) -> F64s<S> {
        F64s { simd: self.simd, lanes: self.simd.select_f64s(self.lanes, yes.lanes, no.lanes) }
    }

    /// As [`LaneMask::select`], of three coordinates.
    #[inline(always)]
    pub(crate) fn select3(self, yes: [F64s<S>; 3], no: [F64s<S>; 3]) -> [F64s<S>; 3] {
        [self.select(yes[0], no[0]), self.select(yes[1], no[1]), self.select(yes[2], no[2])]
    }

    /// False everywhere.
    #[inline(always)]
    pub(crate) fn nowhere(simd: S) -> Self {
        let zero = F64s::all(simd, 0.0);
        zero.gt(zero)
    }

    /// Whether any lane is true.
    #[inline(always)]
    pub(crate) fn any(self) -> bool {
        bytemuck::bytes_of(&self.lanes).iter().any(|byte| *byte != 0)
    }

    /// Where this holds and `other` does not.
    #[inline(always)]
    pub(crate) fn and_not(self, other: Self) -> Self {
        let both = self.simd.and_m64s(self.lanes, other.lanes);
        Self { lanes: self.simd.xor_m64s(self.lanes, both), ..self }
    }

    /// The lanes that are true.
    #[inline(always)]
    pub(crate) fn lanes(self) -> impl Iterator<Item = usize> {
        let ones = self.select(F64s::all(self.simd, 1.0), F64s::all(self.simd, 0.0)).to_lanes();
        (0..S::F64_LANES).filter(move |&lane| ones[lane] > 0.0)
    }
}

impl<S: Simd> BitAnd for LaneMask<S> {
    type Output = Self;

    #[inline(always)]
    fn bitand(self, other: Self) -> Self {
        Self { lanes: self.simd.and_m64s(self.lanes, other.lanes), ..self }
    }
}

impl<S: Simd> BitOr for LaneMask<S> {
    type Output = Self;

    #[inline(always)]
    fn bitor(self, other: Self) -> Self {
        Self { lanes: self.simd.or_m64s(self.lanes, other.lanes), ..self }
    }
}

impl<S: Simd> Add for F64s<S> {
    type Output = Self;

    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Self { lanes: self.simd.add_f64s(self.lanes, other.lanes), ..self }
    }
}

impl<S: Simd> Sub for F64s<S> {
    type Output = Self;

    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Self { lanes: self.simd.sub_f64s(self.lanes, other.lanes), ..self }
    }
}

impl<S: Simd> Mul for F64s<S> {
    type Output = Self;

    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        Self { lanes: self.simd.mul_f64s(self.lanes, other.lanes), ..self }
    }
}

impl<S: Simd> Div for F64s<S> {
    type Output = Self;

    #[inline(always)]
    fn div(self, other: Self) -> Self {
        Self { lanes: self.simd.div_f64s(self.lanes, other.lanes), ..self }
    }
}

/// The same point in every lane.
#[inline(always)]
pub(crate) fn all3<S: Simd>(simd: S, p: impl Into<[f64; 3]>) -> [F64s<S>; 3] {
    let [x, y, z] = p.into();
    [F64s::all(simd, x), F64s::all(simd, y), F64s::all(simd, z)]
}

/// `a + b`.
#[inline(always)]
pub(crate) fn plus<S: Simd>(a: [F64s<S>; 3], b: [F64s<S>; 3]) -> [F64s<S>; 3] {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

/// `a - b`.
#[inline(always)]
pub(crate) fn minus<S: Simd>(a: [F64s<S>; 3], b: [F64s<S>; 3]) -> [F64s<S>; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// `a . b`.
#[inline(always)]
pub(crate) fn dot<S: Simd>(a: [F64s<S>; 3], b: [F64s<S>; 3]) -> F64s<S> {
    a[2].mul_add(b[2], a[1].mul_add(b[1], a[0] * b[0]))
}
