//! Files for other programs.

use crate::{Fault, Plugin};
use ffgs_core::Gaussians;
use glam::DMat3;
use std::path::Path;

/// The Gaussians of a file, and what is known of them beside.
#[derive(Clone, Copy, Debug)]
pub struct Splats<'a> {
    /// The Gaussians.
    pub gaussians: &'a Gaussians,
    /// Of those that are followed over time.
    pub followed: Option<Followed<'a>>,
}

/// What is known of Gaussians that are followed over time, a row each.
#[derive(Clone, Copy, Debug)]
pub struct Followed<'a> {
    /// Position covariances (m^2).
    pub covariances: &'a [DMat3],
    /// Ids that stay with a Gaussian over all frames.
    pub ids: &'a [u32],
}

impl<'a> From<&'a Gaussians> for Splats<'a> {
    fn from(gaussians: &'a Gaussians) -> Self {
        Self { gaussians, followed: None }
    }
}

/// A format of files that hold the Gaussians of one frame. Which layers, which frames and under which names is the caller's
/// choice: players want one file per frame.
pub trait SplatWriter: Plugin {
    /// End of its file names, with the dot.
    fn extension(&self) -> &'static str;

    /// Writes a file, whole or not at all. A format without a place for the pixel filter, or for what is known of followed
    /// Gaussians, leaves it out.
    ///
    /// # Errors
    /// When the file cannot be written, or the format cannot hold the Gaussians.
    fn write(&self, file: &Path, splats: &Splats) -> Result<(), Fault>;

    /// Reads a file again, as a player sees it; `None` for a format that this program only writes.
    ///
    /// # Errors
    /// When the file cannot be read.
    fn read(&self, file: &Path) -> Option<Result<Gaussians, Fault>> {
        let _ = file;
        None
    }
}
