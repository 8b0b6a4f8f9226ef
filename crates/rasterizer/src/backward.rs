//! The backward pass over tiles: from pixel derivatives to derivatives per (tile, splat) entry.

use crate::blend::{Contribution, TilePlane, Visitor, walk};
use crate::constants::{AREA, ENTRY, MAX_ALPHA, MIN_TRANSMITTANCE};
use crate::cpu::CpuRasterizer;
use crate::gradients::{Gradients, PixelGradients};
use crate::projection::{Ridge, Splat};
use crate::projection_backward::to_parameters;
use crate::tape::{RenderTape, TilePixels, for_each_pixel, gather};
use crate::tile_lists::{Entry, for_each_tile_slice};
use crate::view::View;
use ffgs_core::{Gaussians, instructions};
use pulp::{Simd, WithSimd};

impl CpuRasterizer {
    /// Adds to `out` the derivatives of a loss whose derivative with respect to the image (and transmittance) of
    /// `tape` is `upstream`. `gaussians` and `view` are those of the `render` call that filled `tape`.
    pub fn backward(
        &self,
        gaussians: &Gaussians,
        view: &View,
        tape: &mut RenderTape,
        upstream: &PixelGradients,
        out: &mut Gradients,
    ) {
        differentiate_tiles(view, tape, upstream);
        if let crate::Background::Colour(_) = view.background {
            add_background(view, tape, upstream, &mut out.background);
        }
        to_parameters(gaussians, view, self.options, tape, out);
    }
}

fn differentiate_tiles(view: &View, tape: &mut RenderTape, upstream: &PixelGradients) {
    let arch = instructions();
    let RenderTape { pixels, lists, splats, grid, entry_gradients, .. } = tape;
    entry_gradients.resize(lists.len(), [0.0; ENTRY]);
    for_each_tile_slice(&lists.starts, entry_gradients, &|tile, entries| {
        if !entries.is_empty() {
            let start = lists.starts[tile] as usize;
            let slots = &lists.slots[start..start + entries.len()];
            let input = TileUpstream::new(view, *grid, tile, &pixels[tile], upstream);
            arch.dispatch(TileBackward { origin: grid.origin(tile), splats, slots, input, entries });
        }
    });
}

fn add_background(view: &View, tape: &RenderTape, upstream: &PixelGradients, out: &mut [f64; 3]) {
    for (channel, sum) in out.iter_mut().enumerate() {
        let gradient = upstream.image.plane(channel);
        for (tile, pixels) in tape.pixels.iter().enumerate() {
            if view.tiles.is_none_or(|m| m.is_active(tile)) {
                for_each_pixel(view.camera.size(), tape.grid, tile, |pixel, local| {
                    *sum += f64::from(gradient[pixel]) * f64::from(pixels.transmittance.0[local]);
                });
            }
        }
    }
}

/// Pixel derivatives of one tile, and what of them does not depend on the splat.
struct TileUpstream {
    rgb: [TilePlane; 3],
    /// Derivative of the loss with respect to `ln T_final`, plus everything blended behind the current splat.
    behind: TilePlane,
}

impl TileUpstream {
    fn new(
        view: &View,
        grid: crate::tiles::TileGrid,
        tile: usize,
        pixels: &TilePixels,
        upstream: &PixelGradients,
    ) -> Self {
        let size = view.camera.size();
        let rgb = [0, 1, 2].map(|c| gather(size, grid, tile, upstream.image.plane(c)));
        let mut behind = TilePlane::ZERO;
        for_each_pixel(size, grid, tile, |pixel, local| {
            let background = view.background.pixel(pixel);
            let through = upstream.transmittance.map_or(0.0, |t| t[pixel])
                + (0..3).map(|c| rgb[c].0[local] * background[c]).sum::<f32>();
            let blended: f32 = (0..3).map(|c| rgb[c].0[local] * pixels.rgb[c].0[local]).sum();
            behind.0[local] = blended + pixels.transmittance.0[local] * through;
        });
        Self { rgb, behind }
    }
}

struct TileBackward<'a> {
    origin: [usize; 2],
    splats: &'a [Splat],
    slots: &'a [Entry],
    input: TileUpstream,
    entries: &'a mut [[f32; ENTRY]],
}

