//! What the machine can do at best: multiply-adds and memory traffic, on one thread and on two.

use criterion::{BenchmarkId, Criterion, Throughput};
use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;
use std::hint::black_box;

/// Independent sums: enough to hide the latency of two multiply-add units.
const CHAINS: usize = 10;
const ROUNDS: usize = 100_000;
/// Far larger than any cache that a core has for itself (bytes).
const ARRAY: usize = 256 << 20;

/// Groups `machine/fma` (elements = multiply-adds) and `machine/copy` (bytes read plus bytes written).
pub(crate) fn rates(c: &mut Criterion) {
    let mut group = c.benchmark_group("machine");
    let lanes = Arch::new().dispatch(Lanes);
    for threads in [1, 2] {
        let pool = super::scene::pool(threads);
        group.throughput(Throughput::Elements((threads * ROUNDS * CHAINS * lanes) as u64));
        group.bench_function(BenchmarkId::new("fma", format!("{threads}t")), |b| {
            b.iter(|| {
                pool.install(|| {
                    (0..threads).into_par_iter().map(|_| Arch::new().dispatch(Chains)).sum::<f32>()
                })
            });
        });
        let source = vec![1_u64; ARRAY / 8];
        let mut target = vec![0_u64; ARRAY / 8];
        group.throughput(Throughput::Bytes(2 * ARRAY as u64));
        group.bench_function(BenchmarkId::new("copy", format!("{threads}t")), |b| {
            let part = source.len() / threads;
            b.iter(|| {
                pool.install(|| {
                    let parts = target.par_chunks_mut(part).zip(source.par_chunks(part));
                    parts.for_each(|(target, source)| target.copy_from_slice(source));
                });
                black_box(&mut target);
            });
        });
    }
    group.finish();
}

/// Lanes of the dispatched instruction set.
struct Lanes;

impl WithSimd for Lanes {
    type Output = usize;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> usize {
        S::F32_LANES
    }
}

/// [`CHAINS`] sums of [`ROUNDS`] multiply-adds each.
struct Chains;

impl WithSimd for Chains {
    type Output = f32;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> f32 {
        let (a, b) = (simd.splat_f32s(black_box(0.999)), simd.splat_f32s(black_box(1e-3)));
        let mut sums = [simd.splat_f32s(0.5); CHAINS];
        for _ in 0..ROUNDS {
            for sum in &mut sums {
                *sum = simd.mul_add_e_f32s(*sum, a, b);
            }
        }
        let mut total = 0.0;
        for sum in sums {
            total += simd.reduce_sum_f32s(sum);
        }
        total
    }
}
