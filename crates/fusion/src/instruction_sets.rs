//! For tests of the kernels: none fuses a product with a sum, so all instruction sets find the same bits.

use pulp::{Simd, WithSimd};

/// Runs with instruction set 0 (none), 1 (AVX2) or 2 (AVX-512), if the machine has it.
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
