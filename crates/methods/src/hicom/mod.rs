//! HiCoM: Hierarchical Coherent Motion for Streamable Dynamic Scene with 3D Gaussian Splatting (Gao et al., NeurIPS 2024).
//!
//! A frame has two stages of whole photographs. First only the deltas of grids of cubes are trained, which move all Gaussians; then
//! Gaussians are added where the gradient was large, and only these are trained. In the next frame they belong to the others, and as
//! many are removed, those of lowest opacity. Losses, rates and schedules are those of the official configuration `dynerf.yaml`.
//!
//! Deviations:
//! - The first frame is that of this program, for every method (docs/adr/0036); a sky that stays is behind all Gaussians, in place of
//!   black, and renders are antialiased.
//! - Gradient sums count the views in which a Gaussian received a gradient, not those whose frustum it touches, and start anew in each frame.
//! - Of the added Gaussians those that fade or grow too large are removed before large ones are split, not after. The official
//!   limit of 20 px has no effect there and is left out: splitting clears the radii before they are read.
//! - It runs on the CPU.

mod grid;

use crate::added::AddedConfig;
use crate::deformation::{DELTA, MotionFitConfig};
use crate::saved::{Reader, Writer};
use crate::two_stages::{Stages, merge};
use anyhow::Result;
use ffgs_core::{Scene, StageLog};
use ffgs_method::{Finetuning, MotionMethod, Step};
use ffgs_trainer::AdamVec;
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

/// The method, with what it keeps between frames.
pub struct Hicom {
    config: HicomConfig,
    /// None before the first frame that moves.
    grids: Option<Grids>,
    /// Gaussians that the last frame added; they are the last ones.
    added: usize,
}

impl Hicom {
    /// Nothing has moved yet.
    pub fn new(config: HicomConfig) -> Self {
        Self { config, grids: None, added: 0 }
    }
}

impl MotionMethod for Hicom {
    /// Moves nothing: the grids of the last frame are where the training starts. Removes as many Gaussians as were added.
    fn predict(&mut self, _: &Step, scene: &mut Scene, _: &mut StageLog) -> Result<()> {
        merge(scene, std::mem::take(&mut self.added));
        Ok(())
    }

    fn finetune(&mut self, step: &Step, scene: &mut Scene, log: &mut StageLog) -> Result<Finetuning> {
        let Self { config, grids, .. } = self;
        let stages = Stages { motion: &config.motion, added: &config.added };
        self.added = stages.train(step, scene, log, |means| {
            let grids = grids.get_or_insert_with(|| Grids::new(means, config));
            let deformation = grids.deformation(means);
            grids.deltas.adam = AdamVec::new(grids.deltas.nodes().len(), DELTA);
            Ok((deformation, &mut grids.deltas))
        })?;
        Ok(Finetuning::Done)
    }

    fn save(&self) -> Vec<u8> {
        let head = Writer::default().count(self.added);
        self.grids.as_ref().map_or_else(Vec::new, |grids| grids.save(head).finish())
    }

    fn restore(&mut self, state: &[u8], _: &Scene) -> Result<()> {
        if state.is_empty() {
            return Ok(());
        }
        let mut state = Reader(state);
        self.added = state.count()?;
        self.grids = Some(Grids::restore(&mut state, &self.config)?);
        state.end()
    }
}

#[cfg(test)]
mod tests;
