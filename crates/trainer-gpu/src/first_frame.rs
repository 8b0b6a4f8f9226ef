//! Frame 0: static, dynamic and sky together. CPU twin: `ffgs_trainer::train_first_frame`.

use crate::optimiser::Optimiser;
use crate::sky::GpuSky;
use crate::target::{Selection, Target};
use crate::workspace::{Workspace, largest_view, shared_layers};
use ffgs_core::TrainingView;
use ffgs_gpu::{Gpu, GpuError};
use ffgs_rasterizer::RenderOptions;
use ffgs_rasterizer_gpu::{backward, prepare, render};
use ffgs_trainer::{
    DensityControl, Epochs, FirstFrame, FirstFrameConfig, IndexMap, LearningRates, Progress, SKY_DOUBT,
    decay, density_config, reset_opacities,
};

/// Trains frame 0 from `start`, as [`ffgs_trainer::train_first_frame`] does.
///
/// # Errors
/// When the device fails or has too little memory.
pub fn train_first_frame(
    gpu: &Gpu,
    config: &FirstFrameConfig,
    views: &[TrainingView],
    start: FirstFrame,
    extent: f32,
    seed: u64,
    report: &mut dyn FnMut(Progress),
) -> Result<FirstFrame, GpuError> {
    if config.iterations == 0 || views.is_empty() {
        return Ok(start);
    }
    let mut training = Training::new(gpu, config, views, &start, extent, seed)?;
    let mut epochs = Epochs::new((0..views.len()).collect(), seed);
    for iteration in 0..config.iterations {
        let Some(index) = epochs.draw() else { break };
        training.step(iteration, index)?;
        training.control_density(iteration + 1)?;
        training.workspace.report(iteration + 1, config.iterations, &training.optimiser, report)?;
    }
    training.warn_of_missing_room()?;
    let mut sky = start.sky;
    training.sky.download(gpu, &mut sky)?;
    let gaussians = training.optimiser.download()?;
    gpu.release_unused();
    Ok(FirstFrame { gaussians, sky })
}

struct Training<'a> {
    config: &'a FirstFrameConfig,
    extent: f32,
    targets: Vec<Target>,
    workspace: Workspace<'a>,
    optimiser: Optimiser<'a>,
    sky: GpuSky,
    density: DensityControl,
}

impl<'a> Training<'a> {
    fn new(
        gpu: &'a Gpu,
        config: &'a FirstFrameConfig,
        views: &[TrainingView],
        FirstFrame { gaussians, sky }: &FirstFrame,
        extent: f32,
        seed: u64,
    ) -> Result<Self, GpuError> {
        let layers = shared_layers(gpu, views)?;
        let target = |view: &TrainingView| {
            let selection = Selection { region: None, tiles: None, layers: Some(&layers) };
            Target::new(gpu, &view.camera, &view.image, &selection)
        };
        let mut training = Self {
            config,
            extent,
            targets: views.iter().map(target).collect::<Result<_, _>>()?,
            workspace: Workspace::new(gpu, gaussians.len(), largest_view(views))?,
            optimiser: Optimiser::new(gpu, gaussians)?,
            sky: GpuSky::new(gpu, sky)?,
            density: DensityControl::new(density_config(config), gaussians.len(), seed),
        };
        // A mean over pixels: the derivative of one is about this large.
        let typical = 1.0 / (3 * largest_view(views)) as f32;
        training.sky.prepare(gpu, config.sky_rate, typical, SKY_DOUBT * typical);
        training.fit()?;
        Ok(training)
    }

    fn fit(&mut self) -> Result<(), GpuError> {
        self.workspace.fit(&self.optimiser.scene, &self.targets, options(None))
    }

    /// One step; reads nothing back.
    fn step(&self, iteration: usize, index: usize) -> Result<(), GpuError> {
        let Self { config, optimiser, sky, .. } = self;
        let Workspace { gpu, scratch, .. } = &self.workspace;
        let (scene, target, stamp) = (&optimiser.scene, &self.targets[index], iteration as u32 + 1);
        let degree = iteration * 10 / config.iterations.max(1);
        prepare(gpu, scene, &target.view, scratch, options(Some(degree)), stamp);
        optimiser.prepare(&self.rates(iteration), stamp);
        let mut commands = gpu.commands();
        sky.draw(&mut commands, target);
        render(&mut commands, scene, &target.view, scratch);
        self.workspace.loss(&mut commands, target);
        backward(&mut commands, scene, &target.view, scratch, &optimiser.gradients);
        optimiser.step(&mut commands);
        sky.step(&mut commands, target, scratch, optimiser.corrections());
        gpu.submit(commands)
    }

    fn rates(&self, iteration: usize) -> LearningRates {
        let c = self.config;
        let rate = decay(c.position_rate, c.position_rate_end, iteration, c.iterations) * self.extent;
        LearningRates { scales: c.scale_rate, opacities: c.opacity_rate, ..LearningRates::with_means(rate) }
    }

    /// Rounds of growth and removal, decided on the host: a few times in a training, 300 bytes a Gaussian.
    fn control_density(&mut self, done: usize) -> Result<(), GpuError> {
        let c = self.config;
        let share = done as f32 / c.iterations as f32;
        let reset_at = (c.opacity_reset * c.iterations as f32) as usize;
        let resets = reset_at > 0 && done == reset_at;
        let due = c.densify_every > 0 && done.is_multiple_of(c.densify_every);
        let grows = due && share >= c.densify_span[0] && share <= c.densify_span[1];
        if !(resets || grows) {
            return Ok(());
        }
        self.warn_of_missing_room()?;
        let mut gaussians = self.optimiser.download()?;
        self.observe()?;
        if resets {
            reset_opacities(&mut gaussians, 0.01);
        }
        let map = if grows {
            let plan = self.density.plan(&gaussians, self.extent);
            self.density.apply(&plan, &mut gaussians)
        } else {
            IndexMap::identity(gaussians.len())
        };
        self.optimiser.replace(&gaussians, &map, !resets)?;
        self.fit()
    }

    /// Hands what the steps noted since the last round to the density control.
    fn observe(&mut self) -> Result<(), GpuError> {
        let ledger = self.optimiser.ledger()?;
        let sums: Vec<f32> = ledger.iter().map(|l| l.gradient_norm).collect();
        let views: Vec<u32> = ledger.iter().map(|l| l.views).collect();
        self.density.observe_sums(&sums, &views);
        Ok(())
    }

    /// Room is made for half as much again as was needed at the start of a round; beyond that the farthest splats of a
    /// view are left out, which the next round ends.
    fn warn_of_missing_room(&self) -> Result<(), GpuError> {
        if !self.workspace.was_enough()? {
            tracing::warn!("first frame: the farthest splats of some views were left out of some steps");
        }
        Ok(())
    }
}

fn options(degree: Option<usize>) -> RenderOptions {
    RenderOptions { antialiased: true, sh_degree: degree }
}
