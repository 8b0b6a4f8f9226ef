//! A layer cut in two at a depth per tile is, put together again, the layer.

use ffgs_core::{Camera, Gaussians, ImageSize, Intrinsics};
use ffgs_rasterizer::{Background, CpuRasterizer, RenderTape, SplitLayers, TileDepths, View};
use ffgs_testkit::largest_difference;
use glam::DMat4;

const SIZE: ImageSize = ImageSize { width: 70, height: 50 };

/// Translucent balls at all depths from `near` to `far` (m), over the whole image.
fn balls(count: usize, near: f32, far: f32) -> Gaussians {
    let mut out = Gaussians::zeros(count, 0);
    for i in 0..count {
        let share = |k: usize| ((i * k) % count) as f32 / count as f32;
        let depth = near + (far - near) * share(7);
        out.means[i] = [(1.4 * share(5) - 0.7) * depth, (share(3) - 0.5) * depth, depth];
        out.quats[i] = [1.0, 0.0, 0.0, 0.0];
        out.log_scales[i] = [-2.2 + share(11), -2.0, -2.4];
        out.opacity_logits[i] = 3.0 * share(13) - 1.5;
        out.sh[i] = [share(17), share(19), share(23)].map(|v| 2.0 * v - 1.0);
    }
    out
}

#[test]
fn front_and_what_shows_of_the_rest_are_the_whole() {
    let intrinsics = Intrinsics { fx: 50.0, fy: 50.0, cx: 35.0, cy: 25.0 };
    let camera = Camera::new(intrinsics, DMat4::IDENTITY, SIZE).unwrap();
    let view = View { camera: &camera, background: Background::Colour([0.2, 0.5, 0.9]), tiles: None };
    let rasterizer = CpuRasterizer::default();
    let (layer, moving) = (balls(120, 2.0, 8.0), balls(9, 4.0, 5.0));

    let mut tape = RenderTape::default();
    rasterizer.render(&moving, &view, &mut tape);
    let depths = TileDepths::nearest(&tape);
    let mut split = SplitLayers::default();
    rasterizer.render_split(&layer, &view, &depths, &mut tape, &mut split);
    let (mut front_only, mut behind_only) = (0, 0);
    let mut joined = Vec::new();
    for p in 0..SIZE.pixels() {
        let through = split.transmittance[p];
        front_only += usize::from(through < 0.5);
        behind_only += usize::from(through == 1.0);
        let (front, behind) = (split.front.pixel(p), split.behind.pixel(p));
        joined.extend([0, 1, 2].map(|c| front[c] + through * behind[c]));
    }
    assert!(
        front_only > 100 && behind_only > 100,
        "{front_only} and {behind_only} pixels: the cut goes through"
    );

    rasterizer.render(&layer, &view, &mut tape);
    let whole: Vec<f32> = (0..SIZE.pixels()).flat_map(|p| tape.image().pixel(p)).collect();
    let error = largest_difference(&joined, &whole);
    // The whole stops where less than 1e-4 shows through; the part behind the cut does not know that.
    assert!(error < 1.1e-4, "{error:.1e}");
}
