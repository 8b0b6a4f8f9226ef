//! What the summary tells of pictures that are not as the calibration says, or as they look.

use super::{CAMERAS, SIZE, error, footage, request, run, toml};
use ffgs_prepare::{Request, Step};
use image::Rgba;
use std::fs;

fn summary(folder: &tempfile::TempDir) -> String {
    run(&Request { only: vec![Step::Pictures], ..request(folder) }).to_string()
}

#[test]
fn scaled_intrinsics_are_told_once_for_all_cameras() {
    let folder = footage(0, 1);
    assert!(!summary(&folder).contains("scaled"));
    let twice = format!("size = [{}, {}]", 2 * SIZE.width, 2 * SIZE.height);
    let text = toml(|pose| pose).replace(&format!("size = [{}, {}]", SIZE.width, SIZE.height), &twice);
    let folder = footage(0, 1);
    fs::write(folder.path().join("calibration.toml"), text).unwrap();
    let told = summary(&folder);
    assert_eq!(told.matches("intrinsics were scaled").count(), 1, "{told}");
    assert!(
        told.contains(
            "for 256 columns, the pictures of camera cam_0, cam_1, cam_2, cam_3 and 2 others have 128"
        ),
        "{told}"
    );
    let turned = format!("size = [{}, {}]", SIZE.height, SIZE.width);
    let text = toml(|pose| pose).replace(&format!("size = [{}, {}]", SIZE.width, SIZE.height), &turned);
    let folder = footage(0, 1);
    fs::write(folder.path().join("calibration.toml"), text).unwrap();
    let told = error(&request(&folder));
    assert!(told.contains("96 x 128, but its pictures are 128 x 96; a video may say"), "{told}");
}

/// A picture as a JPEG whose EXIF data say that it was taken with the camera on its side.
fn turned_jpeg(picture: &image::DynamicImage) -> Vec<u8> {
    let mut jpeg = std::io::Cursor::new(Vec::new());
    picture.to_rgb8().write_to(&mut jpeg, image::ImageFormat::Jpeg).unwrap();
    let segment: [&[u8]; 4] = [
        b"\xff\xe1\x00\x22Exif\0\0II*\0\x08\0\0\0",
        // One entry: tag 0x0112, a short, once, 6.
        b"\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0",
        b"\0\0\0\0",
        &jpeg.get_ref()[2..],
    ];
    [&jpeg.get_ref()[..2], &segment.concat()].concat()
}

#[test]
fn pictures_that_are_to_be_turned_are_told() {
    let folder = footage(0, 1);
    let camera = folder.path().join("cam_2");
    for file in fs::read_dir(&camera).unwrap().map(|entry| entry.unwrap().path()).collect::<Vec<_>>() {
        fs::write(file.with_extension("jpg"), turned_jpeg(&image::open(&file).unwrap())).unwrap();
        fs::remove_file(file).unwrap();
    }
    let told = summary(&folder);
    assert!(told.contains("pictures of camera cam_2 say by EXIF data that they are to be turned"), "{told}");
    let size = |width: usize, height: usize| format!("size = [{width}, {height}]");
    let text = toml(|pose| pose);
    let (before, after) = text.split_once("[cam_2]").unwrap();
    let after = after.replacen(&size(SIZE.width, SIZE.height), &size(SIZE.height, SIZE.width), 1);
    fs::write(folder.path().join("calibration.toml"), format!("{before}[cam_2]{after}")).unwrap();
    let told = error(&Request { out: folder.path().join("other"), ..request(&folder) });
    assert!(told.contains("EXIF data say that they are to be turned, which is not done here"), "{told}");
}

#[test]
fn transparent_pictures_are_told() {
    let folder = footage(0, 1);
    let with_alpha = |camera: usize, alpha: u8| {
        let file = folder.path().join(format!("cam_{camera}/1.png"));
        let mut picture = image::open(&file).unwrap().into_rgba8();
        picture.put_pixel(3, 4, Rgba([255, 0, 255, alpha]));
        picture.save(&file).unwrap();
    };
    (0..CAMERAS).for_each(|camera| with_alpha(camera, 255));
    assert!(!summary(&folder).contains("transparent"), "opaque");
    with_alpha(2, 0);
    let other = Request { out: folder.path().join("other"), only: vec![Step::Pictures], ..request(&folder) };
    let told = run(&other).to_string();
    assert!(told.contains("pictures of camera cam_2 are transparent in parts"), "{told}");
}
