//! One rig, written by hand in every format, must come back the same.

mod colmap;
mod left_out;
mod opencv;
mod rig;

use ffgs_arrays::NpzWriter;
use ffgs_calibration::{ColouredPoint, Distortion, Footage, Pictures, detect};
use glam::{DMat3, DMat4, DVec3};
use rig::*;
use std::fs;

/// The camera matrix of OpenCV's convention: the first pixel's centre is 0.
fn opencv_matrix() -> String {
    format!("[[{}, 0, {}], [0, {}, {}], [0, 0, 1]]", K[0], K[2] - 0.5, K[1], K[3] - 0.5)
}

#[test]
fn caliscope_and_aniposelib() {
    for vector in [false, true] {
        let pictures = folder(&["cam_0/1.png", "cam_1/1.png"]);
        let mut text = String::new();
        for (i, pose) in poses().iter().enumerate() {
            let rotation = DMat3::from_mat4(*pose);
            let (axis, angle) = glam::DQuat::from_mat3(&rotation).to_axis_angle();
            let v = axis * angle;
            let rotation = if vector { format!("[{}, {}, {}]", v.x, v.y, v.z) } else { rows(rotation) };
            let heading = if vector {
                format!("[cam_{i}]\nname = \"cam_{i}\"")
            } else {
                format!("[cameras.{i}]\ncam_id = {i}")
            };
            let camera = format!(
                "{heading}\nsize = [{WIDTH}, {HEIGHT}]\nmatrix = {}\ndistortions = {BROWN:?}\nrotation = {rotation}\n\
                 translation = [0.1, -0.2, 2.0]\n",
                opencv_matrix()
            );
            text.push_str(&camera);
        }
        write(&pictures, "calibration.toml", &text);
        assert_rig(&read(pictures.path(), "toml").cameras, true);
    }
}

#[test]
fn nerfstudio_with_opengl_axes_and_a_missing_picture() {
    let pictures = folder(&["images/a.png", "images/b.png"]);
    let flip = DMat4::from_diagonal(glam::DVec4::new(1.0, -1.0, -1.0, 1.0));
    let frames: Vec<String> = ["images/a.png", "./images/b", "images/gone.png"]
        .iter()
        .enumerate()
        .map(|(i, file)| {
            let m = (poses()[i % 2].inverse() * flip).transpose().to_cols_array_2d();
            format!(r#"{{"file_path": "{file}", "transform_matrix": {m:?}}}"#)
        })
        .collect();
    let [k1, k2, p1, p2, k3] = BROWN;
    let text = format!(
        r#"{{"fl_x": {}, "fl_y": {}, "cx": {}, "cy": {}, "w": {WIDTH}, "h": {HEIGHT}.0, "camera_model": "OPENCV",
        "k1": {k1}, "k2": {k2}, "p1": {p1}, "p2": {p2}, "k3": {k3}, "ply_file_path": "sparse_pc.ply", "frames": [{}]}}"#,
        K[0],
        K[1],
        K[2],
        K[3],
        frames.join(", ")
    );
    write(&pictures, "transforms.json", &text);
    let footage = read(pictures.path(), "transforms");
    assert_rig(&footage.cameras, true);
    let skipped = |name: &str| footage.skipped.iter().any(|s| s.contains(name));
    assert!(skipped("gone.png") && skipped("sparse_pc.ply"), "{:?}", footage.skipped);
    let points = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nproperty uchar red\n\
        property uchar green\nproperty uchar blue\nend_header\n1 2 3 0 255 51\n";
    write(&pictures, "sparse_pc.ply", points);
    let footage = read(pictures.path(), "transforms");
    assert_eq!(footage.points, [ColouredPoint { position: DVec3::new(1.0, 2.0, 3.0), colour: [0, 255, 51] }]);
}

