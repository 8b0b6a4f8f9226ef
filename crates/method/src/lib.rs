//! The contract: what can be exchanged. No implementation, no file is opened here, no clock.
//!
//! | trait | what it is |
//! |---|---|
//! | [`CaptureFormat`], [`Capture`] | a layout of captures on disk, and an opened one |
//! | [`TrackFormat`], [`TrackSource`] | a file format of a tracker; the motion of one view from t-1 to t |
//! | [`MotionMethod`] | moves and changes a scene from t-1 to t |
//! | [`SplatWriter`] | writes the Gaussians of a frame for other programs |
//!
//! Every plug-in has a [`Plugin::name`] and stands in one [`Registry`]: the values of command-line options, the lists
//! that the program prints and the errors on unknown names come from there. To add one, write its file and add its line
//! to the list.
//!
//! An error of a format is a [`Fault`]: it names the file and what to do about it.

#![warn(clippy::missing_errors_doc)]

mod capture;
mod fault;
mod motion;
mod registry;
mod splats;
mod tracks;

pub use capture::{Capture, CaptureFormat, Part, Points, Split, ViewAt};
pub use fault::Fault;
pub use motion::{Finetuning, MotionMethod, Step};
pub use registry::{Plugin, Registry, Unknown};
pub use splats::{Followed, SplatWriter, Splats};
pub use tracks::{PixelCenter, TrackFormat, TrackSource, Tracked, ViewStep};
