//! Sums over the pixels that a Gaussian covers, and split renders of a layer around a depth.

use crate::backward::for_each_tile_slice;
use crate::blend::{AREA, COLUMNS, Contribution, TilePlane, Visitor, walk};
use crate::contract::View;
use crate::cpu::{BlendTile, CpuRasterizer, tile_origin};
use crate::projection::Splat;
use crate::tape::{RenderTape, TilePixels, for_each_pixel};
use crate::tile_lists::Entry;
use crate::tiles::TileGrid;
use ffgs_core::{Gaussians, ImageSize, PlanarImage};
use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;
use std::ops::Range;

/// Channels that are summed together: one AVX-512 register, two of AVX2.
const GROUP: usize = 16;

/// Values of consecutive channels of one pixel, or sums of one (tile, splat) entry.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C, align(64))]
struct ChannelGroup([f32; GROUP]);

/// Sums per Gaussian of `alpha T` times per-pixel channels: association (Algorithm 1, lines 15 to 19, with every
/// contributor), and the transpose of blending.
#[derive(Clone, Debug, Default)]
pub struct FootprintSums {
    channels: usize,
    sums: Vec<f32>,
    hits: Vec<u32>,
    entries: Vec<ChannelGroup>,
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
pub trait PixelChannels: Sync {
    /// Number of channels.
    fn count(&self) -> usize;

    /// Writes the channels of a pixel, counted row by row; `false` when the pixel does not count: then it adds to no
    /// sum, and nothing is blended there.
    fn at(&self, pixel: usize, values: &mut [f32]) -> bool;
}

impl PixelChannels for &[&[f32]] {
    fn count(&self) -> usize {
        self.len()
    }

    fn at(&self, pixel: usize, values: &mut [f32]) -> bool {
        values.iter_mut().zip(*self).for_each(|(value, channel)| *value = channel[pixel]);
        true
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
        let n = gaussians.len();
        self.sum_footprints(gaussians, n, view, &channels, tape, out);
        let FootprintSums { sums, hits, .. } = out;
        let (mut sums, mut hits) = (std::mem::take(sums), std::mem::take(hits));
        sums.clear();
        sums.resize(n * channels.len(), 0.0);
        hits.clear();
        hits.resize(n, 0);
        out.for_each(n, tape, |i, values, count| {
            sums[i * channels.len()..(i + 1) * channels.len()].copy_from_slice(values);
            hits[i] = count;
        });
        (out.sums, out.hits) = (sums, hits);
    }

    /// As [`CpuRasterizer::accumulate`] for the first `wanted` Gaussians; the others only hide what is behind them. The
    /// sums are left for [`FootprintSums::for_each`].
    pub(crate) fn sum_footprints(
        &self,
        gaussians: &Gaussians,
        wanted: usize,
        view: &View,
        channels: &impl PixelChannels,
        tape: &mut RenderTape,
        out: &mut FootprintSums,
    ) {
        self.prepare(gaussians, view, tape);
        let (arch, size) = (Arch::new(), view.camera.size());
        let groups = out.reset(channels.count(), tape);
        let RenderTape { lists, splats, grid, .. } = tape;
        // Splats are in the order of the Gaussians.
        let first_other = splats.partition_point(|s| (s.index as usize) < wanted);
        let starts: Vec<u32> = lists.starts.iter().map(|&s| s * groups as u32).collect();
        for_each_tile_slice(&starts, &mut out.entries[..lists.len() * groups], &|tile, entries| {
            let start = lists.starts[tile] as usize;
            let slots = &lists.slots[start..start + entries.len() / groups];
            entries.fill(ChannelGroup::default());
            // What lies behind the last one changes no sum.
            let Some(last) = slots.iter().rposition(|entry| entry.slot() < first_other) else { return };
            let pixels = TileChannels::gather(size, *grid, tile, channels);
            let origin = tile_origin(tile, *grid);
            let slots = &slots[..=last];
            arch.dispatch(SumTile { origin, splats, slots, wanted, pixels, entries });
        });
    }

