//! Calibrations of many programs in one form: lenses with their distortion, poses, and where the pictures are.
//!
//! Each format is a file in [`formats`] that turns its own axes, units and pixel centres into this project's:
//! world-to-camera with OpenCV axes, and the centre of the first pixel at (0.5, 0.5).

mod error;
mod footage;
pub mod formats;
mod lens;
mod media;
mod undistortion;

pub use error::CalibrationError;
pub use footage::{ColouredPoint, Footage, Pictures, Role, SourceCamera};
pub use formats::{FORMATS, Format, detect};
pub use lens::{Distortion, Lens};
pub use media::{CLEAN_PLATES, Media};
pub use undistortion::Undistortion;
