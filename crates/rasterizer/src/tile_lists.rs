//! The depth-ordered list of every tile.
//!
//! Splats come in the order of their Gaussians. One pass counts them by tile while the next ones are projected, a second
//! bins them to their tiles, and each tile sorts its own list, which fits a cache and needs no other thread.

use crate::projection::Splat;
use crate::tiles::{Span, TileGrid, TileMask, for_each_tile};

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
#[derive(Clone, Debug, Default)]
pub(crate) struct TileLists {
    /// Tile `t` owns entries `starts[t]..starts[t + 1]`.
    pub(crate) starts: Vec<u32>,
    /// Entries front to back, tile by tile; their places count from the tile's start.
    pub(crate) slots: Vec<Entry>,
    /// Splat `s` owns `entry_starts[s]..entry_starts[s + 1]` of `entries`.
    pub(crate) entry_starts: Vec<u32>,
    /// Places of each splat in the lists of its tiles, in the order of its spans.
    pub(crate) entries: Vec<u32>,
    /// Splat at each place.
    splat_of: Vec<u32>,
    cursors: Vec<u32>,
}

impl TileLists {
    /// Number of (tile, splat) entries.
    pub(crate) fn len(&self) -> usize {
        self.slots.len()
    }

    /// Forgets all splats.
    pub(crate) fn begin(&mut self, grid: TileGrid) {
        self.starts.clear();
        self.starts.resize(grid.count() + 1, 0);
        self.entry_starts.clear();
        self.entry_starts.push(0);
    }

    /// Counts the next splat, given its spans.
    #[inline(always)]
    pub(crate) fn count(&mut self, spans: &[Span], grid: TileGrid, mask: Option<&TileMask>) {
        let mut total = self.entry_starts[self.entry_starts.len() - 1];
        for_each_tile(spans, grid, mask, |tile| {
            self.starts[tile + 1] += 1;
            total += 1;
        });
        self.entry_starts.push(total);
    }

    /// Bins the splats that were counted, and sorts every tile by depth.
    pub(crate) fn finish(
        &mut self,
        splats: &[Splat],
        spans: &[Span],
        grid: TileGrid,
        mask: Option<&TileMask>,
    ) {
        for tile in 0..grid.count() {
            self.starts[tile + 1] += self.starts[tile];
        }
        self.bin(splats, spans, grid, mask);
        let Self { starts, slots, splat_of, .. } = self;
        for_each_tile_slice(starts, slots, &|tile, list| {
            list.sort_unstable();
            let first = starts[tile];
            for entry in list {
                let place = entry.place() as u32;
                *entry = Entry::new(splat_of[place as usize], place - first);
            }
        });
    }

    fn bin(&mut self, splats: &[Splat], spans: &[Span], grid: TileGrid, mask: Option<&TileMask>) {
        let total = self.starts[grid.count()] as usize;
        self.slots.resize(total, Entry::default());
        self.splat_of.resize(total, 0);
        self.entries.resize(total, 0);
        self.cursors.clear();
        self.cursors.extend_from_slice(&self.starts[..grid.count()]);
        let mut rank = 0;
        for (slot, splat) in splats.iter().enumerate() {
            let (start, count) = (splat.spans.0 as usize, splat.spans.1 as usize);
            for_each_tile(&spans[start..start + count], grid, mask, |tile| {
                let place = self.cursors[tile];
                self.cursors[tile] += 1;
                // Depths are positive: their bits compare as they do.
                self.slots[place as usize] = Entry::new(splat.depth.to_bits(), place);
                self.splat_of[place as usize] = slot as u32;
                self.entries[rank] = place;
                rank += 1;
            });
        }
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
    fn scattered(grid: TileGrid, lists: &mut TileLists) -> (Vec<Splat>, Vec<Span>) {
        let (mut splats, mut spans) = (Vec::new(), Vec::new());
        lists.begin(grid);
        for i in 0..500_u32 {
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
            let first = spans.len();
            assert!(cover(&mut splat, &extent, grid, None, &mut spans));
            lists.count(&spans[first..], grid, None);
            splats.push(splat);
        }
        (splats, spans)
    }

    #[test]
    fn lists_run_front_to_back_and_every_splat_finds_its_places() {
        let grid = TileGrid::new(ImageSize { width: 160, height: 96 });
        let mut lists = TileLists::default();
        let (splats, spans) = scattered(grid, &mut lists);
        lists.finish(&splats, &spans, grid, None);
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
