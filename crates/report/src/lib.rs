//! `report.html`: one self-contained file that shows a run: pictures with a scrubber over frames, curves, the paper's
//! timing table, motion and uncertainty, what was skipped, the configuration. No network, no other files.

mod colour;
mod document;
mod error;
mod input;
mod motion_plots;
mod overlay;
mod page;
mod picture;
mod plot;
mod timing;

pub use document::{Curve, curves, document};
pub use error::ReportError;
pub use input::{Fact, FrameReport, MotionAccuracy, ReportInput, SkipCount, ViewReport};
pub use overlay::{OverlayError, motion_picture, uncertainty_picture};
pub use page::write_report;
pub use picture::{CameraPicture, CameraPictures, FramePictures, Thumbnails, Turntable};
