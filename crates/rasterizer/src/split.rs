//! Renders of a layer in two parts, in front of and behind a depth per tile.

use crate::cpu::{BlendTile, CpuRasterizer};
use crate::tape::{RenderTape, TilePixels, for_each_pixel};
use crate::view::View;
use ffgs_core::{Gaussians, ImageSize, PlanarImage, instructions};
use rayon::prelude::*;

impl CpuRasterizer {
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
        self.prepare(&[gaussians], view, tape);
        let (arch, size) = (instructions(), view.camera.size());
        let RenderTape { pixels, lists, splats, grid, .. } = tape;
        out.reset(size);
        out.tiles.resize_with(grid.count(), TilePixels::default);
        pixels.par_iter_mut().zip(&mut out.tiles).enumerate().for_each(|(tile, (front, behind))| {
            let slots = &lists.slots[lists.starts[tile] as usize..lists.starts[tile + 1] as usize];
            let cut = slots.partition_point(|s| splats[s.slot()].depth < depths.0[tile]);
            let origin = grid.origin(tile);
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
