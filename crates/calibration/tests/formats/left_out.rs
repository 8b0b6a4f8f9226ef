//! What files say that cannot be used is refused or told: lenses that change, masks that lack some, coefficients of another number, points that are
//! no places.

use crate::rig::*;
use ffgs_arrays::NpzWriter;
use ffgs_calibration::{Distortion, Footage, Pictures, detect};
use glam::DMat4;
use std::fs;
use tempfile::TempDir;

fn error(folder: &TempDir) -> String {
    let (format, file) = detect(folder.path(), None).unwrap();
    (format.read)(folder.path(), &file).unwrap_err().to_string()
}

fn mask_counts(footage: &Footage) -> Vec<usize> {
    let count = |masks: &Option<Pictures>| match masks {
        Some(Pictures::Files(files)) => files.len(),
        _ => 0,
    };
    footage.cameras.iter().map(|camera| count(&camera.masks)).collect()
}

/// Two cameras `a` and `b` in two frames; `focals` are those of `a` in each frame.
fn capture_list(focals: [f64; 2]) -> String {
    let k = |focal: f64| format!("[[{focal}, 0, {}], [0, {}, {}], [0, 0, 1]]", K[2], K[1], K[3]);
    let [a, b] = poses().map(|pose| format!("{:?}", pose.transpose().to_cols_array_2d()));
    format!(
        r#"{{"w": {WIDTH}, "h": {HEIGHT}, "k": [[{}, {same}], [{same}, {}]], "w2c": [[{a}, {b}], [{b}, {a}]],
        "fn": [["a/0.png", "b/0.png"], ["b/1.png", "a/1.png"]], "cam_id": [[0, 1], [1, 0]]}}"#,
        k(focals[0]),
        k(focals[1]),
        same = k(K[0])
    )
}

fn capture() -> TempDir {
    let below = |folder: &str| ["a/0", "a/1", "b/0", "b/1"].map(|name| format!("{folder}/{name}.png"));
    let files = [below("ims"), below("seg")].concat();
    let capture = folder(&files.iter().map(String::as_str).collect::<Vec<_>>());
    write(&capture, "train_meta.json", &capture_list([K[0]; 2]));
    capture
}

#[test]
fn a_missing_mask_costs_those_of_its_camera_and_is_told() {
    let capture = capture();
    let footage = read(capture.path(), "dynamic3dgs");
    assert_eq!((mask_counts(&footage), footage.skipped.len()), (vec![2, 2], 0));
    fs::remove_file(capture.path().join("seg/b/1.png")).unwrap();
    let footage = read(capture.path(), "dynamic3dgs");
    assert_eq!((mask_counts(&footage), footage.skipped.len()), (vec![2, 0], 1));
    let told = &footage.skipped[0];
    assert!(told.starts_with("masks of camera 'b': 1 of 2 are missing (first: "), "{told}");
    assert!(told.contains("seg/b/1.png), so none of this camera are used"), "{told}");
    fs::remove_file(capture.path().join("seg/b/0.png")).unwrap();
    assert!(read(capture.path(), "dynamic3dgs").skipped.is_empty(), "it has none at all");
}

#[test]
fn a_capture_that_is_zoomed_is_refused() {
    let capture = capture();
    write(&capture, "train_meta.json", &capture_list([K[0], K[0] + 0.02]));
    assert_rig(&read(capture.path(), "dynamic3dgs").cameras, false);
    write(&capture, "train_meta.json", &capture_list([K[0], 77.0]));
    let error = error(&capture);
    assert!(
        error.contains("train_meta.json: camera 'a': its picture of frame 1 has another lens"),
        "{error}"
    );
    assert!(error.contains("focal lengths 70.00") && error.contains("focal lengths 77.00"), "{error}");
}

#[test]
fn a_capture_may_have_a_size_for_each_camera() {
    let capture = capture();
    let one = format!("\"w\": {WIDTH}, \"h\": {HEIGHT}");
    let sizes = |w: &str, h: &str| capture_list([K[0]; 2]).replace(&one, &format!("\"w\": {w}, \"h\": {h}"));
    write(&capture, "train_meta.json", &sizes("[64, 80]", "[48, 60]"));
    let footage = read(capture.path(), "dynamic3dgs");
    let found: Vec<_> = footage.cameras.iter().map(|c| (c.lens.size.width, c.lens.size.height)).collect();
    assert_eq!(found, [(64, 48), (80, 60)], "a and b, though frame 1 has them in another order");
    write(&capture, "train_meta.json", &sizes("[64]", "48"));
    assert!(error(&capture).contains("camera 'b': w or h has no entry for it"));
}