#[test]
fn easyvolcap() {
    let pictures =
        folder(&["images/01/000.png", "images/02/000.png", "masks/01/000.png", "masks/02/000.png"]);
    let (mut intri, mut extri) = ("%YAML:1.0\n---\n".to_owned(), "%YAML:1.0\n---\n".to_owned());
    let matrix = |name: &str, values: &str, rows: usize| {
        format!("{name}: !!opencv-matrix\n  rows: {rows}\n  cols: 1\n  dt: d\n  data: [{values}]\n")
    };
    for (name, pose) in ["01", "02"].iter().zip(poses()) {
        let k = opencv_matrix().replace(['[', ']'], "");
        intri += &matrix(&format!("K_{name}"), &k, 3);
        intri += &matrix(&format!("dist_{name}"), &format!("{BROWN:?}").replace(['[', ']'], ""), 5);
        extri += &matrix(&format!("Rot_{name}"), &rows(DMat3::from_mat4(pose)).replace(['[', ']'], ""), 3);
        extri += &matrix(&format!("T_{name}"), "0.1, -0.2, 2.0", 3);
    }
    write(&pictures, "intri.yml", &intri);
    write(&pictures, "extri.yml", &extri);
    let footage = read(pictures.path(), "easyvolcap");
    assert_rig(&footage.cameras, true);
    assert!(footage.cameras.iter().all(|c| matches!(&c.masks, Some(Pictures::Files(m)) if m.len() == 1)));
}

/// A camera of Qualisys Track Manager, with the given attributes after its serial number, whose video shows the sensor from (100, 20) on.
fn qualisys_camera(serial: &str, attributes: &str, pose: DMat4) -> String {
    let (left, top) = (100.0, 20.0);
    let ([k1, k2, p1, p2, k3], place) = (BROWN, pose.inverse().w_axis);
    // Rows of the turn from the world to a camera with y up and z back.
    let rows = DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0)) * DMat3::from_mat4(pose);
    let rows = rows.transpose().to_cols_array();
    let axis = |k: usize| format!("r{}{}=\"{}\"", k / 3 + 1, k % 3 + 1, rows[k]);
    let axes = (0..9).map(axis).collect::<Vec<_>>().join(" ");
    let [fx, fy, cx, cy] = [K[0], K[1], K[2] - 0.5 + left, K[3] - 0.5 + top].map(|v| 64.0 * v);
    let (right, bottom) = (left + f64::from(WIDTH) - 1.0, top + f64::from(HEIGHT) - 1.0);
    format!(
        r#"<camera serial="{serial}" {attributes}>
        <fov_video left="{left}" top="{top}" right="{right}" bottom="{bottom}"/>
        <transform x="{}" y="{}" z="{}" {axes}/>
        <intrinsic focalLengthU="{fx}" focalLengthV="{fy}" centerPointU="{cx}" centerPointV="{cy}" skew="0" radialDistortion1="{k1}"
            radialDistortion2="{k2}" radialDistortion3="{k3}" tangentalDistortion1="{p1}" tangentalDistortion2="{p2}"/></camera>"#,
        place.x, place.y, place.z
    )
}

#[test]
fn qualisys_in_millimetres() {
    let pictures = folder(&["23087/1.png", "cam02/1.png"]);
    let cameras = |attributes: &str| {
        let [a, b] = poses();
        let all = [("23087", attributes, a), ("11000", "model=\"Oqus 700\"", a), ("cam02", "", b)];
        all.map(|(serial, attributes, pose)| qualisys_camera(serial, attributes, pose)).concat()
    };
    let text = |attributes: &str| {
        format!(
            "<?xml version='1.0'?>\n<calibration><cameras>{}</cameras></calibration>",
            cameras(attributes)
        )
    };
    write(&pictures, "calibration/trial.qca.txt", &text("viewrotation=\"0\""));
    let footage = read(pictures.path(), "qualisys");
    assert_rig(&footage.cameras, true);
    assert_eq!(footage.metres_per_unit, Some(0.001));
    assert!(
        footage.skipped == ["no video or images are here for 1 of 3 cameras"] && footage.assumed.is_empty()
    );
    write(&pictures, "calibration/trial.qca.txt", &text("viewrotation=\"90\""));
    assert!(read(pictures.path(), "qualisys").assumed[0].contains("23087"));
    write(&pictures, "calibration/trial.qca.txt", &text("active=\"0\""));
    let footage = read(pictures.path(), "qualisys");
    assert!(footage.cameras.len() == 1 && footage.skipped[0].contains("'23087' was not active"));
    for (was, is, message) in [
        ("</calibration>", "", "root"),
        ("skew=\"0\"", "skew=\"NaN\"", "'skew' of <intrinsic> is no number: 'NaN'"),
        ("<fov_video", "<fov", "no <fov_video>"),
        (" r33", " rr", "no 'r33'"),
        ("camera", "cam", "no <camera>"),
    ] {
        write(&pictures, "calibration/trial.qca.txt", &text("").replace(was, is));
        let (format, file) = detect(pictures.path(), None).unwrap();
        let error = (format.read)(pictures.path(), &file).unwrap_err().to_string();
        assert!(error.contains("trial.qca.txt") && error.contains(message), "{error}");
    }
}

