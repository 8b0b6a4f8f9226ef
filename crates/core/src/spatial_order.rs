//! An order in which neighbours in space are neighbours in memory.

use glam::Vec3;

/// Bits of a cell's number along each axis.
const BITS: u32 = 21;

/// Indices of `points` (m) along a Z-order curve through their bounding box (Morton 1966); points in one cell keep their
/// order. Every point comes once, also those that are not finite. Neighbours in this order are neighbours in space,
/// so that tiles, nodes of k-d trees and cache lines are reused.
pub fn spatial_order(points: &[[f32; 3]]) -> Vec<usize> {
    let finite = || points.iter().map(|&p| Vec3::from(p)).filter(|p| p.is_finite());
    let low = finite().fold(Vec3::INFINITY, Vec3::min).as_dvec3();
    let high = finite().fold(Vec3::NEG_INFINITY, Vec3::max).as_dvec3();
    // One scale for all axes: cells are cubes.
    let scale = f64::from((1_u32 << BITS) - 1) / (high - low).max_element();
    let code = |&i: &usize| {
        let cell = (Vec3::from(points[i]).as_dvec3() - low) * scale;
        // A number that is not finite becomes 0 or the largest; where all points are one, the scale is infinite.
        (0..3).map(|axis| spread(cell[axis] as u64) << axis).sum::<u64>()
    };
    let mut order: Vec<usize> = (0..points.len()).collect();
    order.sort_by_cached_key(code);
    order
}

/// Two zero bits between each of the [`BITS`] lowest.
fn spread(cell: u64) -> u64 {
    let mut x = cell & ((1 << BITS) - 1);
    x = (x | x << 32) & 0x001f_0000_0000_ffff;
    x = (x | x << 16) & 0x001f_0000_ff00_00ff;
    x = (x | x << 8) & 0x100f_00f0_0f00_f00f;
    x = (x | x << 4) & 0x10c3_0c30_c30c_30c3;
    (x | x << 2) & 0x1249_2492_4924_9249
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bits_are_interleaved() {
        for cell in [0, 1, 2, 0b1011, 0x1f_ffff, 0x15_5aa3] {
            let expected = (0..u64::from(BITS)).map(|b| (cell >> b & 1) << (3 * b)).sum::<u64>();
            assert_eq!(spread(cell), expected);
        }
    }

    #[test]
    fn a_shuffled_grid_comes_out_cell_by_cell() {
        let at = |k: usize| (k % 8) as f32;
        // 8 x 8 x 8 points, shuffled by a stride that shares no factor with their number.
        let points: Vec<[f32; 3]> =
            (0..512).map(|i| i * 131 % 512).map(|k| [at(k), at(k / 8), at(k / 64)]).collect();
        let order = spatial_order(&points);
        // Every aligned cube of 2, 4 and 8 is contiguous.
        for side in [2, 4, 8_usize] {
            for run in order.chunks(side * side * side) {
                let cube = |&i: &usize| points[i].map(|v| v as usize / side);
                assert!(run.iter().all(|i| cube(i) == cube(&run[0])), "cubes of {side}");
            }
        }
    }

    #[test]
    fn every_point_comes_once_whatever_it_is() {
        let odd =
            [[1.0, 2.0, 3.0], [f32::NAN; 3], [1.0, 2.0, 3.0], [f32::INFINITY, 0.0, 0.0], [1e30, -1e30, 0.0]];
        for points in [&odd[..], &odd[..1], &odd[1..2], &[], &[[5.0; 3]; 4]] {
            let mut order = spatial_order(points);
            order.sort_unstable();
            assert!(order.into_iter().eq(0..points.len()));
        }
        assert_eq!(spatial_order(&[[5.0; 3]; 4]), [0, 1, 2, 3]);
    }
}
