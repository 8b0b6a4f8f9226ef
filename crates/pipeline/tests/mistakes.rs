//! What `ffgs check` answers to each gross mistake that a user makes: a sound capture with one thing wrong at a time.

use ffgs_arrays::{NpzFile, NpzWriter};
use image::{DynamicImage, GrayImage, RgbaImage, imageops};
use serde_json::{Value, json};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use tempfile::TempDir;

/// How the check ends.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Ends {
    /// The capture can be used; the answer is a note, or nothing.
    Usable,
    /// A fault: the check fails, and the message says how to mend it.
    Fault,
}
use Ends::{Fault, Usable};

/// A mistake: its name, what makes it in a sound capture, how the check ends and what it says.
type Mistake = (&'static str, fn(&Path), Ends, &'static str);

const MISTAKES: &[Mistake] = &[
    ("none", |_| (), Usable, "no faults"),
    ("masks are cut-outs (RGBA)", cut_outs, Usable, "no faults"),
    ("masks are inverted", |root| masks(root, inverted), Fault, "masks that cover most of the image"),
    ("masks are the photographs", photographs, Fault, "masks that cover most of the image"),
    ("a mask of another size", |root| resized(root, "seg"), Fault, "is 40 x 30, but its camera is 256 x 144"),
    ("camera-to-world", camera_to_world, Fault, "if w2c were camera-to-world"),
    ("axes of OpenGL", opengl, Fault, "if w2c were in OpenGL's axes"),
    ("intrinsics of a larger size", |root| intrinsics(root, 4.0), Fault, "lies outside"),
    ("intrinsics of half the size", |root| intrinsics(root, 0.5), Usable, "is far from the middle"),
    ("skew", |root| train(root, |k, _| k[0][1] = json!(3.0)), Fault, "skew"),
    ("a pose with NaN", nan_pose, Fault, "train_meta.json"),
    ("lengths in millimetres", millimetres, Usable, "are the lengths metres"),
    (
        "rows and columns of tracks exchanged",
        |root| tracks(root, <[f32]>::reverse),
        Fault,
        "like row, column",
    ),
    ("tracks of another size", |root| tracks(root, double), Fault, "like those of another size"),
    ("a frame without tracks", without_tracks, Usable, "no view has a file for frame 2"),
    (
        "an image of another size",
        |root| resized(root, "ims"),
        Fault,
        "is 40 x 30, but its camera is 256 x 144",
    ),
    ("a mask is missing", |root| fs::remove_file(root.join(MASK)).unwrap(), Usable, "count as empty"),
    ("an image is missing", |root| fs::remove_file(root.join(IMAGE)).unwrap(), Fault, "trk003/000001.png"),
    ("an image is cut off", cut_off, Fault, "not a readable image"),
    ("test cameras are training cameras", shared, Usable, "also trained on"),
    ("one camera with the pose of another", twins, Usable, "stand in the same place"),
    ("one camera with half the exposure", darker, Usable, "exposure differs: camera 'trk003'"),
    ("one camera upside down", upside_down, Usable, "upside down"),
    ("points of an older program", older_points, Usable, "its points were made by an older version"),
];

/// The camera at which one-camera mistakes are made.
const CAMERA: &str = "trk003";
const IMAGE: &str = "ims/trk003/000001.png";
const MASK: &str = "seg/trk003/000001.png";

#[test]
fn every_gross_mistake_is_named() {
    let wrong: Vec<String> = MISTAKES.iter().filter_map(missed).collect();
    assert!(wrong.is_empty(), "{}", wrong.join("\n\n"));
}

/// What the check said, where it is not what the table demands.
fn missed((name, make, ends, part): &Mistake) -> Option<String> {
    let folder = sound();
    make(folder.path());
    let output = Command::new(env!("CARGO_BIN_EXE_ffgs"))
        .args(["check", "--quiet"])
        .arg(folder.path())
        .stdin(Stdio::null())
        .output()
        .unwrap();
    let said = [&output.stdout, &output.stderr].map(|text| String::from_utf8_lossy(text)).concat();
    let found = if output.status.success() { Usable } else { Fault };
    (found != *ends || !said.contains(part)).then(|| format!("{name}: {found:?}, without {part:?}\n{said}"))
}

