//! Connected regions of masks.

use ffgs_core::{ImageSize, Mask};
use std::collections::BTreeMap;
use std::ops::Range;

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
    kept(mask, 1, |region| region.pixels().any(&touches))
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
    let inside = |region: &Region| region.pixels().filter(|&i| possible.data()[i] == 1).count();
    kept(mask, 0, |region| region.len() as f64 > largest || 2 * inside(region) <= region.len())
}

/// The mask with the holes filled, of any size and also at the border, for whose pixels `fills` holds.
pub(crate) fn filled_where(mask: &Mask, fills: impl Fn(&mut dyn Iterator<Item = usize>) -> bool) -> Mask {
    kept(mask, 0, |region| !fills(&mut region.pixels()))
}

/// The mask with the regions of `value` that `keep` refuses turned over.
fn kept(mask: &Mask, value: u8, keep: impl Fn(&Region) -> bool) -> Mask {
    let mut data = mask.data().to_vec();
    for region in regions(mask, value).iter().filter(|region| !keep(region)) {
        region.0.iter().for_each(|run| data[run.clone()].fill(1 - value));
    }
    Mask::new(mask.size(), data).expect("the length is that of the mask")
}

/// Connected pixels of one value, as runs of them within rows.
#[derive(Default)]
struct Region(Vec<Range<usize>>);

impl Region {
    fn len(&self) -> usize {
        self.0.iter().map(Range::len).sum()
    }

    fn pixels(&self) -> impl Iterator<Item = usize> {
        self.0.iter().flat_map(Range::clone)
    }
}

/// The regions (4-neighbours) of a value. Runs that lie below each other are one region.
fn regions(mask: &Mask, value: u8) -> Vec<Region> {
    let width = mask.size().width;
    let mut runs: Vec<Range<usize>> = Vec::new();
    let mut sets = Sets::default();
    let mut above = 0..0;
    for (y, row) in mask.data().chunks_exact(width).enumerate() {
        let first = runs.len();
        runs.extend(runs_of(row, value).map(|run| y * width + run.start..y * width + run.end));
        sets.grow(runs.len());
        for run in first..runs.len() {
            let is_left = |other: &Range<usize>| other.end + width <= runs[run].start;
            above.start += runs[above.clone()].iter().take_while(|other| is_left(other)).count();
            let below = runs[above.clone()].iter().take_while(|other| other.start + width < runs[run].end);
            (above.start..).zip(below).for_each(|(other, _)| sets.join(other, run));
        }
        above = first..runs.len();
    }
    let mut found: BTreeMap<usize, Region> = BTreeMap::new();
    for (at, run) in runs.into_iter().enumerate() {
        found.entry(sets.root(at)).or_default().0.push(run);
    }
    found.into_values().collect()
}

/// The runs of a value in a row.
fn runs_of(row: &[u8], value: u8) -> impl Iterator<Item = Range<usize>> {
    let mut at = 0;
    row.chunk_by(|a, b| a == b).filter_map(move |run| {
        at += run.len();
        (run[0] == value).then(|| at - run.len()..at)
    })
}

/// Disjoint sets, each with its least member as root.
#[derive(Default)]
struct Sets(Vec<usize>);

impl Sets {
    fn grow(&mut self, len: usize) {
        self.0.extend(self.0.len()..len);
    }

    fn root(&mut self, mut at: usize) -> usize {
        while self.0[at] != at {
            self.0[at] = self.0[self.0[at]];
            at = self.0[at];
        }
        at
    }

    fn join(&mut self, a: usize, b: usize) {
        let (a, b) = (self.root(a), self.root(b));
        self.0[a.max(b)] = a.min(b);
    }
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

    /// The regions are those that a search from pixel to pixel finds.
    #[test]
    fn runs_that_touch_are_one_region() {
        for (width, height, seed) in [(40, 30, 1), (7, 50, 2), (1, 9, 3), (9, 1, 4), (64, 64, 5)] {
            let size = ImageSize { width, height };
            let value = |i: usize| u8::from((i + seed * 7919).wrapping_mul(2_654_435_761) >> 9 & 255 < 140);
            let mask = Mask::new(size, (0..size.pixels()).map(value).collect()).unwrap();
            for value in [0, 1] {
                let mut seen = vec![false; size.pixels()];
                let mut searched = Vec::new();
                for start in (0..size.pixels()).filter(|&i| mask.data()[i] == value) {
                    if !seen[start] {
                        let same = |_, i: usize| mask.data()[i] == value;
                        let mut region = ffgs_core::connected(start, width, &mut seen, same);
                        region.sort_unstable();
                        searched.push(region);
                    }
                }
                let found: Vec<Vec<usize>> =
                    regions(&mask, value).iter().map(|region| region.pixels().collect()).collect();
                assert_eq!(found, searched, "{size:?}, {value}");
            }
        }
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
