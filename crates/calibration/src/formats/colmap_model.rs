//! What COLMAP's text and binary files hold alike.

use crate::ColouredPoint;
use ffgs_core::ImageSize;

/// `cameras` of a model: id to model name, size and parameters.
pub(super) struct CameraRecord {
    pub id: u32,
    pub model: String,
    pub size: ImageSize,
    pub parameters: Vec<f64>,
}

/// `images` of a model.
pub(super) struct ImageRecord {
    /// Hamilton quaternion w, x, y, z of world to camera.
    pub rotation: [f64; 4],
    pub translation: [f64; 3],
    pub camera: u32,
    pub name: String,
}

/// A sparse model.
#[derive(Default)]
pub(super) struct Model {
    pub cameras: Vec<CameraRecord>,
    pub images: Vec<ImageRecord>,
    pub points: Vec<ColouredPoint>,
}
