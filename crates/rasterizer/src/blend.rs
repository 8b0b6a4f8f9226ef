//! The walk over a tile's splats, front to back, shared by every pass that blends.

use crate::constants::{AREA, MAX_ALPHA, MIN_ALPHA, TILE};
use crate::projection::Splat;
use crate::tile_lists::Entry;
use pulp::Simd;

/// Splats loaded ahead.
const BATCH: usize = 16;

/// One value per pixel of a tile, row by row, aligned for the widest vectors.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub(crate) struct TilePlane(pub(crate) [f32; AREA]);

impl TilePlane {
    pub(crate) const ZERO: Self = Self([0.0; AREA]);
    pub(crate) const ONE: Self = Self([1.0; AREA]);
}

/// One vector of contributions: consecutive pixels of a row.
pub(crate) struct Contribution<S: Simd> {
    /// Vector number inside the tile: pixels `vector * lanes ..`.
    pub(crate) vector: usize,
    /// Horizontal distance of the pixel centre from the ridge, the line where the splat is densest in its row (px).
    pub(crate) from_ridge: S::f32s,
    /// Pixel centre minus splat centre, vertically (px); one value for the row.
    pub(crate) dy: S::f32s,
    /// `exp(-sigma)`.
    pub(crate) falloff: S::f32s,
    /// Capped opacity at the pixels.
    pub(crate) alpha: S::f32s,
    /// Transmittance in front.
    pub(crate) transmittance: S::f32s,
    /// `alpha * transmittance` where the contribution counts, else 0.
    pub(crate) weight: S::f32s,
    /// Where the contribution counts.
    pub(crate) counts: S::m32s,
}

/// What a pass does with the contributions.
pub(crate) trait Visitor<S: Simd> {
    /// A splat begins.
    fn begin(&mut self, simd: S, splat: &Splat);
    /// Some pixels of the splat count.
    fn visit(&mut self, simd: S, c: &Contribution<S>);
    /// The splat ends; `place` is where the tile keeps its sums.
    fn end(&mut self, simd: S, place: usize);
}

/// `exp(-s)` for `s` in [0, 5.6] as the eighth power of a degree-6 polynomial for `exp` on [-0.7, 0]
/// (relative error below 1e-6; beyond the range the caller masks).
#[inline(always)]
fn exp_negative<S: Simd>(simd: S, s: S::f32s) -> S::f32s {
    const P: [f32; 6] = [1.0, 0.499_999_1, 0.166_651_62, 0.041_573_365, 0.008_068_932, 0.001_033_801_8];
    let x = simd.mul_f32s(s, simd.splat_f32s(-0.125));
    let mut p = simd.splat_f32s(P[5]);
    for &c in P[..5].iter().rev() {
        p = simd.mul_add_e_f32s(p, x, simd.splat_f32s(c));
    }
    let e = simd.mul_add_e_f32s(p, x, simd.splat_f32s(1.0));
    let e2 = simd.mul_f32s(e, e);
    let e4 = simd.mul_f32s(e2, e2);
    simd.mul_f32s(e4, e4)
}

#[inline(always)]
fn any<S: Simd>(simd: S, mask: S::m32s) -> bool {
    simd.first_true_m32s(mask) < S::F32_LANES
}

/// Rows of a tile with a pixel that is not finished, a bit per row.
#[derive(Clone, Copy)]
struct OpenRows(u32);

impl OpenRows {
    #[inline(always)]
    fn new<S: Simd>(simd: S, state: &[S::f32s]) -> Self {
        let mut rows = Self((1 << TILE) - 1);
        for row in 0..TILE {
            rows.close_finished(simd, state, row);
        }
        rows
    }

    /// Closes `row` if all of its pixels are finished.
    #[inline(always)]
    fn close_finished<S: Simd>(&mut self, simd: S, state: &[S::f32s], row: usize) {
        let vectors = TILE / S::F32_LANES;
        let mut highest = simd.splat_f32s(0.0);
        for &t in &state[row * vectors..(row + 1) * vectors] {
            highest = simd.max_f32s(highest, t);
        }
        if !any(simd, simd.greater_than_f32s(highest, simd.splat_f32s(0.0))) {
            self.0 &= !(1 << row);
        }
    }
}

/// Columns 0, 1, 2, … as floats.
const COLUMNS: [f32; TILE] =
    [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0, 11.0, 12.0, 13.0, 14.0, 15.0];

/// Rows and columns of a tile that a splat's ellipse can touch.
struct RowRange {
    /// A bit per row.
    rows: u32,
    slope: f32,
    reach_over_a: f32,
    shrink: f32,
}

