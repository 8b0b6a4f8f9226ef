//! Shi and Tomasi's corners ("Good features to track", CVPR 1994), spread over the picture.

use crate::lucas_kanade::{self, smaller_eigenvalue};
use crate::pyramid::Level;
use ffgs_core::Mask;
use ffgs_core::kernel::{Kernel, dispatch, fma};

/// Half the side of the window over which the gradients' products are summed.
const RADIUS: usize = 3;
/// Least smaller eigenvalue, per pixel of the window: a gradient of 1.5 grey levels a pixel in every direction.
/// Sensor noise of one grey level has 0.2.
const LEAST_EIGENVALUE: f32 = 2.25;

/// The best corner of every cell of `cell` pixels, or of `fine_cell` pixels where `interest` is set: centres of pixels,
/// with their strength, row by row. Where `interest` is set a corner is whatever Lucas-Kanade can follow
/// (docs/adr/0098-in-masks-what-can-be-followed-is-a-corner.md).
pub(crate) fn corners(
    level: &Level,
    interest: Option<&Mask>,
    cell: usize,
    fine_cell: usize,
) -> Vec<([f32; 2], f32)> {
    let strength = dispatch(Strengths(level));
    let elsewhere = (cell, LEAST_EIGENVALUE);
    let mut found = in_cells(level, &strength, elsewhere, |i| interest.is_none_or(|m| m.data()[i] == 0));
    if let Some(mask) = interest {
        found.extend(in_cells(level, &strength, (fine_cell, lucas_kanade::LEAST_EIGENVALUE), |i| {
            mask.data()[i] != 0
        }));
    }
    found
}

fn in_cells(
    level: &Level,
    strength: &[f32],
    (cell, least): (usize, f32),
    counts: impl Fn(usize) -> bool,
) -> Vec<([f32; 2], f32)> {
    let (width, height) = (level.size.width, level.size.height);
    let columns = width.div_ceil(cell);
    let mut best = vec![(0, least); columns * height.div_ceil(cell)];
    for (y, row) in strength.chunks_exact(width).enumerate() {
        let slots = &mut best[y / cell * columns..][..columns];
        for (k, (slot, values)) in slots.iter_mut().zip(row.chunks(cell)).enumerate() {
            for (x, &s) in values.iter().enumerate() {
                let i = y * width + k * cell + x;
                if s > slot.1 && counts(i) {
                    *slot = (i, s);
                }
            }
        }
    }
    let centre = |i: usize| [(i % width) as f32 + 0.5, (i / width) as f32 + 0.5];
    best.into_iter().filter(|b| b.1 > least).map(|(i, s)| (centre(i), s)).collect()
}

/// Smaller eigenvalue of the mean structure tensor around every pixel.
struct Strengths<'a>(&'a Level);

impl Kernel for Strengths<'_> {
    type Output = Vec<f32>;

    #[inline(always)]
    fn run<const FMA: bool>(self) -> Vec<f32> {
        let level = self.0;
        let (width, height) = (level.size.width, level.size.height);
        let side = 2 * RADIUS + 1;
        let first = -(RADIUS as isize);
        // Sums along the rows first, then down the columns of the last rows.
        let mut sums = vec![[0.0_f32; 3].map(|v| vec![v; width]); side];
        let mut out = vec![0.0; width * height];
        for y in 0..height + 2 * RADIUS {
            let start = level.index(first, first + y as isize);
            let columns = start..start + width + 2 * RADIUS;
            along_row::<FMA>(&level.dx[columns.clone()], &level.dy[columns], &mut sums[y % side]);
            if let Some(row) = y.checked_sub(2 * RADIUS) {
                down_columns(&sums, &mut out[row * width..(row + 1) * width]);
            }
        }
        out
    }
}

/// Sums of the derivatives' products (xx, xy, yy) over the columns of every window.
#[inline(always)]
fn along_row<const FMA: bool>(dx: &[f32], dy: &[f32], sums: &mut [Vec<f32>; 3]) {
    let [xx, xy, yy] = sums.each_mut().map(|v| &mut v[..]);
    let width = xx.len();
    let (xy, yy) = (&mut xy[..width], &mut yy[..width]);
    let (dx, dy) = (&dx[..width + 2 * RADIUS], &dy[..width + 2 * RADIUS]);
    for x in 0..width {
        let mut sum = [0.0_f32; 3];
        for k in 0..=2 * RADIUS {
            let (u, v) = (dx[x + k], dy[x + k]);
            sum = [fma::<FMA>(u, u, sum[0]), fma::<FMA>(u, v, sum[1]), fma::<FMA>(v, v, sum[2])];
        }
        (xx[x], xy[x], yy[x]) = (sum[0], sum[1], sum[2]);
    }
}

/// Adds up the rows of every window.
#[inline(always)]
fn down_columns(sums: &[[Vec<f32>; 3]], out: &mut [f32]) {
    let per_pixel = 1.0 / (sums.len() * sums.len()) as f32;
    let width = out.len();
    let mut total = [0, 1, 2].map(|_| vec![0.0_f32; width]);
    for row in sums {
        for (total, row) in total.iter_mut().zip(row) {
            total.iter_mut().zip(row).for_each(|(t, v)| *t += v);
        }
    }
    let [xx, xy, yy] = total.each_ref().map(|v| &v[..width]);
    for x in 0..width {
        out[x] = smaller_eigenvalue([xx[x], xy[x], yy[x]].map(|s| s * per_pixel));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pyramid::Pyramid;
    use ffgs_core::{ImageRgb8, ImageSize};

    const SIZE: ImageSize = ImageSize { width: 96, height: 64 };

    #[test]
    fn what_is_faint_has_corners_only_where_a_mask_holds_it() {
        // Waves of 5 grey levels, as folds of cloth or skin have.
        let grey = |i: usize| {
            let [x, y] = [i % SIZE.width, i / SIZE.width].map(|v| v as f32 * 0.5);
            (128.0 + 5.0 * x.sin() * y.cos()).round() as u8
        };
        let image = ImageRgb8::new(SIZE, (0..SIZE.pixels()).flat_map(|i| [grey(i); 3]).collect()).unwrap();
        let level = &Pyramid::new(&image, 1).levels[0];
        let left = (0..SIZE.pixels()).map(|i| u8::from(i % SIZE.width < 48)).collect();
        let left = Mask::new(SIZE, left).unwrap();
        assert!(corners(level, None, 4, 3).is_empty());
        let found = corners(level, Some(&left), 4, 3);
        assert!(found.len() > 100 && found.iter().all(|([x, _], _)| *x < 48.0), "{} corners", found.len());
    }
}
