//! What a check tells of a capture whose files are all sound: a ball among five cameras, with one thing wrong each time.

use ffgs_arrays::NpzWriter;
use ffgs_core::{Camera, ImageSize, Intrinsics};
use ffgs_dataset::{Capture, check};
use glam::{DMat3, DMat4, DVec2, DVec3};
use image::{GrayImage, Luma, Rgb, RgbImage};
use std::f64::consts::TAU;
use std::fs;
use std::path::Path;
use tempfile::TempDir;

const SIZE: ImageSize = ImageSize { width: 160, height: 120 };
const CAMERAS: usize = 5;
const FRAMES: usize = 12;

fn camera(i: usize) -> Camera {
    let angle = TAU * i as f64 / CAMERAS as f64;
    let eye = DVec3::new(4.0 * angle.cos(), 4.0 * angle.sin(), 1.5);
    let forward = -eye.normalize();
    let right = forward.cross(DVec3::Z).normalize();
    let rotation = DMat3::from_cols(right, forward.cross(right), forward).transpose();
    let pose = DMat4::from_translation(-(rotation * eye)) * DMat4::from_mat3(rotation);
    Camera::new(Intrinsics { fx: 140.0, fy: 140.0, cx: 80.0, cy: 60.0 }, pose, SIZE).unwrap()
}

fn on_ball(camera: &Camera, x: u32, y: u32, time: f64) -> bool {
    let centre = DVec3::new(0.12 * time - 0.7, 0.3 * (0.5 * time).sin(), 0.2 * (0.4 * time).cos());
    let ray = camera.ray(DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5));
    let to = centre - camera.center();
    (to - ray * to.dot(ray) / ray.length_squared()).length() < 0.35
}

/// What a view shows at a frame: the time, the brightness of its image, and a change of its mask.
struct Shown {
    time: f64,
    grey: u8,
    mask: fn(GrayImage) -> GrayImage,
}

fn unchanged(mask: GrayImage) -> GrayImage {
    mask
}

fn sound(_: usize, frame: usize) -> Shown {
    Shown { time: frame as f64, grey: 120, mask: unchanged }
}

fn capture(shown: impl Fn(usize, usize) -> Shown) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    write_meta(root);
    for i in 0..CAMERAS {
        for kind in ["ims", "seg"] {
            fs::create_dir_all(root.join(format!("{kind}/c{i}"))).unwrap();
        }
        for frame in 0..FRAMES {
            let Shown { time, grey, mask } = shown(i, frame);
            let camera = camera(i);
            let ball = |x, y| on_ball(&camera, x, y, time);
            let (width, height) = (SIZE.width as u32, SIZE.height as u32);
            let silhouette = GrayImage::from_fn(width, height, |x, y| Luma([u8::from(ball(x, y))]));
            let image = RgbImage::from_pixel(width, height, Rgb([grey; 3]));
            image.save(root.join(format!("ims/c{i}/{frame:06}.png"))).unwrap();
            mask(silhouette).save(root.join(format!("seg/c{i}/{frame:06}.png"))).unwrap();
        }
    }
    let row = |k: usize| {
        let angle = 0.7 * k as f32;
        [2.0 * angle.cos(), 2.0 * angle.sin(), -0.5 + 0.01 * k as f32, 0.5, 0.5, 0.5, 0.0]
    };
    let rows: Vec<f32> = (0..100).flat_map(row).collect();
    NpzWriter::new().f32("data", &[100, 7], &rows).write(&root.join("init_pt_cld.npz")).unwrap();
    folder
}

fn write_meta(root: &Path) {
    let per_camera = |value: &dyn Fn(usize) -> String| {
        format!("[{}]", (0..CAMERAS).map(value).collect::<Vec<_>>().join(","))
    };
    let per_frame = |value: &dyn Fn(usize) -> String| {
        format!("[{}]", (0..FRAMES).map(value).collect::<Vec<_>>().join(","))
    };
    let k = per_camera(&|_| "[[140,0,80],[0,140,60],[0,0,1]]".to_owned());
    let w2c = per_camera(&|i| format!("{:?}", camera(i).camera_from_world().transpose().to_cols_array_2d()));
    let ids = per_camera(&|i| i.to_string());
    let names = per_frame(&|t| per_camera(&|i| format!("\"c{i}/{t:06}.png\"")));
    let meta = format!(
        r#"{{"w":160,"h":120,"k":{},"w2c":{},"fn":{names},"cam_id":{}}}"#,
        per_frame(&|_| k.clone()),
        per_frame(&|_| w2c.clone()),
        per_frame(&|_| ids.clone())
    );
    fs::write(root.join("train_meta.json"), meta).unwrap();
}

