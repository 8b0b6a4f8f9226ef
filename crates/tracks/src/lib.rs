//! Tracker outputs (npz, flo, EXR, npy) to the motion types of core, and their validation.
//!
//! `tracks/tracks.json` of a capture names the trackers:
//!
//! ```json
//! {"trackers": [{"name": "xfeat", "level": "sparse", "format": "npz",
//!                "pattern": "xfeat/{camera}/{frame:06}.npz", "pixel_center": "integer"}]}
//! ```
//!
//! A file of frame t holds the motion from t-1 to t. Motion leaves this crate in continuous pixel coordinates with
//! pixel centres at + 0.5, finite, and of the size of its camera.

#![warn(clippy::missing_errors_doc)]

mod background;
mod check;
mod error;
mod exr;
mod flo;
mod flow;
mod formats;
mod index;
mod npy;
mod npz;
mod source;
mod store;

pub use background::{MovingBackground, moving_backgrounds};
pub use check::{FilesRead, TrackerSummary, TracksReport, check};
pub use formats::FORMATS;
pub use index::Tracker;
pub use source::sources;
pub use store::TrackStore;
