//! What a calibration says of footage: its cameras, points and units. Every format is turned into this.

use crate::Lens;
use glam::{DMat4, DVec3};
use std::path::PathBuf;

/// Footage as its calibration describes it; nothing of the pictures has been read.
#[derive(Clone, Debug, Default)]
pub struct Footage {
    /// The cameras, in the order of the calibration, names unique.
    pub cameras: Vec<SourceCamera>,
    /// Points of the scene, where the calibration has them.
    pub points: Vec<ColouredPoint>,
    /// Whether these points are all that a reconstruction starts from; else others are added.
    pub points_are_complete: bool,
    /// `timestamps.csv` with a time for every frame of every camera.
    pub timestamps: Option<PathBuf>,
    /// Metres in one unit of the poses, where the format says so.
    pub metres_per_unit: Option<f64>,
    /// What the format takes for granted, one sentence each.
    pub assumed: Vec<String>,
    /// What was left out, and why, one sentence each.
    pub skipped: Vec<String>,
}

/// One camera of the footage.
#[derive(Clone, Debug)]
pub struct SourceCamera {
    /// Its name, a plain file name.
    pub name: String,
    /// Its lens, for the pictures' full size.
    pub lens: Lens,
    /// `camera_from_world` with OpenCV axes: one for a fixed camera, else one per picture.
    pub poses: Vec<DMat4>,
    /// Its pictures.
    pub pictures: Pictures,
    /// Masks of the same count and size as the pictures, where there are some.
    pub masks: Option<Pictures>,
    /// What it is used for.
    pub role: Role,
}

/// The poses of [`SourceCamera::poses`], given one per picture.
pub(crate) fn one_if_fixed(mut poses: Vec<DMat4>) -> Vec<DMat4> {
    if poses.iter().all(|pose| *pose == poses[0]) {
        poses.truncate(1);
    }
    poses
}

/// Where a camera's pictures are.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Pictures {
    /// A video that ffmpeg reads.
    Video(PathBuf),
    /// One file per frame, in order.
    Files(Vec<PathBuf>),
}

/// What a camera is used for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Role {
    /// The format says nothing.
    #[default]
    Unsaid,
    /// Reconstructed from.
    Train,
    /// Held out.
    Test,
}

/// A point of a structure-from-motion program.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ColouredPoint {
    /// Position in the world.
    pub position: DVec3,
    /// sRGB.
    pub colour: [u8; 3],
}
