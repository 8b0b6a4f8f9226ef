//! Errors of splat files. Each names the file.

use std::io;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// A splat file that could not be read or written.
#[derive(Debug, Error)]
#[error("{}: {problem}", .path.display())]
pub struct SplatError {
    /// The file.
    pub path: PathBuf,
    /// What is wrong with it.
    #[source]
    pub problem: Problem,
}

/// What is wrong with a splat file.
#[derive(Debug, Error)]
pub enum Problem {
    /// The operating system refused.
    #[error("{0}")]
    Io(#[from] io::Error),
    /// The header is not that of a file we can read.
    #[error("bad header: {0}")]
    Header(String),
    /// A property that a splat needs is absent.
    #[error("vertex property `{0}` is missing; is this a 3D Gaussian Splatting PLY?")]
    MissingProperty(String),
    /// The file ends before its header says so.
    #[error("the file is truncated: {0}")]
    Truncated(String),
    /// A value is NaN, infinite or not a number at all.
    #[error("{0}")]
    BadValue(String),
    /// The bytes are not those that were written.
    #[error("the file is corrupt: {0}; delete it and resume from an earlier frame")]
    Corrupt(String),
    /// The data handed over do not fit together.
    #[error("{0}")]
    Shape(String),
    /// The PNG or JPEG encoder refused.
    #[error("{0}")]
    Image(#[from] image::ImageError),
    /// The WebP encoder refused.
    #[error("{0}")]
    WebP(#[from] image_webp::EncodingError),
    /// The zip writer refused.
    #[error("{0}")]
    Zip(#[from] zip::result::ZipError),
}

/// Names the file in an error.
pub(crate) trait InFile<T> {
    fn in_file(self, path: &Path) -> Result<T, SplatError>;
}

impl<T, E: Into<Problem>> InFile<T> for Result<T, E> {
    fn in_file(self, path: &Path) -> Result<T, SplatError> {
        self.map_err(|e| SplatError { path: path.to_owned(), problem: e.into() })
    }
}
