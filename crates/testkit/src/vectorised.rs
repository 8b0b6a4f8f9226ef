//! Code run with a chosen instruction set, so that tests can compare all that the machine has.

use pulp::{Simd, WithSimd};

/// Runs `op` with an instruction set: 0 = scalar, 1 = AVX2, 2 = AVX-512. `None` where the machine lacks it.
pub fn vectorised<O: WithSimd>(set: usize, op: O) -> Option<O::Output> {
    match set {
        0 => Some(Simd::vectorize(pulp::Scalar::new(), op)),
        #[cfg(target_arch = "x86_64")]
        1 => pulp::x86::V3::try_new().map(|simd| Simd::vectorize(simd, op)),
        #[cfg(target_arch = "x86_64")]
        2 => pulp::x86::V4::try_new().map(|simd| Simd::vectorize(simd, op)),
        _ => None,
    }
}
