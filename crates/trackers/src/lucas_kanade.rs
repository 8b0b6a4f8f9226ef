//! Lucas and Kanade's tracker on pyramids (Bouguet, "Pyramidal implementation of the Lucas Kanade feature tracker",
//! 2000), with the mean of every window taken out, so that a change of exposure is no motion.

use crate::pyramid::{Level, PAD, Pyramid};
use ffgs_core::instructions;
use pulp::{Simd, WithSimd};

/// Half the side of the window.
const RADIUS: usize = 7;
const SIDE: usize = 2 * RADIUS + 1;
/// A row of the window with one column more, which counts for nothing: a whole number of vectors.
const ROW: usize = SIDE + 1;
const PIXELS: f32 = (SIDE * SIDE) as f32;
const ITERATIONS: usize = 20;
/// A step below this (px) ends the iterations: a hundredth of a good tracker's noise is not worth more.
const CONVERGED: f32 = 0.01;
/// Smaller eigenvalue per pixel below which a window has no texture in some direction.
pub(crate) const LEAST_EIGENVALUE: f32 = 0.5;

type Row = [f32; ROW];
type Patch = [Row; SIDE];

/// Where the content of `prev` around `at` lies in `next`, with the correlation of the two windows (1 = equal up to
/// exposure). Without a guess of the displacement all levels are searched; a guess is refined on the finest two, because
/// a small thing is lost in the coarse ones. `None` when the window has no texture or leaves the picture.
pub(crate) fn track(
    prev: &Pyramid,
    next: &Pyramid,
    at: [f32; 2],
    guess: Option<[f32; 2]>,
) -> Option<([f32; 2], f32)> {
    instructions().dispatch(Search { prev, next, at, guess })
}

struct Search<'a> {
    prev: &'a Pyramid,
    next: &'a Pyramid,
    at: [f32; 2],
    guess: Option<[f32; 2]>,
}

impl WithSimd for Search<'_> {
    type Output = Option<([f32; 2], f32)>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
        let Self { prev, next, at, guess } = self;
        let highest = if guess.is_some() { 1 } else { usize::MAX };
        let top = highest.min(prev.levels.len() - 1).min(next.levels.len() - 1);
        let scale = |level: usize| 1.0 / (1_u32 << level) as f32;
        let mut d = guess.unwrap_or_default().map(|v| v * scale(top));
        let mut correlation = 0.0;
        for level in (0..=top).rev() {
            let p = at.map(|v| v * scale(level));
            let mut found = None;
            if let Some(template) = Template::new(simd, &prev.levels[level], p) {
                found = template.follow(simd, &next.levels[level], p, d);
                d = found.unwrap_or(d);
                if level == 0 {
                    correlation = template.correlation(simd, &next.levels[0], p, d)?;
                }
            }
            // A coarse level may be blank where a finer one has texture.
            if level > 0 {
                d = [2.0 * d[0], 2.0 * d[1]];
            } else {
                found?;
            }
        }
        Some(([at[0] + d[0], at[1] + d[1]], correlation))
    }
}

/// The window that is looked for, with its derivatives; means taken out, zero in the column that does not count.
struct Template {
    grey: Patch,
    dx: Patch,
    dy: Patch,
    /// Inverse of the structure tensor: (xx, xy, yy).
    inverse: [f32; 3],
    /// Products of the window with its derivatives.
    own: [f32; 2],
}

impl Template {
    /// `None` when the window has no texture or lies outside.
    #[inline(always)]
    fn new<S: Simd>(simd: S, level: &Level, p: [f32; 2]) -> Option<Self> {
        let place = Place::new(level, p)?;
        let dx = place.centred(simd, &level.dx);
        let dy = place.centred(simd, &level.dy);
        let (a, b, c) = (product(simd, &dx, &dx), product(simd, &dx, &dy), product(simd, &dy, &dy));
        if !(smaller_eigenvalue([a, b, c]) > LEAST_EIGENVALUE * PIXELS) {
            return None;
        }
        let scale = 1.0 / (a * c - b * b);
        let grey = place.centred(simd, &level.grey);
        let own = [product(simd, &grey, &dx), product(simd, &grey, &dy)];
        Some(Self { grey, dx, dy, inverse: [c * scale, -b * scale, a * scale], own })
    }

    /// The displacement at which the level looks like this, from `d`.
    #[inline(always)]
    fn follow<S: Simd>(&self, simd: S, next: &Level, p: [f32; 2], mut d: [f32; 2]) -> Option<[f32; 2]> {
        let [xx, xy, yy] = self.inverse;
        for _ in 0..ITERATIONS {
            let place = Place::new(next, [p[0] + d[0], p[1] + d[1]])?;
            let [x, y] = self.products(simd, &place, &next.grey);
            let (u, v) = (self.own[0] - x, self.own[1] - y);
            let step = [xx * u + xy * v, xy * u + yy * v];
            d = [d[0] + step[0], d[1] + step[1]];
            if step[0].abs().max(step[1].abs()) < CONVERGED {
                break;
            }
        }
        Some(d)
    }

