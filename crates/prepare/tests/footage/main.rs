//! A ball that rolls through a ring of cameras, from footage to a capture.

mod again;
mod told;
mod videos;

use ffgs_arrays::NpzFile;
use ffgs_core::{Camera, ImageSize, Intrinsics};
use ffgs_dataset::{Capture, Split, check};
use ffgs_prepare::{Layout, Request, Step, Summary, TestCameras, convert, prepare};
use glam::{DMat3, DMat4, DVec2, DVec3, Vec3};
use image::{Rgb, RgbImage};
use std::f64::consts::PI;
use std::fs;
use std::num::NonZeroUsize;
use std::path::Path;
use tempfile::TempDir;

const SIZE: ImageSize = ImageSize { width: 128, height: 96 };
const FRAMES: usize = 8;
const CAMERAS: usize = 6;
/// A frame in which the ball is out of sight.
const FAR_AWAY: usize = 1000;

fn camera(i: usize) -> Camera {
    let angle = std::f64::consts::TAU * i as f64 / CAMERAS as f64;
    let eye = DVec3::new(3.0 * angle.cos(), 3.0 * angle.sin(), 1.2);
    let forward = -eye.normalize();
    let right = forward.cross(DVec3::Z).normalize();
    let rotation = DMat3::from_cols(right, forward.cross(right), forward).transpose();
    let mut pose = DMat4::from_mat3(rotation);
    pose.w_axis = (-(rotation * eye)).extend(1.0);
    Camera::new(Intrinsics { fx: 110.0, fy: 110.0, cx: 64.0, cy: 48.0 }, pose, SIZE).unwrap()
}

/// Where the ball is in a frame (x, m).
fn place(frame: usize) -> f64 {
    -0.7 + 0.2 * frame as f64
}

/// Whether a ray through the pixel meets the ball.
fn on_ball(camera: &Camera, x: u32, y: u32, place: f64) -> bool {
    let centre = DVec3::new(place, 0.1, 0.0);
    let ray = camera.ray(DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5));
    let to = centre - camera.center();
    to.dot(ray) > 0.0 && (to - ray * to.dot(ray)).length() < 0.35
}

/// Values of a hash of the place, so that every picture has texture.
fn noise(x: u32, y: u32, seed: u32) -> u8 {
    let mut h = x.wrapping_mul(0x9E37_79B1) ^ y.wrapping_mul(0x85EB_CA77) ^ seed.wrapping_mul(0xC2B2_AE3D);
    h = (h ^ (h >> 15)).wrapping_mul(0x2C1B_3C6D);
    ((h ^ (h >> 13)) % 40) as u8
}

fn picture(i: usize, frame: usize) -> RgbImage {
    picture_at(i, place(frame))
}

fn picture_at(i: usize, place: f64) -> RgbImage {
    let camera = camera(i);
    RgbImage::from_fn(SIZE.width as u32, SIZE.height as u32, |x, y| {
        let n = noise(x / 3, y / 3, i as u32);
        if on_ball(&camera, x, y, place) {
            Rgb([220 - n, 60 + n, 50])
        } else {
            Rgb([70 + n, 90 + n, 110 + n / 2])
        }
    })
}

/// Some pictures of the empty scene, then the ball's.
fn footage(empty: usize, frames: usize) -> TempDir {
    let shown = std::iter::repeat_n(FAR_AWAY, empty).chain(0..frames);
    footage_at(&shown.map(place).collect::<Vec<_>>())
}

/// A folder with a TOML calibration and a picture folder per camera: a picture for each place of the ball.
fn footage_at(places: &[f64]) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    for i in 0..CAMERAS {
        let pictures = folder.path().join(format!("cam_{i}"));
        fs::create_dir(&pictures).unwrap();
        for (number, place) in places.iter().enumerate() {
            picture_at(i, *place).save(pictures.join(format!("{}.png", number + 1))).unwrap();
        }
    }
    fs::write(folder.path().join("calibration.toml"), toml(|pose| pose)).unwrap();
    folder
}

