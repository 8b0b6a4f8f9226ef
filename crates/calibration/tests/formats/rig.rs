//! The rig that is written in every format, and what reads it.

use ffgs_calibration::{Distortion, Footage, SourceCamera, detect};
use glam::{DMat3, DMat4, DVec2, DVec3};
use std::fs;
use std::path::Path;
use tempfile::TempDir;

pub(crate) const WIDTH: u32 = 64;
pub(crate) const HEIGHT: u32 = 48;
pub(crate) const K: [f64; 4] = [70.0, 72.0, 33.5, 22.25];
pub(crate) const BROWN: [f64; 5] = [-0.11, 0.02, 0.001, -0.002, 0.003];

/// Two cameras two metres from the origin, a quarter turn about the vertical (y down) apart.
pub(crate) fn poses() -> [DMat4; 2] {
    [0.2, 0.2 + std::f64::consts::FRAC_PI_2].map(|angle: f64| {
        let rotation = DMat3::from_rotation_x(0.1) * DMat3::from_rotation_y(angle);
        let mut pose = DMat4::from_mat3(rotation);
        pose.w_axis = DVec3::new(0.1, -0.2, 2.0).extend(1.0);
        pose
    })
}

pub(crate) fn folder(files: &[&str]) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    for file in files {
        let path = folder.path().join(file);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        image::RgbImage::new(WIDTH, HEIGHT).save(path).unwrap();
    }
    folder
}

pub(crate) fn write(folder: &TempDir, name: &str, text: &str) {
    let path = folder.path().join(name);
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    fs::write(path, text).unwrap();
}

pub(crate) fn read(folder: &Path, format: &str) -> Footage {
    let (found, file) = detect(folder, None).unwrap();
    assert_eq!(found.name, format);
    (found.read)(folder, &file).unwrap()
}

/// Compares with the rig; pixels to a thousandth, wherever the format counts them from.
pub(crate) fn assert_rig(cameras: &[SourceCamera], distorted: bool) {
    assert_eq!(cameras.len(), 2);
    let brown = if distorted { Distortion::opencv(&BROWN).unwrap() } else { Distortion::None };
    for (camera, pose) in cameras.iter().zip(poses()) {
        for point in [DVec3::new(0.1, 0.2, -0.1), DVec3::new(-0.3, 0.1, 0.2)] {
            let to = |pose: &DMat4| {
                let p = pose.transform_point3(point);
                DVec2::new(p.x / p.z, p.y / p.z)
            };
            let bent = brown.distort(to(&pose));
            let wanted = DVec2::new(K[0] * bent.x + K[2], K[1] * bent.y + K[3]);
            let found = camera.lens.pixel(to(&camera.poses[0]));
            assert!((found - wanted).length() < 1e-3, "{}: {found}, wanted {wanted}", camera.name);
            assert!((camera.poses[0].transform_point3(point) - pose.transform_point3(point)).length() < 1e-6);
        }
        assert_eq!((camera.lens.size.width, camera.lens.size.height), (WIDTH as usize, HEIGHT as usize));
    }
}

pub(crate) fn rows(m: DMat3) -> String {
    let r = m.transpose();
    let row = |v: DVec3| format!("[{}, {}, {}]", v.x, v.y, v.z);
    format!("[{}, {}, {}]", row(r.x_axis), row(r.y_axis), row(r.z_axis))
}
