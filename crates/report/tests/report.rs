//! The report is one file that stands alone, whatever the run produced.

use ffgs_core::{Camera, ImageRgb8, ImageSize, Intrinsics};
use ffgs_report::{
    CameraPicture, CameraPictures, Fact, FramePictures, FrameReport, ReportInput, Thumbnails, Turntable,
    ViewReport, motion_picture, uncertainty_picture, write_report,
};
use glam::{DMat3, DMat4, DVec3};
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

fn filled(colour: [u8; 3]) -> ImageRgb8 {
    let size = ImageSize { width: 32, height: 20 };
    ImageRgb8::new(size, colour.repeat(size.pixels())).unwrap()
}

fn run(folder: &Path) -> ReportInput {
    let (truth, render) = (filled([10, 200, 30]), filled([40, 100, 90]));
    let thumbnails = Thumbnails::for_run(2, 1);
    let pictures = FramePictures {
        views: vec![thumbnails.view(&truth, &render).unwrap().unwrap()],
        motion: Some(thumbnails.encode(&truth).unwrap()),
        uncertainty: None,
    };
    let path = folder.join("pictures.json");
    fs::write(&path, serde_json::to_vec(&pictures).unwrap()).unwrap();
    let view = ViewReport { name: "</script><b>cam".into(), psnr: Some(20.0), ..ViewReport::default() };
    let frame = FrameReport { views: vec![view], pictures: Some(path), ..FrameReport::default() };
    let changes = BTreeMap::from([("born".to_owned(), 12)]);
    let later = FrameReport { index: 1, changes, ..frame.clone() };
    ReportInput { title: "a < b".into(), frames: vec![frame, later], ..ReportInput::default() }
}

/// Between `start` and `end`, as JSON.
fn json(html: &str, start: &str, end: &str) -> serde_json::Value {
    let at = html.find(start).unwrap() + start.len();
    serde_json::from_str(&html[at..at + html[at..].find(end).unwrap()]).unwrap()
}

#[test]
fn the_page_stands_alone_and_its_data_parse() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("out/report.html");
    write_report(&path, &run(folder.path())).unwrap();
    let html = fs::read_to_string(&path).unwrap();
    assert!(html.contains("<title>a &lt; b</title>"));
    assert!(!html.contains("http://") && !html.contains("https://") && !html.contains("src=\""));
    assert_eq!(
        html.matches("</script>").count(),
        3,
        "two frames and the program; a name must not end the script"
    );
    let frames = json(&html, "const frames = ", ";\n");
    assert_eq!(frames[1]["views"][0]["name"], "</script><b>cam");
    assert!(frames[0]["views"][0]["mpsnr"].is_null());
    assert!(html.contains("aria-label=\"Gaussians that change\"") && html.contains("</i>born</span>"));
    for frame in 0..2 {
        let start = format!("id=\"pictures-{frame}\">");
        let pictures = json(&html, &start, "</script>");
        let image = pictures["views"][0][2].as_str().unwrap();
        assert!(image.starts_with("data:image/jpeg;base64,"));
    }
    assert!(!html.contains(&*folder.path().to_string_lossy()), "no path of this machine");
}

#[test]
fn a_circle_is_embedded_where_there_is_one() {
    let folder = tempfile::tempdir().unwrap();
    let (path, turntable) = (folder.path().join("report.html"), folder.path().join("turntable.json"));
    let picture = Thumbnails::of_bytes(2000).encode(&filled([10, 200, 30])).unwrap();
    let circle = Turntable { frame: 7, pictures: vec![picture; 24] };
    fs::write(&turntable, serde_json::to_vec(&circle).unwrap()).unwrap();
    let input = ReportInput { turntable: Some(turntable), ..run(folder.path()) };
    write_report(&path, &input).unwrap();
    let html = fs::read_to_string(&path).unwrap();
    let data = json(&html, "id=\"turntable-data\">", "</script>");
    assert_eq!((data["frame"].as_u64(), data["pictures"].as_array().unwrap().len()), (Some(7), 24));
    assert!(html.contains("<code>ffgs view .</code>"));
}

