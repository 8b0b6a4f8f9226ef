//! `cameras.txt`, `images.txt`, `points3D.txt`.

use super::colmap_model::{CameraRecord, ImageRecord, Model};
use super::read_text;
use crate::{CalibrationError, ColouredPoint};
use ffgs_core::ImageSize;
use glam::DVec3;
use std::path::Path;
use std::str::FromStr;

pub(super) fn read(cameras: &Path) -> Result<Model, CalibrationError> {
    let images = cameras.with_file_name("images.txt");
    let points = cameras.with_file_name("points3D.txt");
    Ok(Model {
        cameras: parse(cameras, |lines| lines.iter().map(|l| camera(l)).collect())?,
        images: parse(&images, images_of)?,
        points: if points.is_file() {
            parse(&points, |lines| lines.iter().map(|l| point(l)).collect())?
        } else {
            Vec::new()
        },
    })
}

fn parse<T>(file: &Path, read: impl Fn(&[&str]) -> Option<Vec<T>>) -> Result<Vec<T>, CalibrationError> {
    let text = read_text(file)?;
    let lines: Vec<&str> = text.lines().filter(|l| !l.starts_with('#')).collect();
    read(&lines).ok_or_else(|| CalibrationError::content(file, "not a text model of COLMAP"))
}

fn numbers<T: FromStr>(words: &[&str]) -> Option<Vec<T>> {
    words.iter().map(|w| w.parse().ok()).collect()
}

fn camera(line: &str) -> Option<CameraRecord> {
    let words: Vec<&str> = line.split_whitespace().collect();
    let size = ImageSize { width: words.get(2)?.parse().ok()?, height: words.get(3)?.parse().ok()? };
    Some(CameraRecord {
        id: words[0].parse().ok()?,
        model: words[1].to_owned(),
        size,
        parameters: numbers(&words[4..])?,
    })
}

/// Two lines an image: the pose with the name, and the points, which may be an empty line.
fn images_of(lines: &[&str]) -> Option<Vec<ImageRecord>> {
    lines.chunks(2).map(|pair| pair[0]).filter(|l| !l.trim().is_empty()).map(image).collect()
}

fn image(line: &str) -> Option<ImageRecord> {
    let words: Vec<&str> = line.split_whitespace().collect();
    let pose = numbers::<f64>(words.get(1..8)?)?;
    Some(ImageRecord {
        rotation: [pose[0], pose[1], pose[2], pose[3]],
        translation: [pose[4], pose[5], pose[6]],
        camera: words.get(8)?.parse().ok()?,
        // Names may hold spaces.
        name: words.get(9..).filter(|w| !w.is_empty())?.join(" "),
    })
}

fn point(line: &str) -> Option<ColouredPoint> {
    let words: Vec<&str> = line.split_whitespace().collect();
    let position = numbers::<f64>(words.get(1..4)?)?;
    let colour = numbers::<u8>(words.get(4..7)?)?;
    Some(ColouredPoint { position: DVec3::from_slice(&position), colour: [colour[0], colour[1], colour[2]] })
}
