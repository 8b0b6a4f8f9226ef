//! The two passes over one band of rows and one channel: SSIM statistics, then the gradient.

use super::region::Span;
use super::window::{LANES, WINDOW, filter_columns, filter_row};
use super::{BAND, MAX_COLUMNS, Padded};
use crate::constants::{C1, C2, RADIUS};
use ffgs_core::kernel::{Kernel, fma};
use ffgs_core::{ImageSize, Mask};

/// Rows a band needs, its own and the window's reach.
const ROWS: usize = BAND + 2 * RADIUS;
/// Samples of one loaded row.
const LOADED: usize = MAX_COLUMNS + 2 * RADIUS;

/// Horizontally filtered maps of one span.
pub(super) type RowMaps = [[[f32; MAX_COLUMNS]; ROWS]; 4];

/// Horizontally filtered maps before any use.
pub(super) static EMPTY_MAPS: RowMaps = [[[0.0; MAX_COLUMNS]; ROWS]; 4];

/// Sums over counted samples of one band and channel.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Sums {
    pub ssim: f64,
    pub l1: f64,
    pub squared: f64,
}

/// What both passes read of one channel.
#[derive(Clone, Copy)]
pub(super) struct Channel<'a> {
    pub index: usize,
    pub size: ImageSize,
    /// One plane.
    pub rendered: &'a [f32],
    /// Interleaved RGB bytes.
    pub target: &'a [u8],
    pub mask: Option<&'a Mask>,
}

impl Channel<'_> {
    /// Loads `x.len()` samples of a row, rendered (composited over the target outside the mask) and target;
    /// zero outside the image. Row and first column carry an offset of [`RADIUS`].
    #[inline(always)]
    fn load(&self, row: usize, first: usize, x: &mut [f32], y: &mut [f32]) {
        let ImageSize { width, .. } = self.size;
        let begin = first.max(RADIUS) - RADIUS;
        let end = (first + x.len() - RADIUS).min(width);
        let skip = begin + RADIUS - first;
        let count = end - begin;
        x[..skip].fill(0.0);
        y[..skip].fill(0.0);
        x[skip + count..].fill(0.0);
        y[skip + count..].fill(0.0);
        let (x, y) = (&mut x[skip..skip + count], &mut y[skip..skip + count]);
        let at = (row - RADIUS) * width + begin;
        for (v, rgb) in y.iter_mut().zip(self.target[at * 3..(at + count) * 3].as_chunks::<3>().0) {
            *v = f32::from(rgb[self.index]) / 255.0;
        }
        x.copy_from_slice(&self.rendered[at..at + count]);
        if let Some(mask) = self.mask {
            for ((v, &target), &counted) in x.iter_mut().zip(y.iter()).zip(&mask.data()[at..at + count]) {
                *v = if counted != 0 { *v } else { target };
            }
        }
    }

    /// 1 where a pixel counts, else 0 (also beyond the right edge).
    #[inline(always)]
    fn weights(&self, row: usize, x0: usize, out: &mut [f32]) {
        let width = self.size.width;
        let count = out.len().min(width - x0);
        out[count..].fill(0.0);
        match self.mask {
            None => out[..count].fill(1.0),
            Some(mask) => {
                let counted = &mask.data()[row * width + x0..row * width + x0 + count];
                out.iter_mut().zip(counted).for_each(|(w, &m)| *w = f32::from(m));
            }
        }
    }
}

/// First pass: SSIM and its partial derivatives by the window statistics, zero where a pixel does not count.
pub(super) struct Statistics<'a> {
    pub channel: Channel<'a>,
    pub band: usize,
    pub spans: &'a [Span],
    pub maps: &'a mut RowMaps,
    pub layout: Padded,
    /// This band's derivatives by (mean of x, mean of x^2 + y^2, mean of x y), rows of `layout.stride`.
    pub partials: &'a mut [f32],
    pub sums: &'a mut Sums,
}

impl Kernel for Statistics<'_> {
    type Output = ();

    #[inline(always)]
    fn run<const FMA: bool>(mut self) {
        for &span in self.spans {
            self.filter_rows::<FMA>(span);
            self.finish::<FMA>(span);
        }
    }
}