/// The calibration, with poses as `stored`.
fn toml(stored: impl Fn(DMat4) -> DMat4) -> String {
    let section = |i: usize| {
        let camera = camera(i);
        let k = camera.intrinsics();
        let pose = stored(camera.camera_from_world());
        let r = DMat3::from_mat4(pose).transpose().to_cols_array_2d();
        let t = pose.w_axis;
        format!(
            "[cam_{i}]\nsize = [{}, {}]\nmatrix = [[{}, 0.0, {}], [0.0, {}, {}], [0.0, 0.0, 1.0]]\n\
             distortions = []\nrotation = {r:?}\ntranslation = [{}, {}, {}]\n",
            SIZE.width,
            SIZE.height,
            k.fx,
            k.cx - 0.5,
            k.fy,
            k.cy - 0.5,
            t.x,
            t.y,
            t.z
        )
    };
    (0..CAMERAS).map(section).collect()
}

fn request(folder: &TempDir) -> Request {
    // Below the footage, where nothing of it may be taken for footage.
    let out = folder.path().join("capture");
    Request { test: TestCameras::Named(vec!["cam_3".into()]), ..Request::new(folder.path().to_owned(), out) }
}

fn run(request: &Request) -> Summary {
    prepare(request, &|_: &str, _: usize, _: usize| ()).unwrap()
}

fn error(request: &Request) -> String {
    prepare(request, &|_: &str, _: usize, _: usize| ()).unwrap_err().to_string()
}

/// Intersection over union of all masks with the ball's silhouettes; the capture's frames are `frames` of the footage.
fn overlap(capture: &Capture, frames: std::ops::Range<usize>) -> f64 {
    overlap_at(capture, &frames.map(place).enumerate().collect::<Vec<_>>())
}

/// Intersection over union of the masks of some frames, with the ball's place in each.
fn overlap_at(capture: &Capture, frames: &[(usize, f64)]) -> f64 {
    let (mut both, mut either) = (0, 0);
    for view in 0..capture.views(Split::Train).len() {
        let index: usize = capture.views(Split::Train)[view].name[4..].parse().unwrap();
        for (frame, place) in frames {
            let mask = capture.load_mask(Split::Train, view, *frame).unwrap().unwrap();
            for (i, found) in mask.data().iter().enumerate() {
                let (x, y) = ((i % SIZE.width) as u32, (i / SIZE.width) as u32);
                let truth = on_ball(&camera(index), x, y, *place);
                both += usize::from(truth && *found == 1);
                either += usize::from(truth || *found == 1);
            }
        }
    }
    both as f64 / either as f64
}

#[test]
fn pictures_become_a_capture_that_can_be_run_and_gone_on_with() {
    let folder = footage(8, FRAMES);
    let request = Request { start: 8, ..request(&folder) };
    let summary = run(&request);
    assert!(summary.to_string().contains("6 cameras (0 videos), 1 held out, 8 frames"), "{summary}");
    let capture = Capture::open(&request.out).unwrap();
    let report = check(&capture);
    assert!(report.is_usable() && report.points > 100, "{report}");
    assert!(overlap(&capture, 0..FRAMES) > 0.85, "{}", overlap(&capture, 0..FRAMES));
    assert_eq!(capture.load_image(Split::Test, 0, 2).unwrap().data(), picture(3, 2).as_raw().as_slice());
    assert!((capture.camera(Split::Test, 0, 0).unwrap().center() - camera(3).center()).length() < 1e-6);
    for file in ["masks.png", "tracks/tracks.json", "tracks/lucas_kanade/cam_0/000007.npz"] {
        assert!(request.out.join(file).is_file(), "{file}");
    }
    assert!(!request.out.join("footage.part").exists(), "pictures that were kept for the masks");
    let told = Summary::read(&request.out.join(Summary::FILE)).unwrap().to_string();
    assert!(summary.to_string().ends_with(&told) && told.contains("assumed"), "{told}");
    // Nothing is made twice, what is forced is, and what is missing is made again.
    let stamp = |name: &str| fs::metadata(request.out.join(name)).unwrap().modified().unwrap();
    let before = (stamp("ims/cam_0/000000.png"), stamp("init_pt_cld.npz"));
    run(&Request { force: vec![Step::Points], ..request.clone() });
    assert!(stamp("ims/cam_0/000000.png") == before.0 && stamp("init_pt_cld.npz") > before.1);
    let other = error(&Request { every: NonZeroUsize::new(2).unwrap(), ..request.clone() });
    assert!(other.contains("every = 1") && other.contains('2'), "{other}");
}