    /// Products of the window at a place with the derivatives; its mean drops out, because theirs is zero.
    #[inline(always)]
    fn products<S: Simd>(&self, simd: S, place: &Place, plane: &[f32]) -> [f32; 2] {
        let (mut x, mut y) = (simd.splat_f32s(0.0), simd.splat_f32s(0.0));
        let v = simd.splat_f32s(place.v);
        for block in 0..ROW / S::F32_LANES {
            let mut above = place.along(simd, plane, 0, block);
            for j in 0..SIDE {
                let below = place.along(simd, plane, j + 1, block);
                let value = simd.mul_add_f32s(v, simd.sub_f32s(below, above), above);
                x = simd.mul_add_f32s(value, vector::<S>(&self.dx[j], block), x);
                y = simd.mul_add_f32s(value, vector::<S>(&self.dy[j], block), y);
                above = below;
            }
        }
        [simd.reduce_sum_f32s(x), simd.reduce_sum_f32s(y)]
    }

    #[inline(always)]
    fn correlation<S: Simd>(&self, simd: S, next: &Level, p: [f32; 2], d: [f32; 2]) -> Option<f32> {
        let window = Place::new(next, [p[0] + d[0], p[1] + d[1]])?.centred(simd, &next.grey);
        let energy = (product(simd, &self.grey, &self.grey) * product(simd, &window, &window)).sqrt();
        Some(product(simd, &self.grey, &window) / energy.max(f32::MIN_POSITIVE))
    }
}

/// Where a window lies between the pixels.
struct Place {
    start: usize,
    stride: usize,
    u: f32,
    v: f32,
}

impl Place {
    /// `None` when the centre lies outside the picture.
    #[inline(always)]
    fn new(level: &Level, p: [f32; 2]) -> Option<Self> {
        // The column that does not count, and the pixel beside it for the interpolation.
        const { assert!(RADIUS + 3 <= PAD) };
        let (width, height) = (level.size.width as f32, level.size.height as f32);
        if !(p[0] >= 0.0 && p[0] <= width && p[1] >= 0.0 && p[1] <= height) {
            return None;
        }
        // Above zero because of the padding, where a conversion rounds down.
        let to_corner = PAD as f32 - RADIUS as f32 - 0.5;
        let (x, y) = (p[0] + to_corner, p[1] + to_corner);
        let (left, top) = (x as usize, y as usize);
        let start = top * level.stride() + left;
        Some(Self { start, stride: level.stride(), u: x - left as f32, v: y - top as f32 })
    }

    /// A vector of row `j`, interpolated along the row.
    #[inline(always)]
    fn along<S: Simd>(&self, simd: S, plane: &[f32], j: usize, block: usize) -> S::f32s {
        let pixels = &plane[self.start + j * self.stride + block * S::F32_LANES..][..=S::F32_LANES];
        let left = vector::<S>(&pixels[..S::F32_LANES], 0);
        let right = vector::<S>(&pixels[1..], 0);
        simd.mul_add_f32s(simd.splat_f32s(self.u), simd.sub_f32s(right, left), left)
    }

    /// The bilinear window without its mean, and zero in the column that does not count.
    #[inline(always)]
    fn centred<S: Simd>(&self, simd: S, plane: &[f32]) -> Patch {
        let mut patch = [[0.0; ROW]; SIDE];
        let v = simd.splat_f32s(self.v);
        let mut total = simd.splat_f32s(0.0);
        for block in 0..ROW / S::F32_LANES {
            let mut above = self.along(simd, plane, 0, block);
            for (j, row) in patch.iter_mut().enumerate() {
                let below = self.along(simd, plane, j + 1, block);
                let value = simd.mul_add_f32s(v, simd.sub_f32s(below, above), above);
                S::as_mut_simd_f32s(row).0[block] = value;
                total = simd.add_f32s(total, value);
                above = below;
            }
        }
        let mut outside = 0.0;
        for row in &patch {
            outside += row[SIDE];
        }
        let mean = simd.splat_f32s((simd.reduce_sum_f32s(total) - outside) / PIXELS);
        for row in &mut patch {
            for value in S::as_mut_simd_f32s(row).0 {
                *value = simd.sub_f32s(*value, mean);
            }
            row[SIDE] = 0.0;
        }
        patch
    }
}

/// A vector of a row.
#[inline(always)]
fn vector<S: Simd>(row: &[f32], block: usize) -> S::f32s {
    S::as_simd_f32s(row).0[block]
}

#[inline(always)]
fn product<S: Simd>(simd: S, a: &Patch, b: &Patch) -> f32 {
    let mut sum = simd.splat_f32s(0.0);
    for (x, y) in a.iter().zip(b) {
        for (x, y) in S::as_simd_f32s(x).0.iter().zip(S::as_simd_f32s(y).0) {
            sum = simd.mul_add_f32s(*x, *y, sum);
        }
    }
    simd.reduce_sum_f32s(sum)
}

/// Of the symmetric matrix (a b; b c).
#[inline(always)]
pub(crate) fn smaller_eigenvalue([a, b, c]: [f32; 3]) -> f32 {
    0.5 * (a + c - ((a - c) * (a - c) + 4.0 * b * b).sqrt())
}
