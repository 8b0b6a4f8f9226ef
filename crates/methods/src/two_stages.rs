//! HiCoM and ReCon-GS: nodes move all Gaussians, then some are added.
//!
//! A frame has two stages of whole photographs. First only the deltas of the nodes are trained; then Gaussians are added where the
//! gradient was large, and only these are trained. In the next frame they belong to the others, and as many are removed, those of lowest
//! opacity. Losses, rates and schedules are those of the official configurations, both called `dynerf.yaml`.
//!
//! Deviations of both:
//! - The first frame is that of this program, for every method (docs/adr/0036); a sky that stays is behind all Gaussians, in place of
//!   black, and renders are antialiased.
//! - Gradient sums count the views in which a Gaussian received a gradient, not those whose frustum it touches, and start anew in each frame.
//! - Of the added Gaussians those that fade or grow too large are removed before large ones are split, not after. The official
//!   limit of 20 px has no effect there and is left out: splitting clears the radii before they are read.
//! - They run on the CPU.

use crate::added::{Added, AddedConfig};
use crate::deformation::{Deformation, Deltas, Fit, MotionFitConfig};
use crate::one_layer;
use crate::photographs::{Photographs, frame_seed, view_order};
use crate::saved::{Reader, Writer};
use crate::storage;
use anyhow::Result;
use ffgs_core::{Gaussians, Scene, StageLog};
use ffgs_method::{Finetuning, MotionMethod, Step};
use ffgs_trainer::{Epochs, GradientSums, LearningRates, Schedule, camera_extent};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// What moves the Gaussians in the first stage.
pub(crate) trait Nodes: Sized + Send {
    /// Settings of the method.
    type Config: Send;

    /// Those of both stages.
    fn stages(config: &Self::Config) -> (&MotionFitConfig, &AddedConfig);

    /// Those of a frame in which the Gaussians are at `means` (m), from those of the last one.
    ///
    /// # Errors
    /// When a position is not finite.
    fn next(last: Option<Self>, means: &[[f32; 3]], config: &Self::Config, step: &Step) -> Result<Self>;

    /// Which nodes the Gaussians at these positions follow, and the nodes' deltas.
    ///
    /// # Errors
    /// When a position is not finite.
    fn deformation(&mut self, means: &[[f32; 3]]) -> Result<(Deformation, &mut Deltas)>;

    /// The nodes' deltas.
    fn deltas(&self) -> &Deltas;

    fn save(&self, out: Writer) -> Writer;

    fn restore(state: &mut Reader, config: &Self::Config) -> Result<Self>;
}

/// A method of nodes, with what it keeps between frames.
pub(crate) struct TwoStages<N: Nodes> {
    config: N::Config,
    /// None before the first frame that moves.
    pub nodes: Option<N>,
    /// Gaussians that the last frame added; they are the last ones.
    pub added: usize,
}

impl<N: Nodes> TwoStages<N> {
    /// Nothing has moved yet.
    pub(crate) fn new(config: N::Config) -> Self {
        Self { config, nodes: None, added: 0 }
    }

    /// First stage: moves `gaussians`; their gradient sums.
    fn fit(
        &mut self,
        step: &Step,
        gaussians: &mut Gaussians,
        photographs: &mut Photographs,
        views: &mut Epochs,
    ) -> Result<GradientSums> {
        let nodes = N::next(self.nodes.take(), &gaussians.means, &self.config, step)?;
        let (config, _) = N::stages(&self.config);
        let (deformation, deltas) = self.nodes.insert(nodes).deformation(&gaussians.means)?;
        let schedule = Schedule {
            iterations: config.iterations,
            rates: &|_| LearningRates::with_means(config.rate),
            ..Schedule::default()
        };
        let mut fit = Fit::new((&deformation, deltas), gaussians, photographs, config);
        schedule.run(&mut fit, views, |_, _| Ok(()), &mut |_| ())?;
        Ok(fit.sums)
    }
}