/// The notes, but for those that there are no test views.
fn notes(folder: &TempDir) -> Vec<String> {
    let report = check(&Capture::open(folder.path()).unwrap());
    assert!(report.is_usable(), "{report}");
    let notes = report.notes.into_iter().filter(|n| !n.text.contains("no test views"));
    notes.map(|n| format!("{}: {}", n.file.display(), n.text)).collect()
}

/// The only note is about camera c2, and says this.
fn assert_only(folder: &TempDir, text: &str) {
    let notes = notes(folder);
    assert!(notes.len() == 1 && notes[0].contains("c2") && notes[0].contains(text), "{notes:#?}");
}

#[test]
fn nothing_is_told_of_a_sound_capture() {
    assert_eq!(notes(&capture(sound)), Vec::<String>::new());
}

#[test]
fn a_mask_that_loses_its_object_for_a_frame_is_told() {
    let flickers = |i, t| {
        let mask =
            if (i, t) == (2, 6) { |m: GrayImage| GrayImage::new(m.width(), m.height()) } else { unchanged };
        Shown { mask, ..sound(i, t) }
    };
    let notes = notes(&capture(flickers));
    assert!(
        notes.iter().any(|n| n.contains("c2") && n.contains("masks flicker") && n.contains("frame 6")),
        "{notes:#?}"
    );
}

#[test]
fn a_change_of_exposure_is_told() {
    let darker = |i, t| Shown { grey: if i == 2 && t >= 7 { 100 } else { 120 }, ..sound(i, t) };
    assert_only(&capture(darker), "exposure changes from one frame to the next at frame 7");
}

/// Camera c2 started two frames late.
fn late(i: usize, t: usize) -> Shown {
    Shown { time: t as f64 + if i == 2 { 2.0 } else { 0.0 }, ..sound(i, t) }
}

#[test]
fn the_clock_of_a_camera_that_moves_and_comes_back_is_not_told() {
    let folder = capture(late);
    let file = folder.path().join("train_meta.json");
    let mut meta: serde_json::Value = serde_json::from_str(&fs::read_to_string(&file).unwrap()).unwrap();
    meta["w2c"][5][2][0][3] = 0.5.into();
    fs::write(&file, meta.to_string()).unwrap();
    assert!(!notes(&folder).iter().any(|n| n.contains("not synchronised")));
}

#[test]
fn a_camera_that_started_late_is_told_with_its_offset() {
    let notes = notes(&capture(late));
    let found = notes.iter().filter(|n| n.contains("not synchronised")).collect::<Vec<_>>();
    assert!(
        found.len() == 1 && found[0].contains("2 frames later") && found[0].contains("c2=-2"),
        "{notes:#?}"
    );
}

#[test]
fn masks_of_another_place_are_told() {
    let aside = |m: GrayImage| {
        let (width, height) = m.dimensions();
        GrayImage::from_fn(width, height, |x, y| *m.get_pixel((x + width / 2) % width, y))
    };
    let moved = |i, t| Shown { mask: if i == 2 { aside } else { unchanged }, ..sound(i, t) };
    let notes = notes(&capture(moved));
    let found = notes.iter().filter(|n| n.contains("where the masks of the other cameras have none"));
    assert!(found.clone().count() == 1 && found.clone().all(|n| n.contains("c2")), "{notes:#?}");
}

#[test]
fn a_camera_that_is_upside_down_is_told() {
    let turned = |m: GrayImage| image::imageops::rotate180(&m);
    // The ball stays away from the middle, which turns about itself.
    let shown = |i, t| {
        let time = 0.3 * t as f64 - 4.0;
        Shown { time, mask: if i == 2 { turned } else { unchanged }, ..sound(i, t) }
    };
    let notes = notes(&capture(shown));
    let found = notes.iter().filter(|n| n.contains("upside down"));
    assert!(found.clone().count() == 1 && found.clone().all(|n| n.contains("c2")), "{notes:#?}");
}
