//! Renders whose result is wanted on the host: single stages, pictures and tests.

use crate::encode;
use crate::layout::Ledger;
use crate::scene::{GpuGradients, GpuScene};
use crate::scratch::{Capacity, Scratch};
use crate::view::GpuView;
use ffgs_core::{Gaussians, PlanarImage};
use ffgs_gpu::{Buffer, Gpu, GpuError};
use ffgs_rasterizer::{Gradients, PixelGradients, RenderOptions, View};
use glam::{DMat3, DVec3};

/// Views in one submission: enough to keep a device busy, few enough that no driver takes it for stuck.
pub const VIEWS_PER_SUBMISSION: usize = 8;

/// Renders on the device and brings the results to the host: for single stages, pictures and tests. Training keeps
/// everything on the device and calls [`crate::render`] and [`crate::backward`] itself.
pub struct GpuRasterizer<'a> {
    pub(crate) gpu: &'a Gpu,
    options: RenderOptions,
    pub(crate) scratch: Scratch,
}

/// A rendered view.
#[derive(Clone, Debug, PartialEq)]
pub struct Rendered {
    /// The image, background included, not clamped.
    pub image: PlanarImage,
    /// What the Gaussians let through, row-major.
    pub transmittance: Vec<f32>,
}

impl<'a> GpuRasterizer<'a> {
    /// A rasterizer with these options.
    ///
    /// # Errors
    /// When the device fails or has too little memory.
    pub fn new(gpu: &'a Gpu, options: RenderOptions) -> Result<Self, GpuError> {
        Ok(Self { gpu, options, scratch: Scratch::new(gpu, Capacity::guess(1024, 1024))? })
    }

    /// Renders `gaussians`.
    ///
    /// # Errors
    /// When the device fails or has too little memory.
    pub fn render(&mut self, gaussians: &Gaussians, view: &View) -> Result<Rendered, GpuError> {
        let scene = GpuScene::upload(self.gpu, gaussians)?;
        let view = GpuView::new(self.gpu, view.camera, view.background, view.tiles)?;
        self.render_uploaded(&scene, &view)
    }

    /// Renders a scene from several views, up to eight in a submission.
    ///
    /// # Errors
    /// When the device fails or has too little memory.
    pub fn render_views(&mut self, scene: &GpuScene, views: &[View]) -> Result<Vec<Rendered>, GpuError> {
        let mut out = Vec::with_capacity(views.len());
        for group in views.chunks(VIEWS_PER_SUBMISSION) {
            out.extend(self.render_group(scene, group)?);
        }
        Ok(out)
    }

    fn render_group(&mut self, scene: &GpuScene, views: &[View]) -> Result<Vec<Rendered>, GpuError> {
        let gpu = self.gpu;
        let on_device = |v: &View| GpuView::new(gpu, v.camera, v.background, v.tiles);
        let views: Vec<GpuView> = views.iter().map(on_device).collect::<Result<_, _>>()?;
        let pixels = views.iter().map(|v| v.size().pixels()).max().unwrap_or(0);
        self.scratch.ensure(gpu, Capacity { gaussians: scene.count, pixels, ..Capacity::default() })?;
        let image = |v: &GpuView| gpu.buffer("image of a view", 16 * v.size().pixels() as u64);
        let images: Vec<Buffer> = views.iter().map(image).collect::<Result<_, _>>()?;
        loop {
            self.scratch.restart(gpu, scene.count);
            let mut commands = gpu.commands();
            for (view, image) in views.iter().zip(&images) {
                encode::prepare(gpu, scene, view, &self.scratch, self.options, 1);
                encode::render(&mut commands, scene, view, &self.scratch);
                commands.copy(&self.scratch.pixels, image, 16 * view.size().pixels() as u64);
            }
            gpu.submit(commands)?;
            // The largest need of all views.
            let needed = self.scratch.needed(gpu)?;
            if self.scratch.holds(needed) {
                break;
            }
            self.scratch.ensure(gpu, needed)?;
        }
        let rendered = |(view, image): (&GpuView, &Buffer)| {
            let (image, transmittance) = view.unpack(&gpu.download(image, view.size().pixels())?);
            Ok(Rendered { image, transmittance })
        };
        views.iter().zip(&images).map(rendered).collect()
    }

    /// Renders a scene that is on the device, again with more memory if that was too little.
    ///
    /// # Errors
    /// When the device fails or has too little memory.
    pub(crate) fn render_uploaded(&mut self, scene: &GpuScene, view: &GpuView) -> Result<Rendered, GpuError> {
        self.render_on_device(scene, view)?;
        let pixels = self.gpu.download(&self.scratch.pixels, view.size().pixels())?;
        let (image, transmittance) = view.unpack(&pixels);
        Ok(Rendered { image, transmittance })
    }

