//! From tiles to the row-major image.

use crate::constants::TILE;
use crate::tape::{RenderTape, TilePixels};
use crate::tiles::TileGrid;
use crate::view::{Background, View};
use ffgs_core::ImageSize;
use rayon::prelude::*;

/// Tile results over the background. Only tiles that are computed, or were in the last call, are written.
pub(crate) fn compose(view: &View, tape: &mut RenderTape) {
    let (size, grid) = (view.camera.size(), tape.grid);
    if tape.image.size() != size || tape.drawn.len() != grid.count() {
        tape.image.reset(size);
        tape.transmittance.clear();
        tape.transmittance.resize(size.pixels(), 1.0);
        tape.drawn.clear();
        tape.drawn.resize(grid.count(), false);
    }
    let RenderTape { image, transmittance, drawn, pixels, .. } = tape;
    let (red, rest) = image.data_mut().split_at_mut(size.pixels());
    let (green, blue) = rest.split_at_mut(size.pixels());
    let band = TILE * size.width;
    red.par_chunks_mut(band)
        .zip(green.par_chunks_mut(band))
        .zip(blue.par_chunks_mut(band))
        .zip(transmittance.par_chunks_mut(band))
        .zip(drawn.par_chunks_mut(grid.columns))
        .zip(pixels.par_chunks(grid.columns))
        .enumerate()
        .for_each(|(row, (((((red, green), blue), through), drawn), tiles))| {
            let mut band = Band { planes: [red, green, blue], through, size, grid, row };
            band.fill(view, drawn, tiles);
        });
}

/// The image's rows of one row of tiles.
struct Band<'a> {
    planes: [&'a mut [f32]; 3],
    through: &'a mut [f32],
    size: ImageSize,
    grid: TileGrid,
    row: usize,
}

impl Band<'_> {
    fn fill(&mut self, view: &View, drawn: &mut [bool], tiles: &[TilePixels]) {
        for (column, (drawn, tile)) in drawn.iter_mut().zip(tiles).enumerate() {
            let active = view.tiles.is_none_or(|m| m.is_active(self.row * self.grid.columns + column));
            if active {
                self.draw(column, tile, view.background);
            } else if *drawn {
                self.clear(column);
            }
            *drawn = active;
        }
    }

    /// Ranges of a tile's rows: in the band, and first pixel in the tile.
    fn rows(&self, column: usize) -> impl Iterator<Item = (std::ops::Range<usize>, usize)> + use<> {
        let (width, x) = (self.size.width, column * TILE);
        let (columns, rows) = (TILE.min(width - x), self.through.len() / width);
        (0..rows).map(move |y| (y * width + x..y * width + x + columns, y * TILE))
    }

    fn draw(&mut self, column: usize, tile: &TilePixels, background: Background) {
        let first = self.row * TILE * self.size.width;
        for (range, local) in self.rows(column) {
            let locals = local..local + range.len();
            let through = &tile.transmittance.0[locals.clone()];
            self.through[range.clone()].copy_from_slice(through);
            for channel in 0..3 {
                let out = self.planes[channel][range.clone()].iter_mut();
                let blended = out.zip(&tile.rgb[channel].0[locals.clone()]).zip(through);
                match background {
                    Background::Colour(rgb) => blended.for_each(|((o, &c), &t)| *o = c + t * rgb[channel]),
                    Background::Image(image) => {
                        let behind = &image.plane(channel)[first + range.start..first + range.end];
                        blended.zip(behind).for_each(|(((o, &c), &t), &b)| *o = c + t * b);
                    }
                }
            }
        }
    }

    /// Black, and nothing in the way.
    fn clear(&mut self, column: usize) {
        for (range, _) in self.rows(column) {
            self.planes.iter_mut().for_each(|plane| plane[range.clone()].fill(0.0));
            self.through[range].fill(1.0);
        }
    }
}