    /// Renders `gaussians` in two parts: what lies nearer than `depths` at each tile, and the rest over the view's
    /// background.
    pub fn render_split(
        &self,
        gaussians: &Gaussians,
        view: &View,
        depths: &TileDepths,
        tape: &mut RenderTape,
        out: &mut SplitLayers,
    ) {
        self.prepare(gaussians, view, tape);
        let (arch, size) = (Arch::new(), view.camera.size());
        let RenderTape { pixels, lists, splats, grid, .. } = tape;
        out.reset(size);
        out.tiles.resize_with(grid.count(), TilePixels::default);
        pixels.par_iter_mut().zip(&mut out.tiles).enumerate().for_each(|(tile, (front, behind))| {
            let slots = &lists.slots[lists.starts[tile] as usize..lists.starts[tile + 1] as usize];
            let cut = slots.partition_point(|s| splats[s.slot()].depth < depths.0[tile]);
            let origin = tile_origin(tile, *grid);
            arch.dispatch(BlendTile { origin, splats, slots: &slots[..cut], out: front });
            arch.dispatch(BlendTile { origin, splats, slots: &slots[cut..], out: behind });
        });
        for tile in (0..grid.count()).filter(|&t| view.tiles.is_none_or(|m| m.is_active(t))) {
            let (front, behind) = (&pixels[tile], &out.tiles[tile]);
            for_each_pixel(size, *grid, tile, |pixel, local| {
                let background = view.background.pixel(pixel);
                let through = behind.transmittance.0[local];
                out.transmittance[pixel] = front.transmittance.0[local];
                out.front.set_pixel(pixel, [0, 1, 2].map(|c| front.rgb[c].0[local]));
                out.behind
                    .set_pixel(pixel, [0, 1, 2].map(|c| behind.rgb[c].0[local] + through * background[c]));
            });
        }
    }
}

/// Depth (m) per tile at which [`CpuRasterizer::render_split`] cuts.
#[derive(Clone, Debug)]
pub struct TileDepths(Vec<f32>);

impl TileDepths {
    /// The nearest depth in each tile of what `tape` holds; tiles without any take the nearest of their neighbours,
    /// spreading outward, so that a layer which grows a little stays in front of what is behind it.
    pub fn nearest(tape: &RenderTape) -> Self {
        let (grid, lists) = (tape.grid, &tape.lists);
        let mut depths: Vec<f32> = (0..grid.count())
            .map(|t| {
                let (start, end) = (lists.starts[t] as usize, lists.starts[t + 1] as usize);
                lists.slots[start..end].first().map_or(f32::INFINITY, |s| tape.splats[s.slot()].depth)
            })
            .collect();
        for _ in 0..grid.columns.max(grid.rows) {
            if depths.iter().all(|d| d.is_finite()) {
                break;
            }
            let before = depths.clone();
            for tile in (0..depths.len()).filter(|&t| before[t].is_infinite()) {
                let (x, y) = (tile % grid.columns, tile / grid.columns);
                for ny in y.saturating_sub(1)..(y + 2).min(grid.rows) {
                    for nx in x.saturating_sub(1)..(x + 2).min(grid.columns) {
                        depths[tile] = depths[tile].min(before[ny * grid.columns + nx]);
                    }
                }
            }
        }
        Self(depths)
    }
}

/// A layer cut in two at a depth per tile.
#[derive(Clone, Debug)]
pub struct SplitLayers {
    /// Colour of the nearer part.
    pub front: PlanarImage,
    /// Transmittance of the nearer part, row-major.
    pub transmittance: Vec<f32>,
    /// Colour of the farther part over the background.
    pub behind: PlanarImage,
    tiles: Vec<TilePixels>,
}

impl Default for SplitLayers {
    fn default() -> Self {
        let empty = PlanarImage::zeros(ImageSize { width: 1, height: 1 });
        Self { front: empty.clone(), transmittance: Vec::new(), behind: empty, tiles: Vec::new() }
    }
}

impl SplitLayers {
    fn reset(&mut self, size: ImageSize) {
        self.front.reset(size);
        self.behind.reset(size);
        self.transmittance.clear();
        self.transmittance.resize(size.pixels(), 1.0);
    }
}

/// The channels of a tile's pixels. Those of one pixel lie side by side: a contribution is one product with all of them,
/// and nothing is summed across lanes. Most splats are smaller than a vector of pixels.
struct TileChannels {
    /// Groups of one pixel.
    groups: usize,
    /// (pixels, groups) values, 0 beyond the last channel.
    values: Vec<ChannelGroup>,
    /// Where the first channel is not zero.
    hits: [u32; AREA],
    /// Transmittance to begin with: 0 in pixels that do not count.
    open: TilePlane,
}

impl TileChannels {
    fn gather(size: ImageSize, grid: TileGrid, tile: usize, channels: &impl PixelChannels) -> Self {
        let groups = groups_for(channels.count());
        let values = vec![ChannelGroup::default(); AREA * groups];
        let mut out = Self { groups, values, hits: [0; AREA], open: TilePlane::ZERO };
        let mut pixel_values = vec![0.0; channels.count()];
        for_each_pixel(size, grid, tile, |pixel, local| {
            if channels.at(pixel, &mut pixel_values) {
                out.open.0[local] = 1.0;
                out.hits[local] = u32::from(pixel_values[0] != 0.0);
                let groups = &mut out.values[local * groups..(local + 1) * groups];
                for (group, values) in groups.iter_mut().zip(pixel_values.chunks(GROUP)) {
                    group.0[..values.len()].copy_from_slice(values);
                }
            }
        });
        out
    }
}

/// Groups that hold so many channels and the hits.
fn groups_for(channels: usize) -> usize {
    (channels + 1).div_ceil(GROUP)
}

impl FootprintSums {
    /// Makes room for the entries of `tape`; groups of an entry.
    fn reset(&mut self, channels: usize, tape: &RenderTape) -> usize {
        self.channels = channels;
        let groups = groups_for(channels);
        let needed = tape.lists.len() * groups;
        if self.entries.len() < needed {
            self.entries.resize(needed, ChannelGroup::default());
        }
        groups
    }

