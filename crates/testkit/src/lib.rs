//! What tests of several crates share. A dev-dependency only: no crate depends on it otherwise.
//!
//! Here a fault is a panic, because it fails the test: functions panic on a missing file, a missing array, or columns
//! of different lengths.
#![allow(clippy::missing_panics_doc, reason = "said once, above")]

mod case;
mod compare;
pub mod conformance;
mod random;
mod scene;
mod vectorised;

pub use case::{Case, case, cases};
pub use compare::{largest, largest_difference, relative_difference};
pub use random::{normal, normal3};
pub use scene::look_at;
pub use vectorised::vectorised;
