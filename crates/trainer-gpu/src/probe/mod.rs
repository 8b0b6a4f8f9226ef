//! One training step with its parts, for benchmarks.

mod floor;

pub use floor::{Counts, Floor};

use crate::optimiser::Optimiser;
use crate::sky::GpuSky;
use crate::target::{Shared, Target};
use crate::workspace::Workspace;
use ffgs_core::{Gaussians, SkyCube, TrainingView};
use ffgs_gpu::{Commands, Gpu, GpuError, KernelTime};
use ffgs_rasterizer::RenderOptions;
use ffgs_rasterizer_gpu::{GpuScene, backward, prepare, render};
use ffgs_trainer::{Columns, IndexMap, LearningRates};
use std::cell::Cell;

/// A part of a training step. Each needs what the ones before it left on the device.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// Projection to image.
    Forward,
    /// Loss with its gradient by the image.
    Loss,
    /// Gradient by the Gaussians.
    Backward,
    /// One step of the optimiser.
    Adam,
    /// All of it in one submission.
    Step,
}

/// One view with everything that a step needs on the device: what training does in each iteration, to be
/// timed part by part.
pub struct Probe<'a> {
    workspace: Workspace<'a>,
    optimiser: Optimiser<'a>,
    target: Target<'a>,
    options: RenderOptions,
    stamp: Cell<u32>,
}

/// So small that the scene stays what it is.
const RATES: LearningRates =
    LearningRates { means: 1e-9, quats: 1e-9, scales: 1e-9, opacities: 1e-9, sh0: 1e-9, sh_rest: 1e-9 };

impl<'a> Probe<'a> {
    /// Everything on the device, and one whole step done.
    ///
    /// # Errors
    /// When the device fails or has too little memory.
    pub fn new(
        gpu: &'a Gpu,
        gaussians: &Gaussians,
        view: &'a TrainingView,
        options: RenderOptions,
    ) -> Result<Self, GpuError> {
        let target = Target::new(gpu, view, (None, None), &Shared::default())?;
        let optimiser = Optimiser::new(gpu, GpuScene::upload(gpu, gaussians)?, Columns::ALL)?;
        let mut workspace = Workspace::new(gpu, gaussians.len(), view.camera.size().pixels())?;
        workspace.fit(&optimiser.scene, std::slice::from_ref(&target), options)?;
        let sky = GpuSky::fixed(gpu, &SkyCube::filled(8, [0.3; 3]))?;
        let mut commands = gpu.commands();
        sky.draw(&mut commands, &target);
        gpu.submit(commands)?;
        let probe = Self { workspace, optimiser, target, options, stamp: Cell::new(0) };
        probe.run(Part::Step)?;
        Ok(probe)
    }

    /// Submits a part; does not wait for it.
    ///
    /// # Errors
    /// When the device failed.
    pub fn run(&self, part: Part) -> Result<(), GpuError> {
        self.prepare(part);
        let mut commands = self.workspace.gpu.commands();
        self.record(part, &mut commands);
        self.workspace.gpu.submit(commands)
    }

    /// Times of the kernels of a part, in their order; `None` where the adapter has no timestamps. Waits for the device.
    ///
    /// # Errors
    /// When the device failed.
    pub fn times(&self, part: Part) -> Result<Option<Vec<KernelTime>>, GpuError> {
        self.prepare(part);
        let Some(mut commands) = self.workspace.gpu.timed_commands() else { return Ok(None) };
        self.record(part, &mut commands);
        self.workspace.gpu.submit_timed(commands).map(Some)
    }

    /// What a round of density control moves, with nothing grown: Gaussians, moments and notes to the host and back.
    /// Returns the bytes.
    ///
    /// # Errors
    /// When the device fails or has too little memory.
    pub fn round_trip(&mut self) -> Result<u64, GpuError> {
        let gpu = self.workspace.gpu;
        let before = gpu.traffic();
        let gaussians = self.optimiser.download()?;
        self.optimiser.ledger()?;
        self.optimiser.replace(&gaussians, &IndexMap::identity(gaussians.len()), (true, false))?;
        gpu.finish()?;
        let after = gpu.traffic();
        Ok(after.up + after.down - before.up - before.down)
    }

    /// A new step wherever gradients are written, so that they replace those of the last one.
    fn prepare(&self, part: Part) {
        let Workspace { gpu, scratch, .. } = &self.workspace;
        let starts = matches!(part, Part::Backward | Part::Step);
        self.stamp.set(self.stamp.get() + u32::from(starts));
        prepare(gpu, &self.optimiser.scene, &self.target.view, scratch, self.options, self.stamp.get());
        self.optimiser.prepare(&RATES, self.stamp.get());
    }

    fn record(&self, part: Part, commands: &mut Commands) {
        let Self { workspace, optimiser, target, .. } = self;
        let (scene, view, scratch) = (&optimiser.scene, &target.view, &workspace.scratch);
        match part {
            Part::Forward => render(commands, scene, view, scratch),
            Part::Loss => workspace.loss(commands, target),
            Part::Backward => backward(commands, scene, view, scratch, &optimiser.gradients),
            Part::Adam => optimiser.step(commands),
            Part::Step => [Part::Forward, Part::Loss, Part::Backward, Part::Adam]
                .into_iter()
                .for_each(|part| self.record(part, commands)),
        }
    }

    /// What a step works on; `contributions` = (pixel, Gaussian) pairs that are blended. Waits for the device.
    ///
    /// # Errors
    /// When the device failed.
    pub fn counts(&self, contributions: u64) -> Result<Counts, GpuError> {
        let needed = self.workspace.scratch.needed(self.workspace.gpu)?;
        let in_sight = self.optimiser.ledger()?.iter().filter(|l| l.stamp == self.stamp.get()).count();
        Ok(Counts {
            gaussians: self.optimiser.scene.count,
            in_sight,
            coefficients: ffgs_core::sh_coefficients(self.optimiser.scene.sh_degree),
            spans: needed.spans,
            pairs: needed.pairs,
            tiles: self.target.view.slots(),
            pixels: self.target.view.size().pixels(),
            contributions,
        })
    }
}
