//! What a lane cannot do without, in bytes. docs/bench lists the same terms.

use crate::scene::camera;
use ffgs_core::{Camera, Gaussians, ImageSize};
use ffgs_rasterizer::{
    Background, CpuRasterizer, RenderOptions, RenderTape, TileMask, TopContributors, View,
};

/// Parameters of a Gaussian with SH of degree 3: position 3, rotation 4, scales 3, opacity 1, colour 48.
const PARAMETERS: usize = 59;
/// Parameters, their gradient and Adam's two moments, f32.
const TRAINED: usize = 4 * 4 * PARAMETERS;
/// Parameters alone.
const FROZEN: usize = 4 * PARAMETERS;
/// Photograph and mask of a view's pixel.
const PHOTO: usize = 4;
/// Per pixel of the view at hand, f32: image 3, transmittance 1, what lies behind 3, gradient 3, sums per tile 4, and the
/// loss's derivatives by its three window sums in three channels 9.
const PIXEL: usize = 4 * (3 + 1 + 3 + 3 + 4 + 9);
/// A visible splat: one cache line, its place in the list of pairs, and the tile spans (12 bytes, about two).
const SPLAT: usize = 64 + 4 + 24;
/// A (tile, splat) pair: sorted entry 8, place by splat 4, nine sums of the backward pass.
const PAIR: usize = 8 + 4 + 36;

/// Splats and pairs of one render.
fn tape(gaussians: &Gaussians, camera: &Camera, tiles: Option<&TileMask>) -> usize {
    let view = View { camera, background: Background::Colour([0.0; 3]), tiles };
    let mut tape = RenderTape::default();
    let options = RenderOptions { sh_degree: Some(0), ..RenderOptions::default() };
    CpuRasterizer::new(options).render(gaussians, &view, &mut tape);
    tape.visible() * SPLAT + tape.tile_pairs() * PAIR
}

/// Steps of frame 0.
pub(crate) fn first_frame(gaussians: &Gaussians, size: ImageSize, views: usize) -> usize {
    let pixels = size.pixels();
    gaussians.len() * TRAINED + pixels * (views * PHOTO + PIXEL) + tape(gaussians, &camera(size, 0.0), None)
}

/// The dynamic lane: both layers, the photographs, and for each pixel of a computed tile what the static layer shows in
/// front and behind, the transmittance between (7 f32), and the region (1).
pub(crate) fn dynamic(
    moving: &Gaussians,
    still: &Gaussians,
    size: ImageSize,
    tiles: &TileMask,
    views: usize,
) -> usize {
    const CACHED: usize = 4 * 7 + 1;
    let active = tiles.count() * 256;
    let layers = moving.len() * TRAINED + still.len() * FROZEN;
    let images = size.pixels() * (views * PHOTO + PIXEL) + active * views * CACHED;
    layers + images + tape(moving, &camera(size, 0.0), Some(tiles))
}

/// The static lane's solve: the layer, five vectors of conjugate gradients over its colours, the photographs, and per
/// view the residual (3 f32) and the contributors of every pixel (8 bytes each, and where they start).
pub(crate) fn static_solve(layer: &Gaussians, size: ImageSize, views: usize) -> usize {
    const CONTRIBUTORS: usize = 16;
    const VECTORS: usize = 5;
    let camera = camera(size, 0.0);
    let view = View { camera: &camera, background: Background::Colour([0.0; 3]), tiles: None };
    let rasterizer = CpuRasterizer::new(RenderOptions { sh_degree: Some(0), ..RenderOptions::default() });
    let top: TopContributors =
        rasterizer.top_contributors(layer, &view, CONTRIBUTORS, &mut RenderTape::default());
    let mut seen = vec![false; layer.len()];
    top.indices.iter().filter(|i| **i >= 0).for_each(|&i| seen[i as usize] = true);
    let seen = seen.iter().filter(|s| **s).count();
    let kept = top.indices.iter().filter(|i| **i >= 0).count();
    // Of each Gaussian that a view sees: basis 16, colour and whether it answers 6, what comes back 3, place 1.
    let a_view = size.pixels() * (PHOTO + 12 + 4) + kept * 8 + seen * 4 * (16 + 6 + 3 + 1);
    layer.len() * (FROZEN + VECTORS * 4 * 48) + views * a_view
}
