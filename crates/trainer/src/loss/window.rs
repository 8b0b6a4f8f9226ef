//! The 11-tap Gaussian window of SSIM on fixed-size chunks.

use crate::constants::RADIUS;
use ffgs_core::kernel::fma;

/// Columns a chunk of the filters handles: one AVX-512 register, two of AVX2.
pub(super) const LANES: usize = 16;

/// One half and the centre of the normalised window, sigma = 1.5 px (Wang et al. 2004; 3DGS `loss_utils.py`):
/// `exp(-d^2 / 4.5)` for d = 5, 4, 3, 2, 1, 0, divided by the sum over all 11 taps.
pub(super) const WINDOW: [f32; RADIUS + 1] =
    [0.001_028_380_1, 0.007_598_758, 0.036_000_773, 0.109_360_69, 0.213_005_53, 0.266_011_72];

/// Filters `out.len()` samples (a multiple of [`LANES`]) horizontally; output `i` is centred on `input[i + RADIUS]`.
#[inline(always)]
pub(super) fn filter_row<const FMA: bool>(input: &[f32], out: &mut [f32]) {
    const SPAN: usize = LANES + 2 * RADIUS;
    for (k, chunk) in out.chunks_exact_mut(LANES).enumerate() {
        let samples: &[f32; SPAN] = input[k * LANES..k * LANES + SPAN].try_into().expect("SPAN samples");
        let mut sum = [0.0; LANES];
        for i in 0..LANES {
            sum[i] = WINDOW[RADIUS] * samples[i + RADIUS];
        }
        for (t, &weight) in WINDOW[..RADIUS].iter().enumerate() {
            for i in 0..LANES {
                sum[i] = fma::<FMA>(weight, samples[i + t] + samples[i + 2 * RADIUS - t], sum[i]);
            }
        }
        chunk.copy_from_slice(&sum);
    }
}

/// Filters `columns` columns vertically; `rows` starts `RADIUS` rows above the output row.
///
/// One expression a column: with an inner loop over taps LLVM gathers scalars instead of loading vectors.
#[inline(always)]
pub(super) fn filter_columns<const FMA: bool, const W: usize>(
    rows: &[[f32; W]],
    columns: usize,
    out: &mut [f32; W],
) {
    let [a, b, c, d, e, f, g, h, i, j, k]: &[[f32; W]; 2 * RADIUS + 1] =
        rows[..=2 * RADIUS].try_into().expect("11 rows");
    for x in 0..columns.min(W) {
        let outer = fma::<FMA>(WINDOW[1], b[x] + j[x], WINDOW[0] * (a[x] + k[x]));
        let middle = fma::<FMA>(WINDOW[3], d[x] + h[x], WINDOW[2] * (c[x] + i[x]));
        let inner = fma::<FMA>(WINDOW[4], e[x] + g[x], WINDOW[5] * f[x]);
        out[x] = outer + middle + inner;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_window_is_the_normalised_gaussian() {
        let tap = |d: usize| (-((d * d) as f64) / 4.5).exp();
        let sum: f64 = tap(0) + (1..=RADIUS).map(|d| 2.0 * tap(d)).sum::<f64>();
        for (t, &w) in WINDOW.iter().enumerate() {
            assert!(
                (f64::from(w) - tap(RADIUS - t) / sum).abs() < 2e-8,
                "tap {t}: {}",
                tap(RADIUS - t) / sum
            );
        }
    }
}