/// Most footage has no camera to spare: the report then says so, rather than showing empty plots.
#[test]
fn a_run_without_test_views_claims_no_quality() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("report.html");
    let mut input = run(folder.path());
    let page = |input: &ReportInput| {
        write_report(&path, input).unwrap();
        fs::read_to_string(&path).unwrap()
    };
    let measured = page(&input);
    assert!(measured.contains("<small>PSNR</small>") && measured.contains("PSNR (dB)"));
    input.frames.iter_mut().for_each(|frame| {
        frame.views.clear();
        frame.initial_mpsnr = None;
    });
    let unmeasured = page(&input);
    assert!(!unmeasured.contains("<small>PSNR") && !unmeasured.contains("PSNR (dB)"));
    assert!(
        unmeasured.contains("No camera of this capture is held out") && !measured.contains("is held out")
    );
    assert!(!unmeasured.contains("trained on") && !measured.contains("trained on"));
}

/// Its views are the training views then, and everything that shows them says so.
#[test]
fn figures_of_training_views_are_called_so() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("report.html");
    let mut input = ReportInput { trained_on: true, ..run(folder.path()) };
    input.frames.iter_mut().for_each(|frame| {
        frame.seconds.insert("wall".into(), 4.0);
    });
    write_report(&path, &input).unwrap();
    let html = fs::read_to_string(&path).unwrap();
    assert!(html.contains("<small>PSNR, training views</small>"));
    assert!(html.contains("aria-label=\"PSNR (dB), training views\""));
    assert!(html.contains("<h2>Views that were trained on (better than new places)</h2>"));
    assert!(html.contains("No camera of this capture is held out") && !html.contains("<h2>Test views"));
    assert!(!html.contains("PSNR per second"), "an efficiency is of test views");
    assert!(html.contains("<div class=\"triptych\">"), "their pictures are shown");
}

#[test]
fn the_training_cameras_are_embedded_where_they_were_drawn() {
    let folder = tempfile::tempdir().unwrap();
    let (path, file) = (folder.path().join("report.html"), folder.path().join("cameras.json"));
    let picture = Thumbnails::of_bytes(2000).encode(&filled([10, 200, 30])).unwrap();
    let camera = CameraPicture { name: "</script>".into(), picture };
    let drawn = CameraPictures { frame: 3, cameras: vec![camera.clone(), camera] };
    fs::write(&file, serde_json::to_vec(&drawn).unwrap()).unwrap();
    write_report(&path, &ReportInput { cameras: Some(file), ..run(folder.path()) }).unwrap();
    let html = fs::read_to_string(&path).unwrap();
    let data = json(&html, "id=\"cameras-data\">", "</script>");
    assert_eq!(serde_json::from_value::<CameraPictures>(data).unwrap(), drawn);
}

/// What the reader should know stands before the figures; all of it stands at the end.
#[test]
fn warnings_and_a_scene_without_motion_are_told_before_the_figures() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("report.html");
    let mut input = run(folder.path());
    let top = |input: &ReportInput| {
        write_report(&path, input).unwrap();
        let html = fs::read_to_string(&path).unwrap();
        html.split_once("<section").unwrap().0.to_owned()
    };
    assert!(top(&input).contains("the scene was taken for static"));
    input.frames[1].dynamic_gaussians = 5;
    let moving = top(&input);
    assert!(!moving.contains("taken for static") && !moving.contains("<ul"), "nothing to be told");
    input.warnings = (0..5).map(|frame| format!("frame {frame}: few <cameras>")).collect();
    let warned = top(&input);
    assert!(warned.contains("frame 0: few &lt;cameras&gt;") && !warned.contains("frame 3"));
    assert!(warned.contains("<a href=\"#warnings\">2 more</a>"));
    let html = fs::read_to_string(&path).unwrap();
    assert!(html.contains("<section id=\"warnings\">") && html.contains("frame 4: few"));
    assert!(!html.contains("picture (nothing moves before the second frame)"), "the script says why");
}

