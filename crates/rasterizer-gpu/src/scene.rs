//! Gaussians in the memory of the device: upload, joining and download.

use crate::layout::{Geometry, Ledger};
use ffgs_core::{Gaussians, PixelFilter, sh_coefficients};
use ffgs_gpu::{Buffer, Gpu, GpuError};

/// Gaussians on the device.
#[derive(Clone, Debug)]
pub struct GpuScene {
    /// (N) rows of [`Geometry`].
    pub geometry: Buffer,
    /// (N, coefficients, RGB) f32.
    pub sh: Buffer,
    /// N.
    pub count: usize,
    /// SH degree of the colours.
    pub sh_degree: usize,
    /// With which they are drawn.
    pub filter: PixelFilter,
}

impl GpuScene {
    /// Copies Gaussians to the device.
    ///
    /// # Errors
    /// When the device has too little memory.
    pub fn upload(gpu: &Gpu, gaussians: &Gaussians) -> Result<Self, GpuError> {
        let rows: Vec<Geometry> = (0..gaussians.len()).map(|i| Geometry::of(gaussians, i)).collect();
        Ok(Self {
            geometry: gpu.upload("Gaussians", &rows)?,
            sh: gpu.upload("spherical harmonics", &gaussians.sh)?,
            count: gaussians.len(),
            sh_degree: gaussians.sh_degree(),
            filter: gaussians.filter,
        })
    }

    /// Some scenes of one SH degree and filter one after another, copied on the device.
    ///
    /// # Errors
    /// When the device fails or has too little memory.
    ///
    /// # Panics
    /// When the SH degrees or filters differ.
    pub fn joined(gpu: &Gpu, parts: &[&Self]) -> Result<Self, GpuError> {
        let parts: Vec<_> = parts.iter().filter(|part| part.count > 0).collect();
        let (sh_degree, filter) =
            parts.first().map_or((0, PixelFilter::default()), |part| (part.sh_degree, part.filter));
        let alike = |part: &&&Self| (part.sh_degree, part.filter) == (sh_degree, filter);
        assert!(parts.iter().all(alike), "SH degrees or filters differ");
        let count: usize = parts.iter().map(|part| part.count).sum();
        let widths = [size_of::<Geometry>(), 12 * sh_coefficients(sh_degree)].map(|width| width as u64);
        let geometry = gpu.buffer("Gaussians", count as u64 * widths[0])?;
        let sh = gpu.buffer("spherical harmonics", count as u64 * widths[1])?;
        let mut commands = gpu.commands();
        let mut at = 0;
        for part in parts {
            let n = part.count as u64;
            commands.copy_to(&part.geometry, &geometry, at * widths[0], n * widths[0]);
            commands.copy_to(&part.sh, &sh, at * widths[1], n * widths[1]);
            at += n;
        }
        let scene = Self { geometry, sh, count, sh_degree, filter };
        gpu.submit(commands)?;
        Ok(scene)
    }

    /// Zeros of the same shape: gradients, moments.
    ///
    /// # Errors
    /// When the device has too little memory.
    pub(crate) fn zeros_like(&self, gpu: &Gpu) -> Result<Self, GpuError> {
        Ok(Self {
            geometry: gpu.buffer("Gaussians", self.geometry.bytes())?,
            sh: gpu.buffer("spherical harmonics", self.sh.bytes())?,
            ..self.clone()
        })
    }

    /// Copies the Gaussians back. Waits for the device.
    ///
    /// # Errors
    /// When the device failed.
    pub fn download(&self, gpu: &Gpu) -> Result<Gaussians, GpuError> {
        let mut out = Gaussians::zeros(self.count, self.sh_degree).with_filter(self.filter);
        let rows: Vec<Geometry> = gpu.download(&self.geometry, self.count)?;
        rows.iter().enumerate().for_each(|(i, row)| row.store(&mut out, i));
        out.sh = gpu.download(&self.sh, self.count * out.sh_stride())?;
        Ok(out)
    }
}

/// Derivatives of a scene's parameters on the device.
#[derive(Clone, Debug)]
pub struct GpuGradients {
    /// By the parameters. Rows whose stamp in `ledger` is not the current step's are stale.
    pub scene: GpuScene,
    /// (N) rows of [`Ledger`].
    pub ledger: Buffer,
    /// (N, 12) by the pose, or a placeholder.
    pub(crate) pose: Buffer,
}

impl GpuGradients {
    /// Zeros for `scene`.
    ///
    /// # Errors
    /// When the device has too little memory.
    pub fn new(gpu: &Gpu, scene: &GpuScene, with_pose: bool) -> Result<Self, GpuError> {
        let rows = if with_pose { scene.count as u64 } else { 1 };
        Ok(Self {
            scene: scene.zeros_like(gpu)?,
            ledger: gpu.buffer("optimiser steps", (scene.count * size_of::<Ledger>()) as u64)?,
            pose: gpu.buffer("pose gradients", rows * 48)?,
        })
    }
}
