//! Connected regions of masks.

use ffgs_core::{ImageSize, Mask, connected};

/// The surroundings of a mask reach as far as this share of the image's diagonal.
const REACH: f64 = 0.05;

/// A distance in the image over which masks may be wrong: 0.6 % of its diagonal, at least 2 px.
pub(crate) fn radius(size: ImageSize) -> usize {
    ((size.width as f64).hypot(size.height as f64) * 0.006).round().max(2.0) as usize
}

/// A mask and what is around it.
pub(crate) fn surroundings(mask: &Mask) -> Mask {
    let ImageSize { width, height } = mask.size();
    mask.dilated(((width as f64).hypot(height as f64) * REACH).round() as usize)
}

/// The regions of a mask (4-neighbours) that have a pixel for which `touches` holds.
pub(crate) fn touched_by(mask: &Mask, touches: impl Fn(usize) -> bool) -> Mask {
    kept(mask, 1, |region| region.iter().any(|&i| touches(i)))
}

/// The mask with holes up to a part of the image filled, and without regions smaller than a part of it.
pub(crate) fn without_specks(mask: &Mask, speck: f64, hole: f64) -> Mask {
    let pixels = mask.size().pixels() as f64;
    let without_holes = kept(mask, 0, |region| region.len() as f64 > hole * pixels);
    kept(&without_holes, 1, |region| region.len() as f64 > speck * pixels)
}

/// The mask with holes filled that are at most a part of the image and mostly `possible`.
pub(crate) fn filled(mask: &Mask, hole: f64, possible: &Mask) -> Mask {
    let largest = hole * mask.size().pixels() as f64;
    let inside = |region: &[usize]| region.iter().filter(|&&i| possible.data()[i] == 1).count();
    kept(mask, 0, |region| region.len() as f64 > largest || 2 * inside(region) <= region.len())
}

/// The mask with the regions of `value` that `keep` refuses turned over.
fn kept(mask: &Mask, value: u8, keep: impl Fn(&[usize]) -> bool) -> Mask {
    let size = mask.size();
    let mut data = mask.data().to_vec();
    let mut seen = vec![false; data.len()];
    for start in 0..data.len() {
        if !seen[start] && mask.data()[start] == value {
            let same = |_, i: usize| mask.data()[i] == value;
            let region = connected(start, size.width, &mut seen, same);
            if !keep(&region) {
                region.iter().for_each(|&i| data[i] = 1 - value);
            }
        }
    }
    Mask::new(size, data).expect("the length is that of the mask")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mask(rows: [&str; 5]) -> Mask {
        let data = rows.iter().flat_map(|r| r.bytes().map(|b| u8::from(b == b'#'))).collect();
        Mask::new(ImageSize { width: rows[0].len(), height: 5 }, data).unwrap()
    }

    #[test]
    fn specks_go_and_holes_are_filled() {
        let found =
            without_specks(&mask(["####...", "#.##..#", "####...", ".......", "#......"]), 0.05, 0.05);
        assert_eq!(found, mask(["####...", "####...", "####...", ".......", "......."]));
    }

    #[test]
    fn larger_holes_are_filled_where_other_views_find_them_possible() {
        let ring = mask(["#####..", "#...#..", "#...#..", "#####..", "......."]);
        let full = mask(["#####..", "#####..", "#####..", "#####..", "......."]);
        let [most, few] =
            [".####..", "...#..."].map(|row| mask([".......", row, "..#....", ".......", "......."]));
        assert_eq!(filled(&ring, 0.2, &most), full);
        assert_eq!(filled(&ring, 0.2, &few), ring);
        assert_eq!(filled(&ring, 0.1, &most), ring, "too large");
    }

    #[test]
    fn a_region_stays_when_it_is_touched() {
        let two = mask(["##.....", "##..##.", "....##.", ".......", "......."]);
        assert_eq!(
            touched_by(&two, |i| i == 7 + 4),
            mask([".......", "....##.", "....##.", ".......", "......."])
        );
    }
}
