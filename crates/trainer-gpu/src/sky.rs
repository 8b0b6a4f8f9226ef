//! The sky in the memory of the device, with its gradient and moments.

use crate::kernels;
use crate::layout::SkyUniform;
use crate::target::Target;
use ffgs_core::SkyCube;
use ffgs_gpu::{Buffer, Commands, Gpu, GpuError, Groups};
use ffgs_rasterizer_gpu::Scratch;

/// One unit of a pixel's derivative in the whole numbers that are summed: a sum holds 2^13 pixels.
const UNIT: f32 = 262_144.0;

/// A sky on the device.
pub(crate) struct GpuSky {
    face_size: usize,
    uniform: Buffer,
    texels: Buffer,
    /// Of a sky that is trained.
    training: Option<Training>,
}

/// Gradient and Adam's moments.
struct Training {
    gradient: Buffer,
    steps: Buffer,
    moments: Buffer,
}

impl GpuSky {
    /// One that stays.
    pub(crate) fn fixed(gpu: &Gpu, sky: &SkyCube) -> Result<Self, GpuError> {
        let size = sky.face_size() as u32;
        let uniform = SkyUniform { size, scale: UNIT, rate: 0.0, epsilon: 1.0 };
        Ok(Self {
            face_size: sky.face_size(),
            uniform: gpu.uniform("sky", &uniform)?,
            texels: gpu.upload("sky", &sky.texels)?,
            training: None,
        })
    }

    /// One that is trained.
    pub(crate) fn trained(gpu: &Gpu, sky: &SkyCube) -> Result<Self, GpuError> {
        let texels = sky.texels.len() as u64;
        let training = Training {
            gradient: gpu.buffer("sky gradient", texels * 12)?,
            steps: gpu.buffer("sky steps", texels * 4)?,
            moments: gpu.buffer("sky moments", texels * 24)?,
        };
        Ok(Self { training: Some(training), ..Self::fixed(gpu, sky)? })
    }

    /// Sets the step size, the size of a typical derivative of one pixel, and the derivative that moves a texel at half
    /// the step size.
    pub(crate) fn prepare(&self, gpu: &Gpu, rate: f32, typical: f32, epsilon: f32) {
        let size = self.face_size as u32;
        gpu.write(&self.uniform, &[SkyUniform { size, scale: UNIT / typical, rate, epsilon }]);
    }

    /// Puts the sky into the layers of a target's view.
    pub(crate) fn draw(&self, commands: &mut Commands, target: &Target) {
        let view = &target.view;
        let buffers = [view.uniform(), &self.uniform, view.slot_list(), &self.texels, &view.layers];
        commands.run(&kernels::SKY_LAYERS, &buffers, Groups::of(view.slots(), 1));
    }

    /// One step down the derivative that reaches the sky through what was rendered last.
    pub(crate) fn step(
        &self,
        commands: &mut Commands,
        target: &Target,
        scratch: &Scratch,
        corrections: &Buffer,
    ) {
        let Some(Training { gradient, steps, moments }) = &self.training else { return };
        let view = &target.view;
        let gather =
            [view.uniform(), &self.uniform, view.slot_list(), &scratch.pixels, &scratch.upstream, gradient];
        commands.run(&kernels::SKY_GRADIENT, &gather, Groups::of(view.slots(), 1));
        let buffers = [&self.uniform, corrections, gradient, &self.texels, steps, moments];
        commands.run(&kernels::SKY_ADAM, &buffers, Groups::Items(6 * self.face_size * self.face_size));
    }

    /// Goes on with other texels; moments stay.
    pub(crate) fn replace(&self, gpu: &Gpu, sky: &SkyCube) {
        gpu.write(&self.texels, &sky.texels);
    }

    /// The texels. Waits for the device.
    pub(crate) fn download(&self, gpu: &Gpu, sky: &mut SkyCube) -> Result<(), GpuError> {
        sky.texels = gpu.download(&self.texels, sky.texels.len())?;
        Ok(())
    }
}