impl WithSimd for TileBackward<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { origin, splats, slots, mut input, entries } = self;
        entries.fill([0.0; ENTRY]);
        let zero = simd.splat_f32s(0.0);
        let [r, g, b] = &input.rgb;
        let mut visitor = Differentiate::<S> {
            rgb: [r, g, b].map(|plane| S::as_simd_f32s(&plane.0).0),
            behind: S::as_mut_simd_f32s(&mut input.behind.0).0,
            colour: [zero; 3],
            opacity: zero,
            ridge: Ridge::default(),
            sums: [zero; ENTRY],
            entries,
        };
        let mut transmittance = TilePlane([1.0; AREA]);
        walk(simd, origin, splats, slots, MIN_TRANSMITTANCE, &mut transmittance, &mut visitor);
    }
}

/// Front to back: `behind` starts as everything the pixel shows (weighted by the upstream derivative) and loses each
/// contribution in turn, so no transmittance is ever divided back out of a product.
struct Differentiate<'a, S: Simd> {
    rgb: [&'a [S::f32s]; 3],
    behind: &'a mut [S::f32s],
    colour: [S::f32s; 3],
    opacity: S::f32s,
    ridge: Ridge,
    /// As [`ENTRY`] has them, but for the first two: first moments of the derivative with respect to the exponent.
    sums: [S::f32s; ENTRY],
    entries: &'a mut [[f32; ENTRY]],
}

