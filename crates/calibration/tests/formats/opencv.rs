//! The rig as programs write it with OpenCV's `FileStorage`, a file or two for each camera.

use crate::rig::*;
use glam::{DMat3, DQuat, DVec3};
use std::fs;

fn file_storage(matrices: &[(&str, usize, Vec<f64>)], yaml: bool) -> String {
    let body = |(name, columns, numbers): &(&str, usize, Vec<f64>)| {
        let numbers: Vec<String> = numbers.iter().map(|v| format!("{v:e}")).collect();
        let rows = numbers.len() / columns;
        if yaml {
            let numbers = numbers.join(", ");
            format!(
                "{name}: !!opencv-matrix\n   rows: {rows}\n   cols: {columns}\n   dt: d\n   data: [ {numbers} ]\n"
            )
        } else {
            let numbers = numbers.join(" ");
            format!(
                "<{name} type_id=\"opencv-matrix\">\n<rows>{rows}</rows><cols>{columns}</cols><dt>d</dt><data>\n{numbers}</data></{name}>\n"
            )
        }
    };
    let body: String = matrices.iter().map(body).collect();
    if yaml {
        format!("%YAML:1.0\n---\n{body}")
    } else {
        format!("<?xml version=\"1.0\"?>\n<opencv_storage>\n{body}</opencv_storage>\n")
    }
}

/// Camera matrix and distortion as OpenCV's programs write them, and the poses' rotation vector, matrix and translation.
type OpenCv = ([f64; 9], [DVec3; 2], [DMat3; 2]);

fn opencv_values() -> OpenCv {
    let k = [K[0], 0.0, K[2] - 0.5, 0.0, K[1], K[3] - 0.5, 0.0, 0.0, 1.0];
    let rotations = poses().map(DMat3::from_mat4);
    let vectors = rotations.map(|rotation| DQuat::from_mat3(&rotation).to_scaled_axis());
    (k, vectors, rotations)
}

/// The keys of three programs, in a folder per camera, where other files lie as well.
#[test]
fn opencv_in_the_folder_of_each_camera() {
    for [rotation, translation] in
        [["RotationVector", "TranslationVector"], ["Rotation", "Translation"], ["rvec", "tvec"]]
    {
        let pictures = folder(&["data/cam1/1.png", "data/cam2/1.png"]);
        let (k, vectors, _) = opencv_values();
        for (i, vector) in vectors.iter().enumerate() {
            let text = file_storage(
                &[
                    ("CameraMatrix", 3, k.to_vec()),
                    ("DistortionCoeffs", 5, BROWN.to_vec()),
                    (rotation, 1, vector.to_array().to_vec()),
                    (translation, 1, vec![0.1, -0.2, 2.0]),
                ],
                false,
            );
            write(&pictures, &format!("data/cam{}/config.xml", i + 1), &text);
            let half = file_storage(&[("CameraMatrix", 3, vec![1.0; 9])], false);
            write(&pictures, &format!("data/cam{}/intrinsics.xml", i + 1), &half);
        }
        write(
            &pictures,
            "data/checkerboard.xml",
            "<?xml version=\"1.0\"?>\n<opencv_storage><CheckerBoardWidth>8</CheckerBoardWidth></opencv_storage>",
        );
        let footage = read(pictures.path(), "opencv");
        assert_rig(&footage.cameras, true);
        assert_eq!([&footage.cameras[0].name, &footage.cameras[1].name], ["cam1", "cam2"]);
        assert!(footage.skipped.is_empty(), "{:?}", footage.skipped);
        assert!(
            footage.assumed.iter().any(|s| s.contains(rotation) && s.contains("from the world")),
            "{:?}",
            footage.assumed
        );
    }
}

#[test]
fn opencv_in_files_that_are_named_as_the_cameras_and_in_parts() {
    let pictures = folder(&["cam_0/1.png", "cam_1/1.png"]);
    let (k, _, rotations) = opencv_values();
    let optics = || vec![("camera_matrix", 3, k.to_vec()), ("distortion_coefficients", 1, BROWN.to_vec())];
    let place = |i: usize| {
        let rotation = rotations[i].transpose().to_cols_array().to_vec();
        vec![("R", 3, rotation), ("T", 1, vec![0.1, -0.2, 2.0])]
    };
    for i in 0..2 {
        let whole = file_storage(&[optics(), place(i)].concat(), true);
        write(&pictures, &format!("calibration/cam_{i}_calib.yml"), &whole);
    }
    assert_rig(&read(pictures.path(), "opencv").cameras, true);

    fs::remove_dir_all(pictures.path().join("calibration")).unwrap();
    for i in 0..2 {
        write(&pictures, &format!("cam_{i}/intrinsics.yml"), &file_storage(&optics(), true));
        write(&pictures, &format!("cam_{i}/extrinsics.xml"), &file_storage(&place(i), false));
    }
    assert_rig(&read(pictures.path(), "opencv").cameras, true);

    let told = |coefficients: Vec<f64>| {
        let mut optics = optics();
        optics[1].2 = coefficients;
        write(&pictures, "cam_0/intrinsics.yml", &file_storage(&optics, true));
        let (format, file) = ffgs_calibration::detect(pictures.path(), None).unwrap();
        (format.read)(pictures.path(), &file)
            .map(|footage| footage.assumed)
            .map_err(|error| error.to_string())
    };
    let error = told(vec![0.1; 6]).unwrap_err();
    assert!(
        error.contains("'cam_0'") && error.contains("distortion_coefficients: 6 distortion coefficients"),
        "{error}"
    );
    assert!(told(vec![0.1; 5]).unwrap().len() == 1, "nothing but the poses is assumed");
    assert!(told(Vec::new()).unwrap().iter().any(|s| s.contains("camera 'cam_0' has no distortion")));

    fs::remove_file(pictures.path().join("cam_1/extrinsics.xml")).unwrap();
    let footage = read(pictures.path(), "opencv");
    assert_eq!(footage.cameras.len(), 1);
    assert!(
        footage.skipped[0].contains("cam_1") && footage.skipped[0].contains("lacks a rotation"),
        "{:?}",
        footage.skipped
    );
    write(&pictures, "cam_1/extrinsics.xml", "<?xml version=\"1.0\"?>\n<opencv_storage>\n<R><data>1 2");
    let skipped = read(pictures.path(), "opencv").skipped;
    assert!(skipped.iter().any(|s| s.contains("cam_1/extrinsics.xml: ")), "truncated: {skipped:?}");
}
