//! Errors of a capture and its files. Each names the file and says what to do.

use ffgs_arrays::ArraysError;
use ffgs_core::{CameraError, ImageSize};
use std::io;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// A capture, or a file of it, cannot be used. Every message names the file; [`DatasetError::fix`] says what to do.
#[derive(Debug, Error)]
pub enum DatasetError {
    /// A file is missing or unreadable.
    #[error("{}: {source}", .file.display())]
    Io {
        /// The file.
        file: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// A picture cannot be written.
    #[error("cannot write {}: {source}", .file.display())]
    Write {
        /// The file.
        file: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// A meta file is not the JSON that the layout asks for.
    #[error("{}: not a camera list of the Dynamic3DGaussians layout: {reason}", .file.display())]
    Meta {
        /// The meta file.
        file: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// A camera of a meta file is not a camera.
    #[error("{}: camera '{view}', frame {frame}: {source}", .file.display())]
    Camera {
        /// The meta file.
        file: PathBuf,
        /// Camera folder.
        view: String,
        /// Frame index in the meta file.
        frame: usize,
        /// Why.
        source: CameraError,
    },
    /// An image or mask cannot be decoded.
    #[error("{}: not a readable image (damaged or truncated): {reason}", .file.display())]
    Image {
        /// The image.
        file: PathBuf,
        /// What the decoder says.
        reason: String,
    },
    /// An image or mask has another size than its camera.
    #[error("{}: image is {} x {}, but its camera is {} x {}", .file.display(), .found.width, .found.height, .expected.width, .expected.height)]
    ImageSize {
        /// The image.
        file: PathBuf,
        /// Size in the meta file.
        expected: ImageSize,
        /// Size of the image.
        found: ImageSize,
    },
    /// The point file is not readable or has another shape than (N, 7).
    #[error(transparent)]
    Points(#[from] ArraysError),
    /// A view or frame that the capture does not hold.
    #[error("{split} has no view {view} at frame {frame}")]
    NoSuchView {
        /// The split.
        split: ffgs_method::Split,
        /// View index.
        view: usize,
        /// Frame index.
        frame: usize,
    },
}

impl DatasetError {
    pub(crate) fn io(file: &Path, source: io::Error) -> Self {
        Self::Io { file: file.to_owned(), source }
    }

    /// What the user can do about it.
    pub fn fix(&self) -> &'static str {
        match self {
            Self::Io { .. } => "add the file or correct its name in the meta file",
            Self::Write { .. } => "check the path, its permissions and the free space",
            Self::Meta { .. } => "write w, h, k, w2c, fn and cam_id with one entry per frame and camera",
            Self::Camera { .. } => {
                "store finite intrinsics and a rigid world-to-camera matrix, or drop the camera"
            }
            Self::Image { .. } => "copy or export the image again (8-bit PNG or JPEG)",
            Self::ImageSize { .. } => "rescale the image, or correct w, h and k in the meta file",
            Self::Points(_) => "store init_pt_cld.npz with data (N, 7): xyz rgb foreground",
            Self::NoSuchView { .. } => "ask for a view and frame that the capture holds",
        }
    }
}
