//! A small capture in every format: two pinhole cameras, one frame.

use ffgs_testkit::look_at;
use glam::{DMat3, DMat4, DQuat, DVec3, DVec4};
use std::fs;
use std::path::Path;

const WIDTH: u32 = 32;
const HEIGHT: u32 = 24;
const FOCAL: f64 = 30.0;

fn poses() -> [DMat4; 2] {
    [DVec3::new(3.0, 0.5, 1.0), DVec3::new(0.5, 3.0, 1.0)].map(|eye| look_at(eye, DVec3::ZERO))
}

/// Writes the capture. A format that is added needs its lines here.
pub(crate) fn write(format: &str, folder: &Path) {
    match format {
        "dynamic3dgs" => dynamic3dgs(folder),
        "panoptic" => panoptic(folder),
        "n3dv" => n3dv(folder),
        "transforms" => transforms(folder),
        "easyvolcap" => easyvolcap(folder),
        "toml" => toml(folder),
        "qualisys" => qualisys(folder),
        "colmap" => colmap(folder),
        "opencv" => opencv(folder),
        other => panic!("no capture of the format {other}: add one"),
    }
}

fn file(folder: &Path, name: &str, bytes: impl AsRef<[u8]>) {
    let path = folder.join(name);
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    fs::write(path, bytes).unwrap();
}

fn pictures(folder: &Path, names: impl IntoIterator<Item = &'static str>) {
    for (i, name) in names.into_iter().enumerate() {
        let path = folder.join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        image::RgbImage::from_pixel(WIDTH, HEIGHT, image::Rgb([60 + 50 * i as u8; 3])).save(path).unwrap();
    }
}

/// Numbers of a matrix, row by row.
fn rows(m: DMat3) -> Vec<f64> {
    m.transpose().to_cols_array().to_vec()
}

fn nested(m: DMat3) -> String {
    let rows: Vec<String> = rows(m).chunks(3).map(|row| format!("{row:?}")).collect();
    format!("[{}]", rows.join(", "))
}

/// The camera matrix in a convention that has the first pixel's centre at `centre`.
fn matrix(centre: f64) -> DMat3 {
    let [cx, cy] = [WIDTH, HEIGHT].map(|side| f64::from(side) / 2.0 - 0.5 + centre);
    DMat3::from_cols(DVec3::X * FOCAL, DVec3::Y * FOCAL, DVec3::new(cx, cy, 1.0))
}

fn rotation(pose: DMat4) -> DMat3 {
    DMat3::from_mat4(pose)
}

fn translation(pose: DMat4) -> [f64; 3] {
    pose.w_axis.truncate().to_array()
}

fn dynamic3dgs(folder: &Path) {
    pictures(folder, ["ims/a/0.png", "ims/b/0.png"]);
    let pose = |pose: DMat4| {
        let rows: Vec<String> = (0..4).map(|i| format!("{:?}", pose.row(i).to_array())).collect();
        format!("[{}]", rows.join(", "))
    };
    let ([a, b], k) = (poses().map(pose), nested(matrix(0.5)));
    let text = format!(
        r#"{{"w": {WIDTH}, "h": {HEIGHT}, "k": [[{k}, {k}]], "w2c": [[{a}, {b}]],
        "fn": [["a/0.png", "b/0.png"]], "cam_id": [[0, 1]]}}"#
    );
    file(folder, "train_meta.json", text);
}

fn panoptic(folder: &Path) {
    pictures(folder, ["hdImgs/00_00/1.png", "hdImgs/00_01/1.png"]);
    let camera = |(i, pose): (usize, DMat4)| {
        let [x, y, z] = translation(pose).map(|metres| 100.0 * metres);
        format!(
            r#"{{"name": "00_0{i}", "type": "hd", "resolution": [{WIDTH}, {HEIGHT}], "K": {}, "R": {},
            "distCoef": [0, 0, 0, 0, 0], "t": [[{x}], [{y}], [{z}]]}}"#,
            nested(matrix(0.0)),
            nested(rotation(pose))
        )
    };
    let cameras: Vec<String> = poses().into_iter().enumerate().map(camera).collect();
    file(folder, "calibration_a.json", format!(r#"{{"cameras": [{}]}}"#, cameras.join(", ")));
}

fn n3dv(folder: &Path) {
    // The format holds the first camera out.
    pictures(folder, ["images/cam00.png", "images/cam01.png", "images/cam02.png"]);
    let mut values = Vec::new();
    let held_out = look_at(DVec3::new(2.0, 2.0, 1.5), DVec3::ZERO);
    for pose in [held_out].into_iter().chain(poses()) {
        let m = pose.inverse();
        let size = [f64::from(HEIGHT), f64::from(WIDTH), FOCAL];
        for (i, size) in size.into_iter().enumerate() {
            values.extend([m.y_axis[i], m.x_axis[i], -m.z_axis[i], m.w_axis[i], size]);
        }
        values.extend([1.0, 9.0]);
    }
    let header = "{'descr': '<f8', 'fortran_order': False, 'shape': (3, 17), }\n";
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.bytes());
    bytes.extend(values.iter().flat_map(|v: &f64| v.to_le_bytes()));
    file(folder, "poses_bounds.npy", bytes);
}