/// A copy of the small capture.
fn sound() -> TempDir {
    let folder = TempDir::new().unwrap();
    let from = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/scenes/pool-mini");
    for name in ["train_meta.json", "test_meta.json", "init_pt_cld.npz"] {
        fs::copy(from.join(name), folder.path().join(name)).unwrap();
    }
    for name in ["ims", "seg", "tracks"] {
        copy_folder(&from.join(name), &folder.path().join(name));
    }
    folder
}

fn copy_folder(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap().map(Result::unwrap) {
        let target = to.join(entry.file_name());
        if entry.path().is_dir() {
            copy_folder(&entry.path(), &target);
        } else {
            fs::copy(entry.path(), target).unwrap();
        }
    }
}

/// All files in the folders of a folder.
fn files(folder: &Path) -> Vec<PathBuf> {
    let inside = |folder: &Path| fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()).collect::<Vec<_>>();
    inside(folder).iter().flat_map(|camera| inside(camera)).collect()
}

fn masks(root: &Path, change: impl Fn(GrayImage) -> GrayImage) {
    for file in files(&root.join("seg")) {
        change(image::open(&file).unwrap().into_luma8()).save(&file).unwrap();
    }
}

fn inverted(mut mask: GrayImage) -> GrayImage {
    mask.iter_mut().for_each(|v| *v = u8::from(*v == 0) * 255);
    mask
}

/// The masks hold the object's colours, with the mask as alpha.
fn cut_outs(root: &Path) {
    for file in files(&root.join("seg")) {
        let mask = image::open(&file).unwrap().into_luma8();
        let cut = RgbaImage::from_fn(mask.width(), mask.height(), |x, y| {
            let alpha = u8::from(mask.get_pixel(x, y).0[0] > 0) * 255;
            image::Rgba([90, 120, 60, alpha])
        });
        cut.save(&file).unwrap();
    }
}

fn photographs(root: &Path) {
    fs::remove_dir_all(root.join("seg")).unwrap();
    copy_folder(&root.join("ims"), &root.join("seg"));
}

fn resized(root: &Path, folder: &str) {
    let file = root.join(folder).join(CAMERA).join("000001.png");
    GrayImage::new(40, 30).save(file).unwrap();
}

fn cut_off(root: &Path) {
    let bytes = fs::read(root.join(IMAGE)).unwrap();
    fs::write(root.join(IMAGE), &bytes[..bytes.len() / 2]).unwrap();
}

fn darker(root: &Path) {
    change_images(root, |image| {
        let mut image = image.into_rgb8();
        image.iter_mut().for_each(|v| *v /= 2);
        image.into()
    });
}

fn upside_down(root: &Path) {
    change_images(root, |image| image.rotate180());
    for file in files(&root.join("seg")).iter().filter(|f| f.parent().unwrap().ends_with(CAMERA)) {
        imageops::rotate180(&image::open(file).unwrap().into_luma8()).save(file).unwrap();
    }
}

fn change_images(root: &Path, change: impl Fn(DynamicImage) -> DynamicImage) {
    for file in files(&root.join("ims")).iter().filter(|f| f.parent().unwrap().ends_with(CAMERA)) {
        change(image::open(file).unwrap()).save(file).unwrap();
    }
}

fn read(file: &Path) -> Value {
    serde_json::from_slice(&fs::read(file).unwrap()).unwrap()
}

/// Changes the intrinsics and the pose of every training camera and frame.
fn train(root: &Path, change: impl Fn(&mut Value, &mut Value)) {
    let file = root.join("train_meta.json");
    let mut meta = read(&file);
    for frame in 0..meta["k"].as_array().unwrap().len() {
        for camera in 0..meta["k"][frame].as_array().unwrap().len() {
            let (mut k, mut pose) = (meta["k"][frame][camera].take(), meta["w2c"][frame][camera].take());
            change(&mut k, &mut pose);
            (meta["k"][frame][camera], meta["w2c"][frame][camera]) = (k, pose);
        }
    }
    fs::write(file, meta.to_string()).unwrap();
}

