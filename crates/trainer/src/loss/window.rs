//! The 11-tap Gaussian window of SSIM on fixed-size chunks.

use crate::simd::fma;

/// Columns a chunk of the filters handles: one AVX-512 register, two of AVX2.
pub(super) const LANES: usize = 16;
/// Half width of the window (px).
pub(super) const RADIUS: usize = 5;

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

/// Filters one chunk vertically: `rows` starts `RADIUS` rows above the output row, `column` is the first column.
#[inline(always)]
pub(super) fn filter_column<const FMA: bool, const W: usize>(
    rows: &[[f32; W]],
    column: usize,
) -> [f32; LANES] {
    let rows: &[[f32; W]; 2 * RADIUS + 1] = rows[..=2 * RADIUS].try_into().expect("11 rows");
    let chunk = |j: usize| -> &[f32; LANES] { rows[j][column..column + LANES].try_into().expect("a chunk") };
    let mut sum = [0.0; LANES];
    for (s, v) in sum.iter_mut().zip(chunk(RADIUS)) {
        *s = WINDOW[RADIUS] * v;
    }
    for (t, &weight) in WINDOW[..RADIUS].iter().enumerate() {
        let (above, below) = (chunk(t), chunk(2 * RADIUS - t));
        for i in 0..LANES {
            sum[i] = fma::<FMA>(weight, above[i] + below[i], sum[i]);
        }
    }
    sum
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
