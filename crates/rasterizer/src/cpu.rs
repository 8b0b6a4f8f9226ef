//! The forward pass.

use crate::blend::{Contribution, TilePlane, Visitor, walk};
use crate::contract::{Rasterizer, RenderOptions, View};
use crate::projection::{PinholeF32, Splat, active_degree, splat, view_colour};
use crate::tape::{ChunkSplats, RenderTape, TilePixels, for_each_pixel};
use crate::tiles::{TILE, TileGrid, cover};
use ffgs_core::Gaussians;
use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

/// Gaussians projected as one unit of parallel work.
const CHUNK: usize = 1024;

/// The CPU rasterizer.
#[derive(Clone, Copy, Debug, Default)]
pub struct CpuRasterizer {
    pub(crate) options: RenderOptions,
}

impl CpuRasterizer {
    /// A rasterizer with these options.
    pub fn new(options: RenderOptions) -> Self {
        Self { options }
    }

    /// Projects, sorts and deals to tiles: everything before blending.
    pub(crate) fn prepare(&self, gaussians: &Gaussians, view: &View, tape: &mut RenderTape) {
        let size = view.camera.size();
        tape.grid = TileGrid::new(size);
        self.project(gaussians, view, tape);
        concatenate(tape);
        tape.lists.build(&tape.splats, &tape.spans, tape.grid, view.tiles);
        tape.pixels.resize_with(tape.grid.count(), TilePixels::default);
    }

    fn project(&self, gaussians: &Gaussians, view: &View, tape: &mut RenderTape) {
        let camera = PinholeF32::from(view.camera);
        let (options, grid, n) = (self.options, tape.grid, gaussians.len());
        let degree = active_degree(gaussians, options);
        tape.chunks.resize_with(n.div_ceil(CHUNK), ChunkSplats::default);
        tape.chunks.par_iter_mut().enumerate().for_each(|(c, chunk)| {
            chunk.splats.clear();
            chunk.spans.clear();
            for i in c * CHUNK..((c + 1) * CHUNK).min(n) {
                let Some((mut s, covariance)) = splat(gaussians, i, &camera, options) else { continue };
                if cover(&mut s, covariance, grid, view.tiles, &mut chunk.spans) {
                    s.colour = view_colour(gaussians, i, &camera, degree).max(glam::Vec3::ZERO).to_array();
                    chunk.splats.push(s);
                }
            }
        });
    }
}

impl Rasterizer for CpuRasterizer {
    fn render(&self, gaussians: &Gaussians, view: &View, tape: &mut RenderTape) {
        self.prepare(gaussians, view, tape);
        let arch = Arch::new();
        let RenderTape { pixels, lists, splats, grid, .. } = tape;
        pixels.par_iter_mut().enumerate().for_each(|(tile, out)| {
            let slots = &lists.slots[lists.starts[tile] as usize..lists.starts[tile + 1] as usize];
            arch.dispatch(BlendTile { origin: tile_origin(tile, *grid), splats, slots, out });
        });
        compose(view, tape);
    }
}

/// First pixel of a tile.
pub(crate) fn tile_origin(tile: usize, grid: TileGrid) -> [usize; 2] {
    [tile % grid.columns * TILE, tile / grid.columns * TILE]
}

fn concatenate(tape: &mut RenderTape) {
    tape.splats.clear();
    tape.spans.clear();
    for chunk in &tape.chunks {
        let first_span = tape.spans.len() as u32;
        tape.spans.extend_from_slice(&chunk.spans);
        tape.splats
            .extend(chunk.splats.iter().map(|&s| Splat { spans: (s.spans.0 + first_span, s.spans.1), ..s }));
    }
}

/// Tile results, over the background, into the row-major image.
fn compose(view: &View, tape: &mut RenderTape) {
    let (size, grid) = (view.camera.size(), tape.grid);
    tape.image.reset(size);
    tape.transmittance.clear();
    tape.transmittance.resize(size.pixels(), 1.0);
    for (tile, pixels) in tape.pixels.iter().enumerate() {
        if view.tiles.is_some_and(|m| !m.is_active(tile)) {
            continue;
        }
        for_each_pixel(size, grid, tile, |pixel, local| {
            let t = pixels.transmittance.0[local];
            let behind = view.background.pixel(pixel);
            tape.transmittance[pixel] = t;
            tape.image.set_pixel(pixel, [0, 1, 2].map(|c| pixels.rgb[c].0[local] + t * behind[c]));
        });
    }
}

/// Blends one tile.
pub(crate) struct BlendTile<'a> {
    pub(crate) origin: [usize; 2],
    pub(crate) splats: &'a [Splat],
    pub(crate) slots: &'a [u32],
    pub(crate) out: &'a mut TilePixels,
}

impl WithSimd for BlendTile<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { origin, splats, slots, out } = self;
        out.rgb = [TilePlane::ZERO; 3];
        out.transmittance = TilePlane::ONE;
        let zero = simd.splat_f32s(0.0);
        let [r, g, b] = &mut out.rgb;
        let planes = [r, g, b].map(|plane| S::as_mut_simd_f32s(&mut plane.0).0);
        let mut visitor = AddColour::<S> { planes, colour: [zero; 3] };
        walk(simd, origin, splats, slots, &mut out.transmittance, &mut visitor);
        out.transmittance.0.iter_mut().for_each(|t| *t = t.abs());
    }
}

struct AddColour<'a, S: Simd> {
    planes: [&'a mut [S::f32s]; 3],
    colour: [S::f32s; 3],
}

impl<S: Simd> Visitor<S> for AddColour<'_, S> {
    #[inline(always)]
    fn begin(&mut self, simd: S, splat: &Splat) {
        // Plain loops: a closure handed to `map` would be compiled without the dispatched instruction set.
        for k in 0..3 {
            self.colour[k] = simd.splat_f32s(splat.colour[k]);
        }
    }

    #[inline(always)]
    fn visit(&mut self, simd: S, c: &Contribution<S>) {
        for (plane, &colour) in self.planes.iter_mut().zip(&self.colour) {
            plane[c.vector] = simd.mul_add_e_f32s(c.weight, colour, plane[c.vector]);
        }
    }

    #[inline(always)]
    fn end(&mut self, _: S, _: usize) {}
}