impl<S: Simd> Visitor<S> for Differentiate<'_, S> {
    #[inline(always)]
    fn begin(&mut self, simd: S, splat: &Splat) {
        // Plain loops: a closure handed to `map` would be compiled without the dispatched instruction set.
        for k in 0..3 {
            self.colour[k] = simd.splat_f32s(splat.colour[k]);
        }
        self.opacity = simd.splat_f32s(splat.opacity);
        self.ridge = Ridge::of(splat);
        self.sums = [simd.splat_f32s(0.0); ENTRY];
    }

    #[inline(always)]
    fn visit(&mut self, simd: S, c: &Contribution<S>) {
        let (zero, one) = (simd.splat_f32s(0.0), simd.splat_f32s(1.0));
        let g = [self.rgb[0][c.vector], self.rgb[1][c.vector], self.rgb[2][c.vector]];
        let mut shade = simd.mul_f32s(g[0], self.colour[0]);
        shade = simd.mul_add_e_f32s(g[1], self.colour[1], shade);
        shade = simd.mul_add_e_f32s(g[2], self.colour[2], shade);
        let behind = simd.sub_f32s(self.behind[c.vector], simd.mul_f32s(c.weight, shade));
        self.behind[c.vector] = behind;
        let hidden = simd.div_f32s(behind, simd.sub_f32s(one, c.alpha));
        let d_alpha = simd.sub_f32s(simd.mul_f32s(c.transmittance, shade), hidden);
        let free = simd.less_than_f32s(simd.mul_f32s(self.opacity, c.falloff), simd.splat_f32s(MAX_ALPHA));
        let d_alpha = simd.select_f32s(simd.and_m32s(c.counts, free), d_alpha, zero);
        // Far from the splat the exponential's polynomial overflows: 0 times that would be NaN.
        let falloff = simd.select_f32s(c.counts, c.falloff, zero);
        let d_opacity = simd.mul_f32s(d_alpha, falloff);
        // With respect to the exponent: alpha = o exp(-sigma).
        let d_exponent = simd.mul_f32s(d_opacity, self.opacity);
        let (ex, ey) = (simd.mul_f32s(d_exponent, c.from_ridge), simd.mul_f32s(d_exponent, c.dy));
        self.sums[0] = simd.add_f32s(self.sums[0], ex);
        self.sums[1] = simd.add_f32s(self.sums[1], ey);
        self.sums[2] = simd.mul_add_e_f32s(ex, c.from_ridge, self.sums[2]);
        self.sums[3] = simd.mul_add_e_f32s(ex, c.dy, self.sums[3]);
        self.sums[4] = simd.mul_add_e_f32s(ey, c.dy, self.sums[4]);
        self.sums[5] = simd.add_f32s(self.sums[5], d_opacity);
        for k in 0..3 {
            self.sums[6 + k] = simd.mul_add_e_f32s(c.weight, g[k], self.sums[6 + k]);
        }
    }

    #[inline(always)]
    fn end(&mut self, simd: S, place: usize) {
        let mut s = [0.0; ENTRY];
        for k in 0..ENTRY {
            s[k] = simd.reduce_sum_f32s(self.sums[k]);
        }
        // sigma = a e^2 / 2 + dy^2 / (2 yy) with e = dx - slope dy; dx and dy fall as the mean grows.
        let Ridge { a, slope, inverse_yy } = self.ridge;
        let by_x = a * s[0];
        s[0] = by_x;
        s[1] = s[1] * inverse_yy - slope * by_x;
        self.entries[place] = s;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cpu::BlendTile;
    use crate::view::{Background, RenderOptions};
    use ffgs_core::{Camera, ImageSize, Intrinsics, PlanarImage};
    use ffgs_testkit::vectorised;

    const SIZE: ImageSize = ImageSize { width: 48, height: 32 };

    fn scene() -> (Gaussians, Camera) {
        let mut g = Gaussians::zeros(40, 0);
        for i in 0..g.len() {
            let spread = |k: usize| ((i * k) % 17) as f32 / 17.0 - 0.5;
            g.means[i] = [3.0 * spread(5), 2.0 * spread(7), 4.0 + spread(3)];
            g.quats[i] = [1.0, spread(11), spread(13), spread(2)];
            g.log_scales[i] = [-2.0 + spread(9), -1.5 + spread(4), -2.5];
            g.opacity_logits[i] = 2.0 * spread(6);
            g.sh[i] = [spread(8), spread(10), spread(12)];
        }
        let intrinsics = Intrinsics { fx: 40.0, fy: 42.0, cx: 24.0, cy: 16.0 };
        (g, Camera::new(intrinsics, glam::DMat4::IDENTITY, SIZE).unwrap())
    }

    /// Pixels of all tiles and sums of all entries, with one instruction set.
    fn both_passes(set: usize) -> Option<Vec<f32>> {
        let (gaussians, camera) = scene();
        let view = View { camera: &camera, background: Background::Colour([0.2, 0.4, 0.6]), tiles: None };
        let mut tape = RenderTape::default();
        CpuRasterizer::new(RenderOptions::default()).prepare(&[&gaussians], &view, &mut tape);
        let mut upstream = PlanarImage::zeros(SIZE);
        upstream.data_mut().iter_mut().enumerate().for_each(|(i, v)| *v = (i as f32 * 0.1).sin());
        let upstream = PixelGradients { image: &upstream, transmittance: None };
        let mut out = Vec::new();
        for tile in 0..tape.grid.count() {
            let (start, end) = (tape.lists.starts[tile] as usize, tape.lists.starts[tile + 1] as usize);
            let (slots, splats) = (&tape.lists.slots[start..end], &tape.splats[..]);
            let (origin, mut pixels) = (tape.grid.origin(tile), TilePixels::default());
            let mut entries = vec![[0.0; ENTRY]; slots.len()];
            vectorised(set, BlendTile { origin, splats, slots, out: &mut pixels })?;
            let input = TileUpstream::new(&view, tape.grid, tile, &pixels, &upstream);
            vectorised(set, TileBackward { origin, splats, slots, input, entries: &mut entries })?;
            out.extend(pixels.rgb.iter().flat_map(|plane| plane.0));
            out.extend(pixels.transmittance.0);
            out.extend(entries.as_flattened());
        }
        Some(out)
    }

    #[test]
    fn every_instruction_set_gives_the_same_within_rounding() {
        let portable = both_passes(0).unwrap();
        assert!(portable.iter().any(|v| v.abs() > 0.5));
        for wide in [1, 2].into_iter().filter_map(both_passes) {
            for (i, (a, b)) in portable.iter().zip(&wide).enumerate() {
                // Fused and separate multiply-adds differ in the last bits, which sums over a tile add up.
                assert!((a - b).abs() <= 2e-5 * a.abs().max(1.0), "value {i}: {a} and {b}");
            }
        }
    }
}
