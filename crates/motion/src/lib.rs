//! The paper's method: from what trackers saw of every Gaussian to where it is at t (Algorithm 1, lines 3 to 42), a file
//! for each stage.
//!
//! [`TrackerMotion`] is the method as a whole; [`observe`] and [`move_by`] are its two halves, for measurements between
//! them. [`Standstill`] leaves every Gaussian where it is.

mod alignment;
mod config;
mod fields;
mod fuse;
mod growth;
mod input;
mod join;
mod observe;
mod on_gpu;
mod standstill;
mod tracker_motion;
mod triangulate;
mod turn;
mod validate;
mod withdraw;

pub use alignment::AlignmentConfig;
pub use config::{AssociationConfig, MarkingConfig, MotionConfig, Rotate};
pub use fuse::pixel_sizes;
pub use input::MotionInput;
pub use join::join;
pub use observe::observe;
pub use standstill::Standstill;
pub use tracker_motion::{TrackerMotion, move_by};
pub use turn::turned;
pub use validate::OUTSIDE_MASKS;
