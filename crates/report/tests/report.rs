//! The report is one file that stands alone, whatever the run produced.

use ffgs_core::{Camera, ImageRgb8, ImageSize, Intrinsics};
use ffgs_report::{FrameReport, ReportInput, ViewReport, motion_picture, uncertainty_picture, write_report};
use glam::{DMat3, DMat4, DVec3};
use image::{Rgb, RgbImage};
use std::fs;
use std::path::Path;

fn run(folder: &Path) -> ReportInput {
    let (truth, render) = (folder.join("a.png"), folder.join("b.png"));
    RgbImage::from_pixel(32, 20, Rgb([10, 200, 30])).save(&truth).unwrap();
    RgbImage::from_pixel(32, 20, Rgb([40, 100, 90])).save(&render).unwrap();
    let view = ViewReport {
        name: "</script><b>cam".into(),
        psnr: Some(20.0),
        ground_truth: truth.clone(),
        render,
        ..ViewReport::default()
    };
    let frame = FrameReport { views: vec![view], motion: Some(truth), ..FrameReport::default() };
    let later = FrameReport { index: 1, ..frame.clone() };
    ReportInput { title: "a < b".into(), frames: vec![frame, later], ..ReportInput::default() }
}

#[test]
fn the_page_stands_alone_and_its_data_parse() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("out/report.html");
    write_report(&path, &run(folder.path())).unwrap();
    let html = fs::read_to_string(&path).unwrap();
    assert!(html.contains("<title>a &lt; b</title>"));
    assert!(!html.contains("http://") && !html.contains("https://") && !html.contains("src=\""));
    assert_eq!(html.matches("</script>").count(), 1, "a name must not end the script");
    let start = html.find("const frames = ").unwrap() + "const frames = ".len();
    let json = &html[start..start + html[start..].find(";\n").unwrap()];
    let frames: serde_json::Value = serde_json::from_str(json).unwrap();
    assert_eq!(frames[1]["views"][0]["name"], "</script><b>cam");
    assert!(frames[0]["views"][0]["mpsnr"].is_null());
    let image = frames[0]["views"][0]["images"][2].as_str().unwrap();
    assert!(image.starts_with("data:image/jpeg;base64,"));
}

#[test]
fn an_empty_run_has_a_report_and_a_missing_picture_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("report.html");
    write_report(&path, &ReportInput::default()).unwrap();
    let mut input = run(folder.path());
    input.frames[1].motion = Some(folder.path().join("absent.png"));
    assert!(write_report(&path, &input).unwrap_err().to_string().contains("absent.png"));
    let small = folder.path().join("small.png");
    RgbImage::new(3, 3).save(&small).unwrap();
    input.frames[0].views[0].render = small;
    assert!(write_report(&path, &input).unwrap_err().to_string().contains("differ in size"));
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
    uncertainty_picture(&camera, &[prev, now], &nothing, &background).unwrap();
}
