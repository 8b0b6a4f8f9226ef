//! Errors of tracker files and of their list. Each names the file.

use ffgs_arrays::ArraysError;
use ffgs_core::ImageSize;
use ffgs_method::Fault;
use std::io;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// A tracker's file, or the list of trackers, cannot be used. Every message names the file.
#[derive(Debug, Error)]
pub(crate) enum TracksError {
    /// The file cannot be read.
    #[error("{}: {source}", .file.display())]
    Io {
        /// The file.
        file: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// tracks.json is not what it should be.
    #[error("{}: not a list of trackers: {reason}", .file.display())]
    Index {
        /// The file.
        file: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// A numpy file is damaged or has another shape.
    #[error(transparent)]
    Array(#[from] ArraysError),
    /// A .flo or .exr file is damaged or lacks its channels.
    #[error("{}: not a readable flow file (damaged or truncated): {reason}", .file.display())]
    Flow {
        /// The file.
        file: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// Columns of a correspondence file disagree in length.
    #[error("{}: '{column}' has {found} rows, 'src' has {expected}", .file.display())]
    Columns {
        /// The file.
        file: PathBuf,
        /// The column at fault.
        column: &'static str,
        /// Rows of `src`.
        expected: usize,
        /// Rows of the column.
        found: usize,
    },
    /// The flow has another size than its camera.
    #[error("{}: flow is {} x {}, but its camera is {} x {}", .file.display(), .found.width, .found.height, .expected.width, .expected.height)]
    Size {
        /// The file.
        file: PathBuf,
        /// Size of the camera.
        expected: ImageSize,
        /// Size of the flow.
        found: ImageSize,
    },
}

impl TracksError {
    /// This error of `file`, with what to do about it.
    pub(crate) fn in_file(&self, file: &Path) -> Fault {
        Fault::new(file, self, self.fix())
    }

    fn fix(&self) -> &'static str {
        match self {
            Self::Io { .. } => "add the file or its read permission",
            Self::Index { .. } => "give every tracker a name, level, format, pattern and pixel_center",
            Self::Array(_) => "write the file again: npz with src, tgt (N, 2), or npy (H, W, 2)",
            Self::Flow { .. } => "write the file again: Middlebury .flo, or EXR with channels U and V",
            Self::Columns { .. } => "give src, tgt, visibility and score the same number of rows",
            Self::Size { .. } => "run the tracker at the images' size",
        }
    }
}
