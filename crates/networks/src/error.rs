//! Errors of networks, descriptions and their library. Each names the file and says what to do.

use std::path::{Path, PathBuf};
use thiserror::Error;

/// A network cannot be used. Every message names the file.
#[derive(Debug, Error)]
pub enum NetworkError {
    /// ONNX Runtime cannot be loaded.
    #[error("ONNX Runtime, which computes networks, cannot be loaded: {0}")]
    Library(String),
    /// The description cannot be read, or contradicts itself.
    #[error("{}: {reason}", .file.display())]
    Description {
        /// The TOML file, or the name of a shipped description.
        file: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// The network cannot be read, or is not the one that is described.
    #[error("{}: {reason}", .file.display())]
    Model {
        /// The ONNX file.
        file: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// What the network computed cannot be used.
    #[error("{}: {reason}", .file.display())]
    Output {
        /// The ONNX file.
        file: PathBuf,
        /// What is wrong.
        reason: String,
    },
}

impl NetworkError {
    pub(crate) fn description(file: &Path, reason: impl Into<String>) -> Self {
        Self::Description { file: file.to_owned(), reason: reason.into() }
    }

    pub(crate) fn model(file: &Path, reason: impl Into<String>) -> Self {
        Self::Model { file: file.to_owned(), reason: reason.into() }
    }

    pub(crate) fn output(file: &Path, reason: impl Into<String>) -> Self {
        Self::Output { file: file.to_owned(), reason: reason.into() }
    }

    /// What the user can do about it.
    pub fn fix(&self) -> &'static str {
        match self {
            Self::Library(_) => {
                "pip install onnxruntime, and set ORT_DYLIB_PATH to its onnxruntime/capi/libonnxruntime.so.* \
                 (version 1.17 or later)"
            }
            Self::Description { .. } => "docs/footage.md lists the keys of a network's description",
            Self::Model { .. } => {
                "give the ONNX file that the description was written for, or correct the names in it"
            }
            Self::Output { .. } => {
                "check the outputs' names, the normalisation (subtract, divide) and the layout in the description"
            }
        }
    }
}
