//! The seeded scenes of all benchmarks: discs of the size of their spacing on a ground and three walls, as a first
//! frame has them after some training.

use ffgs_core::{
    Camera, Gaussians, ImageRgb8, ImageSize, Intrinsics, Mask, PlanarImage, TrainingView, logit,
};
use ffgs_rasterizer::{Background, CpuRasterizer, FootprintSums, RenderOptions, RenderTape, TileMask, View};
use glam::{DMat4, DVec3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::{ThreadPool, ThreadPoolBuilder};

/// The area before the cameras: half width, depth, height of the walls (m).
const HALF_WIDTH: f32 = 12.0;
const DEPTH: f32 = 30.0;
const HEIGHT: f32 = 6.0;

/// A pool of so many threads.
pub(crate) fn pool(threads: usize) -> ThreadPool {
    ThreadPoolBuilder::new().num_threads(threads).build().expect("threads")
}

/// `n` discs; `spread` = standard deviation along the surface over the distance of neighbours.
pub(crate) fn discs(n: usize, sh_degree: usize, spread: f32) -> Gaussians {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let area = 2.0 * HALF_WIDTH * DEPTH + 2.0 * DEPTH * HEIGHT + 2.0 * HALF_WIDTH * HEIGHT;
    let spacing = (area / n as f32).sqrt();
    let mut out = Gaussians::zeros(n, sh_degree);
    let stride = out.sh_stride();
    for i in 0..n {
        let (mean, normal) = surface_point(rng.random::<f32>() * area, rng.random(), rng.random());
        out.means[i] = mean;
        // The third axis, the thin one, turned to the normal: identity, or a quarter turn about x or y.
        let half = std::f32::consts::FRAC_1_SQRT_2;
        out.quats[i] = [[half, 0.0, half, 0.0], [half, half, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0]][normal];
        let size = (spacing * spread).ln();
        let mut vary = |range: f32| range * (rng.random::<f32>() - 0.5);
        out.log_scales[i] = [size + vary(0.8), size + vary(0.8), size - 2.3 + vary(0.8)];
        out.opacity_logits[i] = logit(0.1 + 0.89 * rng.random::<f32>());
        for coefficient in 0..stride {
            let range = if coefficient == 0 { 2.0 } else { 0.1 };
            out.sh[i * stride + coefficient] = [0; 3].map(|_| range * (rng.random::<f32>() - 0.5));
        }
    }
    out
}

/// A point of the ground or of a wall, chosen by `area` (m^2), and the axis of its normal. Y points down.
fn surface_point(area: f32, u: f32, v: f32) -> ([f32; 3], usize) {
    let (ground, side) = (2.0 * HALF_WIDTH * DEPTH, DEPTH * HEIGHT);
    let across = HALF_WIDTH * (2.0 * u - 1.0);
    if area < ground {
        ([across, 0.0, DEPTH * v], 1)
    } else if area < ground + 2.0 * side {
        let x = if area < ground + side { -HALF_WIDTH } else { HALF_WIDTH };
        ([x, -HEIGHT * u, DEPTH * v], 0)
    } else {
        ([across, -HEIGHT * v, DEPTH], 2)
    }
}

/// A camera at eye height before the scene, moved sideways by `x` (m), 70 degrees wide.
pub(crate) fn camera(size: ImageSize, x: f64) -> Camera {
    let (w, h) = (size.width as f64, size.height as f64);
    let f = w / (2.0 * 35.0_f64.to_radians().tan());
    let intrinsics = Intrinsics { fx: f, fy: f, cx: w / 2.0, cy: h / 2.0 };
    let pose = DMat4::from_rotation_x(0.1) * DMat4::from_translation(DVec3::new(-x, 2.0, 1.0));
    Camera::new(intrinsics, pose, size).expect("a camera")
}

/// (pixel, Gaussian) pairs that are blended.
pub(crate) fn contributions(gaussians: &Gaussians, camera: &Camera, tiles: Option<&TileMask>) -> u64 {
    let view = View { camera, background: Background::Colour([0.0; 3]), tiles };
    let ones = vec![1.0; camera.size().pixels()];
    let (mut tape, mut sums) = (RenderTape::default(), FootprintSums::default());
    let rasterizer = CpuRasterizer::new(RenderOptions { sh_degree: Some(0), ..RenderOptions::default() });
    rasterizer.accumulate(gaussians, &view, &[&ones], &mut tape, &mut sums);
    (0..gaussians.len()).map(|i| u64::from(sums.hits(i))).sum()
}

/// A photograph that differs from the render everywhere, with a mask.
pub(crate) fn training_view(gaussians: &Gaussians, camera: Camera, mask: Mask) -> TrainingView {
    let view = View { camera: &camera, background: Background::Colour([0.3; 3]), tiles: None };
    let mut tape = RenderTape::default();
    CpuRasterizer::default().render(gaussians, &view, &mut tape);
    let mut photo: PlanarImage = tape.image().clone();
    photo.data_mut().iter_mut().enumerate().for_each(|(i, v)| *v = 0.9 * *v + 0.05 * (i as f32 * 0.01).sin());
    TrainingView { camera, image: ImageRgb8::from(&photo), mask }
}
