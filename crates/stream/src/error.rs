//! Errors of streams. Each names the file.

use std::io;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// A stream that could not be read or written.
#[derive(Debug, Error)]
#[error("{}: {problem}", .path.display())]
pub struct StreamError {
    /// The file.
    pub path: PathBuf,
    /// What is wrong with it.
    #[source]
    pub problem: Problem,
}

/// What is wrong with a file of a stream.
#[derive(Debug, Error)]
pub enum Problem {
    /// The operating system refused.
    #[error("{0}")]
    Io(#[from] io::Error),
    /// The JSON is not what a stream's is.
    #[error("not a stream's: {0}")]
    Json(#[from] serde_json::Error),
    /// A later program wrote it.
    #[error("version {found} of the format is unknown, the latest known is {known}; use a newer program")]
    Version {
        /// Of the file.
        found: u32,
        /// Of this program.
        known: u32,
    },
    /// The bytes are not those that were written.
    #[error("corrupt: {0}; write the stream again")]
    Corrupt(String),
    /// What is asked for is not there.
    #[error("{0}")]
    Missing(String),
    /// The writer cannot go on.
    #[error("an earlier frame could not be written; open the stream again to go on with it")]
    Failed,
    /// The data handed over do not fit together.
    #[error("{0}")]
    Shape(String),
}

/// Names the file in an error.
pub(crate) trait InFile<T> {
    fn in_file(self, path: &Path) -> Result<T, StreamError>;
}

impl<T, E: Into<Problem>> InFile<T> for Result<T, E> {
    fn in_file(self, path: &Path) -> Result<T, StreamError> {
        self.map_err(|e| StreamError { path: path.to_owned(), problem: e.into() })
    }
}
