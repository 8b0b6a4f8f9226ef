//! The calibration that Qualisys Track Manager exports as XML (`*.qca.txt`): millimetres, and 1/64 of a pixel. Markers' infrared cameras and
//! video cameras stand side by side in it.
//!
//! Distortion is that of OpenCV's model, as it stands. Pose2Sim takes a 64th of it; four cameras of its demonstration reproject their own chessboard
//! pictures with 0.47, 0.53, 0.52 and 1.48 px as it stands, with 0.47, 0.60, 0.57 and 1.52 px with the 64th (OpenCV's `calibrateCamera` with fixed
//! intrinsics, by a script that is not kept).

use super::{Format, checked, find_below, from_opengl, intrinsics, read_text, rigid};
use crate::{CalibrationError, Distortion, Footage, Lens, Media, Role, SourceCamera};
use ffgs_core::ImageSize;
use glam::{DMat3, DMat4, DVec3};
use roxmltree::{Document, Node};
use std::path::{Path, PathBuf};

/// Reads Qualisys' calibration.
pub const FORMAT: Format =
    Format { name: "qualisys", looks_for: "*.qca.txt (Qualisys Track Manager)", find, read };

const METRES_PER_UNIT: f64 = 0.001;
/// Lengths on the sensor are in such shares of a pixel.
const PER_PIXEL: f64 = 64.0;

fn find(folder: &Path) -> Option<PathBuf> {
    find_below(folder, &|path| {
        let name = path.file_name().unwrap_or_default().to_string_lossy().to_lowercase();
        path.is_file() && (name.ends_with(".qca.txt") || name.ends_with(".qca.xml"))
    })
}

fn read(folder: &Path, file: &Path) -> Result<Footage, CalibrationError> {
    let fail = |reason: String| CalibrationError::content(file, reason);
    let text = read_text(file)?;
    let document = Document::parse(&text).map_err(|e| fail(e.to_string()))?;
    let entries: Vec<Node> = document.descendants().filter(|n| n.has_tag_name("camera")).collect();
    if entries.is_empty() {
        return Err(fail("it has no <camera>: export the calibration from Qualisys Track Manager".into()));
    }
    let media = Media::find(folder)?;
    let mut without = 0;
    let mut footage = Footage { metres_per_unit: Some(METRES_PER_UNIT), ..Footage::default() };
    for entry in &entries {
        let name = entry.attribute("serial").unwrap_or_default().to_owned();
        let Some(pictures) = media.likely_of_camera(std::slice::from_ref(&name), &mut footage.assumed) else {
            without += 1;
            continue;
        };
        if entry.attribute("active") == Some("0") {
            footage.skipped.push(format!("camera '{name}' was not active when the rig was calibrated"));
            continue;
        }
        let fail = |reason: String| fail(format!("camera '{name}': {reason}"));
        let (lens, pose) = (lens(*entry).map_err(fail)?, camera_from_world(*entry).map_err(fail)?);
        if entry.attribute("viewrotation").is_some_and(|angle| angle != "0") {
            footage.assumed.push(format!(
                "the pictures of camera '{name}' are turned as its sensor is, not as it is shown"
            ));
        }
        let camera =
            SourceCamera { name, lens, poses: vec![pose], pictures, masks: None, role: Role::Unsaid };
        footage.cameras.push(checked(camera, file)?);
    }
    if without > 0 {
        footage
            .skipped
            .push(format!("no video or images are here for {without} of {} cameras", entries.len()));
    }
    Ok(footage)
}

/// A finite number of an element of a camera.
fn number(parent: Node, element: &str, name: &str) -> Result<f64, String> {
    let node = parent
        .children()
        .find(|n| n.has_tag_name(element))
        .ok_or_else(|| format!("it has no <{element}>"))?;
    let text = node.attribute(name).ok_or_else(|| format!("<{element}> has no '{name}'"))?;
    let value = text.trim().parse().ok().filter(|v: &f64| v.is_finite());
    value.ok_or_else(|| format!("'{name}' of <{element}> is no number: '{text}'"))
}

fn numbers<const N: usize>(parent: Node, element: &str, names: [&str; N]) -> Result<[f64; N], String> {
    let mut values = [0.0; N];
    for (value, name) in values.iter_mut().zip(names) {
        *value = number(parent, element, name)?;
    }
    Ok(values)
}

/// Of the part of the sensor that is filmed.
fn lens(camera: Node) -> Result<Lens, String> {
    // Files of older programs have neither.
    let or_zero = |name: &str| {
        let is_there = camera.children().any(|n| n.has_tag_name("intrinsic") && n.has_attribute(name));
        if is_there { number(camera, "intrinsic", name) } else { Ok(0.0) }
    };
    let [left, right, top, bottom] = numbers(camera, "fov_video", ["left", "right", "top", "bottom"])?;
    let [fx, fy, cx, cy] =
        numbers(camera, "intrinsic", ["focalLengthU", "focalLengthV", "centerPointU", "centerPointV"])?
            .map(|v| v / PER_PIXEL);
    let matrix = [[fx, or_zero("skew")? / PER_PIXEL, cx - left], [0.0, fy, cy - top], [0.0, 0.0, 1.0]];
    // The format spells it so.
    let bent = ["radialDistortion1", "radialDistortion2", "tangentalDistortion1", "tangentalDistortion2"];
    let [k1, k2, p1, p2] = numbers(camera, "intrinsic", bent)?;
    let distortion = Distortion::opencv(&[k1, k2, p1, p2, or_zero("radialDistortion3")?])?;
    let side = |from: f64, to: f64| (to - from + 1.0).max(0.0) as usize;
    let size = ImageSize { width: side(left, right), height: side(top, bottom) };
    Ok(Lens::with_integer_centers(intrinsics(matrix)?, distortion, size))
}

/// The file has the camera's place, and the world's axes in the camera's, which has x right, y up, z back.
fn camera_from_world(camera: Node) -> Result<DMat4, String> {
    let place = numbers(camera, "transform", ["x", "y", "z"])?;
    let axes = numbers(camera, "transform", ["r11", "r12", "r13", "r21", "r22", "r23", "r31", "r32", "r33"])?;
    // Rows of camera-from-world, so columns of world-from-camera.
    Ok(from_opengl(rigid(DMat3::from_cols_array(&axes), DVec3::from(place))))
}
