//! Footage of videos. These need ffmpeg, which the project's set-up for tests installs.

use super::{CAMERAS, FAR_AWAY, FRAMES, SIZE, camera, error, footage, picture, request, run};
use ffgs_core::Intrinsics;
use ffgs_dataset::{Capture, Split};
use ffgs_prepare::{Request, Step};
use glam::DMat3;
use std::fs;
use std::num::NonZeroUsize;
use std::path::Path;
use std::process::Command;

#[test]
fn videos_are_read_frame_by_frame() {
    let folder = footage(0, FRAMES);
    for i in 0..CAMERAS {
        let pictures = folder.path().join(format!("cam_{i}"));
        encode(&pictures, &folder.path().join(format!("cam_{i}.mkv")));
        fs::remove_dir_all(pictures).unwrap();
    }
    let request = Request {
        start: 1,
        every: NonZeroUsize::new(2).unwrap(),
        scale: 0.5,
        offsets: [("cam_1".to_owned(), 1)].into(),
        only: vec![Step::Pictures],
        ..request(&folder)
    };
    let summary = run(&request).to_string();
    assert!(summary.contains("6 videos") && summary.contains("64 x 48"), "{summary}");
    let capture = Capture::open(&request.out).unwrap();
    // Frames 1, 3 and 5; 7 lacks camera 1, which began one frame early.
    assert_eq!(capture.frames(), 3);
    for (view, index, frame, shown) in [(0, 0, 1, 3), (1, 1, 1, 4)] {
        let found = capture.load_image(Split::Train, view, frame).unwrap();
        let wanted = picture(index, shown);
        for (x, y) in [(3, 5), (30, 20), (50, 40)] {
            let mean = |c: usize| -> f64 {
                let four = [(0, 0), (1, 0), (0, 1), (1, 1)];
                four.iter().map(|(u, v)| f64::from(wanted.get_pixel(2 * x + u, 2 * y + v).0[c])).sum::<f64>()
                    / 4.0
            };
            let at = (y as usize * 64 + x as usize) * 3;
            for c in 0..3 {
                assert!((f64::from(found.data()[at + c]) - mean(c)).abs() <= 1.0, "camera {index} {x} {y}");
            }
        }
    }
    fs::write(folder.path().join("cam_5.mkv"), b"no video").unwrap();
    let broken = error(&Request { out: folder.path().join("other"), ..request.clone() });
    assert!(broken.contains("cam_5.mkv"), "{broken}");
}

/// Cameras that lack some frames, with the times of the others kept: each picture of a frame shows the same moment.
#[test]
fn frames_that_a_video_dropped_shift_nothing() {
    let folder = footage(0, FRAMES);
    for i in 0..CAMERAS {
        let pictures = folder.path().join(format!("cam_{i}"));
        let video = folder.path().join(format!("cam_{i}.mkv"));
        encode(&pictures, &video);
        if i == 1 {
            let whole = folder.path().join("whole.mkv");
            fs::rename(&video, &whole).unwrap();
            let mut ffmpeg = Command::new("ffmpeg");
            ffmpeg.args(["-v", "error", "-i"]).arg(&whole);
            ffmpeg.args(["-vf", "select='not(between(n,2,3))'", "-vsync", "passthrough", "-c:v", "ffv1"]);
            assert!(ffmpeg.args(["-pix_fmt", "bgr0"]).arg(&video).status().unwrap().success());
            fs::remove_file(whole).unwrap();
        }
        fs::remove_dir_all(pictures).unwrap();
    }
    let request = Request { only: vec![Step::Pictures], ..request(&folder) };
    let summary = run(&request).to_string();
    assert!(summary.contains("2 of 8 moments lack a picture of a camera: cam_1 lacks 2"), "{summary}");
    let capture = Capture::open(&request.out).unwrap();
    assert_eq!(capture.frames(), FRAMES - 2);
    for (frame, shown) in [0, 1, 4, 5, 6, 7].into_iter().enumerate() {
        for view in [0, 1] {
            let found = capture.load_image(Split::Train, view, frame).unwrap();
            let wanted = picture(view, shown);
            assert!(found.data() == wanted.as_raw().as_slice(), "camera {view}, frame {frame}");
        }
    }
}