#[test]
fn panoptic_in_centimetres() {
    let pictures = folder(&["hdImgs/00_00/1.png", "hdImgs/00_01/1.png"]);
    let camera = |i: usize| {
        let r = rows(DMat3::from_mat4(poses()[i]));
        format!(
            r#"{{"name": "00_0{i}", "type": "hd", "resolution": [{WIDTH}, {HEIGHT}], "K": {},
            "distCoef": {BROWN:?}, "R": {r}, "t": [[0.1], [-0.2], [2.0]]}}"#,
            opencv_matrix()
        )
    };
    let text = format!(r#"{{"cameras": [{}, {}]}}"#, camera(0), camera(1));
    write(&pictures, "calibration_171204_pose1.json", &text);
    let footage = read(pictures.path(), "panoptic");
    assert_rig(&footage.cameras, true);
    assert_eq!(footage.metres_per_unit, Some(0.01));
}

#[test]
fn n3dv_with_columns_down_right_back() {
    let pictures = folder(&["images/cam00.png", "images/cam01.png"]);
    let mut rows = Vec::new();
    for pose in poses() {
        let m = pose.inverse();
        let (right, down, forward, centre) = (m.x_axis, m.y_axis, m.z_axis, m.w_axis);
        let hwf = [f64::from(HEIGHT), f64::from(WIDTH), 70.0];
        for i in 0..3 {
            rows.extend([down[i], right[i], -forward[i], centre[i], hwf[i]]);
        }
        rows.extend([1.0, 9.0]);
    }
    fs::write(pictures.path().join("poses_bounds.npy"), npy_of(&rows)).unwrap();
    let cameras = read(pictures.path(), "n3dv").cameras;
    for (camera, pose) in cameras.iter().zip(poses()) {
        assert!((camera.poses[0] - pose).to_cols_array().iter().all(|v| v.abs() < 1e-9));
        assert_eq!((camera.lens.intrinsics.cx, camera.lens.intrinsics.cy), (32.0, 24.0));
    }
    fs::remove_file(pictures.path().join("images/cam01.png")).unwrap();
    let (format, file) = detect(pictures.path(), Some("n3dv")).unwrap();
    let error = (format.read)(pictures.path(), &file).unwrap_err().to_string();
    assert!(error.contains("2 poses, but pictures of 1 camera beside it"), "{error}");
}

/// numpy's format, version 1.0.
fn npy_of(rows: &[f64]) -> Vec<u8> {
    let mut header =
        format!("{{'descr': '<f8', 'fortran_order': False, 'shape': ({}, 17), }}", rows.len() / 17);
    while (10 + header.len() + 1) % 64 != 0 {
        header.push(' ');
    }
    header.push('\n');
    let mut out = b"\x93NUMPY\x01\x00".to_vec();
    out.extend((header.len() as u16).to_le_bytes());
    out.extend(header.bytes());
    out.extend(rows.iter().flat_map(|v| v.to_le_bytes()));
    out
}

fn quaternions() -> Vec<[f64; 4]> {
    poses()
        .iter()
        .map(|p| glam::DQuat::from_mat3(&DMat3::from_mat4(*p)))
        .map(|q| [q.w, q.x, q.y, q.z])
        .collect()
}

