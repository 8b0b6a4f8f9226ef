//! The Gaussian window of SSIM, and convolutions with it.

use ffgs_core::kernel::{self, Kernel};
use rayon::prelude::*;
use std::ops::Range;

/// Taps of the separable Gaussian window.
pub const WINDOW: usize = 11;
/// Pixels that it reaches to each side.
pub(crate) const RADIUS: usize = WINDOW / 2;
const SIGMA: f64 = 1.5;
/// Rows that are filtered together: their planes stay in a processor's cache, and ten rows around them are filtered twice.
const BAND: usize = 32;

/// What is filtered, (H, W) row-major.
#[derive(Clone, Copy)]
pub(crate) enum Plane<'a> {
    /// An image.
    Values(&'a [f32]),
    /// The product of two images.
    Product(&'a [f32], &'a [f32]),
    /// Derivatives by the filtered values.
    Weights(&'a [f64]),
}

impl Plane<'_> {
    /// Some of its values. Plain loops: closures would be compiled without the dispatched instruction set.
    #[inline(always)]
    fn copy(self, range: Range<usize>, out: &mut [f64]) {
        match self {
            Self::Values(values) => {
                let values = &values[range];
                for i in 0..out.len() {
                    out[i] = f64::from(values[i]);
                }
            }
            Self::Product(a, b) => {
                let (a, b) = (&a[range.clone()], &b[range]);
                for i in 0..out.len() {
                    out[i] = f64::from(a[i]) * f64::from(b[i]);
                }
            }
            Self::Weights(values) => out.copy_from_slice(&values[range]),
        }
    }
}

/// Convolution of a plane of a size [H, W] with the window at the pixels of some rows; zero outside the image.
pub(crate) fn filter(plane: Plane, [height, width]: [usize; 2], rows: Range<usize>) -> Vec<f64> {
    kernel::dispatch(Filter { taps: &taps(), width, height, rows, plane })
}

struct Filter<'a> {
    taps: &'a [f64; WINDOW],
    width: usize,
    height: usize,
    rows: Range<usize>,
    plane: Plane<'a>,
}

impl Kernel for Filter<'_> {
    type Output = Vec<f64>;

    /// Never fused, so that every machine has the same bits.
    #[inline(always)]
    fn run<const FMA: bool>(self) -> Vec<f64> {
        let Self { taps, width, height, rows, plane } = self;
        let near = rows.start.saturating_sub(RADIUS)..(rows.end + RADIUS).min(height);
        // A row between as many zeros as the window reaches beyond it.
        let mut wide = vec![0.0; width + 2 * RADIUS];
        let mut across = vec![0.0; near.len() * width];
        for (y, out) in near.clone().zip(across.chunks_exact_mut(width)) {
            plane.copy(y * width..(y + 1) * width, &mut wide[RADIUS..RADIUS + width]);
            weigh(out, taps, std::array::from_fn(|t| &wide[t..t + width]));
        }
        let zeros = vec![0.0; width];
        let mut out = vec![0.0; rows.len() * width];
        for (y, line) in rows.zip(out.chunks_exact_mut(width)) {
            let neighbour = |t: usize| {
                let row = (y + t).checked_sub(RADIUS).filter(|&row| row < height);
                row.map_or(&zeros[..], |row| {
                    &across[(row - near.start) * width..(row - near.start + 1) * width]
                })
            };
            weigh(line, taps, std::array::from_fn(neighbour));
        }
        out
    }
}

/// The sum of the taps times the rows, which are as long as `out`.
#[inline(always)]
fn weigh(out: &mut [f64], taps: &[f64; WINDOW], rows: [&[f64]; WINDOW]) {
    let rows = rows.map(|row| &row[..out.len()]);
    for (x, out) in out.iter_mut().enumerate() {
        let mut sum = 0.0;
        for t in 0..WINDOW {
            sum += taps[t] * rows[t][x];
        }
        *out = sum;
    }
}

fn taps() -> [f64; WINDOW] {
    let mut taps = [0.0; WINDOW];
    for (i, tap) in taps.iter_mut().enumerate() {
        let distance = i as f64 - RADIUS as f64;
        *tap = (-distance * distance / (2.0 * SIGMA * SIGMA)).exp();
    }
    let sum: f64 = taps.iter().sum();
    taps.map(|t| t / sum)
}

/// `width` values for each of `rows`, which all processors compute in bands: `work` fills those of its rows.
pub(crate) fn by_bands(
    rows: Range<usize>,
    width: usize,
    work: impl Fn(Range<usize>, &mut [f64]) + Sync,
) -> Vec<f64> {
    let mut out = vec![0.0; rows.len() * width];
    out.par_chunks_mut(BAND * width).enumerate().for_each(|(band, out)| {
        let first = rows.start + band * BAND;
        work(first..first + out.len() / width, out);
    });
    out
}