/// Pictures of the empty scene make masks of a single frame, from which no background can be learnt.
#[test]
fn clean_plates_make_masks_of_a_single_frame() {
    let folder = footage(0, FRAMES);
    let plates = folder.path().join("clean_plates");
    fs::create_dir(&plates).unwrap();
    for i in 0..CAMERAS {
        picture(i, FAR_AWAY).save(plates.join(format!("CAM_{i}.png"))).unwrap();
    }
    let one = Request { start: 3, count: Some(1), ..request(&folder) };
    assert!(run(&one).to_string().contains("none: 1 frame cannot tell what moves"));
    let with = Request { clean_plates: Some(plates.clone()), ..one.clone() };
    assert!(error(&with).contains("--force masks"), "masks without clean plates stay");
    let again = Request { force: vec![Step::Masks], ..with.clone() };
    let told = run(&again).to_string();
    assert!(told.contains("made from clean plates of 6 fixed cameras"), "{told}");
    let capture = Capture::open(&with.out).unwrap();
    assert!(overlap(&capture, 3..4) > 0.9, "{}", overlap(&capture, 3..4));
    run(&with);

    let wrong = plates.join("CAM_2.png");
    RgbImage::new(8, 8).save(&wrong).unwrap();
    assert!(error(&again).contains("CAM_2.png: 8 x 8, but"), "{}", error(&again));
    let nobody = tempfile::tempdir().unwrap();
    fs::copy(&wrong, nobody.path().join("unknown.png")).unwrap();
    let unnamed = Request { clean_plates: Some(nobody.path().to_owned()), ..again.clone() };
    assert!(error(&unnamed).contains("cam_0.png, for example"), "{}", error(&unnamed));
    assert!(overlap(&capture, 3..4) > 0.9, "masks that cannot be made again stay");
    assert!(run(&with).to_string().contains("made from clean plates of 6 fixed cameras"));

    fs::rename(&plates, folder.path().join("empty")).unwrap();
    let among = Request { clean_plates: Some(folder.path().join("empty")), ..again };
    assert!(error(&among).contains("would be taken for footage"), "{}", error(&among));
}

/// The ball covers its middle in all frames, and the background that is learnt has its colours there. A background that is trusted finds
/// a tenth of the ball; frames in which it stands just where it was learnt stay without a mask (ADR 82).
#[test]
fn what_hardly_moves_has_fewer_holes() {
    let places: Vec<f64> = (0..FRAMES).map(|frame| -0.2 + 0.05 * frame as f64).collect();
    let folder = footage_at(&places);
    let request = Request { only: vec![Step::Pictures, Step::Masks], ..request(&folder) };
    run(&request);
    let frames: Vec<(usize, f64)> = places.into_iter().enumerate().collect();
    let overlap = overlap_at(&Capture::open(&request.out).unwrap(), &frames);
    assert!(overlap > 0.4, "{overlap}");
}

