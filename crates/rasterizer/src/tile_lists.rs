//! The depth-ordered list of every tile.
//!
//! Splats come in the order of their Gaussians and are binned in parts. A first pass counts the splats of each part by tile, which
//! gives every part places of its own in every list; a second writes them there. Then each tile sorts its list, which fits a cache
//! and needs no other thread. The lists do not depend on how many parts there are.

use crate::projection::Splat;
use crate::tiles::{Span, TileGrid, TileMask, for_each_tile};
use rayon::prelude::*;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

/// Parts per thread: enough to share out evenly.
const PARTS_PER_THREAD: usize = 4;
/// Splats below which a part costs more than it gains.
const LEAST_PART: usize = 2048;

/// One splat in a tile's list. Until the list is sorted it holds depth and place: among splats of one depth, the order
/// of the Gaussians decides.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Entry(u64);

impl Entry {
    fn new(high: u32, low: u32) -> Self {
        Self(u64::from(high) << 32 | u64::from(low))
    }

    /// Which splat.
    #[inline(always)]
    pub(crate) fn slot(self) -> usize {
        (self.0 >> 32) as usize
    }

    /// Its place in the tile's list before sorting: where sums over the tile's pixels are kept.
    #[inline(always)]
    pub(crate) fn place(self) -> usize {
        (self.0 & u64::from(u32::MAX)) as usize
    }
}

/// Depth-ordered splat lists of all tiles.
#[derive(Debug, Default)]
pub(crate) struct TileLists {
    /// Tile `t` owns entries `starts[t]..starts[t + 1]`.
    pub(crate) starts: Vec<u32>,
    /// Entries front to back, tile by tile; their places count from the tile's start.
    pub(crate) slots: Vec<Entry>,
    /// Splat `s` owns `entry_starts[s]..entry_starts[s + 1]` of `entries`.
    pub(crate) entry_starts: Vec<u32>,
    /// Places of each splat in the lists of its tiles, in the order of its spans.
    pub(crate) entries: Vec<u32>,
    /// Depth and splat at each place. No two threads write to one place, which the compiler cannot know.
    binned: Vec<AtomicU64>,
    parts: Vec<Part>,
}

/// Consecutive splats that one thread bins.
#[derive(Debug, Default)]
struct Part {
    /// Number of its splats in every tile; then the place of the next one there.
    cursors: Vec<u32>,
    /// Number of its entries.
    total: u32,
}

impl TileLists {
    /// Number of (tile, splat) entries.
    pub(crate) fn len(&self) -> usize {
        self.slots.len()
    }

    /// Bins splats to the computed tiles among their `spans`, and sorts every tile by depth.
    pub(crate) fn build(
        &mut self,
        splats: &[Splat],
        spans: &[Span],
        grid: TileGrid,
        mask: Option<&TileMask>,
    ) {
        let tiling = Tiling { spans, grid, mask };
        let size = splats.len().div_ceil(PARTS_PER_THREAD * rayon::current_num_threads()).max(LEAST_PART);
        self.count(splats, size, tiling);
        self.assign_places(grid);
        self.place(splats, size, tiling);
        self.sort();
    }

    /// Counts the splats of every part by tile; `entry_starts` count from the part's first entry.
    fn count(&mut self, splats: &[Splat], size: usize, tiling: Tiling) {
        let Self { entry_starts, parts, .. } = self;
        parts.resize_with(splats.len().div_ceil(size), Part::default);
        entry_starts.clear();
        entry_starts.resize(splats.len() + 1, 0);
        let starts = entry_starts[..splats.len()].par_chunks_mut(size);
        parts.par_iter_mut().zip(splats.par_chunks(size)).zip(starts).for_each(|((part, splats), starts)| {
            let Part { cursors, total } = part;
            cursors.clear();
            cursors.resize(tiling.grid.count(), 0);
            *total = 0;
            for (splat, start) in splats.iter().zip(starts) {
                *start = *total;
                tiling.for_each_tile(splat, |tile| {
                    cursors[tile] += 1;
                    *total += 1;
                });
            }
        });
    }

    /// Where every tile starts, and where every part starts within it.
    fn assign_places(&mut self, grid: TileGrid) {
        self.starts.clear();
        let mut next = 0;
        for tile in 0..grid.count() {
            self.starts.push(next);
            for part in &mut self.parts {
                next += std::mem::replace(&mut part.cursors[tile], next);
            }
        }
        self.starts.push(next);
    }

    /// Writes every splat to its places.
    fn place(&mut self, splats: &[Splat], size: usize, tiling: Tiling) {
        let Self { starts, slots, entry_starts, entries, binned, parts } = self;
        let total = starts[tiling.grid.count()];
        slots.resize(total as usize, Entry::default());
        entries.resize(total as usize, 0);
        binned.resize_with(total as usize, AtomicU64::default);
        entry_starts[splats.len()] = total;
        let (mut first, mut rest) = (0, &mut entries[..]);
        let mut share = |part: &Part| {
            let own = rest.split_off_mut(..part.total as usize).unwrap_or_default();
            first += part.total;
            (first - part.total, own)
        };
        let shares: Vec<_> = parts.iter().map(&mut share).collect();
        let starts = entry_starts[..splats.len()].par_chunks_mut(size);
        let parts = parts.par_iter_mut().zip(splats.par_chunks(size)).zip(starts).zip(shares).enumerate();
        parts.for_each(|(number, (((part, splats), starts), (first, entries)))| {
            let mut entries = entries.iter_mut();
            for (k, (splat, start)) in splats.iter().zip(starts).enumerate() {
                *start += first;
                // Depths are positive: their bits compare as they do.
                let value = Entry::new(splat.depth.to_bits(), (number * size + k) as u32).0;
                tiling.for_each_tile(splat, |tile| {
                    let place = &mut part.cursors[tile];
                    binned[*place as usize].store(value, Relaxed);
                    if let Some(entry) = entries.next() {
                        *entry = *place;
                    }
                    *place += 1;
                });
            }
        });
    }

