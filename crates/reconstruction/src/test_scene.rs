//! A patterned ball that six cameras photograph, for the tests.

use ffgs_core::{
    Camera, Dynamic, Gaussians, ImageRgb8, ImageSize, Intrinsics, Mask, Scene, SkyCube, TrainingView,
};
use ffgs_motion::join;
use ffgs_rasterizer::{Background, CpuRasterizer, RenderTape, View};
use ffgs_testkit::look_at;
use ffgs_trainer::from_points;
use glam::{DVec3, Vec3};

/// Of the photographs.
pub(crate) const SIZE: ImageSize = ImageSize { width: 96, height: 72 };
/// Of the sky.
const GREY: [f32; 3] = [0.3; 3];

/// Discs on a ball of 0.6 m around a place, coloured by waves over it.
pub(crate) fn ball(centre: Vec3) -> Gaussians {
    let place = |i: usize| {
        let z = 1.0 - (2.0 * i as f32 + 1.0) / 1500.0;
        let (sin, cos) = (2.399_963 * i as f32).sin_cos();
        let ring = (1.0 - z * z).sqrt();
        Vec3::new(ring * cos, ring * sin, z) * 0.6
    };
    let places: Vec<Vec3> = (0..1500).map(place).collect();
    let colours: Vec<[f32; 3]> =
        places.iter().map(|p| (*p * 7.0).to_array().map(|v| 0.5 + 0.4 * v.sin())).collect();
    let positions: Vec<[f32; 3]> = places.iter().map(|p| (*p + centre).to_array()).collect();
    from_points(&positions, &colours, 1, 0.95)
}

/// Of nothing but what moves.
pub(crate) fn scene(moving: &Gaussians) -> Scene {
    let dynamic = Dynamic { gaussians: Gaussians::zeros(0, 1), ..Dynamic::default() };
    let mut scene = Scene::new(Gaussians::zeros(0, 1), dynamic, SkyCube::filled(8, GREY));
    join(&mut scene.dynamic, moving, &photographs(moving));
    scene
}

/// Six cameras over half a circle, and what they see of `moving`.
pub(crate) fn photographs(moving: &Gaussians) -> Vec<TrainingView> {
    photographs_from(moving, 0.6)
}

/// The same from cameras at a height (m).
pub(crate) fn photographs_from(moving: &Gaussians, height: f64) -> Vec<TrainingView> {
    let view = |i: usize| {
        let (sin, cos) = (i as f64 * 0.5).sin_cos();
        let pose = look_at(DVec3::new(5.0 * cos, 5.0 * sin, height), DVec3::ZERO);
        let intrinsics = Intrinsics { fx: 90.0, fy: 90.0, cx: 48.0, cy: 36.0 };
        let camera = Camera::new(intrinsics, pose, SIZE).unwrap();
        let shown = View { camera: &camera, background: Background::Colour(GREY), tiles: None };
        let mut tape = RenderTape::default();
        CpuRasterizer::default().render(moving, &shown, &mut tape);
        let mask = tape.transmittance().iter().map(|&t| u8::from(t < 0.5)).collect();
        TrainingView { camera, image: ImageRgb8::from(tape.image()), mask: Mask::new(SIZE, mask).unwrap() }
    };
    (0..6).map(view).collect()
}

/// The same photographs, in which nothing counts as foreground.
pub(crate) fn without_masks(views: Vec<TrainingView>) -> Vec<TrainingView> {
    views.into_iter().map(|view| TrainingView { mask: Mask::filled(SIZE, false), ..view }).collect()
}
