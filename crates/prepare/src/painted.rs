//! Pictures of a painted wall behind a floor, for tests.

use crate::views::View;
use ffgs_core::{Camera, ImageRgb8, ImageSize, Intrinsics};
use glam::{DMat4, DVec2, DVec3};

pub(crate) const SIZE: ImageSize = ImageSize { width: 72, height: 48 };
/// Wall at this distance (m), floor this far below the cameras (m).
pub(crate) const WALL: f64 = 6.0;
pub(crate) const FLOOR: f64 = 1.0;

/// Of cameras in a row, 0.2 m apart: what is seen at each pixel has the grey that `shade` gives it (0 to 1).
pub(crate) fn view(i: usize, shade: impl Fn(DVec3, usize) -> f64) -> View {
    let intrinsics = Intrinsics { fx: 60.0, fy: 60.0, cx: 36.0, cy: 24.0 };
    let pose = DMat4::from_translation(DVec3::X * (0.4 - 0.2 * i as f64));
    let camera = Camera::new(intrinsics, pose, SIZE).unwrap();
    let value = |p: usize| {
        let pixel = DVec2::new((p % SIZE.width) as f64 + 0.5, (p / SIZE.width) as f64 + 0.5);
        (shade(hit(&camera, pixel), p) * 255.0).round() as u8
    };
    let data = (0..SIZE.pixels()).flat_map(|p| [value(p); 3]).collect();
    View { camera, image: ImageRgb8::new(SIZE, data).unwrap(), mask: None }
}

/// Smooth waves on the wall and on the floor.
pub(crate) fn painted(p: DVec3, _: usize) -> f64 {
    if on_wall(p) { texture(p.x, p.y) } else { texture(p.x, p.z) }
}

/// Whether a point is on the wall and not on the floor.
pub(crate) fn on_wall(p: DVec3) -> bool {
    p.z > WALL - 1e-6
}

/// What no two views have in common.
pub(crate) fn noise(view: usize, pixel: usize) -> f64 {
    let mixed = ((view * SIZE.pixels() + pixel) as u64 + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    let mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    (mixed >> 40) as f64 / (1_u64 << 24) as f64
}

/// Grey of a surface at two coordinates (m).
fn texture(u: f64, v: f64) -> f64 {
    let waves = [(5.1, 1.3), (3.7, -4.1), (-1.9, 6.3), (7.9, 2.7), (0.7, -8.3)];
    0.5 + waves.iter().map(|(a, b)| 0.09 * (a * u + b * v + a * b).sin()).sum::<f64>()
}

/// What a camera sees along a ray: the wall, or the floor before it.
fn hit(camera: &Camera, pixel: DVec2) -> DVec3 {
    let ray = camera.ray(pixel);
    let wall = (WALL - camera.center().z) / ray.z;
    let floor = (FLOOR - camera.center().y) / ray.y;
    camera.center() + ray * if floor > 0.0 { wall.min(floor) } else { wall }
}