impl<N: Nodes> MotionMethod for TwoStages<N> {
    fn trains_on_cpu(&self) -> bool {
        true
    }

    /// Moves nothing: the training starts from the nodes of the last frame. Removes as many Gaussians as were added.
    fn predict(&mut self, _: &Step, scene: &mut Scene, _: &mut StageLog) -> Result<()> {
        merge(scene, std::mem::take(&mut self.added));
        Ok(())
    }

    fn finetune(&mut self, step: &Step, scene: &mut Scene, log: &mut StageLog) -> Result<Finetuning> {
        let Scene { dynamic, sky, .. } = scene;
        if dynamic.gaussians.is_empty() {
            return Ok(Finetuning::Done);
        }
        let (mut photographs, mut views) = (Photographs::new(step, sky), view_order(step));
        let mut gaussians = std::mem::take(&mut dynamic.gaussians);
        let kept = gaussians.len();
        let start = Instant::now();
        let sums = self.fit(step, &mut gaussians, &mut photographs, &mut views)?;
        log.since("motion", start);
        let start = Instant::now();
        let (_, config) = N::stages(&self.config);
        let copies = (camera_extent(step.now), frame_seed(step));
        if let Some(added) = Added::new(config, &mut gaussians, &sums, &mut photographs, copies) {
            added.train(&mut views)?;
        }
        log.since("added Gaussians", start);
        self.added = gaussians.len() - kept;
        one_layer::replace(dynamic, gaussians, &(0..kept).collect::<Vec<_>>());
        Ok(Finetuning::Done)
    }

    fn store(&self, scene: &Scene, folder: &Path) -> Result<Vec<PathBuf>> {
        let deltas = self.nodes.as_ref().map_or(&[][..], |nodes| &nodes.deltas().applied);
        if deltas.is_empty() {
            return Ok(Vec::new());
        }
        let gaussians = &scene.dynamic.gaussians;
        let kept = gaussians.len() - self.added;
        Ok(vec![storage::write(folder, deltas.as_chunks().0, gaussians, kept)?])
    }

    fn save(&self) -> Vec<u8> {
        let head = Writer::default().count(self.added);
        self.nodes.as_ref().map_or_else(Vec::new, |nodes| nodes.save(head).finish())
    }

    fn restore(&mut self, state: &[u8], _: &Scene) -> Result<()> {
        if state.is_empty() {
            return Ok(());
        }
        let mut state = Reader(state);
        self.added = state.count()?;
        self.nodes = Some(N::restore(&mut state, &self.config)?);
        state.end()
    }
}

/// At the start of a frame: the Gaussians that the last one added belong to the others, and as many are removed, those of lowest opacity.
fn merge(scene: &mut Scene, added: usize) {
    one_layer::join(scene);
    if added == 0 {
        return;
    }
    let opacities = &scene.dynamic.gaussians.opacity_logits;
    let mut order: Vec<usize> = (0..opacities.len()).collect();
    order.sort_by(|&a, &b| opacities[a].total_cmp(&opacities[b]).then(a.cmp(&b)));
    let mut kept = order.split_off(added.min(order.len()));
    kept.sort_unstable();
    scene.dynamic.keep(&kept);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::World;

    #[test]
    fn the_faintest_go_and_the_order_stays() {
        let mut scene = World::new().scene();
        merge(&mut scene, 0);
        let all = scene.dynamic.ids.clone();
        scene.dynamic.gaussians.opacity_logits[3] = -9.0;
        scene.dynamic.gaussians.opacity_logits[1] = -8.0;
        merge(&mut scene, 2);
        let without: Vec<u32> = all.iter().copied().filter(|id| ![1, 3].contains(id)).collect();
        assert_eq!(scene.dynamic.ids, without);
        merge(&mut scene, 10_000);
        assert!(scene.dynamic.gaussians.is_empty());
    }
}