#[test]
fn what_was_assumed_of_the_footage_is_shown() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("report.html");
    write_report(&path, &run(folder.path())).unwrap();
    assert!(!fs::read_to_string(&path).unwrap().contains("ffgs prepare"));
    let preparation = vec![Fact { name: "assumed".into(), value: "units are <metres>".into() }];
    write_report(&path, &ReportInput { preparation, ..run(folder.path()) }).unwrap();
    let html = fs::read_to_string(&path).unwrap();
    assert!(html.contains("How the capture was prepared") && html.contains("units are &lt;metres&gt;"));
}

/// A run folder may come from someone else: what its files of pictures hold must stay data.
#[test]
fn pictures_that_are_none_end_no_block_and_load_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let (path, input) = (folder.path().join("report.html"), run(folder.path()));
    let hostile = r#"{"views": [["</script><script>alert(1)</script>", "https://a.example/b.png", ""]]}"#;
    fs::write(folder.path().join("pictures.json"), hostile).unwrap();
    write_report(&path, &input).unwrap();
    let html = fs::read_to_string(&path).unwrap();
    assert_eq!(html.matches("</script>").count(), 3, "two frames and the program");
    assert_eq!(
        json(&html, "id=\"pictures-1\">", "</script>")["views"][0][0],
        "</script><script>alert(1)</script>"
    );
    assert!(html.contains("default-src 'none'; img-src data:"));
}

#[test]
fn an_empty_run_has_a_report_and_a_missing_file_of_pictures_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("report.html");
    write_report(&path, &ReportInput::default()).unwrap();
    let mut input = run(folder.path());
    input.frames[0].pictures = None;
    write_report(&path, &input).unwrap();
    input.frames[1].pictures = Some(folder.path().join("absent.json"));
    assert!(write_report(&path, &input).unwrap_err().to_string().contains("absent.json"));
}

#[test]
fn motion_to_the_right_is_the_wheels_right_colour() {
    let size = ImageSize { width: 200, height: 160 };
    let intrinsics = Intrinsics { fx: 100.0, fy: 100.0, cx: 100.0, cy: 80.0 };
    let camera = Camera::new(intrinsics, DMat4::IDENTITY, size).unwrap();
    let background = ImageRgb8::new(size, vec![100; size.pixels() * 3]).unwrap();
    let (prev, now) = (DVec3::new(0.0, 0.0, 2.0), DVec3::new(0.5, 0.0, 2.0));
    let behind = DVec3::new(0.0, 0.0, -2.0);
    let picture = motion_picture(&camera, &[prev, behind], &[now, behind], &background).unwrap();
    assert_eq!(picture.pixel(80 * 200 + 125), [1.0, 0.0, 0.0]);
    assert_eq!(picture.pixel(10 * 200 + 190), [35.0 / 255.0; 3]);
    assert!(motion_picture(&camera, &[prev], &[], &background).is_err());
    let nothing = [DMat3::ZERO, DMat3::from_diagonal(DVec3::NAN)];
    let empty = uncertainty_picture(&camera, &[], &[], &background).unwrap();
    assert!(uncertainty_picture(&camera, &[prev, now], &nothing, &background).unwrap() == empty, "no dot");
    let known = [DMat3::IDENTITY, DMat3::ZERO];
    assert!(uncertainty_picture(&camera, &[prev, now], &known, &background).unwrap() != empty, "a dot");
}

#[test]
fn what_only_a_video_shows_is_there_once_it_was_measured() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("report.html");
    let mut input = run(folder.path());
    let written = |input: &ReportInput| {
        write_report(&path, input).unwrap();
        fs::read_to_string(&path).unwrap()
    };
    let names = ["<small>VMAF</small>", "VMAF per second (VE)", "Flicker", "flicker (levels)"];
    let before = written(&input);
    assert!(names.iter().all(|name| !before.contains(name)), "nothing was measured");
    for frame in &mut input.frames {
        frame.seconds.insert("wall".into(), 4.0);
        frame.views[0].vmaf = Some(50.0);
        frame.views[0].flicker = Some(1.25);
    }
    let after = written(&input);
    let missing: Vec<_> = names.iter().filter(|name| !after.contains(*name)).collect();
    assert!(missing.is_empty(), "{missing:?}");
    assert!(after.contains("12.50") && after.contains("1.250") && after.contains("5.00"), "VE, flicker, PE");
}
