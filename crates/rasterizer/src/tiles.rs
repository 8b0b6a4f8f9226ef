//! Tiles of an image, and which of them are computed.

use crate::constants::TILE;
use ffgs_core::{ImageSize, Mask};
use std::ops::{Range, RangeInclusive};

/// Which tiles of a view to compute.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TileMask {
    columns: usize,
    active: Vec<bool>,
}

impl TileMask {
    /// Tiles that hold at least one foreground pixel.
    pub fn covering(mask: &Mask) -> Self {
        let grid = TileGrid::new(mask.size());
        let mut active = vec![false; grid.count()];
        for (y, row) in mask.data().chunks(mask.size().width).enumerate() {
            let tiles = &mut active[y / TILE * grid.columns..][..grid.columns];
            for (tile, pixels) in tiles.iter_mut().zip(row.chunks(TILE)) {
                *tile |= pixels.iter().fold(0, |any, pixel| any | pixel) != 0;
            }
        }
        Self { columns: grid.columns, active }
    }

    /// Whether a tile is computed, tiles counted row by row.
    pub fn is_active(&self, tile: usize) -> bool {
        self.active[tile]
    }

    /// Number of active tiles.
    pub fn count(&self) -> usize {
        self.active.iter().filter(|&&a| a).count()
    }

    /// Pixels of the active tiles of an image of this size, as row-major ranges in ascending order.
    pub fn pixel_runs(&self, size: ImageSize) -> Vec<Range<usize>> {
        let mut runs: Vec<Range<usize>> = Vec::new();
        for y in 0..size.height {
            for column in (0..self.columns).filter(|c| self.active[y / TILE * self.columns + c]) {
                let first = y * size.width + column * TILE;
                let end = y * size.width + (column * TILE + TILE).min(size.width);
                match runs.last_mut() {
                    Some(run) if run.end == first => run.end = end,
                    _ => runs.push(first..end),
                }
            }
        }
        runs
    }

    /// Whether any tile in these rows and columns is computed.
    pub(crate) fn any_in(&self, rows: RangeInclusive<i32>, columns: &RangeInclusive<i32>) -> bool {
        // A range left of the image ends at column -1.
        let (first, end) = (*columns.start() as u32, (*columns.end() + 1) as u32);
        !columns.is_empty() && { rows }.any(|row| self.any(Span { row: row as u32, first, end }))
    }

    /// Whether any of these tiles is computed.
    pub(crate) fn any(&self, span: Span) -> bool {
        let row = span.row as usize * self.columns;
        self.active[row + span.first as usize..row + span.end as usize].iter().any(|&a| a)
    }
}

/// The tiles of an image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct TileGrid {
    pub(crate) columns: usize,
    pub(crate) rows: usize,
}

impl TileGrid {
    pub(crate) fn new(size: ImageSize) -> Self {
        Self { columns: size.width.div_ceil(TILE), rows: size.height.div_ceil(TILE) }
    }

    pub(crate) fn count(self) -> usize {
        self.columns * self.rows
    }

    /// First pixel of a tile.
    pub(crate) fn origin(self, tile: usize) -> [usize; 2] {
        [tile % self.columns * TILE, tile / self.columns * TILE]
    }
}

/// Tiles `first..end` of one tile row.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Span {
    pub(crate) row: u32,
    pub(crate) first: u32,
    pub(crate) end: u32,
}

/// First and last of `count` tiles with a pixel centre in `low..=high` (px); the first comes after the last if none.
#[inline(always)]
pub(crate) fn tile_range(low: f32, high: f32, count: usize) -> (i32, i32) {
    const SHARE: f32 = 1.0 / TILE as f32;
    let at = |v: f32| ((v - 0.5) * SHARE).max(-1.0).min(count as f32).floor() as i32;
    (at(low).max(0), at(high).min(count as i32 - 1))
}

/// Calls `visit(tile)` for the computed tiles of some spans, in their order.
#[inline(always)]
pub(crate) fn for_each_tile(
    spans: &[Span],
    grid: TileGrid,
    mask: Option<&TileMask>,
    mut visit: impl FnMut(usize),
) {
    for span in spans {
        let row = span.row as usize * grid.columns;
        for tile in row + span.first as usize..row + span.end as usize {
            if mask.is_none_or(|m| m.active[tile]) {
                visit(tile);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixel_runs_are_the_active_tiles() {
        let size = ImageSize { width: 40, height: 20 };
        let mut data = vec![0; size.pixels()];
        data[3 * 40 + 20] = 1;
        data[18 * 40 + 35] = 1;
        let mask = TileMask::covering(&Mask::new(size, data).unwrap());
        let mut covered = vec![0; size.pixels()];
        mask.pixel_runs(size).into_iter().flatten().for_each(|p| covered[p] += 1);
        for (p, &count) in covered.iter().enumerate() {
            let tile = p / 40 / TILE * 3 + p % 40 / TILE;
            assert_eq!(count, usize::from(mask.is_active(tile)), "pixel {p}");
        }
    }

    #[test]
    fn a_range_beside_the_image_holds_no_tile() {
        let size = ImageSize { width: 40, height: 20 };
        let mask = TileMask::covering(&Mask::new(size, vec![1; size.pixels()]).unwrap());
        for (low, high) in [(-9.0, 0.25), (-9.0, -3.0), (60.0, 70.0)] {
            let (first, last) = tile_range(low, high, 3);
            assert!(!mask.any_in(0..=1, &(first..=last)), "{low} {high}");
        }
        assert!(mask.any_in(0..=1, &(2..=2)));
    }
}
