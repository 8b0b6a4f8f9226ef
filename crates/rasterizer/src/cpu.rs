//! The forward pass.

use crate::blend::{Contribution, TilePlane, Visitor, walk};
use crate::block::{BLOCK, Block, Projected};
use crate::chunks::{Chunk, ChunkBounds, chunks_of};
use crate::compose::compose;
use crate::constants::MIN_TRANSMITTANCE;
use crate::coverage::cover;
use crate::pinhole::PinholeF32;
use crate::projection::{Splat, active_degree, view_colour};
use crate::tape::{ChunkSplats, RenderTape, TilePixels, append};
use crate::tile_lists::Entry;
use crate::tiles::{TileGrid, TileMask};
use crate::view::{RenderOptions, View};
use ffgs_core::{Gaussians, instructions};
use pulp::{Simd, WithSimd};
use rayon::prelude::*;

/// Chunks per thread that are projected before they are appended: enough to share out evenly, few enough to stay in cache.
const CHUNKS_AHEAD: usize = 8;

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

    /// Renders one view into `tape`, which keeps the image, the transmittance and what the backward pass needs.
    pub fn render(&self, gaussians: &Gaussians, view: &View, tape: &mut RenderTape) {
        self.render_layers(&[gaussians], view, tape);
    }

    /// As [`CpuRasterizer::render`], for several layers sorted by depth together; nothing of them is copied. Indices
    /// count through the layers in their order.
    pub fn render_layers(&self, layers: &[&Gaussians], view: &View, tape: &mut RenderTape) {
        self.prepare(layers, view, tape);
        let arch = instructions();
        let RenderTape { pixels, lists, splats, grid, .. } = tape;
        pixels.par_iter_mut().enumerate().for_each(|(tile, out)| {
            let slots = &lists.slots[lists.starts[tile] as usize..lists.starts[tile + 1] as usize];
            arch.dispatch(BlendTile { origin: grid.origin(tile), splats, slots, out });
        });
        compose(view, tape);
    }

    /// Projects, sorts and assigns to tiles: everything before blending. `tape` then knows which Gaussians are visible and how deep the tiles
    /// are; it holds no image.
    pub fn prepare(&self, layers: &[&Gaussians], view: &View, tape: &mut RenderTape) {
        self.prepare_within(layers, None, view, tape);
    }

    /// As [`CpuRasterizer::prepare`], without the chunks of Gaussians that `bounds` rule out.
    pub(crate) fn prepare_within(
        &self,
        layers: &[&Gaussians],
        bounds: Option<&ChunkBounds>,
        view: &View,
        tape: &mut RenderTape,
    ) {
        tape.grid = TileGrid::new(view.camera.size());
        self.project(layers, bounds, view, tape);
        tape.lists.build(&tape.splats, &tape.spans, tape.grid, view.tiles);
        tape.pixels.resize_with(tape.grid.count(), TilePixels::default);
    }

    fn project(
        &self,
        layers: &[&Gaussians],
        bounds: Option<&ChunkBounds>,
        view: &View,
        tape: &mut RenderTape,
    ) {
        let size = view.camera.size();
        let shared = Projection {
            options: self.options,
            camera: PinholeF32::new(view.camera, self.options),
            size: [size.width as f32, size.height as f32],
            grid: tape.grid,
            mask: view.tiles,
        };
        let RenderTape { chunks: [ready, next], splats, spans, grid, .. } = tape;
        splats.clear();
        spans.clear();
        let mut chunks = chunks_of(layers);
        if let Some(bounds) = bounds {
            let in_sight = bounds.in_sight(&shared.camera, shared.size, *grid, view.tiles);
            chunks = in_sight.map(|number| chunks[number].clone()).collect();
        }
        let group = CHUNKS_AHEAD * rayon::current_num_threads();
        let buffers = group.min(chunks.len()).max(next.len());
        ready.resize_with(buffers, ChunkSplats::default);
        next.resize_with(buffers, ChunkSplats::default);
        let mut waiting = 0;
        for chunks in chunks.chunks(group) {
            let (done, free) = (&ready[..waiting], &mut next[..chunks.len()]);
            rayon::join(|| append(done, splats, spans), || project_chunks(&shared, chunks, free));
            std::mem::swap(ready, next);
            waiting = chunks.len();
        }
        append(&ready[..waiting], splats, spans);
    }
}

/// What every chunk of a projection reads.
struct Projection<'a> {
    options: RenderOptions,
    camera: PinholeF32,
    /// Of the image (px).
    size: [f32; 2],
    grid: TileGrid,
    mask: Option<&'a TileMask>,
}

/// Projects the Gaussians of a chunk.
struct ProjectChunk<'a> {
    shared: &'a Projection<'a>,
    chunk: &'a Chunk<'a>,
    out: &'a mut ChunkSplats,
}

impl WithSimd for ProjectChunk<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { shared, chunk, out } = self;
        let Chunk { layer, ref range, before } = *chunk;
        let dropout = shared.options.dropout;
        let degree = active_degree(layer, shared.options);
        out.splats.clear();
        out.spans.clear();
        let (mut block, mut projected) = (Block::default(), Projected::default());
        for start in range.clone().step_by(BLOCK) {
            let count = BLOCK.min(range.end - start);
            for k in 0..count {
                let factor = dropout.map_or(1.0, |dropout| dropout.factor(before + start + k));
                block.load(k, layer, start + k, &shared.camera, factor);
            }
            block.project(&shared.camera, layer.filter, shared.size, &mut projected);
            for k in 0..count {
                if !(projected.opacity[k] > 0.0) {
                    continue;
                }
                let (mut splat, extent) = projected.splat(k, before + start + k);
                if cover(&mut splat, &extent, shared.grid, shared.mask, &mut out.spans) {
                    let colour = view_colour(layer, start + k, &shared.camera, degree);
                    splat.colour = colour.max(glam::Vec3::ZERO).to_array();
                    out.splats.push(splat);
                }
            }
        }
    }
}

/// Projects each chunk into its own buffer.
fn project_chunks(shared: &Projection, chunks: &[Chunk], projected: &mut [ChunkSplats]) {
    let arch = instructions();
    projected.par_iter_mut().zip(chunks).for_each(|(out, chunk)| {
        arch.dispatch(ProjectChunk { shared, chunk, out });
    });
}

/// Blends one tile.
pub(crate) struct BlendTile<'a> {
    pub(crate) origin: [usize; 2],
    pub(crate) splats: &'a [Splat],
    pub(crate) slots: &'a [Entry],
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
        walk(simd, origin, splats, slots, MIN_TRANSMITTANCE, &mut out.transmittance, &mut visitor);
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
