//! Sums over the pixels that a Gaussian covers.

use crate::blend::{Contribution, TilePlane, Visitor, walk};
use crate::chunks::ChunkBounds;
use crate::constants::{AREA, MIN_TRANSMITTANCE};
use crate::cpu::CpuRasterizer;
use crate::projection::Splat;
use crate::tape::{RenderTape, for_each_row};
use crate::tile_lists::{Entry, for_each_tile_slice};
use crate::tiles::TileGrid;
use crate::top_contributors::Heaviest;
use crate::view::View;
use ffgs_core::{Gaussians, ImageSize, instructions};
use pulp::{Simd, WithSimd};
use std::ops::Range;

/// Sums per Gaussian of `alpha T` times per-pixel channels: the transpose of blending.
#[derive(Clone, Debug, Default)]
pub struct FootprintSums {
    channels: usize,
    sums: Vec<f32>,
    hits: Vec<u32>,
    by_entry: EntrySums,
}

impl FootprintSums {
    /// (channels) sums of Gaussian `i`.
    pub fn of(&self, i: usize) -> &[f32] {
        &self.sums[i * self.channels..(i + 1) * self.channels]
    }

    /// Pixels where Gaussian `i` contributes and the first channel is not zero.
    pub fn hits(&self, i: usize) -> u32 {
        self.hits[i]
    }
}

/// What is summed under footprints.
pub(crate) trait PixelChannels: Sync {
    /// Number of channels.
    fn count(&self) -> usize;

    /// Transmittance at which a pixel is finished.
    fn finished(&self) -> f32 {
        MIN_TRANSMITTANCE
    }

    /// Contributions of each pixel that are summed, the heaviest; 0 = all.
    fn contributors(&self) -> usize {
        0
    }

    /// Writes the channels of a run of `pixels`, counted row by row, into the planes (a channel each) from `local` on, and
    /// 1 into `open` where a pixel counts. Where it does not it adds to no sum, and nothing is blended there: planes
    /// and `open` stay 0.
    fn gather(&self, pixels: Range<usize>, local: usize, planes: &mut [TilePlane], open: &mut TilePlane);
}

impl PixelChannels for &[&[f32]] {
    fn count(&self) -> usize {
        self.len()
    }

    fn gather(&self, pixels: Range<usize>, local: usize, planes: &mut [TilePlane], open: &mut TilePlane) {
        let count = pixels.len();
        for (plane, channel) in planes.iter_mut().zip(*self) {
            plane.0[local..local + count].copy_from_slice(&channel[pixels.clone()]);
        }
        open.0[local..local + count].fill(1.0);
    }
}

impl CpuRasterizer {
    /// Renders `gaussians` and sums `alpha T * channel` per Gaussian over the pixels, for each row-major channel.
    pub fn accumulate(
        &self,
        gaussians: &Gaussians,
        view: &View,
        channels: &[&[f32]],
        tape: &mut RenderTape,
        out: &mut FootprintSums,
    ) {
        let (n, count) = (gaussians.len(), channels.len());
        let FootprintSums { channels: width, sums, hits, by_entry } = out;
        *width = count;
        sums.clear();
        sums.resize(n * count, 0.0);
        hits.clear();
        hits.resize(n, 0);
        self.sum_entries(
            &Summed { layers: &[gaussians], bounds: None, wanted: n },
            view,
            &channels,
            tape,
            by_entry,
        );
        by_entry.for_each(tape, n, |i, values, hit| {
            sums[i * count..(i + 1) * count].copy_from_slice(values);
            hits[i] = hit;
        });
    }