    /// Sorts every tile: among splats of one depth, the order of the Gaussians decides.
    fn sort(&mut self) {
        let Self { starts, slots, binned, .. } = self;
        for_each_tile_slice(starts, slots, &|tile, list| {
            let binned = &binned[starts[tile] as usize..starts[tile + 1] as usize];
            let (depth, slot) = (|v: u64| (v >> 32) as u32, |v: u64| v as u32);
            for (place, entry) in list.iter_mut().enumerate() {
                *entry = Entry::new(depth(binned[place].load(Relaxed)), place as u32);
            }
            list.sort_unstable();
            for entry in list {
                let place = entry.place();
                *entry = Entry::new(slot(binned[place].load(Relaxed)), place as u32);
            }
        });
    }
}

/// Which tiles splats are binned to.
#[derive(Clone, Copy)]
struct Tiling<'a> {
    spans: &'a [Span],
    grid: TileGrid,
    mask: Option<&'a TileMask>,
}

impl Tiling<'_> {
    #[inline(always)]
    fn for_each_tile(self, splat: &Splat, visit: impl FnMut(usize)) {
        let (start, count) = (splat.spans.0 as usize, splat.spans.1 as usize);
        for_each_tile(&self.spans[start..start + count], self.grid, self.mask, visit);
    }
}

/// Runs `f(tile, its slice of values)` in parallel without allocating: halves the tile range recursively.
pub(crate) fn for_each_tile_slice<T: Send>(
    starts: &[u32],
    values: &mut [T],
    f: &(impl Fn(usize, &mut [T]) + Sync),
) {
    fn recurse<T: Send>(
        starts: &[u32],
        first: usize,
        values: &mut [T],
        f: &(impl Fn(usize, &mut [T]) + Sync),
    ) {
        let tiles = starts.len() - 1;
        if tiles == 1 {
            return f(first, values);
        }
        let middle = tiles / 2;
        let (left, right) = values.split_at_mut((starts[middle] - starts[0]) as usize);
        rayon::join(
            || recurse(&starts[..=middle], first, left, f),
            || recurse(&starts[middle..], first + middle, right, f),
        );
    }
    if starts.len() > 1 {
        recurse(starts, 0, values, f);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::coverage::cover;
    use crate::projection::Extent;
    use ffgs_core::ImageSize;

    /// Round splats of radius 20 px at scattered places; few depths, so that many are equal.
    fn scattered(grid: TileGrid, number: u32) -> (Vec<Splat>, Vec<Span>) {
        let (mut splats, mut spans) = (Vec::new(), Vec::new());
        for i in 0..number {
            let at = |k: u32| (i.wrapping_mul(2_654_435_761).wrapping_add(k) >> 7) % 160;
            let mut splat = Splat {
                mean: [at(0) as f32, at(99_991) as f32 * 0.6],
                conic: [0.01, 0.0, 0.01],
                depth: 1.0 + (i * 7 % 5) as f32,
                reach: 2.0,
                half_height: 20.0,
                shrink: 1.0,
                ..Splat::default()
            };
            let extent = Extent { covariance: [100.0, 0.0], half_width: 20.0 };
            assert!(cover(&mut splat, &extent, grid, None, &mut spans));
            splats.push(splat);
        }
        (splats, spans)
    }

    #[test]
    fn lists_run_front_to_back_and_every_splat_finds_its_places() {
        let grid = TileGrid::new(ImageSize { width: 160, height: 96 });
        let mut lists = TileLists::default();
        // The second time in several parts, in the memory of the first.
        for number in [500, 3 * LEAST_PART as u32 + 7] {
            let (splats, spans) = scattered(grid, number);
            lists.build(&splats, &spans, grid, None);
            check(&lists, &splats, &spans, grid);
        }
        assert!(lists.parts.len() > 1);
    }

    fn check(lists: &TileLists, splats: &[Splat], spans: &[Span], grid: TileGrid) {
        let mut at_place = vec![usize::MAX; lists.len()];
        for tile in 0..grid.count() {
            let (start, end) = (lists.starts[tile] as usize, lists.starts[tile + 1] as usize);
            let list = &lists.slots[start..end];
            let key = |e: &Entry| (splats[e.slot()].depth.to_bits(), e.slot());
            assert!(list.windows(2).all(|pair| key(&pair[0]) < key(&pair[1])), "tile {tile}");
            list.iter().for_each(|e| at_place[start + e.place()] = e.slot());
        }
        for (slot, splat) in splats.iter().enumerate() {
            let places = lists.entry_starts[slot] as usize..lists.entry_starts[slot + 1] as usize;
            let mut expected = Vec::new();
            let owned = &spans[splat.spans.0 as usize..(splat.spans.0 + splat.spans.1) as usize];
            for_each_tile(owned, grid, None, |tile| expected.push(tile));
            assert_eq!(places.len(), expected.len());
            for (&place, tile) in lists.entries[places].iter().zip(expected) {
                assert_eq!(at_place[place as usize], slot);
                assert!((lists.starts[tile]..lists.starts[tile + 1]).contains(&place));
            }
        }
    }
}