    /// The same without a look at the image.
    pub(crate) fn render_on_device(&mut self, scene: &GpuScene, view: &GpuView) -> Result<(), GpuError> {
        let (gpu, pixels) = (self.gpu, view.size().pixels());
        self.scratch.ensure(gpu, Capacity { gaussians: scene.count, pixels, ..Capacity::default() })?;
        loop {
            encode::prepare(gpu, scene, view, &self.scratch, self.options, 1);
            self.scratch.restart(gpu, scene.count);
            let mut commands = gpu.commands();
            encode::render(&mut commands, scene, view, &self.scratch);
            gpu.submit(commands)?;
            let needed = self.scratch.needed(gpu)?;
            if self.scratch.holds(needed) {
                return Ok(());
            }
            self.scratch.ensure(gpu, needed)?;
        }
    }

    /// Renders and differentiates; derivatives as [`ffgs_rasterizer::CpuRasterizer::backward`] gives them,
    /// but overwriting `out`.
    ///
    /// # Errors
    /// When the device fails or has too little memory.
    pub fn render_and_differentiate(
        &mut self,
        gaussians: &Gaussians,
        view: &View,
        upstream: &PixelGradients,
        out: &mut Gradients,
    ) -> Result<Rendered, GpuError> {
        let gpu = self.gpu;
        let scene = GpuScene::upload(gpu, gaussians)?;
        let mut on_device = GpuView::new(gpu, view.camera, view.background, view.tiles)?;
        on_device.constants.with_pose = 1;
        let rendered = self.render_uploaded(&scene, &on_device)?;
        let gradients = GpuGradients::new(gpu, &scene, true)?;
        gpu.write(&self.scratch.upstream, &interleaved(upstream));
        let mut commands = gpu.commands();
        encode::backward(&mut commands, &scene, &on_device, &self.scratch, &gradients);
        gpu.submit(commands)?;
        collect(gpu, &gradients, out)?;
        out.background = background_gradient(&rendered, view, upstream);
        Ok(rendered)
    }
}

fn interleaved(upstream: &PixelGradients) -> Vec<[f32; 4]> {
    let pixel = |p: usize| {
        let [r, g, b] = upstream.image.pixel(p);
        [r, g, b, upstream.transmittance.map_or(0.0, |t| t[p])]
    };
    (0..upstream.image.size().pixels()).map(pixel).collect()
}

fn collect(gpu: &Gpu, gradients: &GpuGradients, out: &mut Gradients) -> Result<(), GpuError> {
    out.gaussians = gradients.scene.download(gpu)?;
    let ledger: Vec<Ledger> = gpu.download(&gradients.ledger, gradients.scene.count)?;
    out.touched = ledger.iter().map(|l| l.stamp != 0).collect();
    out.mean2d_norm = ledger.iter().map(|l| l.gradient_norm).collect();
    out.views_seen = ledger.iter().map(|l| l.views).collect();
    let poses: Vec<[f32; 12]> = gpu.download(&gradients.pose, gradients.scene.count)?;
    (out.camera_rotation, out.camera_translation) = (DMat3::ZERO, DVec3::ZERO);
    for pose in poses.iter().map(|p| p.map(f64::from)) {
        out.camera_rotation += DMat3::from_cols_slice(&pose[..9]).transpose();
        out.camera_translation += DVec3::new(pose[9], pose[10], pose[11]);
    }
    Ok(())
}

/// By a constant background colour; zero for an image.
fn background_gradient(rendered: &Rendered, view: &View, upstream: &PixelGradients) -> [f64; 3] {
    let ffgs_rasterizer::Background::Colour(_) = view.background else { return [0.0; 3] };
    let columns = view.camera.size().width.div_ceil(ffgs_rasterizer::TILE);
    let width = view.camera.size().width;
    let computed = |pixel: usize| {
        let tile = pixel / width / ffgs_rasterizer::TILE * columns + pixel % width / ffgs_rasterizer::TILE;
        view.tiles.is_none_or(|m| m.is_active(tile))
    };
    [0, 1, 2].map(|c| {
        let terms = upstream.image.plane(c).iter().zip(&rendered.transmittance).enumerate();
        terms.filter(|(p, _)| computed(*p)).map(|(_, (g, t))| f64::from(*g) * f64::from(*t)).sum()
    })
}