#[test]
fn numbers_that_are_none_are_those_of_a_camera_and_no_part_of_a_name() {
    let capture = capture();
    for (from, to) in [("ims/a", "ims/NaN_room"), ("seg/a", "seg/NaN_room")] {
        fs::rename(capture.path().join(from), capture.path().join(to)).unwrap();
    }
    let text = capture_list([K[0]; 2]).replace("\"a/", "\"NaN_room/");
    write(&capture, "train_meta.json", &text);
    let footage = read(capture.path(), "dynamic3dgs");
    assert_eq!((footage.cameras[0].name.as_str(), mask_counts(&footage)), ("NaN_room", vec![2, 2]));
    write(&capture, "train_meta.json", &text.replacen("2.0]", "NaN]", 1));
    let told = error(&capture);
    assert!(told.contains("camera 'NaN_room'") && told.contains("not finite"), "{told}");
    write(&capture, "train_meta.json", &text.replace("[[70, 0,", "[[Infinity, 0,"));
    let told = error(&capture);
    assert!(told.contains("camera 'NaN_room'") && told.contains("not finite"), "{told}");
}

#[test]
fn points_of_a_capture_that_are_no_places_are_counted() {
    let capture = capture();
    let row = |x: f32, red: f32| [x, 2.0, 3.0, red, 1.0, 0.2, 1.0];
    let told = |rows: &[[f32; 7]]| {
        let file = capture.path().join("init_pt_cld.npz");
        NpzWriter::new().f32("data", &[rows.len(), 7], rows.as_flattened()).write(&file).unwrap();
        let footage = read(capture.path(), "dynamic3dgs");
        (footage.points.len(), footage.skipped)
    };
    assert_eq!(told(&[row(1.0, 0.5)]), (1, Vec::new()));
    let (points, skipped) = told(&[row(1.0, 0.5), row(f32::INFINITY, 0.5), row(1.0, f32::NAN)]);
    assert_eq!((points, skipped.len()), (1, 1));
    assert!(skipped[0].contains("init_pt_cld.npz: 2 of 3 points are NaN"), "{skipped:?}");
}

