//! Steps that are made again.

use super::{FRAMES, error, footage, request, run, toml};
use ffgs_dataset::{Capture, Split};
use ffgs_prepare::{Request, Step, TestCameras};
use glam::{DMat4, DVec3};
use std::fs;
use std::path::PathBuf;

#[test]
fn another_calibration_is_told_and_read_when_pictures_are_made_again() {
    let folder = footage(0, 2);
    let request = Request { only: vec![Step::Pictures], ..request(&folder) };
    run(&request);
    let file = folder.path().join("calibration.toml");
    let pose =
        |of: &Request| Capture::open(&of.out).unwrap().camera(Split::Train, 2, 0).unwrap().translation();
    let before = pose(&request);
    fs::write(&file, format!("# looked through\n{}", toml(|pose| pose))).unwrap();
    run(&request);
    fs::write(&file, toml(|pose| DMat4::from_translation(DVec3::Z) * pose)).unwrap();
    let told = error(&request);
    assert!(
        told.contains("camera 'cam_0' was calibrated otherwise") && told.contains("--force pictures"),
        "{told}"
    );
    run(&Request { force: vec![Step::Pictures], ..request.clone() });
    assert!((pose(&request) - before).length() > 0.5, "{before}");
    let all = fs::read_to_string(&file).unwrap();
    fs::write(&file, all.split_once("[cam_5]").unwrap().0).unwrap();
    assert!(error(&request).contains("camera 'cam_5' is no longer in the footage"));
}

/// Results that are to be made again are removed once it is sure that they can be.
#[test]
fn a_mistake_in_the_command_costs_no_results() {
    let folder = footage(0, FRAMES);
    let request = Request { only: vec![Step::Pictures, Step::Masks], ..request(&folder) };
    run(&request);
    let [picture, mask, list] = ["ims/cam_0/000000.png", "seg/cam_0/000000.png", "train_meta.json"]
        .map(|name| request.out.join(name));
    let again = Request { force: vec![Step::Pictures, Step::Masks], ..request.clone() };
    let mistakes = [
        Request { source: PathBuf::from("nowhere"), ..again.clone() },
        Request { test: TestCameras::Named(vec!["cam_9".into()]), ..again.clone() },
        Request { start: 100, ..again.clone() },
        Request { offsets: [("cam_9".to_owned(), 1)].into(), ..again.clone() },
        Request { format: Some("colmap".to_owned()), ..again.clone() },
    ];
    for mistake in mistakes {
        let told = error(&mistake);
        assert!(picture.exists() && mask.exists() && list.exists(), "{told}");
    }
    let of = |file: &PathBuf| fs::metadata(file).unwrap().modified().unwrap();
    let before = of(&mask);
    run(&request);
    assert_eq!(of(&mask), before, "the steps still count as done");
    run(&again);
    assert!(of(&mask) > before);
}

/// As when the program was killed while it removed the pictures of other settings.
#[test]
fn a_removal_that_was_interrupted_goes_on() {
    let folder = footage(0, FRAMES);
    let request = Request { only: vec![Step::Pictures, Step::Masks], ..request(&folder) };
    run(&request);
    let (journal, mask) = (request.out.join("prepare.json"), request.out.join("seg/cam_0/000000.png"));
    let text = fs::read_to_string(&journal).unwrap();
    let before = fs::read(&mask).unwrap();
    fs::write(&mask, b"of before").unwrap();
    run(&request);
    assert_eq!(fs::read(&mask).unwrap(), b"of before", "what is done stays");
    fs::write(&journal, text.replacen('{', "{\"to_clear\": [\"masks\"],", 1)).unwrap();
    run(&request);
    assert_eq!(fs::read(&mask).unwrap(), before);
    assert!(!fs::read_to_string(&journal).unwrap().contains("to_clear"));
}

/// `--test` and `--offset` take a camera's name as the calibration spells it, and as the capture does.
#[test]
fn cameras_may_be_named_in_both_spellings() {
    let folder = footage(0, 3);
    let text = fs::read_to_string(folder.path().join("calibration.toml")).unwrap();
    fs::write(folder.path().join("calibration.toml"), text.replace("[cam_3]", "[\"cam 3\"]")).unwrap();
    fs::rename(folder.path().join("cam_3"), folder.path().join("cam 3")).unwrap();
    for (i, name) in ["cam 3", "cam_3"].into_iter().enumerate() {
        let request = Request {
            test: TestCameras::Named(vec![name.to_owned()]),
            offsets: [(name.to_owned(), 1)].into(),
            only: vec![Step::Pictures],
            out: folder.path().join(format!("capture{i}")),
            ..request(&folder)
        };
        run(&request);
        let capture = Capture::open(&request.out).unwrap();
        assert_eq!(capture.views(Split::Test)[0].name, "cam_3");
        assert_eq!(capture.frames(), 2, "a camera that began a frame early");
    }
}