fn intrinsics(root: &Path, factor: f64) {
    train(root, |k, _| {
        for (row, column) in [(0, 0), (0, 2), (1, 1), (1, 2)] {
            k[row][column] = json!(k[row][column].as_f64().unwrap() * factor);
        }
    });
}

/// Row-major poses.
fn poses(root: &Path, change: impl Fn(glam::DMat4) -> glam::DMat4) {
    train(root, |_, pose| {
        let rows: [[f64; 4]; 4] = serde_json::from_value(pose.take()).unwrap();
        let changed = change(glam::DMat4::from_cols_array_2d(&rows).transpose());
        *pose = json!(changed.transpose().to_cols_array_2d());
    });
}

fn camera_to_world(root: &Path) {
    poses(root, |m| m.inverse());
}

fn opengl(root: &Path) {
    poses(root, |m| glam::DMat4::from_diagonal(glam::DVec4::new(1.0, -1.0, -1.0, 1.0)) * m);
}

fn nan_pose(root: &Path) {
    let file = root.join("train_meta.json");
    let mut meta = read(&file);
    meta["w2c"][1][2][0][3] = json!(0.123_456_789);
    // JSON has no NaN, but Python writes it.
    fs::write(&file, meta.to_string().replacen("0.123456789", "NaN", 1)).unwrap();
}

fn millimetres(root: &Path) {
    poses(root, |mut m| {
        m.w_axis = (1000.0 * m.w_axis.truncate()).extend(1.0);
        m
    });
    let file = root.join("init_pt_cld.npz");
    let points = NpzFile::open(&file).unwrap().f32("data").unwrap();
    let scaled = |(i, v): (usize, &f32)| if i % 7 < 3 { 1000.0 * v } else { *v };
    let values: Vec<f32> = points.data.iter().enumerate().map(scaled).collect();
    NpzWriter::new().f32("data", &points.shape, &values).write(&file).unwrap();
}

/// Changes both ends of every track of a tracker.
fn tracks(root: &Path, change: impl Fn(&mut [f32])) {
    for file in files(&root.join("tracks/descriptors")) {
        let npz = NpzFile::open(&file).unwrap();
        let mut writer = NpzWriter::new();
        for name in ["src", "tgt"] {
            let mut ends = npz.f32(name).unwrap();
            ends.data.chunks_exact_mut(2).for_each(&change);
            writer.f32(name, &ends.shape, &ends.data);
        }
        let visibility = npz.f32("visibility").unwrap();
        writer.f32("visibility", &visibility.shape, &visibility.data).write(&file).unwrap();
    }
}

fn double(end: &mut [f32]) {
    end.iter_mut().for_each(|v| *v *= 2.0);
}

fn without_tracks(root: &Path) {
    for file in files(&root.join("tracks/descriptors")).iter().filter(|f| f.ends_with("000002.npz")) {
        fs::remove_file(file).unwrap();
    }
}

/// The second camera has the pose of the first.
fn twins(root: &Path) {
    let file = root.join("train_meta.json");
    let mut train = read(&file);
    for frame in train["w2c"].as_array_mut().unwrap() {
        frame[1] = frame[0].clone();
    }
    fs::write(file, train.to_string()).unwrap();
}

/// `ffgs prepare` made the capture before steps had versions; pictures were as good then.
fn older_points(root: &Path) {
    let prepared = json!({"settings": {}, "steps": {"pictures": "few", "points": "many"}, "origin": [0, 0, 0],
        "metres_per_unit": 1, "assumed": [], "skipped": []});
    fs::write(root.join("prepare.json"), prepared.to_string()).unwrap();
}

/// The test cameras are the first three training cameras.
fn shared(root: &Path) {
    let (train, file) = (read(&root.join("train_meta.json")), root.join("test_meta.json"));
    let mut test = read(&file);
    for key in ["k", "w2c", "fn", "cam_id"] {
        let frames = train[key].as_array().unwrap().iter();
        test[key] = frames.map(|cameras| json!(cameras.as_array().unwrap()[..3])).collect();
    }
    fs::write(file, test.to_string()).unwrap();
}
