//! A frame of a capture in the layouts of other tools.

use crate::PrepareError;
use crate::camera_lists::write_json;
use ffgs_core::{Camera, is_present, open_input, write_atomically};
use ffgs_dataset::{Capture, Points, Split};
use glam::{DMat4, DQuat};
use serde_json::{Value, json};
use std::fmt::Write as _;
use std::fs;
use std::io::{self, Write as _};
use std::path::Path;
use std::str::FromStr;

/// What nerfstudio calls its points.
const POINTS: &str = "sparse_pc.ply";

/// A layout that can be written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Layout {
    /// `transforms.json` with images and `sparse_pc.ply`.
    Nerfstudio,
    /// A text model in `sparse/0` with images.
    Colmap,
}

impl FromStr for Layout {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "nerfstudio" => Ok(Self::Nerfstudio),
            "colmap" => Ok(Self::Colmap),
            _ => Err(format!("'{text}' is none of nerfstudio, colmap")),
        }
    }
}

/// A view with the name of its image below `images/`.
struct Shot {
    camera: Camera,
    file: String,
    test: bool,
}

/// Writes one frame of a capture: cameras, copied images and initial points.
///
/// # Errors
/// When the capture cannot be read, has no such frame, or the folder cannot be written.
pub fn convert(capture: &Capture, layout: Layout, frame: usize, out: &Path) -> Result<(), PrepareError> {
    if frame >= capture.frames() {
        return Err(PrepareError::Footage(format!(
            "there is no frame {frame}: the capture has {}",
            capture.frames()
        )));
    }
    let shots = shots(capture, frame, out)?;
    // A capture may do without points; other tools start from random ones then.
    let has_points = is_present(&capture.points_path());
    let points = if has_points { capture.initial_points()? } else { Points::default() };
    match layout {
        Layout::Nerfstudio => {
            let with_points = !points.is_empty();
            if with_points {
                write_text(&out.join(POINTS), &ply(&points))?;
            }
            write_json(&out.join("transforms.json"), &transforms(&shots, with_points))
        }
        Layout::Colmap => write_model(&shots, &points, &out.join("sparse/0")),
    }
}

fn shots(capture: &Capture, frame: usize, out: &Path) -> Result<Vec<Shot>, PrepareError> {
    let mut shots = Vec::new();
    for split in [Split::Train, Split::Test] {
        for (v, view) in capture.views(split).iter().enumerate() {
            let from = capture.image_path(split, v, frame)?;
            let ending = from.extension().map_or("png".into(), |e| e.to_string_lossy().into_owned());
            let file = format!("{}.{ending}", view.name.replace('/', "_"));
            let to = out.join("images").join(&file);
            fs::create_dir_all(out.join("images")).map_err(|e| PrepareError::io(out, e))?;
            copy(&from, &to)?;
            shots.push(Shot { camera: capture.camera(split, v, frame)?, file, test: split == Split::Test });
        }
    }
    Ok(shots)
}

/// Copies a picture; an error names the file that it is about.
fn copy(from: &Path, to: &Path) -> Result<(), PrepareError> {
    let mut source = open_input(from).map_err(|e| PrepareError::io(from, e))?;
    write_atomically(to, |out| io::copy(&mut source, out).map(|_| ()))
        .map_err(|e: io::Error| PrepareError::io(to, e))
}

/// OpenGL's axes, camera to world.
fn transforms(shots: &[Shot], with_points: bool) -> Value {
    let flip = DMat4::from_diagonal(glam::DVec4::new(1.0, -1.0, -1.0, 1.0));
    let entry = |s: &Shot| {
        let k = s.camera.intrinsics();
        let matrix = (s.camera.camera_from_world().inverse() * flip).transpose().to_cols_array_2d();
        json!({
            "file_path": format!("images/{}", s.file), "transform_matrix": matrix,
            "fl_x": k.fx, "fl_y": k.fy, "cx": k.cx, "cy": k.cy,
            "w": s.camera.size().width, "h": s.camera.size().height,
        })
    };
    let names = |test: bool| -> Vec<String> {
        shots.iter().filter(|s| s.test == test).map(|s| format!("images/{}", s.file)).collect()
    };
    let frames: Vec<Value> = shots.iter().map(entry).collect();
    let mut all = json!({
        "camera_model": "PINHOLE", "frames": frames, "train_filenames": names(false), "test_filenames": names(true),
    });
    // Where none are named, nerfstudio starts from random ones.
    if with_points {
        all["ply_file_path"] = json!(POINTS);
    }
    all
}

/// Points in the world of the cameras, as text.
fn ply(points: &Points) -> String {
    let mut text = format!(
        "ply\nformat ascii 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n\
         property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n",
        points.len()
    );
    for (p, [r, g, b]) in coloured(points) {
        // Writing to a string does not fail.
        let _ = writeln!(text, "{} {} {} {r} {g} {b}", p[0], p[1], p[2]);
    }
    text
}

fn coloured(points: &Points) -> impl Iterator<Item = (&[f32; 3], [u8; 3])> {
    points.positions.iter().zip(&points.colours).map(|(p, c)| (p, c.map(|v| (v * 255.0).round() as u8)))
}

fn write_model(shots: &[Shot], points: &Points, folder: &Path) -> Result<(), PrepareError> {
    let (mut cameras, mut images, mut cloud) = (String::new(), String::new(), String::new());
    for (i, s) in shots.iter().enumerate() {
        let (k, size, id) = (s.camera.intrinsics(), s.camera.size(), i + 1);
        let q = DQuat::from_mat3(&s.camera.rotation());
        let t = s.camera.translation();
        // Writing to a string does not fail.
        let _ = writeln!(
            cameras,
            "{id} PINHOLE {} {} {} {} {} {}",
            size.width, size.height, k.fx, k.fy, k.cx, k.cy
        );
        let _ = writeln!(
            images,
            "{id} {} {} {} {} {} {} {} {id} {}\n",
            q.w, q.x, q.y, q.z, t.x, t.y, t.z, s.file
        );
    }
    for (i, (p, [r, g, b])) in coloured(points).enumerate() {
        let _ = writeln!(cloud, "{} {} {} {} {r} {g} {b} 0", i + 1, p[0], p[1], p[2]);
    }
    for (name, text) in [("points3D.txt", cloud), ("images.txt", images), ("cameras.txt", cameras)] {
        write_text(&folder.join(name), &text)?;
    }
    Ok(())
}

fn write_text(file: &Path, text: &str) -> Result<(), PrepareError> {
    write_atomically(file, |w| w.write_all(text.as_bytes())).map_err(|e: io::Error| PrepareError::io(file, e))
}