impl RowRange {
    #[inline(always)]
    fn new(splat: &Splat, y: f32) -> Self {
        let [a, b, _] = splat.conic;
        let limit = |row: f32| row.max(0.0).min(TILE as f32) as u32;
        let first = limit((-splat.half_height - y).ceil());
        let end = limit((splat.half_height - y).floor() + 1.0);
        Self {
            rows: (1 << end) - (1 << first.min(end)),
            slope: -b / a,
            reach_over_a: splat.squared_reach() / a,
            shrink: splat.shrink,
        }
    }

    /// Horizontal extent at vertical offset `dy`, relative to the splat's centre.
    #[inline(always)]
    fn columns(&self, dy: f32) -> (f32, f32) {
        let half = (self.reach_over_a - dy * dy * self.shrink).max(0.0).sqrt() + 1e-2;
        (self.slope * dy - half, self.slope * dy + half)
    }
}

/// Falloff and opacity of a splat in a vector of pixels `from_ridge` off its ridge, and in which of them it shows. `least` is the exponent on
/// the ridge, `half_a` half of the conic's first entry.
#[inline(always)]
fn evaluate<S: Simd>(
    simd: S,
    from_ridge: S::f32s,
    least: S::f32s,
    half_a: S::f32s,
    opacity: S::f32s,
) -> (S::f32s, S::f32s, S::m32s) {
    let sigma = simd.mul_add_e_f32s(simd.mul_f32s(half_a, from_ridge), from_ridge, least);
    let falloff = exp_negative(simd, sigma);
    let alpha = simd.min_f32s(simd.splat_f32s(MAX_ALPHA), simd.mul_f32s(opacity, falloff));
    let shows = simd.and_m32s(
        simd.greater_than_or_equal_f32s(alpha, simd.splat_f32s(MIN_ALPHA)),
        // The polynomial holds up to here, beyond every splat's reach; also false for NaN.
        simd.less_than_f32s(sigma, simd.splat_f32s(5.6)),
    );
    (falloff, alpha, shows)
}

/// The transmittance behind a splat, negative where the pixel is finished now; the splat's weight; and in which pixels it counts.
#[inline(always)]
fn attenuate<S: Simd>(
    simd: S,
    t: S::f32s,
    alpha: S::f32s,
    shows: S::m32s,
    least_open: S::f32s,
) -> (S::f32s, S::f32s, S::m32s) {
    let weight = simd.mul_f32s(alpha, t);
    let next = simd.sub_f32s(t, weight);
    let open = simd.greater_than_f32s(next, least_open);
    let counts = simd.and_m32s(shows, open);
    let closed = simd.select_f32s(shows, simd.neg_f32s(t), t);
    (simd.select_f32s(counts, next, closed), simd.select_f32s(counts, weight, simd.splat_f32s(0.0)), counts)
}

/// A splat seen from a tile.
struct Placed<'a, S: Simd> {
    splat: &'a Splat,
    /// Centre of the tile's first pixel minus the splat's (px).
    x: f32,
    y: f32,
    rows: RowRange,
    /// Half of the conic's first entry.
    half_a: f32,
    half_a_: S::f32s,
    opacity: S::f32s,
}

impl<'a, S: Simd> Placed<'a, S> {
    #[inline(always)]
    fn new(simd: S, splat: &'a Splat, [x, y]: [f32; 2], rows: RowRange) -> Self {
        let half_a = 0.5 * splat.conic[0];
        let (half_a_, opacity) = (simd.splat_f32s(half_a), simd.splat_f32s(splat.opacity));
        Self { splat, x, y, rows, half_a, half_a_, opacity }
    }
}

/// A row of a splat.
struct SplatRow<S: Simd> {
    /// As [`Contribution::dy`].
    dy: S::f32s,
    /// Where the ridge is, relative to the splat's centre (px).
    shift: S::f32s,
    /// The exponent on the ridge.
    least: S::f32s,
}

impl<S: Simd> SplatRow<S> {
    /// The square completed, sigma = a (dx - slope dy)^2 / 2 + the least of this row: nothing cancels on needles.
    #[inline(always)]
    fn new(simd: S, placed: &Placed<S>, dy: f32) -> Self {
        let least = simd.splat_f32s(placed.half_a * placed.splat.shrink * dy * dy);
        Self { dy: simd.splat_f32s(dy), shift: simd.splat_f32s(placed.rows.slope * dy), least }
    }
}

/// The pixels of a tile during a walk.
struct Pixels<'a, S: Simd> {
    columns: &'a [S::f32s],
    /// Transmittance, negative where finished.
    state: &'a mut [S::f32s],
    /// Transmittance up to which a pixel is finished.
    least_open: S::f32s,
}

