//! Sums over the pixels that a Gaussian covers, and split renders of a layer around a depth.

use crate::backward::for_each_tile_slice;
use crate::blend::{Contribution, TilePlane, Visitor, walk};
use crate::contract::View;
use crate::cpu::{BlendTile, CpuRasterizer, tile_origin};
use crate::projection::Splat;
use crate::tape::{RenderTape, TilePixels, for_each_pixel};
use crate::tile_lists::Entry;
use crate::tiles::TileGrid;
use ffgs_core::{Gaussians, ImageSize, PlanarImage};
use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

/// Sums per Gaussian of `alpha T` times per-pixel channels: association (Algorithm 1, lines 15 to 19, with every
/// contributor), and the transpose of blending.
#[derive(Clone, Debug, Default)]
pub struct FootprintSums {
    channels: usize,
    sums: Vec<f32>,
    hits: Vec<u32>,
    entries: Vec<f32>,
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
        self.accumulate_first(gaussians, gaussians.len(), view, &channels, tape, out);
    }

    /// As [`CpuRasterizer::accumulate`] for the first `wanted` Gaussians; the others only hide what is behind them.
    pub fn accumulate_first(
        &self,
        gaussians: &Gaussians,
        wanted: usize,
        view: &View,
        channels: &impl PixelChannels,
        tape: &mut RenderTape,
        out: &mut FootprintSums,
    ) {
        self.prepare(gaussians, view, tape);
        let (arch, size, width) = (Arch::new(), view.camera.size(), channels.count() + 1);
        let RenderTape { lists, splats, grid, .. } = tape;
        out.entries.clear();
        out.entries.resize(lists.len() * width, 0.0);
        let starts: Vec<u32> = lists.starts.iter().map(|&s| s * width as u32).collect();
        for_each_tile_slice(&starts, &mut out.entries, &|tile, entries| {
            if entries.is_empty() {
                return;
            }
            let start = lists.starts[tile] as usize;
            let slots = &lists.slots[start..start + entries.len() / width];
            let (planes, open) = gather_channels(size, *grid, tile, channels);
            let origin = tile_origin(tile, *grid);
            arch.dispatch(SumTile { origin, splats, slots, wanted, planes: &planes, open, entries });
        });
        out.collect(wanted, channels.count(), tape);
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

/// A plane a channel, and 1 in the pixels that count.
fn gather_channels(
    size: ImageSize,
    grid: TileGrid,
    tile: usize,
    channels: &impl PixelChannels,
) -> (Vec<TilePlane>, TilePlane) {
    let mut planes = vec![TilePlane::ZERO; channels.count()];
    let mut open = TilePlane::ZERO;
    let mut values = vec![0.0; channels.count()];
    for_each_pixel(size, grid, tile, |pixel, local| {
        if channels.at(pixel, &mut values) {
            open.0[local] = 1.0;
            planes.iter_mut().zip(&values).for_each(|(plane, &value)| plane.0[local] = value);
        }
    });
    (planes, open)
}

impl FootprintSums {
    /// Gaussians that reach a computed tile, ascending, with their sums and hits.
    pub(crate) fn touched<'a>(
        &'a self,
        tape: &'a RenderTape,
    ) -> impl Iterator<Item = (usize, &'a [f32], u32)> {
        let wanted = self.hits.len();
        let indices = tape.visible_indices().take_while(move |&i| i < wanted);
        indices.map(|i| (i, self.of(i), self.hits(i)))
    }

    fn collect(&mut self, n: usize, channels: usize, tape: &RenderTape) {
        let width = channels + 1;
        self.channels = channels;
        self.sums.clear();
        self.sums.resize(n * channels, 0.0);
        self.hits.clear();
        self.hits.resize(n, 0);
        // Splats are in the order of the Gaussians.
        for (slot, splat) in tape.splats.iter().enumerate().take_while(|(_, s)| (s.index as usize) < n) {
            let i = splat.index as usize;
            let range = tape.lists.entry_starts[slot] as usize..tape.lists.entry_starts[slot + 1] as usize;
            for &entry in &tape.lists.entries[range] {
                let values = &self.entries[entry as usize * width..(entry as usize + 1) * width];
                self.sums[i * channels..(i + 1) * channels].iter_mut().zip(values).for_each(|(s, v)| *s += v);
                self.hits[i] += values[channels] as u32;
            }
        }
    }
}

struct SumTile<'a> {
    origin: [usize; 2],
    splats: &'a [Splat],
    slots: &'a [Entry],
    /// Gaussians from this index on are not summed.
    wanted: usize,
    planes: &'a [TilePlane],
    /// Transmittance to begin with: 0 in pixels that do not count.
    open: TilePlane,
    entries: &'a mut [f32],
}

impl WithSimd for SumTile<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { origin, splats, slots, wanted, planes, mut open, entries } = self;
        let planes: Vec<&[S::f32s]> = planes.iter().map(|p| S::as_simd_f32s(&p.0).0).collect();
        let sums = vec![simd.splat_f32s(0.0); planes.len() + 1];
        let mut visitor = Sum::<S> { planes, wanted, counts: true, shows: false, sums, entries };
        walk(simd, origin, splats, slots, &mut open, &mut visitor);
    }
}

struct Sum<'a, S: Simd> {
    planes: Vec<&'a [S::f32s]>,
    wanted: usize,
    /// Whether the current splat is summed.
    counts: bool,
    /// Whether a pixel of it has counted; of hidden splats nothing needs to be written.
    shows: bool,
    sums: Vec<S::f32s>,
    entries: &'a mut [f32],
}

impl<S: Simd> Visitor<S> for Sum<'_, S> {
    #[inline(always)]
    fn begin(&mut self, simd: S, splat: &Splat) {
        self.counts = (splat.index as usize) < self.wanted;
        if self.shows {
            self.sums.fill(simd.splat_f32s(0.0));
            self.shows = false;
        }
    }

    #[inline(always)]
    fn visit(&mut self, simd: S, c: &Contribution<S>) {
        if !self.counts {
            return;
        }
        self.shows = true;
        let (zero, one) = (simd.splat_f32s(0.0), simd.splat_f32s(1.0));
        for (sum, plane) in self.sums.iter_mut().zip(&self.planes) {
            *sum = simd.mul_add_e_f32s(c.weight, plane[c.vector], *sum);
        }
        let absent = simd.equal_f32s(self.planes[0][c.vector], zero);
        let hit = simd.select_f32s(c.counts, simd.select_f32s(absent, zero, one), zero);
        let last = self.sums.len() - 1;
        self.sums[last] = simd.add_f32s(self.sums[last], hit);
    }

    #[inline(always)]
    fn end(&mut self, simd: S, entry: usize) {
        if !self.shows {
            return;
        }
        let width = self.sums.len();
        let out = &mut self.entries[entry * width..(entry + 1) * width];
        for (o, &s) in out.iter_mut().zip(&self.sums) {
            *o = simd.reduce_sum_f32s(s);
        }
    }
}