    /// Renders Gaussians and sums the channels per (tile, splat) entry.
    pub(crate) fn sum_entries(
        &self,
        summed: &Summed,
        view: &View,
        channels: &impl PixelChannels,
        tape: &mut RenderTape,
        out: &mut EntrySums,
    ) {
        let &Summed { layers, bounds, wanted } = summed;
        self.prepare_within(layers, bounds, view, tape);
        let (arch, size, width) = (instructions(), view.camera.size(), channels.count() + 1);
        let finished = channels.finished();
        let RenderTape { lists, splats, grid, .. } = tape;
        out.width = width;
        // Not cleared: each tile clears its own entries, while they are in its cache.
        out.values.resize(lists.len() * width, 0.0);
        let starts: Vec<u32> = lists.starts.iter().map(|&s| s * width as u32).collect();
        for_each_tile_slice(&starts, &mut out.values, &|tile, entries| {
            if entries.is_empty() {
                return;
            }
            entries.fill(0.0);
            let start = lists.starts[tile] as usize;
            let slots = &lists.slots[start..start + entries.len() / width];
            let (planes, open) = gather_channels(size, *grid, tile, channels);
            let origin = grid.origin(tile);
            if channels.contributors() > 0 {
                let count = channels.contributors().min(slots.len());
                let mut heaviest = Heaviest::default();
                heaviest.find(origin, splats, slots, finished, count, &open);
                sum_heaviest(&heaviest, wanted, &planes, entries);
                return;
            }
            for (step, planes) in planes.chunks(MAX_CHANNELS).enumerate() {
                let (first, entries) = (step * MAX_CHANNELS, &mut *entries);
                arch.dispatch(SumTile {
                    origin,
                    splats,
                    slots,
                    finished,
                    wanted,
                    planes,
                    first,
                    width,
                    open,
                    entries,
                });
            }
        });
    }
}

/// Gaussians whose footprints are summed.
pub(crate) struct Summed<'a> {
    /// All that is rendered.
    pub(crate) layers: &'a [&'a Gaussians],
    /// Chunks of them that are out of a view's sight are skipped.
    pub(crate) bounds: Option<&'a ChunkBounds>,
    /// The first so many are summed; the others only hide what is behind them.
    pub(crate) wanted: usize,
}

/// Sums of each (tile, splat) entry by its place: those of the channels, then the hits.
#[derive(Clone, Debug, Default)]
pub(crate) struct EntrySums {
    width: usize,
    values: Vec<f32>,
}

impl EntrySums {
    /// Calls `visit(Gaussian, sums of the channels, hits)` for those of the first `wanted` Gaussians that reach a computed
    /// tile, ascending. `tape` is that of the sums.
    pub(crate) fn for_each(
        &self,
        tape: &RenderTape,
        wanted: usize,
        mut visit: impl FnMut(usize, &[f32], u32),
    ) {
        let mut total = vec![0.0; self.width];
        let lists = &tape.lists;
        // Splats are in the order of the Gaussians.
        let splats = tape.splats.iter().take_while(|s| (s.index as usize) < wanted);
        for (splat, ends) in splats.zip(lists.entry_starts.windows(2)) {
            total.fill(0.0);
            for &place in &lists.entries[ends[0] as usize..ends[1] as usize] {
                let values = &self.values[place as usize * self.width..(place as usize + 1) * self.width];
                total.iter_mut().zip(values).for_each(|(sum, value)| *sum += value);
            }
            let (hits, sums) = total.split_last().expect("an entry holds its hits");
            visit(splat.index as usize, sums, *hits as u32);
        }
    }
}

/// A plane a channel, and 1 in the pixels that count.
fn gather_channels(
    size: ImageSize,
    grid: TileGrid,
    tile: usize,
    channels: &impl PixelChannels,
) -> (Vec<TilePlane>, TilePlane) {
    let mut planes = vec![TilePlane::ZERO; channels.count()];
    let mut open = TilePlane::ZERO;
    for_each_row(size, grid, tile, |pixels, local| channels.gather(pixels, local, &mut planes, &mut open));
    (planes, open)
}

/// The sums of [`SumTile`] over the heaviest contributions only.
fn sum_heaviest(heaviest: &Heaviest, wanted: usize, planes: &[TilePlane], entries: &mut [f32]) {
    let width = planes.len() + 1;
    for pixel in 0..AREA {
        let hit = f32::from(planes[0].0[pixel] != 0.0);
        for (splat, weight) in heaviest.of(pixel).filter(|(splat, _)| (splat.index as usize) < wanted) {
            let sums = &mut entries[splat.place * width..(splat.place + 1) * width];
            sums.iter_mut().zip(planes).for_each(|(sum, plane)| *sum += weight * plane.0[pixel]);
            sums[planes.len()] += hit;
        }
    }
}