#[test]
fn masks_that_hold_nothing_are_told() {
    let summary = |places: [f64; 5]| {
        let folder = footage_at(&places);
        run(&Request { only: vec![Step::Pictures, Step::Masks], ..request(&folder) }).to_string()
    };
    assert!(summary([0.1; 5]).contains("ALL EMPTY"), "{}", summary([0.1; 5]));
    assert!(!summary([-0.6, -0.3, 0.0, 0.3, 0.6]).contains("ALL EMPTY"));
}

/// Backgrounds are learnt from twenty frames; the masks of the others are as good.
#[test]
fn frames_of_which_nothing_is_learnt_have_masks() {
    let places: Vec<f64> = (0..24).map(|frame| -0.7 + 0.06 * frame as f64).collect();
    let folder = footage_at(&places);
    let request = Request { only: vec![Step::Pictures, Step::Masks], ..request(&folder) };
    run(&request);
    let capture = Capture::open(&request.out).unwrap();
    let frames: Vec<(usize, f64)> = places.into_iter().enumerate().collect();
    let (others, samples): (Vec<_>, Vec<_>) = frames.into_iter().partition(|(frame, _)| frame % 6 == 5);
    let [samples, others] = [samples, others].map(|frames| overlap_at(&capture, &frames));
    assert!(samples > 0.85 && others > samples - 0.03, "{samples} {others}");
}

/// Masks that the footage has stay, and the same command goes on.
#[test]
fn clean_plates_do_not_replace_masks_of_the_footage() {
    let folder = footage(0, FRAMES);
    let plates = tempfile::tempdir().unwrap();
    picture(0, FAR_AWAY).save(plates.path().join("cam_0.png")).unwrap();
    let source = Request { only: vec![Step::Pictures, Step::Masks], ..request(&folder) };
    run(&source);
    let capture = tempfile::tempdir().unwrap();
    let with = Request {
        clean_plates: Some(plates.path().to_owned()),
        only: source.only.clone(),
        ..Request::new(source.out, capture.path().join("again"))
    };
    for _ in 0..2 {
        let told = run(&with).to_string();
        assert!(told.contains("those of the footage; the clean plates were not needed"), "{told}");
    }
}

#[test]
fn a_capture_written_for_other_tools_is_read_as_the_same_cameras() {
    let folder = footage(0, 1);
    let request = request(&folder);
    run(&request);
    let capture = Capture::open(&request.out).unwrap();
    for (layout, format) in [(Layout::Nerfstudio, "transforms"), (Layout::Colmap, "colmap")] {
        let out = tempfile::tempdir().unwrap();
        convert(&capture, layout, 0, out.path()).unwrap();
        let (found, file) = ffgs_calibration::detect(out.path(), None).unwrap();
        let read = (found.read)(out.path(), &file).unwrap();
        let (cameras, points) = (read.cameras, capture.initial_points().unwrap());
        assert_eq!((found.name, cameras.len()), (format, CAMERAS));
        assert!(!points.is_empty() && read.points.len() == points.len(), "{}", read.points.len());
        for (read, wanted) in read.points.iter().zip(&points.positions) {
            assert!((read.position.as_vec3() - Vec3::from(*wanted)).length() < 1e-5, "{wanted:?}");
        }
        for c in &cameras {
            let wanted = camera(c.name[4..].parse().unwrap());
            assert!((c.poses[0] - wanted.camera_from_world()).to_cols_array().iter().all(|v| v.abs() < 1e-6));
            assert_eq!((c.lens.intrinsics.cx, c.lens.size), (wanted.intrinsics().cx, SIZE));
        }
        assert!(convert(&capture, layout, 1, out.path()).unwrap_err().to_string().contains("no frame 1"));
    }
    fs::write(capture.points_path(), b"no archive").unwrap();
    let out = tempfile::tempdir().unwrap();
    let damaged = convert(&capture, Layout::Colmap, 0, out.path()).unwrap_err().to_string();
    assert!(damaged.contains("init_pt_cld.npz"), "{damaged}");
    fs::remove_file(capture.points_path()).unwrap();
    convert(&capture, Layout::Colmap, 0, out.path()).unwrap();
}

