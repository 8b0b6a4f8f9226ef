//! Nearest neighbours among descriptors, and how clearly the nearest is ahead of the second.

use crate::Descriptor;
use ffgs_core::instructions;
use pulp::{Simd, WithSimd};

/// The nearest descriptor, and how near the nearest two are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Neighbours {
    /// Index of the nearest one.
    pub index: usize,
    /// Squared distance to it.
    pub nearest: f32,
    /// Squared distance to the second; infinite when there is none.
    pub second: f32,
}

impl Neighbours {
    /// Lowe's ratio test.
    pub fn is_distinct(&self, ratio: f32) -> bool {
        self.nearest < ratio * ratio * self.second
    }
}

/// The two nearest of the candidates (indices into `all`); `None` without candidates.
pub fn nearest_two(
    wanted: &Descriptor,
    all: &[Descriptor],
    candidates: impl IntoIterator<Item = usize>,
) -> Option<Neighbours> {
    instructions().dispatch(Nearest { wanted, all, candidates })
}

struct Nearest<'a, I> {
    wanted: &'a Descriptor,
    all: &'a [Descriptor],
    candidates: I,
}

impl<I: IntoIterator<Item = usize>> WithSimd for Nearest<'_, I> {
    type Output = Option<Neighbours>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
        let mut best: Option<Neighbours> = None;
        for index in self.candidates {
            let distance = squared_distance(simd, self.wanted, &self.all[index]);
            best = Some(match best {
                None => Neighbours { index, nearest: distance, second: f32::INFINITY },
                Some(b) if distance < b.nearest => Neighbours { index, nearest: distance, second: b.nearest },
                Some(b) => Neighbours { second: b.second.min(distance), ..b },
            });
        }
        best
    }
}

#[inline(always)]
fn squared_distance<S: Simd>(simd: S, a: &Descriptor, b: &Descriptor) -> f32 {
    // Two sums, so that one addition need not wait for the other.
    let mut sums = [simd.splat_f32s(0.0); 2];
    let pairs = S::as_simd_f32s(a).0.chunks_exact(2).zip(S::as_simd_f32s(b).0.chunks_exact(2));
    for (x, y) in pairs {
        let (first, second) = (simd.sub_f32s(x[0], y[0]), simd.sub_f32s(x[1], y[1]));
        sums[0] = simd.mul_add_f32s(first, first, sums[0]);
        sums[1] = simd.mul_add_f32s(second, second, sums[1]);
    }
    simd.reduce_sum_f32s(simd.add_f32s(sums[0], sums[1]))
}
