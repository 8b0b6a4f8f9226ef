//! The K largest contributions of every pixel.

use crate::blend::{AREA, Contribution, MIN_TRANSMITTANCE, TilePlane, Visitor, walk};
use crate::contract::View;
use crate::cpu::{CpuRasterizer, tile_origin};
use crate::projection::Splat;
use crate::tape::{RenderTape, for_each_pixel};
use crate::tile_lists::Entry;
use crate::tiles::TILE;
use ffgs_core::Gaussians;
use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

/// Indices and weights `alpha T` of the K largest contributions a pixel, heaviest first.
#[derive(Clone, Debug, Default)]
pub struct TopContributors {
    /// K.
    pub count: usize,
    /// (H, W, K) Gaussian indices, -1 = empty.
    pub indices: Vec<i32>,
    /// (H, W, K) weights, 0 where empty.
    pub weights: Vec<f32>,
}

impl CpuRasterizer {
    /// Renders `gaussians` and lists the `count` largest contributions of each pixel.
    pub fn top_contributors(
        &self,
        gaussians: &Gaussians,
        view: &View,
        count: usize,
        tape: &mut RenderTape,
    ) -> TopContributors {
        self.prepare(gaussians, view, tape);
        let (size, grid, lists, splats) = (view.camera.size(), tape.grid, &tape.lists, &tape.splats);
        let (arch, width) = (Arch::new(), size.width);
        let n = size.pixels() * count;
        let mut out = TopContributors { count, indices: vec![-1; n], weights: vec![0.0; n] };
        let band = (TILE * width * count).max(1);
        let rows = out.indices.par_chunks_mut(band).zip(out.weights.par_chunks_mut(band)).enumerate();
        rows.for_each(|(row, (indices, weights))| {
            let mut best = vec![(-1, 0.0); AREA * count];
            for tile in row * grid.columns..(row + 1) * grid.columns {
                let slots = &lists.slots[lists.starts[tile] as usize..lists.starts[tile + 1] as usize];
                best.fill((-1, 0.0));
                let origin = tile_origin(tile, grid);
                arch.dispatch(TopTile { origin, splats, slots, count, best: &mut best });
                for_each_pixel(size, grid, tile, |pixel, local| {
                    let first = (pixel - origin[1] * width) * count;
                    for (k, &(index, weight)) in best[local * count..][..count].iter().enumerate() {
                        (indices[first + k], weights[first + k]) = (index, weight);
                    }
                });
            }
        });
        out
    }
}

struct TopTile<'a> {
    origin: [usize; 2],
    splats: &'a [Splat],
    slots: &'a [Entry],
    count: usize,
    best: &'a mut [(i32, f32)],
}

impl WithSimd for TopTile<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { origin, splats, slots, count, best } = self;
        let mut visitor = Keep { index: -1, count, best };
        walk(simd, origin, splats, slots, MIN_TRANSMITTANCE, &mut TilePlane::ONE.clone(), &mut visitor);
    }
}

struct Keep<'a> {
    index: i32,
    count: usize,
    best: &'a mut [(i32, f32)],
}

impl<S: Simd> Visitor<S> for Keep<'_> {
    #[inline(always)]
    fn begin(&mut self, _: S, splat: &Splat) {
        self.index = splat.index as i32;
    }

    #[inline(always)]
    fn visit(&mut self, simd: S, c: &Contribution<S>) {
        let mut weights = [0.0; 16];
        simd.partial_store_f32s(&mut weights[..S::F32_LANES], c.weight);
        for (lane, &weight) in weights[..S::F32_LANES].iter().enumerate().filter(|(_, w)| **w > 0.0) {
            let pixel = c.vector * S::F32_LANES + lane;
            insert(&mut self.best[pixel * self.count..(pixel + 1) * self.count], (self.index, weight));
        }
    }

    #[inline(always)]
    fn end(&mut self, _: S, _: usize) {}
}

/// Keeps a descending list; of equal weights the one in front stays first.
fn insert(list: &mut [(i32, f32)], candidate: (i32, f32)) {
    let place = list.partition_point(|&(_, w)| w >= candidate.1);
    if place < list.len() {
        list[place..].rotate_right(1);
        list[place] = candidate;
    }
}