impl Statistics<'_> {
    #[inline(always)]
    fn filter_rows<const FMA: bool>(&mut self, span: Span) {
        let n = span.columns;
        let mut loaded = [[0.0; LOADED]; 4];
        for j in 0..ROWS {
            let row = self.band * BAND + j;
            if row < RADIUS || row - RADIUS >= self.channel.size.height {
                self.maps.iter_mut().for_each(|map| map[j][..n].fill(0.0));
                continue;
            }
            let [x, y, squares, products] = &mut loaded;
            self.channel.load(row, span.x0, &mut x[..n + 2 * RADIUS], &mut y[..n + 2 * RADIUS]);
            for i in 0..LOADED {
                squares[i] = fma::<FMA>(x[i], x[i], y[i] * y[i]);
                products[i] = x[i] * y[i];
            }
            for (map, input) in self.maps.iter_mut().zip(&loaded) {
                filter_row::<FMA>(input, &mut map[j][..n]);
            }
        }
    }

    #[inline(always)]
    fn finish<const FMA: bool>(&mut self, span: Span) {
        let mut weights = [0.0; MAX_COLUMNS];
        let mut total = [0.0; LANES];
        let mut filtered = [[0.0; MAX_COLUMNS]; 4];
        let rows = BAND.min(self.channel.size.height - self.band * BAND);
        for r in 0..rows {
            self.channel.weights(self.band * BAND + r, span.x0, &mut weights[..span.columns]);
            for (out, map) in filtered.iter_mut().zip(&*self.maps) {
                filter_columns::<FMA, MAX_COLUMNS>(&map[r..], span.columns, out);
            }
            for column in (0..span.columns).step_by(LANES) {
                let means = chunks_of(&filtered, column);
                let weight: &[f32; LANES] = weights[column..column + LANES].try_into().expect("a chunk");
                let partials = partials_of(&means, weight, &mut total);
                for (m, partial) in partials.iter().enumerate() {
                    let at = self.layout.at(m, r, span.x0 + column);
                    self.partials[at..at + LANES].copy_from_slice(partial);
                }
            }
        }
        self.sums.ssim += sum_lanes(&total);
    }
}

/// Derivatives of SSIM by the windowed means of x, x^2 + y^2 and x y, where
/// `SSIM = (2 mx my + C1)(2 sxy + C2) / ((mx^2 + my^2 + C1)(sxx + syy + C2))`.
#[inline(always)]
fn partials_of(
    means: &[[f32; LANES]; 4],
    weight: &[f32; LANES],
    total: &mut [f32; LANES],
) -> [[f32; LANES]; 3] {
    let mut out = [[0.0; LANES]; 3];
    for i in 0..LANES {
        let (mx, my) = (means[0][i], means[1][i]);
        let (mean_product, mean_squares) = (mx * my, mx * mx + my * my);
        let a1 = 2.0 * mean_product + C1;
        let b1 = mean_squares + C1;
        let a2 = 2.0 * (means[3][i] - mean_product) + C2;
        let b2 = means[2][i] - mean_squares + C2;
        let inverse = weight[i] / (b1 * b2);
        let ssim = a1 * a2 * inverse;
        let by_squares = -ssim / b2;
        let by_product = 2.0 * a1 * inverse;
        total[i] += ssim;
        out[0][i] =
            2.0 * my * a2 * inverse - 2.0 * mx * (ssim / b1) - 2.0 * mx * by_squares - my * by_product;
        out[1][i] = by_squares;
        out[2][i] = by_product;
    }
    out
}

/// Factors of the two gradients, the mean over counted samples included.
#[derive(Clone, Copy)]
pub(super) struct Factors {
    pub l1: f32,
    pub ssim: f32,
}

/// Second pass: filters the partial derivatives back and adds the L1 term.
pub(super) struct Gradient<'a> {
    pub channel: Channel<'a>,
    pub band: usize,
    pub spans: &'a [Span],
    pub maps: &'a mut RowMaps,
    pub layout: Padded,
    /// All bands' derivatives of this channel.
    pub partials: &'a [f32],
    pub factors: Factors,
    /// This band's rows of the gradient plane.
    pub output: &'a mut [f32],
    pub sums: &'a mut Sums,
}

impl Kernel for Gradient<'_> {
    type Output = ();

    #[inline(always)]
    fn run<const FMA: bool>(mut self) {
        for &span in self.spans {
            self.filter_rows::<FMA>(span);
            self.finish::<FMA>(span);
        }
    }
}