fn nerfstudio_entry(file: &str, pose: DMat4, more: &str) -> String {
    let flip = DMat4::from_diagonal(glam::DVec4::new(1.0, -1.0, -1.0, 1.0));
    let matrix = (pose.inverse() * flip).transpose().to_cols_array_2d();
    format!(r#"{{"file_path": "{file}", "transform_matrix": {matrix:?}{more}}}"#)
}

fn nerfstudio(folder: &TempDir, entries: &[String]) {
    let [fx, fy, cx, cy] = K;
    let text = format!(
        r#"{{"fl_x": {fx}, "fl_y": {fy}, "cx": {cx}, "cy": {cy}, "w": {WIDTH}, "h": {HEIGHT}, "aabb_scale": Infinity, "frames": [{}]}}"#,
        entries.join(", ")
    );
    write(folder, "transforms.json", &text);
}

/// Two cameras with two frames each; `more` is what the entry of a picture has besides.
fn nerfstudio_video(more: impl Fn(&str) -> String) -> TempDir {
    let names = ["a/0.png", "a/1.png", "b/0.png", "b/1.png"];
    let pictures = folder(&[names.as_slice(), &["m/a0.png", "m/a1.png", "m/b0.png"]].concat());
    let entry = |(i, name): (usize, &&str)| nerfstudio_entry(name, poses()[i / 2], &more(name));
    nerfstudio(&pictures, &names.iter().enumerate().map(entry).collect::<Vec<_>>());
    pictures
}

#[test]
fn masks_that_nerfstudio_names_are_complete_or_told() {
    let mask = |name: &str| format!(r#", "mask_path": "m/{}""#, name.replace('/', ""));
    let footage = read(nerfstudio_video(mask).path(), "transforms");
    assert_eq!((mask_counts(&footage), footage.skipped.len()), (vec![2, 0], 1));
    let told = &footage.skipped[0];
    assert!(told.contains("masks of camera 'b': 1 of 2 are missing") && told.contains("m/b1.png"), "{told}");
    let of_first = |name: &str| if name == "a/0.png" { mask(name) } else { String::new() };
    let skipped = read(nerfstudio_video(of_first).path(), "transforms").skipped;
    assert!(
        skipped.len() == 1 && skipped[0].contains("1 of 2 are missing (first: that of a/1.png)"),
        "{skipped:?}"
    );
    assert!(read(nerfstudio_video(|_| String::new()).path(), "transforms").skipped.is_empty());
}

#[test]
fn a_lens_of_nerfstudio_that_changes_within_a_camera_is_refused() {
    let focal = |of: f64| {
        move |name: &str| {
            let focal = if name == "b/1.png" { of } else { K[0] };
            format!(r#", "fl_x": {focal}"#)
        }
    };
    assert_rig(&read(nerfstudio_video(focal(K[0] + 0.02)).path(), "transforms").cameras, false);
    let error = error(&nerfstudio_video(focal(90.0)));
    assert!(
        error.contains("camera 'b': b/1.png has another lens") && error.contains("focal lengths 90.00"),
        "{error}"
    );
    // Pictures of one folder are cameras of their own, with lenses of their own.
    let pictures = folder(&["images/0.png", "images/1.png"]);
    let entry = |i: usize, focal: f64| {
        nerfstudio_entry(&format!("images/{i}.png"), poses()[i], &format!(r#", "fl_x": {focal}"#))
    };
    nerfstudio(&pictures, &[entry(0, K[0]), entry(1, 90.0)]);
    let focals: Vec<f64> =
        read(pictures.path(), "transforms").cameras.iter().map(|c| c.lens.intrinsics.fx).collect();
    assert_eq!(focals, [K[0], 90.0]);
}

#[test]
fn nerfstudio_may_count_its_pictures_after_a_dot() {
    let pictures = folder(&["images/frame.0001.png", "images/frame.0002.jpg", "images/frame.png"]);
    let [a, b] = poses();
    let entry = |file: &str, pose| nerfstudio_entry(file, pose, "");
    nerfstudio(&pictures, &[entry("images/frame.0001", a), entry("images/frame.0002", b)]);
    let footage = read(pictures.path(), "transforms");
    assert_rig(&footage.cameras, false);
    let file = |i: usize| match &footage.cameras[i].pictures {
        Pictures::Files(files) => files[0].strip_prefix(pictures.path()).unwrap().display().to_string(),
        Pictures::Video(_) => String::new(),
    };
    assert_eq!([file(0), file(1)], ["images/frame.0001.png", "images/frame.0002.jpg"]);
    assert_eq!([&footage.cameras[0].name, &footage.cameras[1].name], ["frame.0001", "frame.0002"]);

    // Pictures that were converted after the list was written.
    nerfstudio(&pictures, &[entry("images/frame.0001.jpg", a), entry("images/frame.0003.png", b)]);
    let footage = read(pictures.path(), "transforms");
    assert_eq!((footage.cameras.len(), footage.cameras[0].name.as_str()), (1, "frame.0001"));
    assert_eq!(footage.skipped, ["images/frame.0003.png is listed but not there"]);
}

#[test]
fn nerfstudio_pictures_of_one_name_in_folders_are_several_cameras() {
    let pictures = folder(&["a/0.png", "b/0.png"]);
    let [a, b] = poses();
    nerfstudio(&pictures, &[nerfstudio_entry("a/0.png", a, ""), nerfstudio_entry("./b/0.png", b, "")]);
    let footage = read(pictures.path(), "transforms");
    assert_rig(&footage.cameras, false);
    assert_eq!([&footage.cameras[0].name, &footage.cameras[1].name], ["a_0", "b_0"]);
}

/// Cameras `1` and `2` with these coefficients and two pictures each.
fn easyvolcap(coefficients: &str, masks: &[&str]) -> TempDir {
    let names = ["images/1/0.png", "images/1/1.png", "images/2/0.png", "images/2/1.png"];
    let pictures = folder(&[names.as_slice(), masks].concat());
    let [fx, fy, cx, cy] = K;
    let matrix = |name: &str, values: &str| {
        format!("{name}: !!opencv-matrix\n  rows: 1\n  cols: 1\n  dt: d\n  data: [{values}]\n")
    };
    let of = |parts: [(&str, &str); 2]| {
        let all =
            ["1", "2"].map(|n| parts.map(|(key, values)| matrix(&format!("{key}_{n}"), values)).concat());
        format!("%YAML:1.0\n---\n{}", all.concat())
    };
    let k = format!("{fx}, 0., {}, 0., {fy}, {}, 0., 0., 1.", cx - 0.5, cy - 0.5);
    write(&pictures, "intri.yml", &of([("K", &k), ("dist", coefficients)]));
    write(&pictures, "extri.yml", &of([("R", ".1, 0., 0."), ("T", "0., 0., 2.")]));
    pictures
}

#[test]
fn easyvolcaps_masks_are_complete_or_told() {
    let of_one = ["masks/1/0.png", "masks/1/1.png", "mask/2/0.jpg", "mask/2/1.jpg", "mask/2/2.jpg"];
    let footage = read(easyvolcap("0, 0, 0, 0, 0", &of_one).path(), "easyvolcap");
    assert_eq!((mask_counts(&footage), footage.skipped.len()), (vec![2, 2], 0), "more masks than pictures");

    let footage = read(easyvolcap("0, 0, 0, 0, 0", &of_one[1..]).path(), "easyvolcap");
    assert_eq!((mask_counts(&footage), footage.skipped.len()), (vec![0, 2], 1));
    let told = &footage.skipped[0];
    assert!(told.contains("masks of camera '1': 1 of 2 are missing") && told.contains("masks/1/0"), "{told}");

    let two_folders = ["masks/1/1.png", "mask/1/0.png", "mask/1/1.png"];
    let footage = read(easyvolcap("0, 0, 0, 0, 0", &two_folders).path(), "easyvolcap");
    assert_eq!((mask_counts(&footage), footage.skipped.len()), (vec![2, 0], 0), "the folder that has all");

    let skipped = read(easyvolcap("", &["masks/2/0_mask.png"]).path(), "easyvolcap").skipped;
    assert!(
        skipped.len() == 1 && skipped[0].contains("none is called as a picture of camera '2'"),
        "{skipped:?}"
    );
}

#[test]
fn masks_beside_a_video_are_told() {
    let footage = easyvolcap("", &["masks/1/0.png"]);
    fs::remove_dir_all(footage.path().join("images/1")).unwrap();
    write(&footage, "videos/1.mp4", "");
    let footage = read(footage.path(), "easyvolcap");
    assert!(
        footage.skipped.len() == 1 && footage.skipped[0].contains("camera '1' has a video"),
        "{footage:?}"
    );
}

#[test]
fn coefficients_of_another_number_are_refused_by_every_format() {
    for (sound, count) in [("", 0), ("0.08, -0.01, 0, 0", 4), ("[[-0.1], [0.02], [0], [0], [0]]", 5)] {
        let read_so = read(easyvolcap(&sound.replace(['[', ']'], ""), &[]).path(), "easyvolcap");
        assert_eq!(read_so.cameras[0].lens.distortion == Distortion::None, count == 0, "{sound}");
        assert_eq!(read(toml(&format!("[{sound}]")).path(), "toml").cameras.len(), 2);
    }
    let four = read(easyvolcap(".08, -.01, 0, 0", &[]).path(), "easyvolcap");
    assert_eq!(four.cameras[0].lens.distortion, Distortion::opencv(&[0.08, -0.01, 0.0, 0.0]).unwrap());
    for wrong in
        [easyvolcap("-0.1, 0.02, 0.003", &[]), toml("[-0.1, 0.02, 0.003]"), panoptic("[-0.1, 0.02, 0.003]")]
    {
        let error = error(&wrong);
        assert!(
            error.contains("camera '") && error.contains("3 distortion coefficients; OpenCV has"),
            "{error}"
        );
    }
    assert_eq!(read(panoptic("[-0.1, 0.02, 0.0, 0.0, 0.003]").path(), "panoptic").cameras.len(), 1);
    assert!(error(&toml("[0.1, 0.2, 0.0]\nfisheye = true")).contains("must be four finite numbers"));
    assert_eq!(read(toml("[0.1, 0.2, 0.0, 0.0]\nfisheye = true").path(), "toml").cameras.len(), 2);
}

/// caliscope's list of two cameras with these `distortions`.
fn toml(coefficients: &str) -> TempDir {
    let pictures = folder(&["cam_0/1.png", "cam_1/1.png"]);
    let [fx, fy, cx, cy] = K;
    let camera = |i: usize| {
        format!(
            "[cam_{i}]\nsize = [{WIDTH}, {HEIGHT}]\nmatrix = [[{fx:?}, 0.0, {cx:?}], [0.0, {fy:?}, {cy:?}], [0.0, 0.0, 1.0]]\n\
             rotation = [0.0, 0.0, 0.0]\ntranslation = [0.0, 0.0, {i}.0]\ndistortions = {coefficients}\n"
        )
    };
    write(&pictures, "calibration.toml", &(camera(0) + &camera(1)));
    pictures
}

fn panoptic(coefficients: &str) -> TempDir {
    let pictures = folder(&["hdImgs/00_00/1.png"]);
    let [fx, fy, cx, cy] = K;
    let text = format!(
        r#"{{"cameras": [{{"name": "00_00", "type": "hd", "resolution": [{WIDTH}, {HEIGHT}], "distCoef": {coefficients},
        "K": [[{fx}, 0, {cx}], [0, {fy}, {cy}], [0, 0, 1]], "R": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "t": [[0], [0], [2]]}}]}}"#
    );
    write(&pictures, "calibration_1.json", &text);
    pictures
}
