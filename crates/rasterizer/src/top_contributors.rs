//! The K largest contributions of every pixel.

use crate::blend::{Contribution, TilePlane, Visitor, walk};
use crate::constants::{AREA, MIN_TRANSMITTANCE, TILE};
use crate::cpu::CpuRasterizer;
use crate::projection::Splat;
use crate::tape::{RenderTape, for_each_pixel};
use crate::tile_lists::Entry;
use crate::view::View;
use ffgs_core::{Gaussians, ImageSize, instructions};
use pulp::{Simd, WithSimd};
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
    /// Sorts `gaussians` into `tape` and lists the `count` largest contributions of each pixel.
    pub fn top_contributors(
        &self,
        gaussians: &Gaussians,
        view: &View,
        count: usize,
        tape: &mut RenderTape,
    ) -> TopContributors {
        self.prepare(&[gaussians], view, tape);
        TopContributors::of(tape, view.camera.size(), count, |_| true)
    }
}

impl TopContributors {
    /// Those of the pixels (row by row) that are `wanted`, in a view of this `size` that was rendered or prepared; the lists of all others stay
    /// empty.
    pub fn of(
        tape: &RenderTape,
        size: ImageSize,
        count: usize,
        wanted: impl Fn(usize) -> bool + Sync,
    ) -> Self {
        let mut out = Self::default();
        out.list(tape, size, count, wanted);
        out
    }

    /// The same in the memory of earlier lists.
    pub fn list(
        &mut self,
        tape: &RenderTape,
        size: ImageSize,
        count: usize,
        wanted: impl Fn(usize) -> bool + Sync,
    ) {
        let (grid, lists, splats) = (tape.grid, &tape.lists, &tape.splats);
        let width = size.width;
        let n = size.pixels() * count;
        self.count = count;
        self.indices.resize(n, -1);
        self.weights.resize(n, 0.0);
        let band = (TILE * width * count).max(1);
        let rows = self.indices.par_chunks_mut(band).zip(self.weights.par_chunks_mut(band)).enumerate();
        rows.for_each(|(row, (indices, weights))| {
            indices.fill(-1);
            weights.fill(0.0);
            let mut heaviest = Heaviest::default();
            for tile in row * grid.columns..(row + 1) * grid.columns {
                let slots = &lists.slots[lists.starts[tile] as usize..lists.starts[tile + 1] as usize];
                let origin = grid.origin(tile);
                if slots.is_empty() {
                    continue;
                }
                let mut open = TilePlane::ZERO;
                for_each_pixel(size, grid, tile, |pixel, local| {
                    open.0[local] = f32::from(u8::from(wanted(pixel)));
                });
                heaviest.find(origin, splats, slots, MIN_TRANSMITTANCE, count, &open);
                for_each_pixel(size, grid, tile, |pixel, local| {
                    let first = (pixel - origin[1] * width) * count;
                    for (k, (walked, weight)) in heaviest.of(local).enumerate() {
                        (indices[first + k], weights[first + k]) = (walked.index as i32, weight);
                    }
                });
            }
        });
    }
}

/// A splat of a tile.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Walked {
    /// Its Gaussian.
    pub(crate) index: u32,
    /// Where the tile keeps its sums.
    pub(crate) place: usize,
}

/// The heaviest contributions of each pixel of a tile.
#[derive(Clone, Debug, Default)]
pub(crate) struct Heaviest {
    count: usize,
    /// Splats that the walk reached.
    walked: Vec<Walked>,
    /// (pixels, count) which of them, and `alpha T`; 0 where empty.
    best: Vec<(u32, f32)>,
}

impl Heaviest {
    /// Walks over a tile, down to the transmittance `finished`, and keeps the `count` heaviest of each pixel. `open` is the
    /// transmittance to begin with: 0 in pixels that do not count.
    pub(crate) fn find(
        &mut self,
        origin: [usize; 2],
        splats: &[Splat],
        slots: &[Entry],
        finished: f32,
        count: usize,
        open: &TilePlane,
    ) {
        self.count = count;
        self.walked.clear();
        self.best.clear();
        self.best.resize(AREA * count, (0, 0.0));
        instructions().dispatch(TopTile { origin, splats, slots, finished, open, heaviest: self });
    }

    /// Those of one pixel with their weights, heaviest first.
    pub(crate) fn of(&self, pixel: usize) -> impl Iterator<Item = (Walked, f32)> {
        let best = &self.best[pixel * self.count..(pixel + 1) * self.count];
        best.iter()
            .take_while(|(_, weight)| *weight > 0.0)
            .map(|&(n, weight)| (self.walked[n as usize], weight))
    }
}

struct TopTile<'a> {
    origin: [usize; 2],
    splats: &'a [Splat],
    slots: &'a [Entry],
    finished: f32,
    open: &'a TilePlane,
    heaviest: &'a mut Heaviest,
}

impl WithSimd for TopTile<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { origin, splats, slots, finished, open, heaviest } = self;
        walk(simd, origin, splats, slots, finished, &mut open.clone(), heaviest);
    }
}

impl<S: Simd> Visitor<S> for Heaviest {
    #[inline(always)]
    fn begin(&mut self, _: S, splat: &Splat) {
        self.walked.push(Walked { index: splat.index, place: 0 });
    }

    #[inline(always)]
    fn visit(&mut self, simd: S, c: &Contribution<S>) {
        let mut weights = [0.0; 16];
        simd.partial_store_f32s(&mut weights[..S::F32_LANES], c.weight);
        for (lane, &weight) in weights[..S::F32_LANES].iter().enumerate().filter(|(_, w)| **w > 0.0) {
            let pixel = c.vector * S::F32_LANES + lane;
            let candidate = (self.walked.len() as u32 - 1, weight);
            insert(&mut self.best[pixel * self.count..(pixel + 1) * self.count], candidate);
        }
    }

    #[inline(always)]
    fn end(&mut self, _: S, place: usize) {
        if let Some(walked) = self.walked.last_mut() {
            walked.place = place;
        }
    }
}

/// Keeps a descending list; of equal weights the one in front stays first.
fn insert(list: &mut [(u32, f32)], candidate: (u32, f32)) {
    // Most of what comes after a list is full weighs less than all of it.
    let Some(mut place) = list.len().checked_sub(1).filter(|&last| list[last].1 < candidate.1) else {
        return;
    };
    while place > 0 && list[place - 1].1 < candidate.1 {
        list[place] = list[place - 1];
        place -= 1;
    }
    list[place] = candidate;
}
