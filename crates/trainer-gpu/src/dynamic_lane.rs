//! The dynamic lane: all parameters of the moving Gaussians. CPU twin: `ffgs_trainer::train_dynamic`.

use crate::kernels;
use crate::optimiser::Optimiser;
use crate::sky::GpuSky;
use crate::target::{Selection, Target};
use crate::workspace::Workspace;
use ffgs_core::{Gaussians, TrainingView};
use ffgs_gpu::{Buffer, Commands, Gpu, GpuError, Groups};
use ffgs_rasterizer::{RenderOptions, TileMask};
use ffgs_rasterizer_gpu::{GpuScene, backward, deal, prepare, render, render_split, tile_depths};
use ffgs_trainer::{DynamicLaneConfig, Epochs, Progress, Surroundings, TILE_DILATION, robust_extent};

const OPTIONS: RenderOptions = RenderOptions { antialiased: true, sh_degree: None };

/// Finetunes `dynamic` on the foreground of `views`, as [`ffgs_trainer::train_dynamic`] does.
///
/// # Errors
/// When the device fails or has too little memory; `dynamic` is then as it was.
pub fn train_dynamic(
    gpu: &Gpu,
    config: &DynamicLaneConfig,
    views: &[TrainingView],
    surroundings: Surroundings,
    dynamic: &mut Gaussians,
    seed: u64,
    report: &mut dyn FnMut(Progress),
) -> Result<(), GpuError> {
    let used: Vec<&TrainingView> = views.iter().filter(|v| v.mask.count() > 0).collect();
    if dynamic.is_empty() || config.iterations == 0 || used.is_empty() {
        return Ok(());
    }
    let pixels = used.iter().map(|v| v.camera.size().pixels()).max().unwrap_or(1);
    let targets: Vec<Target> = used.iter().map(|v| target(gpu, config, v)).collect::<Result<_, _>>()?;
    let count = dynamic.len().max(surroundings.static_layer.len());
    let mut lane = Lane {
        config,
        targets,
        workspace: Workspace::new(gpu, count, pixels)?,
        extent: robust_extent(dynamic),
    };
    lane.fill_layers(&used, surroundings, dynamic)?;
    loop {
        let optimiser = Optimiser::new(gpu, dynamic)?;
        lane.workspace.fit(&optimiser.scene, &lane.targets, OPTIONS)?;
        lane.train(&optimiser, seed, report)?;
        if lane.workspace.was_enough()? {
            *dynamic = optimiser.download()?;
            gpu.release_unused();
            return Ok(());
        }
        // Some step lacked room: again from the start, with more.
        lane.workspace.grow()?;
    }
}

fn target(gpu: &Gpu, config: &DynamicLaneConfig, view: &TrainingView) -> Result<Target, GpuError> {
    let region = view.mask.dilated(config.loss_dilation);
    // A region that reaches beyond the usual tiles takes its own.
    let tiles = TileMask::covering(&view.mask.dilated(TILE_DILATION.max(config.loss_dilation)));
    let selection = Selection { region: Some(&region), tiles: Some(&tiles), layers: None };
    Target::new(gpu, &view.camera, &view.image, &selection)
}

struct Lane<'a> {
    config: &'a DynamicLaneConfig,
    targets: Vec<Target>,
    workspace: Workspace<'a>,
    extent: f32,
}

impl Lane<'_> {
    /// Renders sky and static layer once per view into what is in front of and behind the dynamic layer.
    fn fill_layers(
        &mut self,
        views: &[&TrainingView],
        around: Surroundings,
        dynamic: &Gaussians,
    ) -> Result<(), GpuError> {
        let gpu = self.workspace.gpu;
        let scenes = [GpuScene::upload(gpu, around.static_layer)?, GpuScene::upload(gpu, dynamic)?];
        for scene in &scenes {
            self.workspace.fit(scene, &self.targets, OPTIONS)?;
        }
        let sky = GpuSky::new(gpu, around.sky)?;
        sky.prepare(gpu, 0.0, 1.0, 1.0);
        for (target, view) in self.targets.iter().zip(views) {
            let weight = self.config.outside_alpha / view.mask.count() as f32;
            let weight = gpu.uniform("penalty", &[weight, 0.0, 0.0, 0.0])?;
            self.fill_target(target, &scenes, &sky, &weight)?;
        }
        Ok(())
    }

    fn fill_target(
        &self,
        target: &Target,
        [around, dynamic]: &[GpuScene; 2],
        sky: &GpuSky,
        weight: &Buffer,
    ) -> Result<(), GpuError> {
        let Workspace { gpu, scratch, .. } = &self.workspace;
        let view = &target.view;
        let depths = gpu.buffer("tile depths", view.slots() as u64 * 4)?;
        // Two scenes share the view's uniform, so they take two submissions.
        let submit = |scene: &GpuScene, record: &dyn Fn(&mut Commands)| {
            scratch.restart(gpu, scene.count);
            prepare(gpu, scene, view, scratch, OPTIONS, 0);
            let mut commands = gpu.commands();
            deal(&mut commands, scene, view, scratch);
            record(&mut commands);
            gpu.submit(commands)
        };
        submit(dynamic, &|commands| tile_depths(commands, view, scratch, &depths))?;
        submit(around, &|commands| {
            sky.draw(commands, target);
            render_split(commands, view, scratch, &depths);
            let buffers = [view.uniform(), weight, view.slot_list(), &target.region, &view.layers];
            commands.run(&kernels::ALPHA_PENALTY, &buffers, Groups::of(view.slots(), 1));
        })
    }

    fn train(
        &self,
        optimiser: &Optimiser,
        seed: u64,
        report: &mut dyn FnMut(Progress),
    ) -> Result<(), GpuError> {
        let mut epochs = Epochs::new((0..self.targets.len()).collect(), seed);
        for iteration in 0..self.config.iterations {
            let Some(index) = epochs.draw() else { return Ok(()) };
            self.step(optimiser, iteration, &self.targets[index])?;
            self.workspace.report(iteration + 1, self.config.iterations, optimiser, report)?;
        }
        Ok(())
    }

    /// One step; reads nothing back.
    fn step(&self, optimiser: &Optimiser, iteration: usize, target: &Target) -> Result<(), GpuError> {
        let Workspace { gpu, scratch, .. } = &self.workspace;
        let (scene, view, stamp) = (&optimiser.scene, &target.view, iteration as u32 + 1);
        prepare(gpu, scene, view, scratch, OPTIONS, stamp);
        optimiser.prepare(&self.config.rates(iteration, self.extent), stamp);
        let mut commands = gpu.commands();
        render(&mut commands, scene, view, scratch);
        self.workspace.loss(&mut commands, target);
        backward(&mut commands, scene, view, scratch, &optimiser.gradients);
        optimiser.step(&mut commands);
        gpu.submit(commands)
    }
}