    /// Calls `visit(Gaussian, sums, hits)` for the first `wanted` Gaussians that reach a computed tile, ascending.
    pub(crate) fn for_each(
        &self,
        wanted: usize,
        tape: &RenderTape,
        mut visit: impl FnMut(usize, &[f32], u32),
    ) {
        let groups = groups_for(self.channels);
        let mut total = vec![0.0; groups * GROUP];
        // Splats are in the order of the Gaussians.
        let splats = tape.splats.iter().take_while(|s| (s.index as usize) < wanted);
        for (splat, range) in splats.zip(tape.lists.entry_starts.windows(2)) {
            total.fill(0.0);
            for &entry in &tape.lists.entries[range[0] as usize..range[1] as usize] {
                let sums = &self.entries[entry as usize * groups..(entry as usize + 1) * groups];
                for (total, sums) in total.chunks_exact_mut(GROUP).zip(sums) {
                    total.iter_mut().zip(&sums.0).for_each(|(t, s)| *t += s);
                }
            }
            visit(splat.index as usize, &total[..self.channels], total[groups * GROUP - 1] as u32);
        }
    }
}

struct SumTile<'a> {
    origin: [usize; 2],
    splats: &'a [Splat],
    slots: &'a [Entry],
    /// Gaussians from this index on are not summed.
    wanted: usize,
    pixels: TileChannels,
    entries: &'a mut [ChannelGroup],
}

