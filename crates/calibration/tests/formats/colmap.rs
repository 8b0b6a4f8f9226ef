//! What COLMAP's models hold that cannot be used, and its short lens models.

use crate::rig::*;
use ffgs_calibration::{Distortion, detect};
use tempfile::TempDir;

/// A text model in a folder, of a camera with this line and a picture.
fn model(pictures: &TempDir, below: &str, camera: &str, picture: &str) {
    write(pictures, &format!("{below}cameras.txt"), &format!("1 {camera}\n"));
    write(pictures, &format!("{below}images.txt"), &format!("1 1 0 0 0 0.1 -0.2 2.0 1 {picture}\n\n"));
}

#[test]
fn points_that_are_no_places_are_counted() {
    let pictures = folder(&["images/a.png"]);
    model(&pictures, "sparse/0/", &format!("PINHOLE {WIDTH} {HEIGHT} 70 72 32 24"), "a.png");
    let points = |places: &[&str]| {
        let line = |(i, place): (usize, &&str)| format!("{} {place} 10 20 30 0.1 1 0\n", i + 1);
        places.iter().enumerate().map(line).collect::<String>()
    };
    write(&pictures, "sparse/0/points3D.txt", &points(&["1 2 3", "4 5 6"]));
    let sound = read(pictures.path(), "colmap");
    assert_eq!((sound.points.len(), sound.skipped.len()), (2, 0));
    write(&pictures, "sparse/0/points3D.txt", &points(&["nan 2 3", "1 2 3", "1 inf 3", "1 2 -1e39"]));
    let footage = read(pictures.path(), "colmap");
    assert_eq!(footage.points, sound.points[..1]);
    assert!(
        footage.skipped.len() == 1 && footage.skipped[0].contains("points3D.txt: 3 of 4 points"),
        "{footage:?}"
    );
}

#[test]
fn binary_points_that_are_no_places_are_counted() {
    let pictures = folder(&["images/a.png"]);
    let bin = |name: &str, bytes: &[u8]| {
        let file = pictures.path().join("sparse/0").join(name);
        std::fs::create_dir_all(file.parent().unwrap()).unwrap();
        std::fs::write(file, bytes).unwrap();
    };
    let (u, i) = (|v: u64| v.to_le_bytes().to_vec(), |v: u32| v.to_le_bytes().to_vec());
    let f = |values: &[f64]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    let size = [u(WIDTH.into()), u(HEIGHT.into())].concat();
    bin("cameras.bin", &[u(1), i(1), i(1), size, f(&[70.0, 72.0, 32.0, 24.0])].concat());
    let pose = f(&[1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 2.0]);
    bin("images.bin", &[u(1), i(1), pose, i(1), b"a.png\0".to_vec(), u(0)].concat());
    let point = |x: f64| [u(1), f(&[x, 2.0, 3.0]), vec![10, 20, 30], f(&[0.1]), u(0)].concat();
    bin("points3D.bin", &[u(3), point(f64::NAN), point(1.0), point(f64::INFINITY)].concat());
    let footage = read(pictures.path(), "colmap");
    assert_eq!((footage.points.len(), footage.points[0].position.x), (1, 1.0));
    assert!(
        footage.skipped.len() == 1 && footage.skipped[0].contains("points3D.bin: 2 of 3 points"),
        "{footage:?}"
    );
}

#[test]
fn short_models_have_the_coefficients_that_they_name() {
    let pictures = folder(&["images/a.png"]);
    let lens = |camera: &str, parameters: &str| {
        model(&pictures, "sparse/0/", &format!("{camera} {WIDTH} {HEIGHT} 70 32 24 {parameters}"), "a.png");
        read(pictures.path(), "colmap").cameras[0].lens.distortion
    };
    let brown = |k1: f64, k2: f64| Distortion::opencv(&[k1, k2, 0.0, 0.0]).unwrap();
    assert_eq!(lens("SIMPLE_RADIAL", "-0.1"), brown(-0.1, 0.0));
    assert_eq!(lens("RADIAL", "-0.1 0.02"), brown(-0.1, 0.02));
    assert_eq!(lens("SIMPLE_RADIAL_FISHEYE", "0.1"), Distortion::Fisheye([0.1, 0.0, 0.0, 0.0]));
    assert_eq!(lens("RADIAL_FISHEYE", "0.1 0.02"), Distortion::Fisheye([0.1, 0.02, 0.0, 0.0]));
}

#[test]
fn a_lens_that_changes_from_model_to_model_is_refused() {
    let pictures = folder(&["frame_0/images/a.png", "frame_1/images/a.png"]);
    let radial = |focal: f64, k1: f64| format!("SIMPLE_RADIAL {WIDTH} {HEIGHT} {focal} 32 24 {k1}");
    model(&pictures, "frame_0/sparse/", &radial(70.0, -0.1), "a.png");
    model(&pictures, "frame_1/sparse/", &radial(70.02, -0.1001), "a.png");
    assert_eq!(read(pictures.path(), "colmap").cameras[0].poses.len(), 2);
    for other in [radial(75.0, -0.1), radial(70.0, -0.2)] {
        model(&pictures, "frame_1/sparse/", &other, "a.png");
        let (format, file) = detect(pictures.path(), None).unwrap();
        let error = (format.read)(pictures.path(), &file).unwrap_err().to_string();
        assert!(
            error.contains("camera 'a'") && error.contains("frame_1/images/a.png has another lens"),
            "{error}"
        );
    }
}
