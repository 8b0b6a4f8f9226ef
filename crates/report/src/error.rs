//! Errors of writing a report.

use std::io;
use std::path::PathBuf;
use thiserror::Error;

/// Why a report was not written.
#[derive(Debug, Error)]
pub enum ReportError {
    /// The file of a frame's pictures cannot be read.
    #[error("{}: {source}; remove the frame's folder and resume, or run ffgs eval", .path.display())]
    Pictures {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        source: io::Error,
    },
    /// A picture could not be encoded.
    #[error("cannot encode a picture: {0}")]
    Encode(image::ImageError),
    /// The template failed.
    #[error("report template: {0}")]
    Template(#[from] minijinja::Error),
    /// The file cannot be written.
    #[error("cannot write the report: {0}")]
    Io(#[from] io::Error),
}
