//! What all steps of a training on the device share: kernels, working memory and the running loss.

use crate::kernels;
use crate::target::Target;
use ffgs_gpu::{Buffer, Commands, Gpu, GpuError, Groups};
use ffgs_rasterizer::RenderOptions;
use ffgs_rasterizer_gpu::{
    Capacity, GpuScene, Place, SceneDevice, Scratch, VIEWS_PER_SUBMISSION, bin_to_tiles, prepare,
};
use ffgs_trainer::{Progress, TaskView};

/// Steps between two looks at the running loss.
const REPORT_EVERY: usize = 64;

/// How training draws, but for the SH degree of the first frame.
pub(crate) const OPTIONS: RenderOptions = RenderOptions { sh_degree: None, dropout: None, at_centres: false };

/// What the steps of a lane share besides the Gaussians.
pub(crate) struct Workspace<'a> {
    pub gpu: &'a Gpu,
    pub scratch: Scratch,
    partials: Buffer,
    sums: Buffer,
    progress: Buffer,
}

impl<'a> Workspace<'a> {
    /// Room for views of up to `pixels` pixels.
    pub(crate) fn new(gpu: &'a Gpu, gaussians: usize, pixels: usize) -> Result<Self, GpuError> {
        Ok(Self {
            gpu,
            scratch: Scratch::new(gpu, Capacity::guess(gaussians, pixels))?,
            partials: gpu.buffer("loss derivatives", pixels as u64 * 48)?,
            // A tile holds at least a pixel of each 16 x 16 block, whatever the image's shape.
            sums: gpu.buffer("loss sums", pixels as u64 * 48)?,
            progress: gpu.buffer("progress", 16)?,
        })
    }

    /// Makes room for `scene` in every view, and half as much again for what training adds. Waits for the device.
    pub(crate) fn fit(
        &mut self,
        scene: &GpuScene,
        targets: &[Target],
        options: RenderOptions,
    ) -> Result<(), GpuError> {
        let gpu = self.gpu;
        self.scratch.ensure(gpu, Capacity { gaussians: scene.count, ..Capacity::default() })?;
        self.scratch.restart(gpu, scene.count);
        for group in targets.chunks(VIEWS_PER_SUBMISSION) {
            let mut commands = gpu.commands();
            for target in group {
                prepare(gpu, scene, &target.view, &self.scratch, options, 0);
                bin_to_tiles(&mut commands, scene, &target.view, &self.scratch);
            }
            gpu.submit(commands)?;
        }
        let needed = self.scratch.needed(gpu)?.with_margin();
        self.scratch.ensure(gpu, needed)?;
        self.scratch.restart(gpu, scene.count);
        gpu.write(&self.progress, &[0.0_f32; 4]);
        Ok(())
    }

    /// Makes room for what the renders since [`Workspace::fit`] lacked. Waits for the device.
    pub(crate) fn grow(&mut self) -> Result<(), GpuError> {
        let needed = self.scratch.needed(self.gpu)?.with_margin();
        self.scratch.ensure(self.gpu, needed)
    }

    /// Whether every render since [`Workspace::fit`] had room for all splats. Waits for the device.
    pub(crate) fn was_enough(&self) -> Result<bool, GpuError> {
        Ok(self.scratch.holds(self.scratch.needed(self.gpu)?))
    }

    /// Records the loss of the last render against `target`: derivatives into the scratch's upstream, value into the
    /// running means.
    pub(crate) fn loss(&self, commands: &mut Commands, target: &Target) {
        let (view, s) = (&target.view, &self.scratch);
        let (slots, groups) = (view.slot_list(), Groups::of(3 * view.slots(), 1));
        let statistics =
            [&target.loss, slots, &target.region, &target.photograph, &s.pixels, &self.partials, &self.sums];
        commands.run(&kernels::LOSS_STATISTICS, &statistics, groups);
        let gradient = [
            &target.loss,
            slots,
            &target.region,
            &target.photograph,
            &s.pixels,
            &self.partials,
            &self.sums,
            &s.upstream,
        ];
        commands.run(&kernels::LOSS_GRADIENT, &gradient, groups);
        commands.run(&kernels::LOSS_VALUE, &[&target.loss, &self.sums, &self.progress], Groups::Direct(1));
    }

    /// Running means of the loss and of the squared error: 16 bytes. Waits for the device.
    pub(crate) fn running(&self) -> Result<[f64; 2], GpuError> {
        let progress: Vec<f32> = self.gpu.download(&self.progress, 4)?;
        Ok([f64::from(progress[0]), f64::from(progress[1])])
    }

    /// Now and then, and at the end, how far the training has come. Waits for the device when it does.
    pub(crate) fn progress(
        &self,
        done: usize,
        iterations: usize,
        gaussians: usize,
    ) -> Result<Option<Progress>, GpuError> {
        if !done.is_multiple_of(REPORT_EVERY) && done != iterations {
            return Ok(None);
        }
        let [loss, mse] = self.running()?;
        let psnr = -10.0 * mse.max(1e-12).log10();
        Ok(Some(Progress { iteration: done, iterations, loss, psnr, gaussians }))
    }
}

/// Pixels of the largest of some views.
pub(crate) fn largest_view(views: &[TaskView]) -> usize {
    views.iter().map(|v| v.view.camera.size().pixels()).max().unwrap_or(1)
}

/// What `make` makes, with photographs where trainings of the device keep them; once more with these on the host where the
/// memory of the device is too small.
pub(crate) fn in_short_memory<T>(
    device: &SceneDevice,
    make: impl Fn(Place) -> Result<T, GpuError>,
) -> Result<T, GpuError> {
    let place = device.place_of_photographs();
    match make(place) {
        Err(GpuError::OutOfMemory) if place == Place::Device => {
            device.leave_photographs();
            make(Place::Host)
        }
        made => made,
    }
}
