//! The static lane (SH colour only) and the sky lane (texture only). CPU twins: `ffgs_trainer::StaticLane`
//! with the method `steps`, `ffgs_trainer::train_sky`.

use crate::kernels;
use crate::optimiser::Optimiser;
use crate::sky::GpuSky;
use crate::target::{Selection, Target};
use crate::workspace::{Workspace, largest_view, shared_layers};
use ffgs_core::{Gaussians, SkyCube, TrainingView};
use ffgs_gpu::{Gpu, GpuError, Groups};
use ffgs_rasterizer::RenderOptions;
use ffgs_rasterizer_gpu::{backward, prepare, render};
use ffgs_trainer::{BackgroundConfig, Epochs, LearningRates, Progress, SKY_LANE_DOUBT, background_region};

const OPTIONS: RenderOptions = RenderOptions { antialiased: true, sh_degree: None };

/// Finetunes the SH colours of the static layer, as [`ffgs_trainer::StaticLane`] does with the method `steps`.
///
/// # Errors
/// When the device fails or has too little memory; `layer` is then as it was.
pub fn train_static(
    gpu: &Gpu,
    config: &BackgroundConfig,
    views: &[TrainingView],
    sky: &SkyCube,
    layer: &mut Gaussians,
    seed: u64,
    report: &mut dyn FnMut(Progress),
) -> Result<(), GpuError> {
    if layer.is_empty() || views.is_empty() || config.static_iterations == 0 {
        return Ok(());
    }
    let mut lane = Lane::new(gpu, config, views, sky, layer)?;
    let rates = config.static_rates();
    lane.sky.prepare(gpu, 0.0, 1.0, 1.0);
    let mut epochs = Epochs::new((0..views.len()).collect(), seed);
    for iteration in 0..config.static_iterations {
        let Some(index) = epochs.draw() else { break };
        lane.static_step(&rates, iteration as u32 + 1, index)?;
        lane.workspace.report(iteration + 1, config.static_iterations, &lane.optimiser, report)?;
    }
    *layer = lane.optimiser.download()?;
    gpu.release_unused();
    Ok(())
}

/// Finetunes the sky through the transmittance that `layer` leaves, as [`ffgs_trainer::train_sky`] does.
///
/// # Errors
/// When the device fails or has too little memory; `sky` is then as it was.
pub fn train_sky(
    gpu: &Gpu,
    config: &BackgroundConfig,
    views: &[TrainingView],
    layer: &Gaussians,
    sky: &mut SkyCube,
    seed: u64,
) -> Result<(), GpuError> {
    if views.is_empty() || config.sky_iterations == 0 || sky.is_none() {
        return Ok(());
    }
    let mut lane = Lane::new(gpu, config, views, sky, layer)?;
    lane.sky.prepare(gpu, config.sky_rate, 1.0, SKY_LANE_DOUBT);
    let mut epochs = Epochs::new((0..views.len()).collect(), seed);
    for _ in 0..config.sky_iterations {
        let Some(index) = epochs.draw() else { break };
        lane.sky_step(index)?;
    }
    lane.sky.download(gpu, sky)?;
    gpu.release_unused();
    Ok(())
}

struct Lane<'a> {
    targets: Vec<Target>,
    workspace: Workspace<'a>,
    optimiser: Optimiser<'a>,
    sky: GpuSky,
}

impl<'a> Lane<'a> {
    fn new(
        gpu: &'a Gpu,
        config: &BackgroundConfig,
        views: &[TrainingView],
        sky: &SkyCube,
        layer: &Gaussians,
    ) -> Result<Self, GpuError> {
        let layers = shared_layers(gpu, views)?;
        let target = |view: &TrainingView| {
            let region = background_region(view, config.mask_dilation);
            let selection = Selection { region: Some(&region), tiles: None, layers: Some(&layers) };
            Target::new(gpu, &view.camera, &view.image, &selection)
        };
        let targets: Vec<Target> = views.iter().map(target).collect::<Result<_, _>>()?;
        let optimiser = Optimiser::new(gpu, layer)?;
        let mut workspace = Workspace::new(gpu, layer.len(), largest_view(views))?;
        // The geometry does not change: what fits once fits always.
        workspace.fit(&optimiser.scene, &targets, OPTIONS)?;
        Ok(Self { targets, workspace, optimiser, sky: GpuSky::new(gpu, sky)? })
    }

    /// One step; reads nothing back.
    fn static_step(&mut self, rates: &LearningRates, stamp: u32, index: usize) -> Result<(), GpuError> {
        let Self { targets, workspace, optimiser, sky } = self;
        let (gpu, scratch, target) = (workspace.gpu, &workspace.scratch, &targets[index]);
        prepare(gpu, &optimiser.scene, &target.view, scratch, OPTIONS, stamp);
        optimiser.prepare(rates, stamp);
        let mut commands = gpu.commands();
        sky.draw(&mut commands, target);
        render(&mut commands, &optimiser.scene, &target.view, scratch);
        workspace.loss(&mut commands, target);
        backward(&mut commands, &optimiser.scene, &target.view, scratch, &optimiser.gradients);
        optimiser.step(&mut commands);
        gpu.submit(commands)
    }

    /// One step on half the squared error; reads nothing back.
    fn sky_step(&mut self, index: usize) -> Result<(), GpuError> {
        let Self { targets, workspace, optimiser, sky } = self;
        let (gpu, scratch, target) = (workspace.gpu, &workspace.scratch, &targets[index]);
        let view = &target.view;
        prepare(gpu, &optimiser.scene, view, scratch, OPTIONS, 0);
        let mut commands = gpu.commands();
        sky.draw(&mut commands, target);
        render(&mut commands, &optimiser.scene, view, scratch);
        let buffers = [
            &target.loss,
            view.slot_list(),
            &target.region,
            &target.photograph,
            &scratch.pixels,
            &scratch.upstream,
        ];
        commands.run(&kernels::SQUARED_ERROR, &buffers, Groups::of(view.slots(), 1));
        sky.step(&mut commands, target, scratch, optimiser.corrections());
        gpu.submit(commands)
    }
}
