//! A circle around what moves in the last frame of a run, for its report.

use crate::outputs::folder::RunFolder;
use crate::outputs::json::write_json;
use crate::outputs::orbit::{clear_of, orbit};
use anyhow::Result;
use ffgs_core::{Camera, ImageRgb8, ImageSize, Intrinsics, Scene};
use ffgs_method::Capture;
use ffgs_reconstruction::Devices;
use ffgs_report::{Thumbnails, Turntable};

/// Pictures of the circle: a quarter of those of `ffgs render --orbit`, and one megabyte of the report at most.
const VIEWS: usize = 24;
const MOST_BYTES: usize = 30_000;
/// Longer side of a picture (px).
const SIDE: usize = 480;

/// Renders and encodes the circle. A run calls this once, when its frames are finished.
///
/// # Errors
/// When a camera of the capture cannot be read, the device fails, or the file cannot be written.
pub(crate) fn write_turntable(
    folder: &RunFolder,
    capture: &dyn Capture,
    frame: usize,
    scene: &Scene,
    devices: Devices,
) -> Result<()> {
    if scene.dynamic.gaussians.is_empty() {
        return Ok(());
    }
    let cameras = orbit(capture, &scene.dynamic.gaussians, frame, VIEWS)?;
    let scene = clear_of(scene, &cameras);
    let thumbnails = Thumbnails::of_bytes(MOST_BYTES);
    let mut pictures = Vec::with_capacity(VIEWS);
    for camera in &cameras {
        for picture in devices.render(&scene, &[reduced(camera)?])? {
            pictures.push(thumbnails.encode(&ImageRgb8::from(&picture))?);
        }
    }
    write_json(&folder.turntable(), &Turntable { frame, pictures })
}

/// The camera with an image of at most [`SIDE`] pixels.
fn reduced(camera: &Camera) -> Result<Camera> {
    let (size, lens) = (camera.size(), camera.intrinsics());
    let share = (SIDE as f64 / size.width.max(size.height) as f64).min(1.0);
    let scaled = |pixels: usize| ((pixels as f64 * share).round() as usize).max(1);
    let [fx, fy, cx, cy] = [lens.fx, lens.fy, lens.cx, lens.cy].map(|v| v * share);
    let size = ImageSize { width: scaled(size.width), height: scaled(size.height) };
    Ok(Camera::new(Intrinsics { fx, fy, cx, cy }, camera.camera_from_world(), size)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DMat4, DVec2, DVec3};

    #[test]
    fn a_reduced_camera_sees_the_same() {
        let lens = Intrinsics { fx: 1000.0, fy: 900.0, cx: 960.0, cy: 540.0 };
        let large = Camera::new(lens, DMat4::IDENTITY, ImageSize { width: 1920, height: 1080 }).unwrap();
        let small = reduced(&large).unwrap();
        assert_eq!(small.size(), ImageSize { width: 480, height: 270 });
        let point = DVec3::new(0.4, -0.2, 3.0);
        let (far, near) = (large.project(point).unwrap().pixel, small.project(point).unwrap().pixel);
        assert!((near - DVec2::new(far.x / 4.0, far.y / 4.0)).length() < 1e-9);
        assert_eq!(reduced(&small).unwrap(), small);
    }
}