#[test]
fn bad_footage_is_told_with_its_file_and_leaves_no_list() {
    let folder = footage(0, 3);
    let request = Request { only: vec![Step::Pictures], ..request(&folder) };
    let short = error(&Request { count: Some(9), ..request.clone() });
    let source = folder.path().display().to_string();
    assert!(short.starts_with(&source) && short.contains("9 frames were asked for"), "{short}");
    fs::write(folder.path().join("cam_2/2.png"), b"not a picture").unwrap();
    let damaged = error(&request);
    assert!(damaged.contains("cam_2") && damaged.contains("2.png"), "{damaged}");
    assert!(!request.out.join("train_meta.json").exists());
    RgbImage::new(64, 48).save(folder.path().join("cam_2/2.png")).unwrap();
    assert!(error(&request).contains("64 x 48"));
    picture(2, 1).save(folder.path().join("cam_2/2.png")).unwrap();
    fs::remove_file(folder.path().join("cam_4/3.png")).unwrap();
    assert!(error(&Request { count: Some(3), ..request.clone() }).contains("now count = 3"));
    let summary = run(&request).to_string();
    assert!(summary.contains("1 of 3 moments lack a picture of a camera: cam_4 lacks 1"), "{summary}");
    assert_eq!(Capture::open(&request.out).unwrap().frames(), 2);
}

#[test]
fn steps_without_pictures_and_folders_without_a_calibration_are_told() {
    let folder = footage(0, 2);
    let masks = error(&Request { only: vec![Step::Masks], ..request(&folder) });
    assert!(masks.contains("no pictures yet, of which masks are made"), "{masks}");
    fs::rename(folder.path().join("calibration.toml"), folder.path().join("cameras.pkl")).unwrap();
    let unrecognised = error(&request(&folder));
    assert!(
        unrecognised.contains("looked for") && unrecognised.ends_with("there is cameras.pkl"),
        "{unrecognised}"
    );
    fs::remove_file(folder.path().join("cameras.pkl")).unwrap();
    assert!(error(&request(&folder)).ends_with("there is no file but pictures and videos"));
}

/// As with cameras of which the calibration says that all look away from the scene.
#[test]
fn cameras_that_agree_on_nothing_are_told() {
    let told = |stored: fn(DMat4) -> DMat4| {
        let folder = footage(4, 4);
        // Without texture nothing agrees by chance.
        for i in 0..CAMERAS {
            for file in fs::read_dir(folder.path().join(format!("cam_{i}"))).unwrap() {
                let file = file.unwrap().path();
                let mut picture = image::open(&file).unwrap().into_rgb8();
                picture
                    .pixels_mut()
                    .for_each(|p| p.0 = if p.0[0] > 150 { [220, 60, 50] } else { [70, 90, 110] });
                picture.save(&file).unwrap();
            }
        }
        fs::write(folder.path().join("calibration.toml"), toml(stored)).unwrap();
        let only = vec![Step::Pictures, Step::Masks, Step::Points];
        let request = Request { only, start: 4, ..request(&folder) };
        run(&request).to_string()
    };
    let (sound, away) = (told(|pose| pose), told(|pose| DMat4::from_rotation_y(PI) * pose));
    assert!(!sound.contains("no two cameras agree"), "{sound}");
    assert!(away.contains("no two cameras agree on a single point"), "{away}");
}

#[test]
fn points_of_a_capture_are_kept_as_they_are() {
    let folder = footage(0, 1);
    let first = request(&folder);
    run(&first);
    let again = tempfile::tempdir().unwrap();
    let summary = run(&Request::new(first.out.clone(), again.path().join("capture"))).to_string();
    assert!(summary.contains(" of the footage\n"), "{summary}");
    let points = |out: &Path| {
        let rows = NpzFile::open(&out.join("init_pt_cld.npz")).unwrap().f32("data").unwrap();
        rows.rows::<7>().unwrap().iter().map(|row| [row[0], row[1], row[2]]).collect::<Vec<_>>()
    };
    let before = points(&first.out);
    assert!(before.len() > 100);
    assert_eq!(points(&again.path().join("capture")), before);
}