impl<S: Simd> Pixels<'_, S> {
    const VECTORS: usize = TILE / S::F32_LANES;

    /// A splat in the given rows, a bit per row.
    #[inline(always)]
    fn blend<V: Visitor<S>>(&mut self, simd: S, placed: &Placed<S>, mut rows: u32, visitor: &mut V) {
        while rows != 0 {
            let row = rows.trailing_zeros() as usize;
            rows &= rows - 1;
            self.blend_row(simd, placed, row, visitor);
        }
    }

    #[inline(always)]
    fn blend_row<V: Visitor<S>>(&mut self, simd: S, placed: &Placed<S>, row: usize, visitor: &mut V) {
        let dy = placed.y + row as f32;
        // A vector that is a whole row is cheaper to try than to rule out.
        let (low, high) =
            if Self::VECTORS == 1 { (f32::NEG_INFINITY, f32::INFINITY) } else { placed.rows.columns(dy) };
        let of_row = SplatRow::new(simd, placed, dy);
        for part in 0..Self::VECTORS {
            let left = placed.x + (part * S::F32_LANES) as f32;
            if high < left || low > left + (S::F32_LANES - 1) as f32 {
                continue;
            }
            self.blend_vector(simd, placed, &of_row, [row, part], visitor);
        }
    }

    /// A splat in a vector: a part of a row.
    #[inline(always)]
    fn blend_vector<V: Visitor<S>>(
        &mut self,
        simd: S,
        placed: &Placed<S>,
        &SplatRow { dy, shift, least }: &SplatRow<S>,
        [row, part]: [usize; 2],
        visitor: &mut V,
    ) {
        let vector = row * Self::VECTORS + part;
        let transmittance = self.state[vector];
        let dx = simd.add_f32s(self.columns[part], simd.splat_f32s(placed.x));
        let from_ridge = simd.sub_f32s(dx, shift);
        let (falloff, alpha, shows) = evaluate(simd, from_ridge, least, placed.half_a_, placed.opacity);
        let shows = simd.and_m32s(shows, simd.greater_than_f32s(transmittance, simd.splat_f32s(0.0)));
        if Self::VECTORS > 1 && !any(simd, shows) {
            return;
        }
        let (next, weight, counts) = attenuate(simd, transmittance, alpha, shows, self.least_open);
        self.state[vector] = next;
        visitor.visit(
            simd,
            &Contribution { vector, from_ridge, dy, falloff, alpha, transmittance, weight, counts },
        );
    }
}

/// Walks `slots` front to back over the tile whose first pixel is `origin`, up to the transmittance `finished`. `transmittance` starts as given (1) and
/// ends as the final value with its sign flipped where the pixel finished early; callers take the absolute value.
#[inline(always)]
pub(crate) fn walk<S: Simd, V: Visitor<S>>(
    simd: S,
    origin: [usize; 2],
    splats: &[Splat],
    slots: &[Entry],
    finished: f32,
    transmittance: &mut TilePlane,
    visitor: &mut V,
) {
    let (columns, _) = S::as_simd_f32s(&COLUMNS);
    let (state, _) = S::as_mut_simd_f32s(&mut transmittance.0);
    let mut pixels = Pixels { columns, state, least_open: simd.splat_f32s(finished) };
    let mut open_rows = OpenRows::new(simd, pixels.state);
    let mut batch = [Splat::default(); BATCH];
    for entry in 0..slots.len() {
        if entry % BATCH == 0 {
            open_rows = OpenRows::new(simd, pixels.state);
            if open_rows.0 == 0 {
                break;
            }
            // Splats lie anywhere in memory: loads that follow each other overlap.
            for (copy, ahead) in batch.iter_mut().zip(&slots[entry..]) {
                *copy = splats[ahead.slot()];
            }
        }
        let splat = &batch[entry % BATCH];
        let [x, y] = [0, 1].map(|axis| origin[axis] as f32 + 0.5 - splat.mean[axis]);
        let range = RowRange::new(splat, y);
        let rows = range.rows & open_rows.0;
        if rows == 0 {
            continue;
        }
        visitor.begin(simd, splat);
        pixels.blend(simd, &Placed::new(simd, splat, [x, y], range), rows, visitor);
        visitor.end(simd, slots[entry].place());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exponential_is_accurate_over_its_range() {
        let simd = pulp::Scalar::new();
        for i in 0..=5600 {
            let s = i as f32 * 1e-3;
            let exact = (-f64::from(s)).exp();
            let error = (f64::from(exp_negative(simd, s)) - exact).abs() / exact;
            assert!(error < 2e-6, "exp(-{s}) off by {error:e}");
        }
    }
}
