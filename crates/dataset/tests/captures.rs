//! A small synthetic capture, and every way in which it can be wrong.

use ffgs_arrays::NpzWriter;
use ffgs_dataset::{Capture, CheckReport, DatasetError, ImageCheck, check, check_with_progress};
use ffgs_method::Split;
use std::fs;
use std::path::Path;
use tempfile::TempDir;

const POSES: [&str; 2] =
    ["[[1,0,0,0],[0,1,0,0],[0,0,1,2],[0,0,0,1]]", "[[1,0,0,-0.5],[0,1,0,0],[0,0,1,2],[0,0,0,1]]"];

/// Two cameras, two frames, 4 x 2 pixels; the second frame lists the cameras in the other order.
fn capture() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let k = "[[4,0,1.5],[0,4,1],[0,0,1]]";
    let [a, b] = POSES;
    let meta = format!(
        r#"{{"w":4,"h":2,"k":[[{k},{k}],[{k},{k}]],"w2c":[[{a},{b}],[{b},{a}]],
        "fn":[["a/000000.png","b/000000.png"],["b/000001.png","a/000001.png"]],"cam_id":[[0,1],[1,0]]}}"#
    );
    fs::write(root.join("train_meta.json"), meta).unwrap();
    for camera in ["a", "b"] {
        for frame in 0..2 {
            let name = format!("{camera}/{frame:06}.png");
            save(
                &root.join("ims").join(&name),
                &image::RgbImage::from_pixel(4, 2, image::Rgb([9, 8, 7])).into(),
            );
            save(
                &root.join("seg").join(&name),
                &image::GrayImage::from_fn(4, 2, |x, _| image::Luma([u8::from(x == 0)])).into(),
            );
        }
    }
    write_points(root, &[0.0, 0.0, 0.0, 0.5, 0.5, 0.5, 1.0]);
    folder
}

fn save(path: &Path, image: &image::DynamicImage) {
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    image.save(path).unwrap();
}

fn write_points(root: &Path, rows: &[f32]) {
    NpzWriter::new().f32("data", &[rows.len() / 7, 7], rows).write(&root.join("init_pt_cld.npz")).unwrap();
}

fn edit(root: &Path, from: &str, to: &str) {
    let file = root.join("train_meta.json");
    let text = fs::read_to_string(&file).unwrap();
    assert!(text.contains(from));
    fs::write(file, text.replacen(from, to, 1)).unwrap();
}

fn report(root: &Path) -> CheckReport {
    check(&Capture::open(root).unwrap())
}

fn assert_fault(root: &Path, text: &str) {
    let report = report(root).to_string();
    assert!(report.contains(text) && report.contains("fix:"), "{text:?} not in\n{report}");
}

#[test]
fn a_sound_capture_has_no_fault_and_reads_by_camera() {
    let folder = capture();
    let capture = Capture::open(folder.path()).unwrap();
    assert!(check(&capture).is_usable(), "{}", check(&capture));
    assert_eq!(
        (capture.frames(), capture.views(Split::Train).len(), capture.views(Split::Test).len()),
        (2, 2, 0)
    );
    for frame in 0..2 {
        assert_eq!(capture.camera(Split::Train, 1, frame).unwrap().translation().x, -0.5);
    }
    assert_eq!(capture.load_image(Split::Train, 0, 1).unwrap().data()[..3], [9, 8, 7]);
    assert_eq!(capture.load_mask(Split::Train, 0, 1).unwrap().unwrap().count(), 2);
    assert_eq!(capture.initial_points().unwrap().foreground, [true]);
    assert!(capture.camera(Split::Test, 0, 0).is_err() && capture.load_image(Split::Train, 0, 9).is_err());
}

#[test]
fn missing_truncated_and_resized_images_are_faults() {
    let folder = capture();
    let image = folder.path().join("ims/b/000001.png");
    let bytes = fs::read(&image).unwrap();
    for length in 0..bytes.len() - 12 {
        fs::write(&image, &bytes[..length]).unwrap();
        let capture = Capture::open(folder.path()).unwrap();
        assert!(
            matches!(capture.load_image(Split::Train, 1, 1), Err(DatasetError::Image { .. })),
            "{length}"
        );
    }
    assert_fault(folder.path(), "b/000001.png: not a readable image");
    save(&image, &image::RgbImage::new(5, 2).into());
    assert_fault(folder.path(), "b/000001.png: image is 5 x 2, but its camera is 4 x 2");
    fs::remove_file(&image).unwrap();
    assert_fault(folder.path(), "b/000001.png: No such file");
}