#[test]
fn a_static_scene_has_no_masks_and_is_usable() {
    let folder = footage(0, 1);
    let request = request(&folder);
    let summary = run(&request).to_string();
    assert!(summary.contains("masks        none"), "{summary}");
    assert!(check(&Capture::open(&request.out).unwrap()).is_usable());
}

#[test]
fn a_network_that_cannot_be_used_is_told_before_anything_is_made() {
    let folder = footage(0, 2);
    let with = |network: &str| Request { networks: vec![network.to_owned()], ..request(&folder) };
    for (network, wanted) in
        [("nowhere.toml", "nowhere.toml"), ("unknown=a.onnx", "raft, xfeat"), ("raft=a.onnx", "a.onnx")]
    {
        let told = error(&with(network));
        assert!(told.contains(wanted), "{told}");
    }
    let file = folder.path().join("net.toml");
    fs::write(&file, "name = 'descriptors'\nmodel = 'a'\n[input]\nnames = ['a']\n[flow]\noutput = 'f'\n")
        .unwrap();
    assert!(error(&with(file.to_str().unwrap())).contains("another tracker has the name 'descriptors'"));
    assert!(!request(&folder).out.exists());
}

/// Skipped, with a message, where ONNX Runtime is not installed.
#[test]
fn a_network_tracks_beside_the_others_and_can_be_added_later() {
    let folder = footage(0, 2);
    run(&request(&folder));
    let out = request(&folder).out;
    let others = r#"{"trackers": [{"name": "mine", "level": "dense", "format": "flo", "pattern": "mine/{camera}.flo"}]}"#;
    fs::write(out.join("tracks/tracks.json"), others).unwrap();
    fs::create_dir(out.join("tracks/mine")).unwrap();
    let blocks = Path::new(env!("CARGO_MANIFEST_DIR")).join("../networks/tests/networks/blocks.onnx");
    let describe = |rest: &str| {
        let text = "name = 'blocks'\nlevel = 'medium'\n[input]\nnames = ['before', 'now']\n[flow]\noutput = 'flow'\n";
        fs::write(folder.path().join("net.toml"), format!("model = '{}'\n{text}{rest}", blocks.display()))
            .unwrap();
    };
    describe("");
    let networks = vec![folder.path().join("net.toml").display().to_string()];
    let with = Request { networks, ..request(&folder) };
    let summary = match prepare(&with, &|_: &str, _: usize, _: usize| ()) {
        Err(error) if std::env::var_os("ORT_DYLIB_PATH").is_none() => return eprintln!("skipped: {error}"),
        other => other.unwrap().to_string(),
    };
    assert!(summary.contains("blocks (medium, network)"), "{summary}");
    let flow = out.join("tracks/blocks/cam_0/000001.flo");
    assert_eq!(fs::metadata(&flow).unwrap().len() as usize, 12 + 8 * SIZE.pixels());
    let stamp = || fs::metadata(&flow).unwrap().modified().unwrap();
    let first = stamp();
    run(&with);
    assert_eq!(stamp(), first);
    // Another description makes other tracks; those of another program stay, also when tracks are forced.
    describe("layout = 'nchw'\n[input.x]\n");
    assert!(error(&with).contains("net.toml"));
    describe("# the same\n");
    run(&with);
    assert_eq!(stamp(), first);
    run(&Request { force: vec![Step::Tracks], ..with });
    assert!(stamp() > first && out.join("tracks/mine").is_dir());
    let list = fs::read_to_string(out.join("tracks/tracks.json")).unwrap();
    assert!(
        ["mine", "descriptors", "lucas_kanade", "blocks"].iter().all(|name| list.contains(name)),
        "{list}"
    );
}