/// A clean plate whose pictures cannot be decoded is no reason to take its camera for one that moves.
#[test]
fn a_clean_plate_without_pictures_is_told() {
    let folder = footage(0, FRAMES);
    let plates = folder.path().join("clean_plates");
    fs::create_dir(&plates).unwrap();
    for i in 0..CAMERAS {
        let pictures = tempfile::tempdir().unwrap();
        picture(i, FAR_AWAY).save(pictures.path().join("1.png")).unwrap();
        encode_as("png", pictures.path(), &plates.join(format!("cam_{i}.mkv")));
    }
    let request = Request {
        clean_plates: Some(plates.clone()),
        only: vec![Step::Pictures, Step::Masks],
        ..request(&folder)
    };
    assert!(run(&request).to_string().contains("made from clean plates of 6 fixed cameras"));
    let file = plates.join("cam_2.mkv");
    let mut bytes = fs::read(&file).unwrap();
    let start = bytes.windows(4).position(|four| four == b"\x89PNG").unwrap();
    bytes[start..start + 4].fill(0);
    fs::write(&file, bytes).unwrap();
    let told = error(&Request { force: vec![Step::Masks], ..request });
    assert!(told.contains("cam_2.mkv") && told.contains("clean plate"), "{told}");
}

/// Calibrations of OpenCV seldom tell the size of the pictures: it is that of the videos.
#[test]
fn opencv_calibrations_of_videos_have_their_size() {
    let folder = footage(0, FRAMES);
    fs::remove_file(folder.path().join("calibration.toml")).unwrap();
    let calibrate = |i: usize, cx: f64| {
        let camera = camera(i);
        let Intrinsics { fx, fy, cy, .. } = camera.intrinsics();
        let numbers = |name: &str, values: &[f64]| {
            let words: Vec<String> = values.iter().map(f64::to_string).collect();
            format!("<{name} type_id=\"opencv-matrix\"><data>{}</data></{name}>", words.join(" "))
        };
        let pose = camera.camera_from_world();
        let all = [
            numbers("CameraMatrix", &[fx, 0.0, cx - 0.5, 0.0, fy, cy - 0.5, 0.0, 0.0, 1.0]),
            numbers("RotationMatrix", &DMat3::from_mat4(pose).transpose().to_cols_array()),
            numbers("TranslationVector", &pose.w_axis.truncate().to_array()),
        ];
        let text = format!("<?xml version=\"1.0\"?><opencv_storage>{}</opencv_storage>", all.concat());
        fs::write(folder.path().join(format!("cam_{i}/config.xml")), text).unwrap();
    };
    for i in 0..CAMERAS {
        let home = folder.path().join(format!("cam_{i}"));
        encode(&home, &folder.path().join("video.mkv"));
        fs::remove_dir_all(&home).unwrap();
        fs::create_dir(&home).unwrap();
        fs::rename(folder.path().join("video.mkv"), home.join("video.mkv")).unwrap();
        fs::write(home.join("background.mkv"), b"not looked at").unwrap();
        calibrate(i, 64.0);
    }
    let request = Request { only: vec![Step::Pictures], ..request(&folder) };
    let summary = run(&request).to_string();
    assert!(summary.contains("6 videos") && summary.contains("background.mkv beside it"), "{summary}");
    let capture = Capture::open(&request.out).unwrap();
    let found = capture.camera(Split::Train, 1, 0).unwrap();
    assert_eq!(found.size(), SIZE);
    assert!((found.center() - camera(1).center()).length() < 1e-6);
    assert!((found.intrinsics().cx - 64.0).abs() < 0.01, "{:?}", found.intrinsics());
    calibrate(2, 300.0);
    let stray = error(&Request { out: folder.path().join("other"), ..request });
    assert!(stray.contains("'cam_2'") && stray.contains("128 x 96"), "{stray}");
}

/// Without loss, in RGB.
fn encode(pictures: &Path, video: &Path) {
    encode_as("ffv1", pictures, video);
}

fn encode_as(codec: &str, pictures: &Path, video: &Path) {
    let mut ffmpeg = Command::new("ffmpeg");
    ffmpeg.args(["-v", "error", "-framerate", "30", "-i"]).arg(pictures.join("%d.png"));
    let status = ffmpeg
        .args(["-c:v", codec, "-pix_fmt", if codec == "png" { "rgb24" } else { "bgr0" }])
        .arg(video)
        .status();
    assert!(status.expect("ffmpeg is installed by cargo xtask ci").success());
}
