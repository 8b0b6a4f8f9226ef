//! Upright SIFT descriptors (Lowe, IJCV 2004, section 6) of a fixed scale.

use crate::pyramid::Level;

/// Cells along each side, orientations of each, and pixels along each side of a cell.
const CELLS: usize = 4;
const ORIENTATIONS: usize = 8;
const CELL_PX: usize = 4;
const SIDE: usize = CELLS * CELL_PX;
/// Lowe's cap on an entry, against single strong edges.
const CAP: f32 = 0.2;
const ENTRIES: usize = CELLS * CELLS * ORIENTATIONS;

/// A histogram of gradient orientations in 4 x 4 cells, of length 1.
pub type Descriptor = [f32; ENTRIES];

/// The descriptor of the 16 x 16 pixels around a position of the level.
pub(crate) fn describe(level: &Level, at: [f32; 2]) -> Descriptor {
    let mut histogram = [0.0; ENTRIES];
    let half = (SIDE / 2) as isize;
    let clamp = |v: f32, n: usize| (v as isize).clamp(-1, n as isize);
    let (column, row) = (clamp(at[0], level.size.width), clamp(at[1], level.size.height));
    for y in 0..SIDE {
        let start = level.index(column - half, row - half + y as isize);
        for x in 0..SIDE {
            add(&mut histogram, x, y, level.dx[start + x], level.dy[start + x]);
        }
    }
    normalise(&mut histogram);
    histogram.iter_mut().for_each(|v| *v = v.min(CAP));
    normalise(&mut histogram);
    histogram
}

/// Spreads a gradient over the two nearest orientations and the four nearest cells.
fn add(histogram: &mut Descriptor, x: usize, y: usize, dx: f32, dy: f32) {
    let middle = (SIDE as f32 - 1.0) / 2.0;
    let (u, v) = ((x as f32 - middle) / SIDE as f32, (y as f32 - middle) / SIDE as f32);
    let weight = (dx * dx + dy * dy).sqrt() * (-2.0 * (u * u + v * v)).exp();
    let turn = (dy.atan2(dx) / std::f32::consts::TAU).rem_euclid(1.0) * ORIENTATIONS as f32;
    let (cx, cy) = ((x as f32 + 0.5) / CELL_PX as f32 - 0.5, (y as f32 + 0.5) / CELL_PX as f32 - 0.5);
    let parts = |v: f32| [(v.floor(), 1.0 - (v - v.floor())), (v.floor() + 1.0, v - v.floor())];
    for (row, row_part) in parts(cy) {
        for (column, column_part) in parts(cx) {
            let inside = |c: f32| c >= 0.0 && c < CELLS as f32;
            if inside(row) && inside(column) {
                let cell = (row as usize * CELLS + column as usize) * ORIENTATIONS;
                for (orientation, part) in parts(turn) {
                    histogram[cell + orientation as usize % ORIENTATIONS] +=
                        weight * row_part * column_part * part;
                }
            }
        }
    }
}

fn normalise(histogram: &mut Descriptor) {
    let length = histogram.iter().map(|v| v * v).sum::<f32>().sqrt().max(f32::MIN_POSITIVE);
    histogram.iter_mut().for_each(|v| *v /= length);
}
