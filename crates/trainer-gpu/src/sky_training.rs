//! The training of the sky on the device.

use crate::kernels;
use crate::sky::GpuSky;
use crate::target::{Selection, Target};
use crate::workspace::{OPTIONS, Workspace, largest_view, shared_layers};
use ffgs_core::SkyCube;
use ffgs_gpu::{Buffer, GpuError, Groups};
use ffgs_rasterizer_gpu::{GpuScene, SceneDevice, prepare, render};
use ffgs_trainer::{SKY_LANE_DOUBT, SkyTask, SkyTraining, TaskView, bias_corrections};

/// A sky under training on the GPU, behind a layer that stays. A step is one submission and reads nothing back.
pub struct GpuSkyTraining<'a> {
    texels: &'a mut SkyCube,
    sky: GpuSky,
    layer: GpuScene,
    targets: Vec<Target>,
    workspace: Workspace<'a>,
    corrections: Buffer,
}

impl<'a> GpuSkyTraining<'a> {
    pub(crate) fn new(device: &'a SceneDevice, task: SkyTask<'a>) -> Result<Self, GpuError> {
        let SkyTask { sky: texels, rate, layer, views } = task;
        let gpu = &device.gpu;
        let layers = shared_layers(gpu, &views)?;
        let target = |task: &TaskView| {
            let selection = Selection { region: task.region.as_ref(), tiles: None, layers: Some(&layers) };
            Target::new(gpu, &task.view.camera, &task.view.image, &selection)
        };
        let targets: Vec<Target> = views.iter().map(target).collect::<Result<_, _>>()?;
        let layer = device.layer(layer)?;
        let mut workspace = Workspace::new(gpu, layer.count, largest_view(&views))?;
        // The layer does not change: what fits once fits always.
        workspace.fit(&layer, &targets, OPTIONS)?;
        let sky = GpuSky::trained(gpu, texels)?;
        sky.prepare(gpu, rate, 1.0, SKY_LANE_DOUBT);
        let corrections = gpu.upload("bias corrections", &bias_corrections())?;
        Ok(Self { texels, sky, layer, targets, workspace, corrections })
    }
}

impl SkyTraining for GpuSkyTraining<'_> {
    type Error = GpuError;

    /// On half the squared error.
    fn step(&mut self, view: usize) -> Result<(), GpuError> {
        let Self { sky, layer, targets, workspace, .. } = self;
        let (gpu, scratch, target) = (workspace.gpu, &workspace.scratch, &targets[view]);
        let view = &target.view;
        prepare(gpu, layer, view, scratch, OPTIONS, 0);
        let mut commands = gpu.commands();
        sky.draw(&mut commands, target);
        render(&mut commands, layer, view, scratch);
        let buffers = [
            &target.loss,
            view.slot_list(),
            &target.region,
            &target.photograph,
            &scratch.pixels,
            &scratch.upstream,
        ];
        commands.run(&kernels::SQUARED_ERROR, &buffers, Groups::of(view.slots(), 1));
        sky.step(&mut commands, target, scratch, &self.corrections);
        gpu.submit(commands)
    }

    fn download(self) -> Result<(), GpuError> {
        let gpu = self.workspace.gpu;
        self.sky.download(gpu, self.texels)?;
        gpu.release_unused();
        Ok(())
    }
}