fn transforms(folder: &Path) {
    pictures(folder, ["images/a.png", "images/b.png"]);
    let flip = DMat4::from_diagonal(DVec4::new(1.0, -1.0, -1.0, 1.0));
    let frame = |(name, pose): (&str, DMat4)| {
        let m = (pose.inverse() * flip).transpose().to_cols_array_2d();
        format!(r#"{{"file_path": "images/{name}.png", "transform_matrix": {m:?}}}"#)
    };
    let frames: Vec<String> = ["a", "b"].into_iter().zip(poses()).map(frame).collect();
    let lens =
        format!(r#""fl_x": {FOCAL}, "fl_y": {FOCAL}, "cx": 16, "cy": 12, "w": {WIDTH}, "h": {HEIGHT}"#);
    file(folder, "transforms.json", format!(r#"{{{lens}, "frames": [{}]}}"#, frames.join(", ")));
}

fn easyvolcap(folder: &Path) {
    pictures(folder, ["images/01/0.png", "images/02/0.png"]);
    let entry = |name: String, values: &[f64], rows: usize| {
        let data = format!("{values:?}");
        format!("{name}: !!opencv-matrix\n  rows: {rows}\n  cols: 1\n  dt: d\n  data: {data}\n")
    };
    let (mut intri, mut extri) = ("%YAML:1.0\n---\n".to_owned(), "%YAML:1.0\n---\n".to_owned());
    for (name, pose) in ["01", "02"].into_iter().zip(poses()) {
        intri += &entry(format!("K_{name}"), &rows(matrix(0.0)), 3);
        intri += &entry(format!("dist_{name}"), &[0.0; 5], 5);
        extri += &entry(format!("Rot_{name}"), &rows(rotation(pose)), 3);
        extri += &entry(format!("T_{name}"), &translation(pose), 3);
    }
    file(folder, "intri.yml", intri);
    file(folder, "extri.yml", extri);
}

fn toml(folder: &Path) {
    pictures(folder, ["cam_0/1.png", "cam_1/1.png"]);
    let camera = |(i, pose): (usize, DMat4)| {
        format!(
            "[cameras.{i}]\ncam_id = {i}\nsize = [{WIDTH}, {HEIGHT}]\nmatrix = {}\n\
             distortions = [0.0, 0.0, 0.0, 0.0, 0.0]\nrotation = {}\ntranslation = {:?}\n",
            nested(matrix(0.0)),
            nested(rotation(pose)),
            translation(pose)
        )
    };
    file(folder, "calibration.toml", poses().into_iter().enumerate().map(camera).collect::<String>());
}

fn qualisys(folder: &Path) {
    pictures(folder, ["23087/1.png", "23088/1.png"]);
    let [cx, cy] = [WIDTH, HEIGHT].map(|side| 32.0 * (f64::from(side) - 1.0));
    let camera = |(i, pose): (usize, DMat4)| {
        let world_from_camera = pose.inverse();
        let [x, y, z] = translation(world_from_camera).map(|metres| 1000.0 * metres);
        let flip = DMat3::from_diagonal(DVec3::new(1.0, -1.0, -1.0));
        let axes = rows(flip * rotation(pose)).into_iter().enumerate();
        let axes: Vec<String> = axes.map(|(k, v)| format!("r{}{}=\"{v}\"", k / 3 + 1, k % 3 + 1)).collect();
        let axes = axes.join(" ");
        let f = 64.0 * FOCAL;
        format!(
            r#"<camera serial="{}"><fov_video left="0" top="0" right="{}" bottom="{}"/><transform x="{x}" y="{y}" z="{z}" {axes}/>
            <intrinsic focalLengthU="{f}" focalLengthV="{f}" centerPointU="{cx}" centerPointV="{cy}" radialDistortion1="0"
            radialDistortion2="0" tangentalDistortion1="0" tangentalDistortion2="0"/></camera>"#,
            23087 + i,
            WIDTH - 1,
            HEIGHT - 1
        )
    };
    let cameras = poses().into_iter().enumerate().map(camera).collect::<Vec<String>>().concat();
    file(folder, "session.qca.txt", format!("<calibration><cameras>{cameras}</cameras></calibration>"));
}

fn colmap(folder: &Path) {
    pictures(folder, ["images/a.png", "images/b.png"]);
    let image = |(i, (name, pose)): (usize, (&str, DMat4))| {
        let (q, [x, y, z]) = (DQuat::from_mat3(&rotation(pose)), translation(pose));
        format!("{} {} {} {} {} {x} {y} {z} 1 {name}\n\n", i + 1, q.w, q.x, q.y, q.z)
    };
    let images: String = ["a.png", "b.png"].into_iter().zip(poses()).enumerate().map(image).collect();
    file(folder, "sparse/0/cameras.txt", format!("1 PINHOLE {WIDTH} {HEIGHT} {FOCAL} {FOCAL} 16 12\n"));
    file(folder, "sparse/0/images.txt", images);
    file(folder, "sparse/0/points3D.txt", "1 0.1 0.2 0.3 10 20 30 0.1\n");
}

fn opencv(folder: &Path) {
    pictures(folder, ["cam1/1.png", "cam2/1.png"]);
    let entry = |name: &str, values: &[f64]| {
        let words: Vec<String> = values.iter().map(f64::to_string).collect();
        format!("<{name} type_id=\"opencv-matrix\"><data>{}</data></{name}>", words.join(" "))
    };
    for (name, pose) in ["cam1", "cam2"].into_iter().zip(poses()) {
        let camera = [
            entry("CameraMatrix", &rows(matrix(0.0))),
            entry("DistortionCoeffs", &[0.0; 5]),
            entry("Rotation", &rows(rotation(pose))),
            entry("Translation", &translation(pose)),
        ];
        let text = format!("<?xml version=\"1.0\"?><opencv_storage>{}</opencv_storage>", camera.concat());
        file(folder, &format!("{name}/config.xml"), text);
    }
}
