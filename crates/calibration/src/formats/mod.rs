//! One file per calibration format.

mod camera_toml;
mod colmap;
mod colmap_binary;
mod colmap_model;
mod colmap_text;
mod dynamic3dgs;
mod easyvolcap;
mod file_storage;
mod left_out;
mod opencv;
mod panoptic;
mod point_ply;
mod poses_bounds;
mod qualisys;
mod transforms;

pub use camera_toml::FORMAT as TOML;
pub use colmap::FORMAT as COLMAP;
pub use easyvolcap::FORMAT as EASYVOLCAP;
pub use opencv::FORMAT as OPENCV;
pub use panoptic::FORMAT as PANOPTIC;
pub use poses_bounds::FORMAT as N3DV;
pub use qualisys::FORMAT as QUALISYS;
pub use transforms::FORMAT as TRANSFORMS;

use crate::media::{is_footage, is_picture, natural_order};
use crate::{CalibrationError, Footage, Pictures, SourceCamera};
use ffgs_core::{Camera, ImageSize, Intrinsics, open_input};
use glam::{DMat3, DMat4, DQuat, DVec3};
use image::ImageReader;
use std::cell::Cell;
use std::fs;
use std::io::{self, BufReader};
use std::path::{Path, PathBuf};

/// A format in which calibrations come.
#[derive(Clone, Copy, Debug)]
pub struct Format {
    /// Its name on the command line.
    pub name: &'static str,
    /// The file by which it is recognised, for messages.
    pub looks_for: &'static str,
    /// The calibration in or below a folder.
    pub find: fn(&Path) -> Option<PathBuf>,
    /// Reads that calibration and finds its pictures below the folder (the first argument).
    pub read: fn(&Path, &Path) -> Result<Footage, CalibrationError>,
}

/// All formats, in the order in which they are tried.
pub const FORMATS: [Format; 9] =
    [dynamic3dgs::FORMAT, PANOPTIC, N3DV, TRANSFORMS, EASYVOLCAP, TOML, QUALISYS, COLMAP, OPENCV];

/// The format called `name`, or the first that recognises the folder, and its calibration file.
///
/// # Errors
/// When there is no such folder or format, or no format finds its calibration.
pub fn detect(folder: &Path, name: Option<&str>) -> Result<(Format, PathBuf), CalibrationError> {
    require_folder(folder)?;
    let list = |text: fn(&Format) -> &str| FORMATS.iter().map(text).collect::<Vec<_>>().join(", ");
    let named = |f: &&Format| name.is_none_or(|name| f.name == name);
    let mut formats = FORMATS.iter().filter(named).peekable();
    if formats.peek().is_none() {
        let name = name.unwrap_or_default().to_owned();
        return Err(CalibrationError::NoSuchFormat { name, known: list(|f| f.name) });
    }
    let mut found = formats.clone().filter_map(|f| Some((*f, (f.find)(folder)?)));
    found.next().ok_or_else(|| {
        let of_toml = formats.clone().any(|f| f.name == TOML.name);
        if let Some(almost) = of_toml.then(|| camera_toml::almost_found(folder)).flatten() {
            return almost;
        }
        let looked_for = formats.map(|f| f.looks_for).collect::<Vec<_>>().join(", ");
        CalibrationError::Unrecognised { folder: folder.to_owned(), looked_for, found: other_files(folder) }
    })
}

/// What cannot be listed would look like a folder without a calibration.
fn require_folder(path: &Path) -> Result<(), CalibrationError> {
    let no_folder = |what| CalibrationError::NoFolder { path: path.to_owned(), what };
    match fs::read_dir(path) {
        Ok(_) => Ok(()),
        Err(_) if path.is_file() => Err(no_folder("this is a file")),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Err(no_folder("there is no such folder")),
        Err(error) => Err(CalibrationError::io(path, error)),
    }
}

/// Files that a message names.
const SHOWN: usize = 6;

/// Names of some files in or below a folder that are no pictures, in words.
fn other_files(folder: &Path) -> String {
    let found = Cell::new(Vec::new());
    let note = |path: &Path| {
        let mut names = found.take();
        if path.is_file() && !is_picture(path) && names.len() <= SHOWN {
            names.push(path.strip_prefix(folder).unwrap_or(path).display().to_string());
        }
        found.set(names);
        false
    };
    find_below(folder, &note);
    let mut names = found.take();
    match names.len() {
        0 => "no file but pictures and videos".to_owned(),
        count => {
            names.truncate(SHOWN);
            format!("{}{}", names.join(", "), if count > SHOWN { " and others" } else { "" })
        }
    }
}

/// How far below the footage's folder a calibration is looked for.
const DEPTH: usize = 3;

/// What lies in `folder`, then what lies in its folders, and so on, in natural order.
fn levels(folder: &Path) -> impl Iterator<Item = Vec<PathBuf>> {
    let within = |folders: &[PathBuf]| {
        let listed = folders.iter().filter_map(|folder| fs::read_dir(folder).ok()).flatten().flatten();
        let mut entries: Vec<PathBuf> =
            listed.map(|entry| entry.path()).filter(|path| is_footage(path)).collect();
        entries.sort_by(|a, b| natural_order(a, b));
        entries
    };
    let below = move |level: &Vec<PathBuf>| {
        Some(within(&level.iter().filter(|path| path.is_dir()).cloned().collect::<Vec<_>>()))
    };
    std::iter::successors(Some(within(&[folder.to_owned()])), below).take(DEPTH)
}

/// The first path (shallowest, then in natural order) in or below `folder` that `fits`.
fn find_below(folder: &Path, fits: &dyn Fn(&Path) -> bool) -> Option<PathBuf> {
    levels(folder).find_map(|level| level.into_iter().find(|path| fits(path)))
}