impl WithSimd for SumTile<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { origin, splats, slots, wanted, pixels, entries } = self;
        let TileChannels { groups, values, hits, mut open } = pixels;
        let mut visitor = Sum::<S> {
            values: &values,
            hits: &hits,
            columns: S::as_simd_f32s(&COLUMNS).0[0],
            wanted,
            groups,
            counts: true,
            shows: false,
            found: 0,
            sums: vec![ChannelGroup::default(); groups],
            entries,
        };
        walk(simd, origin, splats, slots, &mut open, &mut visitor);
    }
}

struct Sum<'a, S: Simd> {
    values: &'a [ChannelGroup],
    hits: &'a [u32; AREA],
    /// 0, 1, 2, …
    columns: S::f32s,
    wanted: usize,
    groups: usize,
    /// Whether the current splat is summed.
    counts: bool,
    /// Whether a pixel of it has counted; of hidden splats nothing needs to be written.
    shows: bool,
    /// Its hits.
    found: u32,
    sums: Vec<ChannelGroup>,
    entries: &'a mut [ChannelGroup],
}

impl<S: Simd> Sum<'_, S> {
    /// Adds the pixels `range` of the tile, each with its weight; 0 where one does not count.
    #[inline(always)]
    fn add(&mut self, simd: S, range: Range<usize>, weights: &[f32]) {
        for group in 0..self.groups {
            let total = S::as_mut_simd_f32s(&mut self.sums[group].0).0;
            let mut sums = [simd.splat_f32s(0.0); GROUP];
            let parts = GROUP / S::F32_LANES;
            sums[..parts].copy_from_slice(total);
            for (pixel, &weight) in range.clone().zip(weights) {
                let weight = simd.splat_f32s(weight);
                let values = S::as_simd_f32s(&self.values[pixel * self.groups + group].0).0;
                for part in 0..parts {
                    sums[part] = simd.mul_add_e_f32s(weight, values[part], sums[part]);
                }
            }
            total.copy_from_slice(&sums[..parts]);
        }
        for (pixel, &weight) in range.zip(weights) {
            self.found += if weight > 0.0 { self.hits[pixel] } else { 0 };
        }
    }
}

impl<S: Simd> Visitor<S> for Sum<'_, S> {
    #[inline(always)]
    fn begin(&mut self, _: S, splat: &Splat) {
        self.counts = (splat.index as usize) < self.wanted;
        if self.shows {
            self.sums.fill(ChannelGroup::default());
            self.found = 0;
            self.shows = false;
        }
    }

    #[inline(always)]
    fn visit(&mut self, simd: S, c: &Contribution<S>) {
        if !self.counts {
            return;
        }
        let mut weights = ChannelGroup::default();
        S::as_mut_simd_f32s(&mut weights.0).0[0] = c.weight;
        // An ellipse's row is one run of pixels. `first_true_m32s` does not say where: it counts bit masks from the top.
        let (none, lanes) = (simd.splat_f32s(-1.0), simd.splat_f32s(S::F32_LANES as f32));
        let first = simd.reduce_min_f32s(simd.select_f32s(c.counts, self.columns, lanes)) as usize;
        let last = simd.reduce_max_f32s(simd.select_f32s(c.counts, self.columns, none)) as usize;
        if first > last {
            // Every pixel is finished by this splat.
            return;
        }
        self.shows = true;
        let vector = c.vector * S::F32_LANES;
        self.add(simd, vector + first..vector + last + 1, &weights.0[first..=last]);
    }

    #[inline(always)]
    fn end(&mut self, _: S, entry: usize) {
        if !self.shows {
            return;
        }
        let out = &mut self.entries[entry * self.groups..(entry + 1) * self.groups];
        out.copy_from_slice(&self.sums);
        let hits = self.groups * GROUP - 1;
        out[hits / GROUP].0[hits % GROUP] = self.found as f32;
    }
}
