//! HiCoM: Hierarchical Coherent Motion for Streamable Dynamic Scene with 3D Gaussian Splatting (Gao et al., NeurIPS 2024).
//!
//! Nodes are the cells of grids of cubes, from fine to coarse; what all methods of nodes have in common is in [`crate::two_stages`].

mod grid;

use crate::added::AddedConfig;
use crate::deformation::MotionFitConfig;
use crate::two_stages::TwoStages;
use ffgs_method::MotionMethod;
use grid::Grids;
use serde::{Deserialize, Serialize};

/// Settings of HiCoM.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct HicomConfig {
    /// Gaussians per cell of the finest grid, were they spread evenly.
    pub gaussians_per_cell: usize,
    /// Grids.
    pub levels: usize,
    /// Cells along an axis of a grid, in cells of the next coarser one.
    pub level_ratio: usize,
    /// Share of the positions beyond each face of the box.
    pub quantile: f32,
    /// First stage.
    pub motion: MotionFitConfig,
    /// Second stage.
    pub added: AddedConfig,
}

impl Default for HicomConfig {
    fn default() -> Self {
        Self {
            gaussians_per_cell: 5,
            levels: 3,
            level_ratio: 2,
            quantile: 0.05,
            motion: MotionFitConfig::default(),
            added: AddedConfig::default(),
        }
    }
}

/// The method, before the first frame that moves.
pub fn hicom(config: HicomConfig) -> impl MotionMethod {
    TwoStages::<Grids>::new(config)
}

#[cfg(test)]
mod tests;
