//! The forward pass.

use crate::blend::{Contribution, TilePlane, Visitor, walk};
use crate::block::{BLOCK, Block, Projected};
use crate::chunks::{CHUNK, ChunkBounds};
use crate::compose::compose;
use crate::constants::MIN_TRANSMITTANCE;
use crate::coverage::cover;
use crate::dropout::Dropout;
use crate::projection::{PinholeF32, Splat, active_degree, view_colour};
use crate::tape::{Append, ChunkSplats, RenderTape, TilePixels};
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
        self.prepare(gaussians, view, tape);
        let arch = instructions();
        let RenderTape { pixels, lists, splats, grid, .. } = tape;
        pixels.par_iter_mut().enumerate().for_each(|(tile, out)| {
            let slots = &lists.slots[lists.starts[tile] as usize..lists.starts[tile + 1] as usize];
            arch.dispatch(BlendTile { origin: grid.origin(tile), splats, slots, out });
        });
        compose(view, tape);
    }

    /// Projects, sorts and deals to tiles: everything before blending.
    pub(crate) fn prepare(&self, gaussians: &Gaussians, view: &View, tape: &mut RenderTape) {
        self.prepare_within(gaussians, None, view, tape);
    }

    /// As [`CpuRasterizer::prepare`], without the chunks of Gaussians that `bounds` rule out.
    pub(crate) fn prepare_within(
        &self,
        gaussians: &Gaussians,
        bounds: Option<&ChunkBounds>,
        view: &View,
        tape: &mut RenderTape,
    ) {
        tape.grid = TileGrid::new(view.camera.size());
        self.project(gaussians, bounds, view, tape);
        tape.lists.finish(&tape.splats, &tape.spans, tape.grid, view.tiles);
        tape.pixels.resize_with(tape.grid.count(), TilePixels::default);
    }

    fn project(
        &self,
        gaussians: &Gaussians,
        bounds: Option<&ChunkBounds>,
        view: &View,
        tape: &mut RenderTape,
    ) {
        let size = view.camera.size();
        let shared = Projection {
            gaussians,
            camera: PinholeF32::from(view.camera),
            antialiased: self.options.antialiased,
            dropout: self.options.dropout,
            degree: active_degree(gaussians, self.options),
            size: [size.width as f32, size.height as f32],
            grid: tape.grid,
            mask: view.tiles,
        };
        let RenderTape { chunks: [ready, next], splats, spans, lists, grid, .. } = tape;
        splats.clear();
        spans.clear();
        lists.begin(*grid);
        let mut append = Append { splats, spans, lists, grid: *grid, mask: view.tiles };
        let chunks: Vec<usize> = match bounds {
            Some(bounds) => bounds.in_sight(&shared.camera, shared.size, *grid, view.tiles).collect(),
            None => (0..gaussians.len().div_ceil(CHUNK)).collect(),
        };
        let group = CHUNKS_AHEAD * rayon::current_num_threads();
        let buffers = group.min(chunks.len()).max(next.len());
        ready.resize_with(buffers, ChunkSplats::default);
        next.resize_with(buffers, ChunkSplats::default);
        let mut waiting = 0;
        for numbers in chunks.chunks(group) {
            let (done, free) = (&ready[..waiting], &mut next[..numbers.len()]);
            rayon::join(|| append.all(done), || project_chunks(&shared, numbers, free));
            std::mem::swap(ready, next);
            waiting = numbers.len();
        }
        append.all(&ready[..waiting]);
    }
}

/// What every chunk of a projection reads.
struct Projection<'a> {
    gaussians: &'a Gaussians,
    camera: PinholeF32,
    antialiased: bool,
    dropout: Option<Dropout>,
    degree: usize,
    /// Of the image (px).
    size: [f32; 2],
    grid: TileGrid,
    mask: Option<&'a TileMask>,
}

/// Projects up to [`CHUNK`] Gaussians from `first` on.
struct ProjectChunk<'a> {
    shared: &'a Projection<'a>,
    first: usize,
    out: &'a mut ChunkSplats,
}

impl WithSimd for ProjectChunk<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { shared, first, out } = self;
        out.splats.clear();
        out.spans.clear();
        let end = (first + CHUNK).min(shared.gaussians.len());
        let (mut block, mut projected) = (Block::default(), Projected::default());
        for start in (first..end).step_by(BLOCK) {
            let count = BLOCK.min(end - start);
            for k in 0..count {
                block.load(k, shared.gaussians, start + k, &shared.camera, shared.dropout);
            }
            block.project(&shared.camera, shared.antialiased, shared.size, &mut projected);
            for k in 0..count {
                if projected.opacity[k] > 0.0 {
                    shared.keep(&projected, k, start + k, out);
                }
            }
        }
    }
}

impl Projection<'_> {
    /// Adds lane `k`, Gaussian `index`, to the splats if it reaches a computed tile.
    #[inline(always)]
    fn keep(&self, projected: &Projected, k: usize, index: usize, out: &mut ChunkSplats) {
        let (mut splat, extent) = projected.splat(k, index);
        if cover(&mut splat, &extent, self.grid, self.mask, &mut out.spans) {
            let colour = view_colour(self.gaussians, index, &self.camera, self.degree);
            splat.colour = colour.max(glam::Vec3::ZERO).to_array();
            out.splats.push(splat);
        }
    }
}

/// Projects the chunks with these numbers.
fn project_chunks(shared: &Projection, numbers: &[usize], chunks: &mut [ChunkSplats]) {
    let arch = instructions();
    chunks.par_iter_mut().zip(numbers).for_each(|(out, number)| {
        arch.dispatch(ProjectChunk { shared, first: number * CHUNK, out });
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
