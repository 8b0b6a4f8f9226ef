//! The 4D stream: a run as one small file per frame, with random access, checksums, and appending while the run goes on.
//!
//! The static layer is written once and then only what changes of it, which is mostly colours; the dynamic layer as key frames and, between
//! them, rigid motions of groups with residuals, deaths and births. Everything is integers behind an adaptive binary range
//! coder. docs/STREAM.md specifies every byte; this crate is the reference decoder.

mod changed_rows;
mod delta;
pub mod entropy;
mod error;
mod frame_file;
mod harmonics;
mod layers;
mod manifest;
mod motion;
mod numbers;
mod range_coder;
mod reader;
mod row;
mod row_models;
mod steps;
mod symmetry;
mod target;
mod writer;

pub use error::{Problem, StreamError};
pub use harmonics::HarmonicChannels;
pub use manifest::{Entry, Manifest};
pub use reader::{DecodedFrame, Reader};
pub use steps::{Precision, Steps};
pub use writer::{Frame, Writer};