#[test]
fn colmap_text_and_binary_agree() {
    let pictures = folder(&["images/a.png", "images/b.png"]);
    let q = quaternions();
    let [k1, k2, p1, p2, k3] = BROWN;
    let [fx, fy, cx, cy] = K;
    let camera =
        format!("# c\n7 FULL_OPENCV {WIDTH} {HEIGHT} {fx} {fy} {cx} {cy} {k1} {k2} {p1} {p2} {k3} 0 0 0\n");
    let image = |i: usize, name: &str| {
        let [w, x, y, z] = q[i];
        format!("{} {w} {x} {y} {z} 0.1 -0.2 2.0 7 {name}\n1.0 2.0 -1\n", i + 1)
    };
    write(&pictures, "sparse/0/cameras.txt", &camera);
    write(&pictures, "sparse/0/images.txt", &(image(0, "a.png") + &image(1, "b.png")));
    write(&pictures, "sparse/0/points3D.txt", "1 0.5 0.25 -1 10 20 30 0.1 1 0\n");
    let text = read(pictures.path(), "colmap");
    assert_rig(&text.cameras, true);
    for name in ["cameras.txt", "images.txt", "points3D.txt"] {
        fs::remove_file(pictures.path().join("sparse/0").join(name)).unwrap();
    }
    let f = |values: &[f64]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    let u = |v: u64| v.to_le_bytes().to_vec();
    let i = |v: u32| v.to_le_bytes().to_vec();
    let parameters = [fx, fy, cx, cy, k1, k2, p1, p2, k3, 0.0, 0.0, 0.0];
    let cameras = [u(1), i(7), i(6), u(WIDTH.into()), u(HEIGHT.into()), f(&parameters)].concat();
    let image = |n: usize, name: &[u8]| {
        [
            i(n as u32 + 1),
            f(&q[n]),
            f(&[0.1, -0.2, 2.0]),
            i(7),
            name.to_vec(),
            vec![0],
            u(1),
            f(&[1.0, 2.0]),
            u(9),
        ]
        .concat()
    };
    let images = [u(2), image(0, b"a.png"), image(1, b"b.png")].concat();
    let points = [u(1), u(1), f(&[0.5, 0.25, -1.0]), vec![10, 20, 30], f(&[0.1]), u(1), i(1), i(0)].concat();
    for (name, data) in [("cameras", &cameras), ("images", &images), ("points3D", &points)] {
        fs::write(pictures.path().join(format!("sparse/0/{name}.bin")), data).unwrap();
    }
    let binary = read(pictures.path(), "colmap");
    assert_rig(&binary.cameras, true);
    assert_eq!((binary.points.len(), binary.points[0]), (1, text.points[0]));
    fs::write(pictures.path().join("sparse/0/images.bin"), &images[..images.len() - 20]).unwrap();
    let (format, file) = detect(pictures.path(), None).unwrap();
    assert!((format.read)(pictures.path(), &file).unwrap_err().to_string().contains("truncated"));
}

#[test]
fn a_colmap_model_per_frame() {
    let pictures = folder(&[
        "frame_0/images/a.png",
        "frame_0/images/b.png",
        "frame_1/images/a.png",
        "frame_1/images/b.png",
    ]);
    for frame in 0..2 {
        let camera = format!("1 PINHOLE {WIDTH} {HEIGHT} {} {} {} {}\n", K[0], K[1], K[2], K[3]);
        let q = quaternions();
        let image = |i: usize, name: &str| {
            let [w, x, y, z] = q[i];
            format!("{} {w} {x} {y} {z} 0.1 -0.2 {} 1 {name}\n\n", i + 1, 2.0 + f64::from(frame))
        };
        write(&pictures, &format!("frame_{frame}/sparse/cameras.txt"), &camera);
        write(
            &pictures,
            &format!("frame_{frame}/sparse/images.txt"),
            &(image(0, "a.png") + &image(1, "b.png")),
        );
    }
    let footage = read(pictures.path(), "colmap");
    assert_rig(&footage.cameras, false);
    assert!(footage.cameras.iter().all(|c| c.poses.len() == 2 && c.poses[1].w_axis.z == 3.0));
}

#[test]
fn a_capture_is_footage_too() {
    let pictures = folder(&["ims/a/0.png", "ims/b/0.png", "seg/a/0.png", "seg/b/0.png"]);
    let k = format!("[[{}, 0, {}], [0, {}, {}], [0, 0, 1]]", K[0], K[2], K[1], K[3]);
    let pose = |i: usize| format!("{:?}", poses()[i].transpose().to_cols_array_2d());
    let text = format!(
        r#"{{"w": {WIDTH}, "h": {HEIGHT}, "k": [[{k}, {k}]], "w2c": [[{}, {}]], "fn": [["a/0.png", "b/0.png"]], "cam_id": [[0, 1]]}}"#,
        pose(0),
        pose(1)
    );
    write(&pictures, "train_meta.json", &text);
    let footage = read(pictures.path(), "dynamic3dgs");
    assert_rig(&footage.cameras, false);
    assert!(footage.cameras.iter().all(|c| c.masks.is_some()));
    assert!(footage.points.is_empty() && !footage.points_are_complete);
    assert!(footage.skipped.is_empty());
    write(&pictures, "init_meta.json", &text);
    let skipped = read(pictures.path(), "dynamic3dgs").skipped;
    assert!(skipped.len() == 1 && skipped[0].contains("init_meta.json"), "{skipped:?}");

    let rows = [[1.0, 2.0, 3.0, 0.0, 1.0, 0.2, 1.0], [f32::NAN; 7]];
    let file = pictures.path().join("init_pt_cld.npz");
    NpzWriter::new().f32("data", &[2, 7], rows.as_flattened()).write(&file).unwrap();
    let footage = read(pictures.path(), "dynamic3dgs");
    assert_eq!(footage.points, [ColouredPoint { position: DVec3::new(1.0, 2.0, 3.0), colour: [0, 255, 51] }]);
    assert!(footage.points_are_complete);
    fs::write(&file, "none").unwrap();
    let (format, meta) = detect(pictures.path(), Some("dynamic3dgs")).unwrap();
    let error = (format.read)(pictures.path(), &meta).unwrap_err().to_string();
    assert!(error.contains("init_pt_cld.npz"), "{error}");
}

