//! Errors of the preparation of footage. Each names the file or the camera.

use ffgs_arrays::ArraysError;
use ffgs_calibration::CalibrationError;
use ffgs_dataset::DatasetError;
use ffgs_networks::NetworkError;
use std::io;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// Footage cannot be prepared. Every message names the file or camera.
#[derive(Debug, Error)]
pub enum PrepareError {
    /// A file cannot be read or written.
    #[error("{}: {source}", .file.display())]
    Io {
        /// The file.
        file: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// A picture cannot be decoded, or has another size than its neighbours.
    #[error("{}: {reason}", .file.display())]
    Picture {
        /// The picture or video.
        file: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// ffmpeg or ffprobe is not installed.
    #[error("{program} is not installed, and videos cannot be read without it")]
    NoFfmpeg {
        /// The program that was not found.
        program: &'static str,
    },
    /// The footage as a whole does not make a capture.
    #[error("{0}")]
    Footage(String),
    /// The output folder holds something else.
    #[error("{}: {reason}", .folder.display())]
    Output {
        /// The folder.
        folder: PathBuf,
        /// What is there.
        reason: String,
    },
    /// A folder of clean plates cannot be used.
    #[error("{}: {reason}", .folder.display())]
    CleanPlates {
        /// The folder.
        folder: PathBuf,
        /// Why not.
        reason: String,
    },
    /// The calibration cannot be used.
    #[error(transparent)]
    Calibration(#[from] CalibrationError),
    /// The capture cannot be written, or cannot be read again.
    #[error(transparent)]
    Capture(#[from] DatasetError),
    /// A numpy file cannot be written.
    #[error(transparent)]
    Array(#[from] ArraysError),
    /// A network cannot be used.
    #[error(transparent)]
    Network(#[from] NetworkError),
}

impl PrepareError {
    /// The same, with the folder of the footage where it is about all of it.
    pub(crate) fn of(self, source: &Path) -> Self {
        match self {
            Self::Footage(reason) => Self::Footage(format!("{}: {reason}", source.display())),
            other => other,
        }
    }

    pub(crate) fn io(file: &Path, source: io::Error) -> Self {
        Self::Io { file: file.to_owned(), source }
    }

    pub(crate) fn picture(file: &Path, reason: impl Into<String>) -> Self {
        Self::Picture { file: file.to_owned(), reason: reason.into() }
    }

    /// What the user can do about it.
    pub fn fix(&self) -> &'static str {
        match self {
            Self::Io { .. } => "check the path, its permissions and the free space",
            Self::Picture { .. } => {
                "copy or export the file again, or leave its frames out with --start and --count"
            }
            Self::NoFfmpeg { .. } => {
                "install ffmpeg (Debian: sudo apt-get install ffmpeg) so that it is on the PATH"
            }
            Self::Footage(_) => {
                "correct the option or the footage; docs/footage.md tells what each format asks for"
            }
            Self::Output { .. } => "choose another --out, or make the step again with --force",
            Self::CleanPlates { .. } => {
                "name the pictures of the empty scene as the cameras, in a folder beside the footage or one called clean_plates"
            }
            Self::Calibration(error) => error.fix(),
            Self::Capture(error) => error.fix(),
            Self::Array(_) => "check the free space",
            Self::Network(error) => error.fix(),
        }
    }
}
