//! Scores motion estimates against ground truth: end-point errors, normalised errors and coverage.
//!
//! The truth is for scoring only: nothing that estimates may depend on this crate.
//!
//! ```
//! use ffgs_motion_eval::Sample;
//! use glam::{DMat3, DVec3};
//!
//! let sample = Sample { error: DVec3::new(0.02, 0.0, 0.0), covariance: DMat3::IDENTITY * 1e-4 };
//! let summary = ffgs_motion_eval::summarise(&[sample]);
//! assert!((summary.median_cm - 2.0).abs() < 1e-9);
//! assert!((summary.nees_median - 4.0).abs() < 1e-9);
//! ```

mod flow;
mod score;
mod table;
mod truth;

pub use flow::{FlowSummary, TrueFlow, flow_error};
pub use score::{BINS_CM, NOMINAL, Sample, Summary, quantile, summarise};
pub use table::{Row, table};
pub use truth::{Kind, Truth, TruthError};