impl Gradient<'_> {
    #[inline(always)]
    fn filter_rows<const FMA: bool>(&mut self, span: Span) {
        let n = span.columns;
        for j in 0..ROWS {
            let row = self.band * BAND + j;
            let outside = row < RADIUS || row - RADIUS >= self.channel.size.height;
            for (m, map) in self.maps[..3].iter_mut().enumerate() {
                if outside {
                    map[j][..n].fill(0.0);
                    continue;
                }
                let (band, r) = ((row - RADIUS) / BAND, (row - RADIUS) % BAND);
                let at = band * self.layout.band_len() + self.layout.at(m, r, span.x0) - RADIUS;
                filter_row::<FMA>(&self.partials[at..at + n + 2 * RADIUS], &mut map[j][..n]);
            }
        }
    }

    #[inline(always)]
    fn finish<const FMA: bool>(&mut self, span: Span) {
        let width = self.channel.size.width;
        let (mut x, mut y) = ([0.0; LOADED], [0.0; LOADED]);
        let mut weights = [0.0; MAX_COLUMNS];
        let mut totals = [[0.0; LANES]; 2];
        let mut filtered = [[0.0; MAX_COLUMNS]; 3];
        let rows = self.output.len() / width;
        for r in 0..rows {
            let row = self.band * BAND + r;
            let n = span.columns + 2 * RADIUS;
            self.channel.load(row + RADIUS, span.x0, &mut x[..n], &mut y[..n]);
            self.channel.weights(row, span.x0, &mut weights[..span.columns]);
            for (out, map) in filtered.iter_mut().zip(&*self.maps) {
                filter_columns::<FMA, MAX_COLUMNS>(&map[r..], span.columns, out);
            }
            for column in (0..span.columns).step_by(LANES) {
                let chunk = |v: &[f32; LOADED]| -> [f32; LANES] {
                    v[column + RADIUS..column + RADIUS + LANES].try_into().expect("a chunk")
                };
                let weight = weights[column..column + LANES].try_into().expect("a chunk");
                let pixels = Pixels { x: chunk(&x), y: chunk(&y), weight };
                let means = chunks_of(&filtered, column);
                let values = pixels.gradient::<FMA>(&means, self.factors, &mut totals);
                let first = span.x0 + column;
                let count = LANES.min(width - first);
                self.output[r * width + first..][..count].copy_from_slice(&values[..count]);
            }
        }
        self.sums.l1 += sum_lanes(&totals[0]);
        self.sums.squared += sum_lanes(&totals[1]);
    }
}

struct Pixels {
    x: [f32; LANES],
    y: [f32; LANES],
    weight: [f32; LANES],
}

impl Pixels {
    #[inline(always)]
    fn gradient<const FMA: bool>(
        &self,
        means: &[[f32; LANES]; 3],
        factors: Factors,
        totals: &mut [[f32; LANES]; 2],
    ) -> [f32; LANES] {
        let mut out = [0.0; LANES];
        for i in 0..LANES {
            let (x, y, weight) = (self.x[i], self.y[i], self.weight[i]);
            let difference = (x - y) * weight;
            totals[0][i] += difference.abs();
            totals[1][i] = fma::<FMA>(difference, difference, totals[1][i]);
            let sign = if difference > 0.0 { 1.0 } else { 0.0 } - if difference < 0.0 { 1.0 } else { 0.0 };
            let ssim = fma::<FMA>(2.0 * x, means[1][i], fma::<FMA>(y, means[2][i], means[0][i]));
            out[i] = weight * fma::<FMA>(factors.ssim, ssim, factors.l1 * sign);
        }
        out
    }
}

/// The same chunk of several rows. A loop, not `map`: a closure passed to core would be compiled without the
/// instruction set.
#[inline(always)]
fn chunks_of<const N: usize>(rows: &[[f32; MAX_COLUMNS]; N], column: usize) -> [[f32; LANES]; N] {
    let mut out = [[0.0; LANES]; N];
    for (chunk, row) in out.iter_mut().zip(rows) {
        chunk.copy_from_slice(&row[column..column + LANES]);
    }
    out
}

#[inline(always)]
fn sum_lanes(lanes: &[f32; LANES]) -> f64 {
    lanes.iter().map(|&v| f64::from(v)).sum()
}

const _: () = assert!(WINDOW.len() == RADIUS + 1 && MAX_COLUMNS.is_multiple_of(LANES));
