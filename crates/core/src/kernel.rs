//! Run-time instruction-set dispatch (ADR 4): the same safe loops are compiled for the baseline, AVX2 and AVX-512.

use crate::instructions;
use pulp::{Simd, WithSimd};

/// A loop nest worth compiling per instruction set. Everything it calls must be `#[inline(always)]`.
pub trait Kernel {
    /// What it computes.
    type Output;

    /// Runs with fused multiply-add (`FMA`) where the machine has it in hardware; without, a call of `mul_add`
    /// would be a slow library function.
    fn run<const FMA: bool>(self) -> Self::Output;
}

struct Vectorised<K>(K);

impl<K: Kernel> WithSimd for Vectorised<K> {
    type Output = K::Output;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> K::Output {
        if S::IS_SCALAR { self.0.run::<false>() } else { self.0.run::<true>() }
    }
}

/// Runs `kernel` compiled for the best instruction set of this machine. The choice is the same in every thread.
pub fn dispatch<K: Kernel>(kernel: K) -> K::Output {
    instructions().dispatch(Vectorised(kernel))
}

/// `a * b + c`, fused when `FMA`.
#[inline(always)]
pub fn fma<const FMA: bool>(a: f32, b: f32, c: f32) -> f32 {
    if FMA { a.mul_add(b, c) } else { a * b + c }
}