/// An image that is not decoded is still known to be missing, cut off at any byte, empty or of another size.
#[test]
fn a_probe_finds_what_a_broken_copy_leaves() {
    let folder = capture();
    let image = folder.path().join("ims/b/000001.png");
    let capture = Capture::open(folder.path()).unwrap();
    let probe = || capture.probe_image(Split::Train, 1, 1);
    probe().unwrap();
    let bytes = fs::read(&image).unwrap();
    for length in 0..bytes.len() - 12 {
        fs::write(&image, &bytes[..length]).unwrap();
        assert!(matches!(probe(), Err(DatasetError::Image { .. })), "{length}");
    }
    fs::write(&image, [&bytes[..], b"appended"].concat()).unwrap();
    probe().unwrap();
    save(&image, &image::RgbImage::new(5, 2).into());
    assert!(matches!(probe(), Err(DatasetError::ImageSize { .. })));
    fs::remove_file(&image).unwrap();
    let report = check_with_progress(&capture, ImageCheck::Probe, &|_, _| ()).to_string();
    assert!(report.contains("b/000001.png: No such file"), "{report}");
}

/// A run decodes the masks of some frames only: its notes count these, and say so.
#[test]
fn empty_masks_that_a_run_looked_at_are_not_called_all() {
    const FRAMES: usize = 20;
    let folder = capture();
    let (k, [a, b]) = ("[[4,0,1.5],[0,4,1],[0,0,1]]", POSES);
    let rows = |row: &dyn Fn(usize) -> String| (0..FRAMES).map(row).collect::<Vec<_>>().join(",");
    let names = rows(&|frame| format!(r#"["a/{frame:06}.png","b/{frame:06}.png"]"#));
    let (k, poses) = (rows(&|_| format!("[{k},{k}]")), rows(&|_| format!("[{a},{b}]")));
    let cameras = rows(&|_| "[0,1]".to_owned());
    let meta = format!(r#"{{"w":4,"h":2,"k":[{k}],"w2c":[{poses}],"fn":[{names}],"cam_id":[{cameras}]}}"#);
    fs::write(folder.path().join("train_meta.json"), meta).unwrap();
    for name in (0..FRAMES).flat_map(|frame| ["a", "b"].map(|camera| format!("{camera}/{frame:06}.png"))) {
        save(&folder.path().join("ims").join(&name), &image::RgbImage::new(4, 2).into());
        save(&folder.path().join("seg").join(&name), &image::GrayImage::new(4, 2).into());
    }
    let told = |images| {
        let capture = Capture::open(folder.path()).unwrap();
        let notes = check_with_progress(&capture, images, &|_, _| ()).notes;
        notes.into_iter().map(|note| note.text).collect::<Vec<_>>().join("\n")
    };
    let (some, all) = (told(ImageCheck::Probe), told(ImageCheck::Decode));
    assert!(some.contains("10 of 10 masks that were looked at are empty"), "{some}");
    assert!(some.contains("every training mask that was looked at is empty"), "{some}");
    assert!(all.contains("20 of 20 masks are empty") && !all.contains("looked at"), "{all}");
}

#[test]
fn masks_are_there_for_all_images_or_for_none() {
    let folder = capture();
    let seg = folder.path().join("seg");
    let empty = image::GrayImage::new(4, 2).into();
    for name in ["a/000000.png", "a/000001.png"] {
        save(&seg.join(name), &empty);
    }
    let notes = report(folder.path());
    assert!(notes.is_usable() && notes.notes.iter().any(|n| n.text == "2 of 2 masks are empty"));
    for name in ["b/000000.png", "b/000001.png"] {
        save(&seg.join(name), &empty);
    }
    let still = report(folder.path());
    assert!(still.is_usable() && still.notes.iter().any(|n| n.text.contains("every training mask is empty")));
    fs::remove_file(seg.join("b/000001.png")).unwrap();
    let some = report(folder.path());
    let told = "1 of 2 masks are missing, the first is 000001.png; they count as empty";
    assert!(some.is_usable() && some.notes.iter().any(|n| n.text == told), "{some}");
    for name in ["a/000000.png", "a/000001.png"] {
        fs::remove_file(seg.join(name)).unwrap();
    }
    assert_fault(folder.path(), "2 of 2 masks are missing, the first is 000000.png");
    fs::remove_dir_all(seg).unwrap();
    let without = report(folder.path());
    assert!(without.is_usable() && without.notes.iter().any(|n| n.text.contains("no masks")), "{without}");
}

#[test]
fn every_camera_may_have_its_own_image_size() {
    let folder = capture();
    edit(folder.path(), r#""w":4,"h":2"#, r#""w":[4,6],"h":[2,3]"#);
    assert_fault(folder.path(), "its camera is 6 x 3");
    for frame in 0..2 {
        for below in ["ims", "seg"] {
            let image = image::GrayImage::from_pixel(6, 3, image::Luma([1]));
            save(&folder.path().join(format!("{below}/b/{frame:06}.png")), &image.into());
        }
    }
    assert!(report(folder.path()).is_usable());
    edit(folder.path(), "[4,6]", "[4]");
    let error = Capture::open(folder.path()).unwrap_err().to_string();
    assert!(error.contains("no entry for camera 'b'"), "{error}");
}

#[test]
fn invalid_cameras_are_faults() {
    for (from, to, text) in [
        ("[0,0,1,2]", "[0,0,NaN,2]", "camera 'a', frame 0: camera holds a value that is not finite"),
        ("[0,0,1,2]", "[0,0,-1,2]", "mirrors the world"),
        ("[[4,0", "[[-Infinity,0", "not finite"),
        ("[[4,0", "[[0,0", "focal lengths must be positive"),
        ("[[4,0", "[[1e300,0", "a focal length of 1e300 is not plausible"),
        ("[0,0,1,2]", "[0,0,1,1e300]", "a translation of 1e300 is not plausible"),
    ] {
        let folder = capture();
        edit(folder.path(), from, to);
        assert_fault(folder.path(), text);
    }
}

#[test]
fn a_meta_file_of_another_form_is_an_error() {
    for (from, to) in [
        ("\"cam_id\":[[0,1],[1,0]]", "\"cam_id\":[[0,1]]"),
        ("[[0,1],[1,0]]", "[[0,1],[1,2]]"),
        ("a/000000.png", "../a/000000.png"),
        ("\"w\":4", "\"w\":\"4\""),
        ("\"w\":4", "\"w\":4294967296"),
        ("\"w\":4,\"h\":2", "\"w\":9223372036854775807,\"h\":9223372036854775807"),
        ("{\"w\"", "{"),
    ] {
        let folder = capture();
        edit(folder.path(), from, to);
        assert!(matches!(Capture::open(folder.path()), Err(DatasetError::Meta { .. })), "{to}");
    }
    assert!(Capture::open(Path::new("/nowhere")).unwrap_err().to_string().contains("/nowhere"));
}

#[test]
fn a_view_is_one_folder() {
    let folder = capture();
    edit(folder.path(), "a/000000.png", "Infinity_room/000000.png");
    edit(folder.path(), "a/000001.png", "Infinity_room/000001.png");
    edit(folder.path(), "[0,0,1,2]", "[0,0,NaN,2]");
    let named = Capture::open(folder.path()).unwrap();
    assert_eq!(named.views(Split::Train)[0].name, "Infinity_room", "a name with a number that is none");
    assert!(named.camera(Split::Train, 0, 0).is_err() && named.camera(Split::Train, 1, 0).is_ok());

    edit(folder.path(), "Infinity_room/000000.png", "Infinity_room/left/000000.png");
    let error = Capture::open(folder.path()).unwrap_err().to_string();
    assert!(error.contains("Infinity_room/left/000000.png") && error.contains("in one folder"), "{error}");
}

#[test]
fn points_not_finite_missing_or_unseen_are_told() {
    let folder = capture();
    write_points(
        folder.path(),
        &[0.0, 0.0, -9.0, 0.5, 0.5, 0.5, 1.0, f32::NAN, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
    );
    assert_fault(folder.path(), "1 of 2 points are NaN or infinite");
    assert!(report(folder.path()).notes.iter().any(|n| n.text.contains("'a' sees no initial point")));
    // Column 6 is for scoring only.
    write_points(folder.path(), &[0.0; 7]);
    assert!(report(folder.path()).is_usable());
    fs::write(folder.path().join("init_pt_cld.npz"), b"PK").unwrap();
    assert_fault(folder.path(), "init_pt_cld.npz: not a readable npz");
}

/// Points on a grid before both cameras.
fn grid() -> Vec<f32> {
    let place =
        |i: usize| [(i % 5) as f32 * 0.05 - 0.1, (i / 5) as f32 * 0.05 - 0.1, 0.0, 0.5, 0.5, 0.5, 0.0];
    (0..25).flat_map(place).collect()
}

#[test]
fn gross_mistakes_are_found_from_the_data() {
    let folder = capture();
    let root = folder.path();
    write_points(root, &grid());
    assert!(report(root).is_usable(), "{}", report(root));
    // Camera-to-world: the translation changes its sign, and the points lie behind.
    edit(root, "[0,0,1,2]", "[0,0,1,-2]");
    edit(root, "[0,0,1,2]", "[0,0,1,-2]");
    assert_fault(root, "if w2c were camera-to-world");

    let folder = capture();
    edit(folder.path(), "[4,0,1.5]", "[4,0,7.5]");
    assert_fault(folder.path(), "the principal point (8, 1) of its 4 x 2 image lies outside");

    let folder = capture();
    edit(folder.path(), "[4,0,1.5]", "[4,0.5,1.5]");
    let error = Capture::open(folder.path()).unwrap_err().to_string();
    assert!(error.contains("skew of 0.5"), "{error}");

    let folder = capture();
    fs::copy(folder.path().join("train_meta.json"), folder.path().join("test_meta.json")).unwrap();
    let told = report(folder.path());
    assert!(told.notes.iter().any(|n| n.text.contains("a, b also trained on")), "{told}");
}

#[test]
fn masks_that_are_inverted_or_cut_outs_are_seen_through() {
    let folder = capture();
    for name in ["a/000000.png", "a/000001.png", "b/000000.png", "b/000001.png"] {
        let cut_out =
            image::RgbaImage::from_fn(4, 2, |x, _| image::Rgba([9, 8, 7, if x == 0 { 255 } else { 0 }]));
        save(&folder.path().join("seg").join(name), &cut_out.into());
    }
    let cut_out = report(folder.path());
    assert!(cut_out.is_usable() && cut_out.views.iter().all(|v| v.coverage == 0.25), "{cut_out}");
    for name in ["a/000000.png", "a/000001.png", "b/000000.png", "b/000001.png"] {
        let inverted = image::GrayImage::from_fn(4, 2, |x, _| image::Luma([u8::from(x > 0)]));
        save(&folder.path().join("seg").join(name), &inverted.into());
    }
    assert_fault(folder.path(), "2 of 2 cameras have masks that cover most");
}

#[test]
fn the_sample_is_sound() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/scenes/fairmont-mini");
    let report = report(&root);
    assert!(report.is_usable(), "{report}");
    let views: Vec<_> = report.splits.iter().map(|s| (s.views, s.frames)).collect();
    assert_eq!((views, report.points), (vec![(20, 6), (7, 6), (24, 1)], 43240));
}

#[test]
fn two_cameras_of_one_folder_are_refused_whatever_their_ids() {
    let folder = capture();
    let file = folder.path().join("train_meta.json");
    let text = fs::read_to_string(&file).unwrap().replace("b/00000", "a/00000");
    fs::write(&file, text).unwrap();
    let error = Capture::open(folder.path()).unwrap_err().to_string();
    assert!(error.contains("two cameras have the folder 'a'"), "{error}");
}

/// A file that unpacks to a thousand times its size: never unpacked, because its header says that it does not fit.
#[test]
fn bombs_are_judged_by_their_headers() {
    let folder = capture();
    save(&folder.path().join("ims/b/000001.png"), &image::GrayImage::new(6000, 6000).into());
    assert_fault(folder.path(), "b/000001.png: image is 6000 x 6000, but its camera is 4 x 2");
    let rows = 1 << 20;
    let data = vec![0; 6 * rows];
    let points = folder.path().join("init_pt_cld.npz");
    NpzWriter::new().u8("data", &[rows, 6], &data).write(&points).unwrap();
    assert_fault(folder.path(), "expected shape (*, 7), found [1048576, 6]");
    let rows = rows + 1;
    NpzWriter::new().u8("data", &[rows, 7], &vec![0; 7 * rows]).write(&points).unwrap();
    assert_fault(folder.path(), "shape [1048577, 7] is too large");
}

#[cfg(unix)]
#[test]
fn what_is_no_file_is_refused_and_not_waited_for() {
    use std::os::unix::fs::symlink;
    let folder = capture();
    let image = folder.path().join("ims/b/000001.png");
    fs::remove_file(&image).unwrap();
    symlink("/dev/zero", &image).unwrap();
    assert_fault(folder.path(), "b/000001.png: not a file (a folder, pipe or device)");

    // A mask is optional: what stands in its place is a fault of its own and not a mask that is missing.
    let folder = capture();
    let mask = folder.path().join("seg/b/000001.png");
    fs::remove_file(&mask).unwrap();
    fs::create_dir(&mask).unwrap();
    assert_fault(folder.path(), "b/000001.png: not a file (a folder, pipe or device)");
    fs::remove_dir(&mask).unwrap();
    for target in [mask.clone(), folder.path().join("nowhere")] {
        symlink(target, &mask).unwrap();
        assert_fault(folder.path(), "seg/b/000001.png: ");
        assert!(!report(folder.path()).to_string().contains("are missing"));
        fs::remove_file(&mask).unwrap();
    }

    let meta = folder.path().join("test_meta.json");
    assert!(std::process::Command::new("mkfifo").arg(&meta).status().unwrap().success());
    let error = Capture::open(folder.path()).unwrap_err().to_string();
    assert!(error.contains("test_meta.json: not a file"), "{error}");
}