/// Channels summed in one walk over a tile; more take several.
const MAX_CHANNELS: usize = 16;

struct SumTile<'a> {
    origin: [usize; 2],
    splats: &'a [Splat],
    slots: &'a [Entry],
    finished: f32,
    /// Gaussians from this index on are not summed.
    wanted: usize,
    planes: &'a [TilePlane],
    /// Channel of the first plane.
    first: usize,
    /// Values an entry: the sums of all channels, then the hits.
    width: usize,
    /// Transmittance to begin with: 0 in pixels that do not count.
    open: TilePlane,
    entries: &'a mut [f32],
}

impl WithSimd for SumTile<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        // A number that the compiler knows keeps the sums in registers. One to five trackers that know all of the mask
        // have 4, 7, 10, 13, 16 channels.
        match self.planes.len() {
            0..=4 => self.sum::<S, 4>(simd),
            5..=7 => self.sum::<S, 7>(simd),
            8..=10 => self.sum::<S, 10>(simd),
            11..=13 => self.sum::<S, 13>(simd),
            _ => self.sum::<S, MAX_CHANNELS>(simd),
        }
    }
}

impl SumTile<'_> {
    /// With room for `C` channels, the last ones unused.
    #[inline(always)]
    fn sum<S: Simd, const C: usize>(self, simd: S) {
        let Self { origin, splats, slots, finished, wanted, planes, first, width, mut open, entries } = self;
        let zero = simd.splat_f32s(0.0);
        let mut columns = [S::as_simd_f32s(&TilePlane::ZERO.0).0; C];
        columns.iter_mut().zip(planes).for_each(|(column, plane)| *column = S::as_simd_f32s(&plane.0).0);
        let mut visitor = Sum::<S, C> {
            planes: columns,
            channels: first..first + planes.len(),
            width,
            wanted,
            counts: true,
            shows: false,
            sums: [zero; C],
            hits: zero,
            entries,
        };
        walk(simd, origin, splats, slots, finished, &mut open, &mut visitor);
    }
}

struct Sum<'a, S: Simd, const C: usize> {
    planes: [&'a [S::f32s]; C],
    /// Channels that they are; there may be fewer.
    channels: Range<usize>,
    width: usize,
    wanted: usize,
    /// Whether the current splat is summed.
    counts: bool,
    /// Whether a pixel of it has counted; of hidden splats nothing needs to be written.
    shows: bool,
    sums: [S::f32s; C],
    hits: S::f32s,
    entries: &'a mut [f32],
}

impl<S: Simd, const C: usize> Visitor<S> for Sum<'_, S, C> {
    #[inline(always)]
    fn begin(&mut self, simd: S, splat: &Splat) {
        self.counts = (splat.index as usize) < self.wanted;
        self.shows = false;
        self.sums = [simd.splat_f32s(0.0); C];
        self.hits = simd.splat_f32s(0.0);
    }

    #[inline(always)]
    fn visit(&mut self, simd: S, c: &Contribution<S>) {
        if !self.counts {
            return;
        }
        self.shows = true;
        let (zero, one) = (simd.splat_f32s(0.0), simd.splat_f32s(1.0));
        for k in 0..C {
            self.sums[k] = simd.mul_add_e_f32s(c.weight, self.planes[k][c.vector], self.sums[k]);
        }
        let absent = simd.equal_f32s(self.planes[0][c.vector], zero);
        let hit = simd.select_f32s(c.counts, simd.select_f32s(absent, zero, one), zero);
        self.hits = simd.add_f32s(self.hits, hit);
    }

    #[inline(always)]
    fn end(&mut self, simd: S, entry: usize) {
        if !self.shows {
            return;
        }
        let out = &mut self.entries[entry * self.width..(entry + 1) * self.width];
        for (o, &s) in out[self.channels.clone()].iter_mut().zip(&self.sums) {
            *o = simd.reduce_sum_f32s(s);
        }
        out[self.width - 1] = simd.reduce_sum_f32s(self.hits);
    }
}
