//! Output of a render call, and what the backward pass reuses.

use crate::blend::TilePlane;
use crate::constants::{AREA, ENTRY, TILE};
use crate::projection::Splat;
use crate::tile_lists::TileLists;
use crate::tiles::{Span, TileGrid};
use ffgs_core::{ImageSize, PlanarImage};
use std::ops::Range;

/// Blended colour (without background) and final transmittance of one tile.
#[derive(Clone, Debug)]
pub(crate) struct TilePixels {
    pub(crate) rgb: [TilePlane; 3],
    pub(crate) transmittance: TilePlane,
}

impl Default for TilePixels {
    fn default() -> Self {
        Self { rgb: [TilePlane::ZERO; 3], transmittance: TilePlane::ONE }
    }
}

/// Splats and spans that one chunk of Gaussians gave.
#[derive(Clone, Debug, Default)]
pub(crate) struct ChunkSplats {
    pub(crate) splats: Vec<Splat>,
    pub(crate) spans: Vec<Span>,
}

/// A rendered view. Reuse one per view size: nothing is allocated once its buffers have grown.
#[derive(Debug)]
pub struct RenderTape {
    pub(crate) image: PlanarImage,
    pub(crate) transmittance: Vec<f32>,
    pub(crate) grid: TileGrid,
    /// Two groups of chunks: one is projected while the other is appended.
    pub(crate) chunks: [Vec<ChunkSplats>; 2],
    pub(crate) splats: Vec<Splat>,
    pub(crate) spans: Vec<Span>,
    pub(crate) lists: TileLists,
    pub(crate) pixels: Vec<TilePixels>,
    /// Tiles that `image` shows.
    pub(crate) drawn: Vec<bool>,
    /// Derivatives per (tile, splat) entry, by its place.
    pub(crate) entry_gradients: Vec<[f32; ENTRY]>,
    /// Splat slot of each Gaussian, or `u32::MAX`.
    pub(crate) slot_of: Vec<u32>,
}

impl Default for RenderTape {
    fn default() -> Self {
        Self {
            image: PlanarImage::zeros(ImageSize { width: 1, height: 1 }),
            transmittance: Vec::new(),
            grid: TileGrid::default(),
            chunks: [Vec::new(), Vec::new()],
            splats: Vec::new(),
            spans: Vec::new(),
            lists: TileLists::default(),
            pixels: Vec::new(),
            drawn: Vec::new(),
            entry_gradients: Vec::new(),
            slot_of: Vec::new(),
        }
    }
}

impl RenderTape {
    /// The image, background included, not clamped.
    pub fn image(&self) -> &PlanarImage {
        &self.image
    }

    /// The same, which is then gone from here: the next render makes another.
    pub fn take_image(&mut self) -> PlanarImage {
        std::mem::replace(&mut self.image, Self::default().image)
    }

    /// What the Gaussians let through per pixel, row-major; alpha is `1 -` this.
    pub fn transmittance(&self) -> &[f32] {
        &self.transmittance
    }

    /// Number of Gaussians that reach at least one computed tile.
    pub fn visible(&self) -> usize {
        self.splats.len()
    }

    /// Indices of the Gaussians that reach at least one computed tile, ascending.
    pub fn visible_indices(&self) -> impl Iterator<Item = usize> + '_ {
        self.splats.iter().map(|s| s.index as usize)
    }

    /// Number of (tile, splat) pairs: the unit of blending work.
    pub fn tile_pairs(&self) -> usize {
        self.lists.len()
    }
}

/// Appends the splats and spans of some chunks in their order.
pub(crate) fn append(chunks: &[ChunkSplats], splats: &mut Vec<Splat>, spans: &mut Vec<Span>) {
    for chunk in chunks {
        let first = spans.len() as u32;
        spans.extend_from_slice(&chunk.spans);
        let moved = |splat: &Splat| Splat { spans: (splat.spans.0 + first, splat.spans.1), ..*splat };
        splats.extend(chunk.splats.iter().map(moved));
    }
}

/// Calls `visit(pixels of the image, index of the first in the tile)` for the rows of a tile inside the image.
pub(crate) fn for_each_row(
    size: ImageSize,
    grid: TileGrid,
    tile: usize,
    mut visit: impl FnMut(Range<usize>, usize),
) {
    let [x0, y0] = grid.origin(tile);
    for y in 0..TILE.min(size.height - y0) {
        let first = (y0 + y) * size.width + x0;
        visit(first..first + TILE.min(size.width - x0), y * TILE);
    }
}

/// Calls `visit(pixel index in the image, pixel index in the tile)` for the pixels of a tile inside the image.
pub(crate) fn for_each_pixel(
    size: ImageSize,
    grid: TileGrid,
    tile: usize,
    mut visit: impl FnMut(usize, usize),
) {
    for_each_row(size, grid, tile, |pixels, local| {
        pixels.enumerate().for_each(|(x, pixel)| visit(pixel, local + x));
    });
}

/// Collects one row-major value per pixel into a tile plane; 0 beyond the image.
pub(crate) fn gather(size: ImageSize, grid: TileGrid, tile: usize, values: &[f32]) -> TilePlane {
    let mut plane = TilePlane::ZERO;
    for_each_pixel(size, grid, tile, |pixel, local| plane.0[local] = values[pixel]);
    debug_assert!(plane.0.len() == AREA);
    plane
}
