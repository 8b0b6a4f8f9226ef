//! A small scene with photographs, for tests of this crate.

use ffgs_core::{
    Camera, Gaussians, ImageRgb8, ImageSize, Intrinsics, Mask, PlanarImage, SkyCube, TrainingView,
};
use ffgs_rasterizer::{Background, CpuRasterizer, Information, RenderTape, View};
use ffgs_trainer::SkyView;
use glam::{DMat3, DMat4, DVec3};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::sync::Arc;

pub(crate) const SIZE: ImageSize = ImageSize { width: 45, height: 35 };
pub(crate) const SKY: [f32; 3] = [0.5, 0.6, 0.8];

pub(crate) fn camera(angle: f64) -> Camera {
    let intrinsics = Intrinsics { fx: 40.0, fy: 42.0, cx: 22.3, cy: 17.8 };
    let pose = DMat4::from_translation(DVec3::new(0.0, 0.0, 4.0)) * DMat4::from_rotation_y(angle);
    Camera::new(intrinsics, pose, SIZE).unwrap()
}

pub(crate) fn cameras() -> [Camera; 4] {
    [-0.4, -0.1, 0.2, 0.5].map(camera)
}

/// A blob of Gaussians around `center`.
pub(crate) fn blob(n: usize, center: [f32; 3], radius: f32, seed: u64) -> Gaussians {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut out = Gaussians::zeros(n, 1);
    for i in 0..n {
        out.means[i] = center.map(|c| c + rng.random_range(-radius..radius));
        out.quats[i] = [0; 4].map(|_| rng.random_range(-1.0..1.0));
        out.log_scales[i] = [0; 3].map(|_| rng.random_range(-3.0..-1.3));
        out.opacity_logits[i] = rng.random_range(-1.0..3.0);
    }
    out.sh.as_flattened_mut().iter_mut().for_each(|v| *v = rng.random_range(-0.7..0.7));
    out
}

/// As an optimiser finds it: moved and recoloured.
pub(crate) fn perturbed(g: &Gaussians, seed: u64) -> Gaussians {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut out = g.clone();
    out.means.as_flattened_mut().iter_mut().for_each(|v| *v += rng.random_range(-0.03..0.03));
    out.sh.as_flattened_mut().iter_mut().for_each(|v| *v += rng.random_range(-0.2..0.2));
    out
}

pub(crate) fn render(g: &Gaussians, sky: &SkyCube, camera: &Camera) -> PlanarImage {
    let mut behind = PlanarImage::zeros(SIZE);
    SkyView::new(camera, sky.face_size()).render(sky, &mut behind);
    let view = View { camera, background: Background::Image(&behind), tiles: None };
    let mut tape = RenderTape::default();
    CpuRasterizer::default().render(g, &view, &mut tape);
    tape.image().clone()
}

/// Photographs of `truth`, with the pixels that `moving` covers as masks.
pub(crate) fn photographs(truth: &Gaussians, moving: &Gaussians) -> Vec<TrainingView> {
    let (sky, black) = (SkyCube::filled(8, SKY), SkyCube::filled(8, [0.0; 3]));
    let mut white = moving.clone();
    let stride = white.sh_stride();
    white.sh.iter_mut().step_by(stride).for_each(|sh0| *sh0 = [10.0; 3]);
    let view = |camera: Camera| {
        let covered = render(&white, &black, &camera);
        let mask = covered.plane(0).iter().map(|&v| u8::from(v > 0.4)).collect();
        TrainingView {
            camera,
            image: ImageRgb8::from(&render(truth, &sky, &camera)),
            mask: Mask::new(SIZE, mask).unwrap(),
        }
    };
    cameras().into_iter().map(view).collect()
}

pub(crate) fn mean_psnr(g: &Gaussians, sky: &SkyCube, views: &[TrainingView]) -> f64 {
    let psnr = |v: &TrainingView| {
        let (found, truth) = (render(g, sky, &v.camera), PlanarImage::from(&v.image));
        let squares: f64 = found.data().iter().zip(truth.data()).map(|(a, b)| f64::from(a - b).powi(2)).sum();
        -10.0 * (squares / found.data().len() as f64).log10()
    };
    views.iter().map(psnr).sum::<f64>() / views.len() as f64
}

pub(crate) fn joint(a: &Gaussians, b: &Gaussians) -> Gaussians {
    let mut out = a.clone();
    out.extend(b);
    out
}

/// A scene with everything that the lanes need.
pub(crate) struct World {
    pub(crate) moving: Gaussians,
    pub(crate) fixed: Arc<Gaussians>,
    pub(crate) sky: SkyCube,
    pub(crate) views: Vec<TrainingView>,
}

pub(crate) fn world() -> World {
    let (moving, fixed) = (blob(30, [0.0; 3], 0.4, 6), blob(60, [0.0, 0.2, 0.3], 1.6, 7));
    let views = photographs(&joint(&moving, &fixed), &moving);
    World { moving, fixed: Arc::new(fixed), sky: SkyCube::filled(8, SKY), views }
}

/// Diagonals as large as photographs make them, blocks that are no diagonals.
pub(crate) fn information(n: usize) -> Information {
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let block = |rng: &mut ChaCha8Rng| {
        let root = DMat3::from_cols_array(&[(); 9].map(|()| rng.random_range(-1.0..1.0)));
        (root * root.transpose()) * 3e5
    };
    let mut others = Gaussians::zeros(n, 1);
    let mut fill = |column: &mut [f32]| column.iter_mut().for_each(|v| *v = rng.random_range(2e3..2e5));
    fill(others.quats.as_flattened_mut());
    fill(others.log_scales.as_flattened_mut());
    fill(&mut others.opacity_logits);
    fill(others.sh.as_flattened_mut());
    others.quats.iter_mut().for_each(|q| q[0] = 0.0);
    Information { positions: (0..n).map(|_| block(&mut rng)).collect(), others }
}
