//! Upright SIFT descriptors (Lowe, IJCV 2004, section 6) of a fixed scale.

use crate::pyramid::Level;
use ffgs_core::kernel::{Kernel, dispatch, fma};
use std::f32::consts::{FRAC_PI_2, PI, TAU};
use std::sync::LazyLock;

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

/// The two nearest cells of every pixel along a side, and what they get of it; nothing where a cell lies outside.
static SHARES: LazyLock<[[(usize, f32); 2]; SIDE]> = LazyLock::new(|| std::array::from_fn(shares));

fn shares(pixel: usize) -> [(usize, f32); 2] {
    let place = (pixel as f32 + 0.5) / CELL_PX as f32 - 0.5;
    let from_middle = (pixel as f32 - (SIDE as f32 - 1.0) / 2.0) / SIDE as f32;
    let bell = (-2.0 * from_middle * from_middle).exp();
    let share = |cell: f32, part: f32| {
        let inside = cell >= 0.0 && cell < CELLS as f32;
        if inside { (cell as usize, part * bell) } else { (0, 0.0) }
    };
    let part = place - place.floor();
    [share(place.floor(), 1.0 - part), share(place.floor() + 1.0, part)]
}

/// The descriptor of the 16 x 16 pixels around a position of the level.
pub(crate) fn describe(level: &Level, at: [f32; 2]) -> Descriptor {
    let half = (SIDE / 2) as isize;
    let clamp = |v: f32, n: usize| (v as isize).clamp(-1, n as isize);
    let (column, row) = (clamp(at[0], level.size.width), clamp(at[1], level.size.height));
    let (mut histogram, shares) = ([0.0; ENTRIES], &*SHARES);
    for y in 0..SIDE {
        let start = level.index(column - half, row - half + y as isize);
        let [lengths, turns] = dispatch(Polar { dx: &level.dx[start..], dy: &level.dy[start..] });
        for (x, (length, turn)) in lengths.into_iter().zip(turns).enumerate() {
            add(&mut histogram, shares[x], shares[y], length, turn);
        }
    }
    normalise(&mut histogram);
    histogram.iter_mut().for_each(|v| *v = v.min(CAP));
    normalise(&mut histogram);
    histogram
}

/// Spreads a gradient over the two nearest orientations and the four nearest cells.
fn add(
    histogram: &mut Descriptor,
    columns: [(usize, f32); 2],
    rows: [(usize, f32); 2],
    length: f32,
    turn: f32,
) {
    let first = turn as usize;
    let part = turn - first as f32;
    let (now, next) = (first % ORIENTATIONS, (first + 1) % ORIENTATIONS);
    for (row, row_share) in rows {
        for (column, column_share) in columns {
            let cell = &mut histogram[(row * CELLS + column) * ORIENTATIONS..][..ORIENTATIONS];
            let weight = length * row_share * column_share;
            cell[now] += weight * (1.0 - part);
            cell[next] += weight * part;
        }
    }
}

/// Lengths of a row of gradients, and their directions in steps of an orientation, 0 to 8.
struct Polar<'a> {
    dx: &'a [f32],
    dy: &'a [f32],
}

impl Kernel for Polar<'_> {
    type Output = [[f32; SIDE]; 2];

    #[inline(always)]
    fn run<const FMA: bool>(self) -> Self::Output {
        let (dx, dy) = (&self.dx[..SIDE], &self.dy[..SIDE]);
        let (mut lengths, mut turns) = ([0.0; SIDE], [0.0; SIDE]);
        for i in 0..SIDE {
            lengths[i] = fma::<FMA>(dx[i], dx[i], dy[i] * dy[i]).sqrt();
            let angle = angle::<FMA>(dx[i], dy[i]);
            turns[i] = angle * (ORIENTATIONS as f32 / TAU);
        }
        [lengths, turns]
    }
}

/// The angle of a vector, 0 to 2 pi, to 1e-5: Hastings' polynomial ("Approximations for digital computers", 1955, sheet 13)
/// on the first octant, because a library call would keep the loop from becoming vectors.
#[inline(always)]
fn angle<const FMA: bool>(x: f32, y: f32) -> f32 {
    const TERMS: [f32; 6] =
        [-0.011_721_2, 0.052_653_32, -0.116_432_87, 0.193_543_46, -0.332_623_47, 0.999_977_26];
    let (width, height) = (x.abs(), y.abs());
    let slope = width.min(height) / width.max(height).max(f32::MIN_POSITIVE);
    let mut value = 0.0;
    for term in TERMS {
        value = fma::<FMA>(value, slope * slope, term);
    }
    value *= slope;
    value = if height > width { FRAC_PI_2 - value } else { value };
    value = if x < 0.0 { PI - value } else { value };
    if y < 0.0 { TAU - value } else { value }
}

fn normalise(histogram: &mut Descriptor) {
    let length = histogram.iter().map(|v| v * v).sum::<f32>().sqrt().max(f32::MIN_POSITIVE);
    histogram.iter_mut().for_each(|v| *v /= length);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn angles_are_those_of_the_library() {
        for i in 0..720 {
            let wanted = f64::from(i) * std::f64::consts::PI / 360.0 + 1e-3;
            let (x, y) = ((3.0 * wanted.cos()) as f32, (3.0 * wanted.sin()) as f32);
            for found in [angle::<true>(x, y), angle::<false>(x, y)] {
                assert!((f64::from(found) - wanted).abs() < 2e-5, "{wanted} {found}");
            }
        }
        assert_eq!(angle::<false>(0.0, 0.0), 0.0);
    }
}