#[test]
fn what_is_no_calibration_is_told() {
    let empty = tempfile::tempdir().unwrap();
    let error = detect(empty.path(), None).unwrap_err().to_string();
    assert!(error.contains("transforms.json") && error.contains("poses_bounds.npy"), "{error}");
    assert!(detect(empty.path(), Some("mp3")).unwrap_err().to_string().contains("colmap"));
    let pictures = folder(&["cam_0/1.png", "cam_1/1.png"]);
    let broken = format!(
        "[cam_0]\nsize = [{WIDTH}, {HEIGHT}]\nmatrix = {}\ndistortions = []\nrotation = [nan, 0.0, 0.0]\n\
         translation = [0.0, 0.0, 2.0]\n",
        opencv_matrix()
    );
    write(&pictures, "calibration.toml", &broken);
    let (format, file) = detect(pictures.path(), None).unwrap();
    let error = (format.read)(pictures.path(), &file).unwrap_err().to_string();
    assert!(error.contains("camera 'cam_0'") && error.contains("not finite"), "{error}");
}

#[test]
fn what_is_no_folder_is_told() {
    let place = folder(&["a.png"]);
    for (name, what) in [("absent", "there is no such folder"), ("a.png", "this is a file")] {
        let error = detect(&place.path().join(name), None).unwrap_err().to_string();
        assert!(error.contains(what) && error.contains(name) && error.contains("a folder with"), "{error}");
    }
    let error = detect(place.path(), None).unwrap_err();
    assert!(error.to_string().contains("no calibration was recognised"), "a folder is one");
    assert!(error.fix().contains("matrix, distortions, rotation and translation"));
}

/// The example that docs/footage.md has for calibrations of other programs.
fn documented() -> &'static str {
    let (_, from) = include_str!("../../../../docs/footage.md").split_once("```toml\n[cam1]").unwrap();
    from.split_once("```").unwrap().0
}

#[test]
fn the_example_of_the_documentation_is_read() {
    let pictures = folder(&["cam1/1.png", "cam2/1.png"]);
    write(&pictures, "calibration.toml", &format!("[cam1]{}", documented()));
    let footage = read(pictures.path(), "toml");
    let [one, two] = &footage.cameras[..] else { panic!("two cameras: {footage:?}") };
    for (camera, centre) in [(one, DVec3::new(0.0, 0.0, -4.0)), (two, DVec3::new(4.0, 0.0, 0.0))] {
        let pose = camera.poses[0];
        assert!((pose.inverse().w_axis.truncate() - centre).length() < 1e-9, "{}", camera.name);
        assert!((pose.transform_point3(DVec3::ZERO) - DVec3::new(0.0, 0.0, 4.0)).length() < 1e-9);
        assert_eq!((camera.lens.size.width, camera.lens.intrinsics.cx), (1920, 960.0));
        assert_ne!(camera.lens.distortion, Distortion::None);
    }
    assert!(footage.skipped.is_empty() && footage.assumed.is_empty(), "{footage:?}");
}

/// Cameras of the documentation's example after a change to the text of both.
fn changed(from: &str, to: &str) -> Result<Footage, String> {
    let pictures = folder(&["cam1/1.png", "cam2/1.png"]);
    let text = format!("[cam1]{}", documented());
    assert!(text.contains(from), "{from}");
    write(&pictures, "calibration.toml", &text.replace(from, to));
    let (format, file) = detect(pictures.path(), None).map_err(|error| error.to_string())?;
    (format.read)(pictures.path(), &file).map_err(|error| error.to_string())
}

