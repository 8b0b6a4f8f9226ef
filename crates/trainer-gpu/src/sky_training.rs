//! The training of the sky on the device.

use crate::kernels;
use crate::sky::GpuSky;
use crate::target::{Shared, Target};
use crate::workspace::{OPTIONS, Workspace, in_short_memory, largest_view};
use ffgs_core::SkyCube;
use ffgs_gpu::{Buffer, GpuError, Groups};
use ffgs_rasterizer_gpu::{GpuScene, Place, SceneDevice, prepare, render};
use ffgs_trainer::{SKY_LANE_DOUBT, SkyTask, SkyTraining, bias_corrections};

/// A sky under training on the GPU, behind a layer that stays. A step is one submission and reads nothing back.
pub struct GpuSkyTraining<'a> {
    texels: &'a mut SkyCube,
    on_device: OnDevice<'a>,
}

/// What the training has on the device.
struct OnDevice<'a> {
    sky: GpuSky,
    layer: GpuScene,
    targets: Vec<Target<'a>>,
    workspace: Workspace<'a>,
    corrections: Buffer,
}

impl<'a> OnDevice<'a> {
    fn new(device: &'a SceneDevice, task: &SkyTask<'a>, place: Place) -> Result<Self, GpuError> {
        let gpu = &device.gpu;
        let targets = Target::all(gpu, &task.views, &Shared::new(gpu, &task.views, place, true)?)?;
        let layer = device.layer(task.layer)?;
        let mut workspace = Workspace::new(gpu, layer.count, largest_view(&task.views))?;
        // The layer does not change: what fits once fits always.
        workspace.fit(&layer, &targets, OPTIONS)?;
        let sky = GpuSky::trained(gpu, task.sky)?;
        sky.prepare(gpu, task.rate, 1.0, SKY_LANE_DOUBT);
        let corrections = gpu.upload("bias corrections", &bias_corrections())?;
        Ok(Self { sky, layer, targets, workspace, corrections })
    }
}

impl<'a> GpuSkyTraining<'a> {
    pub(crate) fn new(device: &'a SceneDevice, task: SkyTask<'a>) -> Result<Self, GpuError> {
        let on_device = in_short_memory(device, |place| OnDevice::new(device, &task, place))?;
        let SkyTask { sky: texels, .. } = task;
        Ok(Self { texels, on_device })
    }
}

impl SkyTraining for GpuSkyTraining<'_> {
    type Error = GpuError;

    /// On half the squared error.
    fn step(&mut self, view: usize) -> Result<(), GpuError> {
        let OnDevice { sky, layer, targets, workspace, corrections } = &self.on_device;
        let (gpu, scratch, target) = (workspace.gpu, &workspace.scratch, &targets[view]);
        target.bring(gpu);
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
        sky.step(&mut commands, target, scratch, corrections);
        gpu.submit(commands)
    }

    fn download(self) -> Result<(), GpuError> {
        let OnDevice { sky, workspace, .. } = self.on_device;
        let gpu = workspace.gpu;
        sky.download(gpu, self.texels)?;
        gpu.release_unused();
        Ok(())
    }
}
