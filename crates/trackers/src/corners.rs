//! Shi and Tomasi's corners ("Good features to track", CVPR 1994), spread over the picture.

use crate::pyramid::Level;
use ffgs_core::Mask;

/// Half the side of the window over which the gradients' products are summed.
const RADIUS: usize = 3;
/// Least smaller eigenvalue, per pixel of the window: a gradient of 1.5 grey levels a pixel in every direction.
/// Sensor noise of one grey level has 0.2.
const LEAST_EIGENVALUE: f32 = 2.25;

/// The best corner of every cell of `cell` pixels, or of `fine_cell` pixels where `interest` is set: centres of pixels,
/// with their strength, row by row.
pub(crate) fn corners(
    level: &Level,
    interest: Option<&Mask>,
    cell: usize,
    fine_cell: usize,
) -> Vec<([f32; 2], f32)> {
    let strength = strengths(level);
    let mut found = in_cells(level, &strength, cell, |i| interest.is_none_or(|m| m.data()[i] == 0));
    if let Some(mask) = interest {
        found.extend(in_cells(level, &strength, fine_cell, |i| mask.data()[i] != 0));
    }
    found
}

fn in_cells(
    level: &Level,
    strength: &[f32],
    cell: usize,
    counts: impl Fn(usize) -> bool,
) -> Vec<([f32; 2], f32)> {
    let (width, height) = (level.size.width, level.size.height);
    let columns = width.div_ceil(cell);
    let mut best = vec![(0, LEAST_EIGENVALUE); columns * height.div_ceil(cell)];
    for (i, &s) in strength.iter().enumerate() {
        let slot = &mut best[i / width / cell * columns + i % width / cell];
        if s > slot.1 && counts(i) {
            *slot = (i, s);
        }
    }
    let centre = |i: usize| [(i % width) as f32 + 0.5, (i / width) as f32 + 0.5];
    best.into_iter().filter(|b| b.1 > LEAST_EIGENVALUE).map(|(i, s)| (centre(i), s)).collect()
}

/// Smaller eigenvalue of the mean structure tensor around every pixel.
fn strengths(level: &Level) -> Vec<f32> {
    let (width, height) = (level.size.width, level.size.height);
    // Sums along the rows first, then down the columns.
    let (rows, first) = (height + 2 * RADIUS, -(RADIUS as isize));
    let mut wide = vec![[0.0_f32; 3]; width * rows];
    for y in 0..rows {
        let start = level.index(first, first + y as isize);
        let window = |x: usize| start + x..start + x + 2 * RADIUS + 1;
        for x in 0..width {
            let (dx, dy) = (&level.dx[window(x)], &level.dy[window(x)]);
            let mut sum = [0.0; 3];
            for (u, v) in dx.iter().zip(dy) {
                sum[0] += u * u;
                sum[1] += u * v;
                sum[2] += v * v;
            }
            wide[y * width + x] = sum;
        }
    }
    let per_pixel = 1.0 / ((2 * RADIUS + 1) * (2 * RADIUS + 1)) as f32;
    let mut out = Vec::with_capacity(width * height);
    for i in 0..width * height {
        let mut sum = [0.0; 3];
        for k in 0..=2 * RADIUS {
            let row = wide[i + k * width];
            sum.iter_mut().zip(row).for_each(|(s, v)| *s += v);
        }
        out.push(smaller_eigenvalue(sum.map(|s| s * per_pixel)));
    }
    out
}

/// Of the symmetric matrix (a b; b c).
pub(crate) fn smaller_eigenvalue([a, b, c]: [f32; 3]) -> f32 {
    0.5 * (a + c - ((a - c) * (a - c) + 4.0 * b * b).sqrt())
}
