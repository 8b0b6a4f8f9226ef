//! Errors that make a whole batch unusable. A single Gaussian that fails has a status instead.

use thiserror::Error;

/// Why a whole batch could not be processed.
#[derive(Debug, Error, PartialEq)]
pub enum FusionError {
    /// A column does not have one entry per Gaussian.
    #[error("{column} holds {found} entries, expected {expected}")]
    Column {
        /// Name of the column.
        column: &'static str,
        /// Entries found.
        found: usize,
        /// Entries expected.
        expected: usize,
    },
    /// An option needs an input that was not given.
    #[error("{option} needs the input {input}")]
    MissingInput {
        /// The option.
        option: &'static str,
        /// The input it needs.
        input: &'static str,
    },
    /// The spatial index refused the points.
    #[error("spatial index: {0}")]
    Index(String),
    /// Cameras and masks do not belong together.
    #[error("{cameras} cameras but {masks} masks, or a mask whose size is not its camera's")]
    Masks {
        /// Cameras given.
        cameras: usize,
        /// Masks given.
        masks: usize,
    },
}
