//! Optical-flow and matching networks as ONNX files.
//!
//! A [`Description`] (TOML) says what a network takes and gives; [`Network`] runs it on two pictures. The library that
//! computes it, ONNX Runtime, is loaded at run time: this crate links nothing and downloads nothing.

mod description;
mod error;
mod library;
mod network;
mod output;
mod picture;

pub use description::{Colour, Description, FlowOutput, Input, Join, Layout, MatchOutput, SHIPPED};
pub use error::NetworkError;
pub use network::{Motion, Network};