/// Says which of several calibrations in or below `folder` is read, where others fit as well.
fn told_of_others(folder: &Path, taken: &Path, fits: &dyn Fn(&Path) -> bool) -> Option<String> {
    let others = levels(folder).flatten().filter(|path| path != taken && fits(path));
    let names: Vec<String> =
        others.map(|path| path.strip_prefix(folder).unwrap_or(&path).display().to_string()).collect();
    let taken = taken.strip_prefix(folder).unwrap_or(taken).display();
    (!names.is_empty()).then(|| {
        format!(
            "of several calibrations {taken} is read, not {}: move away what is not meant",
            names.join(", ")
        )
    })
}

fn file_called(folder: &Path, name: &str) -> Option<PathBuf> {
    find_below(folder, &|path| path.is_file() && path.file_name().is_some_and(|n| n == name))
}

/// A text model of COLMAP with a million points and their tracks takes a fifth of it.
const MAX_TEXT_BYTES: u64 = 1 << 30;

fn read_text(file: &Path) -> Result<String, CalibrationError> {
    ffgs_core::read_text(file, MAX_TEXT_BYTES).map_err(|e| CalibrationError::io(file, e))
}

/// Refuses what is no camera, by the rules of [`Camera`]; of a video whose size is not known yet, what does not depend on it.
fn checked(camera: SourceCamera, file: &Path) -> Result<SourceCamera, CalibrationError> {
    let size = Some(camera.lens.size).filter(|size| size.width > 0 && size.height > 0);
    for pose in &camera.poses {
        let any = ImageSize { width: 1, height: 1 };
        let pinhole = Camera::new(camera.lens.intrinsics, *pose, size.unwrap_or(any));
        let stray = |pinhole: Camera| pinhole.stray_principal_point().filter(|_| size.is_some());
        if let Some(fault) = pinhole.map_or_else(|e| Some(e.to_string()), stray) {
            return Err(CalibrationError::content(file, format!("camera '{}': {fault}", camera.name)));
        }
    }
    Ok(camera)
}

/// `timestamps.csv` beside the calibration or in the folder of the first video.
fn timestamps_near(file: &Path, first_picture: Option<&Path>) -> Option<PathBuf> {
    let folders = [first_picture.and_then(Path::parent), file.parent()];
    folders.into_iter().flatten().map(|f| f.join("timestamps.csv")).find(|p| p.is_file())
}

/// Width and height from the header of an image.
fn image_size(file: &Path) -> Result<ImageSize, CalibrationError> {
    let opened = open_input(file).map_err(|e| CalibrationError::io(file, e))?;
    let guessed = ImageReader::new(BufReader::new(opened)).with_guessed_format();
    let reader = guessed.map_err(|e| CalibrationError::io(file, e))?;
    let (width, height) =
        reader.into_dimensions().map_err(|e| CalibrationError::content(file, e.to_string()))?;
    Ok(ImageSize { width: width as usize, height: height as usize })
}

/// Width and height: as given, or of the first picture; (0, 0) for a video, whose size is known when ffmpeg has looked at it, and to which the lens belongs.
fn image_or_given_size(given: [Option<f64>; 2], pictures: &Pictures) -> Result<ImageSize, String> {
    match (given, pictures) {
        ([Some(width), Some(height)], _) if width > 0.0 && height > 0.0 => {
            Ok(ImageSize { width: width as usize, height: height as usize })
        }
        (_, Pictures::Files(files)) => image_size(&files[0]).map_err(|e| e.to_string()),
        (_, Pictures::Video(_)) => Ok(ImageSize { width: 0, height: 0 }),
    }
}

/// Rows of a 3x3 camera matrix; skew is refused, as no lens of today has it.
fn intrinsics(rows: [[f64; 3]; 3]) -> Result<Intrinsics, String> {
    let [[fx, skew, cx], [_, fy, cy], _] = rows;
    // A thousandth of the focal length moves the image's edge by less than a pixel.
    if skew.abs() > 1e-3 * fx.abs() {
        return Err(format!("the camera matrix has a skew of {skew}: skewed pixels are not supported"));
    }
    Ok(Intrinsics { fx, fy, cx, cy })
}

/// A pose from the rows of a rotation and a translation.
fn pose(rotation: [[f64; 3]; 3], translation: [f64; 3]) -> DMat4 {
    let rotation = DMat3::from_cols_array_2d(&rotation).transpose();
    rigid(rotation, DVec3::from(translation))
}

fn rigid(rotation: DMat3, translation: DVec3) -> DMat4 {
    let mut m = DMat4::from_mat3(rotation);
    m.w_axis = translation.extend(1.0);
    m
}

/// Rotation by a vector's length about its direction (Rodrigues).
fn rodrigues(vector: [f64; 3]) -> DMat3 {
    DMat3::from_quat(DQuat::from_scaled_axis(DVec3::from(vector)))
}

/// World-to-camera with OpenCV axes from camera-to-world with OpenGL axes (x right, y up, z back).
fn from_opengl(world_from_camera: DMat4) -> DMat4 {
    let flip = DMat4::from_diagonal(glam::DVec4::new(1.0, -1.0, -1.0, 1.0));
    (world_from_camera * flip).inverse()
}

/// A 3x3 matrix of JSON or TOML rows.
fn square(rows: &[Vec<f64>]) -> Option<[[f64; 3]; 3]> {
    let row = |i: usize| -> Option<[f64; 3]> { rows.get(i)?.as_slice().try_into().ok() };
    (rows.len() == 3).then_some([row(0)?, row(1)?, row(2)?])
}