#[test]
fn distortions_by_another_name_are_refused_and_missing_ones_told() {
    for key in ["dist", "distortion", "Dist_Coeffs", "coefficients", "D"] {
        let error = changed("distortions =", &format!("{key} =")).unwrap_err();
        assert!(error.contains("camera 'cam1'") && error.contains(&format!("not as '{key}'")), "{error}");
    }
    let error = changed("distortions = [-0.1", "distortions = [\"a\"").unwrap_err();
    assert!(error.contains("'distortions' is no list of numbers"), "{error}");
    let footage = changed(
        "distortions =",
        "rotation_count = 0\nerror = 0.3\nverified = true\nundistorted = true\ngrid_count =",
    )
    .unwrap();
    assert_eq!(
        footage.assumed,
        ["cameras without 'distortions' are taken to have no lens distortion: 'cam1', 'cam2'"]
    );
}

#[test]
fn a_table_that_lacks_what_makes_it_a_camera_is_named() {
    let error = changed("matrix =", "K =").unwrap_err();
    assert!(error.contains("calibration.toml: the table [cam1] has no 'matrix', only "), "{error}");
    assert!(error.contains("[cam2]") && error.contains("translation"), "{error}");
    let error = changed("translation =", "t =").unwrap_err();
    assert!(error.contains("[cam1] has no 'translation'"), "{error}");
    let pictures = folder(&["cam1/1.png"]);
    write(&pictures, "pyproject.toml", "[tool.black]\nsize = 3\n");
    let error = detect(pictures.path(), None).unwrap_err().to_string();
    assert!(error.contains("no calibration was recognised"), "{error}");
}

/// As a public collection has it: `data/cam1/{video,background,checkerboard}.avi`.
#[test]
fn several_videos_in_a_cameras_folder_are_named() {
    let pictures = folder(&["cam2/1.png"]);
    write(&pictures, "calibration.toml", &format!("[cam1]{}", documented()));
    for file in ["data/cam1/first.avi", "data/cam1/second.avi", "data/cam1/background.avi"] {
        write(&pictures, file, "");
    }
    let footage = read(pictures.path(), "toml");
    assert_eq!(footage.cameras.len(), 1);
    let told = &footage.skipped[0];
    assert!(told.contains("data/cam1/first.avi") && told.contains("data/cam1/second.avi"), "{told}");
    assert!(told.contains("rename the one with its footage to 'cam1.avi'"), "{told}");
    fs::remove_file(pictures.path().join("data/cam1/second.avi")).unwrap();
    assert_eq!(read(pictures.path(), "toml").cameras.len(), 2, "the only footage is taken");
}

/// An old calibration beside the new one, and models of two attempts.
#[test]
fn which_of_several_calibrations_is_read_is_told() {
    let pictures = folder(&["cam1/0.png", "cam2/0.png"]);
    let told = |format: &str| read(pictures.path(), format).assumed.join("\n");
    write(&pictures, "calibration.toml", &format!("[cam1]{}", documented()));
    write(&pictures, "pyproject.toml", "[tool.black]\nsize = 3\n");
    assert!(!told("toml").contains("of several"), "{}", told("toml"));
    write(&pictures, "calib_old.toml", &format!("[cam1]{}", documented()));
    assert!(told("toml").contains("calib_old.toml is read, not calibration.toml:"), "{}", told("toml"));
    let model = |at: &str| {
        write(&pictures, &format!("{at}/cameras.txt"), &format!("1 PINHOLE {WIDTH} {HEIGHT} 70 72 32 24\n"));
        write(&pictures, &format!("{at}/images.txt"), "1 1 0 0 0 0 0 2 1 cam1/0.png\n\n");
    };
    for file in ["calibration.toml", "calib_old.toml"] {
        fs::remove_file(pictures.path().join(file)).unwrap();
    }
    model("sparse/0");
    assert_eq!(told("colmap"), "");
    model("sparse/1");
    assert!(
        told("colmap").contains("sparse/0/cameras.txt is read, not sparse/1/cameras.txt:"),
        "{}",
        told("colmap")
    );
}

#[test]
fn a_camera_without_pictures_is_told_with_what_is_there() {
    let pictures = folder(&["cam1/0.png", "GOPR7/0.png"]);
    write(&pictures, "calibration.toml", &format!("[cam1]{}", documented()));
    let footage = read(pictures.path(), "toml");
    let told = footage.skipped.join("\n");
    assert!(told.contains("has no video or folder called") && told.contains("GOPR7"), "{told}");
}
