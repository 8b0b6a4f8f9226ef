//! Errors of calibrations and of the pictures that belong to them. Each names the file and says what to do.

use ffgs_arrays::ArraysError;
use std::io;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// A calibration, or the pictures it belongs to, cannot be used. Every message names the file.
#[derive(Debug, Error)]
pub enum CalibrationError {
    /// A file cannot be read.
    #[error("{}: {source}", .file.display())]
    Io {
        /// The file.
        file: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// A calibration file is not what its format asks for.
    #[error("{}: {reason}", .file.display())]
    Content {
        /// The file.
        file: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// A numpy file is damaged or has another shape.
    #[error(transparent)]
    Array(#[from] ArraysError),
    /// What is to hold footage and calibration is no folder.
    #[error("{}: {what}; a folder with the footage and its calibration is wanted", .path.display())]
    NoFolder {
        /// What was named.
        path: PathBuf,
        /// What it is instead.
        what: &'static str,
    },
    /// No format recognises the folder.
    #[error("{}: no calibration was recognised; looked for {looked_for}; there is {found}", .folder.display())]
    Unrecognised {
        /// The folder.
        folder: PathBuf,
        /// The files that each format asks for.
        looked_for: String,
        /// Other files that are there, in words.
        found: String,
    },
    /// There is no format of this name.
    #[error("there is no format '{name}'; the formats are {known}")]
    NoSuchFormat {
        /// What was asked for.
        name: String,
        /// All names.
        known: String,
    },
}

impl CalibrationError {
    /// A file with unusable content.
    pub fn content(file: &Path, reason: impl Into<String>) -> Self {
        Self::Content { file: file.to_owned(), reason: reason.into() }
    }

    /// A file that cannot be read.
    pub fn io(file: &Path, source: io::Error) -> Self {
        Self::Io { file: file.to_owned(), source }
    }

    /// What the user can do about it.
    pub fn fix(&self) -> &'static str {
        match self {
            Self::Io { .. } => "add the file or its read permission",
            Self::Content { .. } | Self::Array(_) => {
                "correct the calibration or export it again, or name another with --format and the folder that holds it"
            }
            Self::Unrecognised { .. } => {
                "name the folder that holds both the calibration and the pictures; a calibration of another program can be written as a \
                 TOML: a table per camera with size, matrix, distortions, rotation and translation, as in the example of docs/footage.md, A \
                 calibration of your own"
            }
            Self::NoFolder { .. } => "name the folder that holds both the calibration and the pictures",
            Self::NoSuchFormat { .. } => "choose one of them, or leave --format out",
        }
    }
}
