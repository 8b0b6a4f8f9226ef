//! Errors of numpy files. Each names the file, the array in it and the cause, because files come from other programs.

use std::io;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// A numpy file could not be read or written: the file, the array in it, and why.
#[derive(Debug, Error)]
#[error("{}{}: {cause}", .file.display(), .key.as_ref().map(|k| format!(", array '{k}'")).unwrap_or_default())]
pub struct ArraysError {
    /// The file.
    pub file: PathBuf,
    /// The array in an npz file; `None` for the file as a whole.
    pub key: Option<String>,
    /// Why.
    pub cause: Cause,
}

impl ArraysError {
    pub(crate) fn new(file: &Path, key: Option<&str>, cause: impl Into<Cause>) -> Self {
        Self { file: file.to_owned(), key: key.map(str::to_owned), cause: cause.into() }
    }
}

/// What is wrong with a numpy file.
#[derive(Debug, Error)]
pub enum Cause {
    /// The file cannot be opened, read or written; also a damaged deflate stream.
    #[error("{0}")]
    Io(#[from] io::Error),
    /// Not a zip archive, or a damaged one.
    #[error("not a readable npz (zip) archive, perhaps truncated: {0}")]
    Archive(String),
    /// The archive holds no such array, but these, of which the first are told.
    #[error("missing; the file holds {0:?}")]
    MissingKey(Vec<String>),
    /// Not an npy header.
    #[error("not a readable npy header: {0}")]
    Header(String),
    /// The dtype is not numeric (or a complex, structured, object or text one).
    #[error("expected a numeric array, found dtype {0}")]
    Dtype(String),
    /// The shape asks for more bytes than the reader accepts.
    #[error("shape {0:?} is too large to read")]
    TooLarge(Vec<usize>),
    /// The system has no memory for the entries.
    #[error("there is no memory for its {0} bytes")]
    NoMemory(usize),
    /// Fewer bytes than the shape asks for.
    #[error("truncated: shape {shape:?} needs {expected} bytes, found {found}")]
    Truncated {
        /// Declared shape.
        shape: Vec<usize>,
        /// Bytes needed.
        expected: usize,
        /// Bytes found.
        found: usize,
    },
    /// A value does not fit the wanted type (a fraction or out of range).
    #[error("expected {wanted} values, but entry {index} of the {dtype} array does not fit")]
    Value {
        /// The wanted type.
        wanted: &'static str,
        /// Index of the first bad entry in file order.
        index: usize,
        /// dtype of the file.
        dtype: String,
    },
    /// Another shape than the reader needs.
    #[error("expected shape {expected}, found {found:?}")]
    Shape {
        /// Wanted shape, `*` for any length.
        expected: String,
        /// Shape of the file.
        found: Vec<usize>,
    },
}
