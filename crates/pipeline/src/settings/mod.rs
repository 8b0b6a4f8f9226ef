//! The configuration of a run: keys, defaults and ranges.

pub mod config;
pub(crate) mod config_ranges;
