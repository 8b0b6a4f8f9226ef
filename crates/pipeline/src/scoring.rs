//! Renders the test views of a frame and measures them.

use crate::motion::{Dynamic, UNSIZED};
use crate::record::ViewMetrics;
use anyhow::{Context, Result};
use ffgs_core::{Camera, Gaussians, ImageRgb8, PlanarImage, write_atomically};
use ffgs_dataset::{Capture, Split};
use ffgs_metrics::{image_ssim, mpsnr, psnr};
use ffgs_rasterizer::{Background, CpuRasterizer, Rasterizer, RenderOptions, RenderTape, View};
use ffgs_trainer::{SkyCube, SkyView};
use std::path::Path;

/// The three layers of one frame.
#[derive(Clone, Debug)]
pub struct Layers {
    /// Modelled once; only its colour changes.
    pub static_layer: Gaussians,
    /// Moves every frame.
    pub dynamic: Dynamic,
    /// At infinity.
    pub sky: SkyCube,
}

/// One depth-sorted render of all layers over the sky.
pub fn render(layers: &Layers, camera: &Camera) -> PlanarImage {
    let mut joint = layers.static_layer.clone();
    joint.extend(&layers.dynamic.gaussians);
    render_joint(&joint, &layers.sky, camera, &mut RenderTape::default())
}

fn render_joint(joint: &Gaussians, sky: &SkyCube, camera: &Camera, tape: &mut RenderTape) -> PlanarImage {
    let mut background = PlanarImage::zeros(UNSIZED);
    background.reset(camera.size());
    sky.render(&SkyView::new(camera, sky.face_size()), &mut background);
    let view = View { camera, background: Background::Image(&background), tiles: None };
    CpuRasterizer::new(RenderOptions { antialiased: true, sh_degree: None }).render(joint, &view, tape);
    tape.image().clone()
}

/// Writes a PNG through a temporary file.
pub fn write_png(path: &Path, picture: &ImageRgb8) -> Result<()> {
    let size = picture.size();
    write_atomically(path, |out| {
        let encoder = image::codecs::png::PngEncoder::new(out);
        let (width, height) = (size.width as u32, size.height as u32);
        image::ImageEncoder::write_image(
            encoder,
            picture.data(),
            width,
            height,
            image::ExtendedColorType::Rgb8,
        )
        .map_err(anyhow::Error::from)
    })
    .with_context(|| format!("cannot write {}", path.display()))
}

/// Whether a test camera keeps its pose over the capture.
fn is_fixed(capture: &Capture, view: usize) -> bool {
    let first = capture.camera(Split::Test, view, 0).ok();
    (1..capture.frames_of(Split::Test)).all(|t| capture.camera(Split::Test, view, t).ok() == first)
}

/// Renders every test view of `frame` into `folder/test/CAMERA.png` and measures it.
pub fn score(capture: &Capture, layers: &Layers, frame: usize, folder: &Path) -> Result<Vec<ViewMetrics>> {
    let mut joint = layers.static_layer.clone();
    joint.extend(&layers.dynamic.gaussians);
    let mut tape = RenderTape::default();
    let mut all = Vec::new();
    for (v, view) in capture.views(Split::Test).iter().enumerate() {
        let truth = crate::frame::load_view(capture, Split::Test, v, frame)?;
        let rendered = render_joint(&joint, &layers.sky, &truth.camera, &mut tape);
        write_png(&folder.join(format!("test/{}.png", view.name)), &ImageRgb8::from(&rendered))?;
        all.push(ViewMetrics {
            camera: view.name.clone(),
            fixed: is_fixed(capture, v),
            psnr: psnr(&rendered, &truth.image)?,
            mpsnr: mpsnr(&rendered, &truth.image, &truth.mask)?,
            ssim: image_ssim(&rendered, &truth.image)?,
        });
    }
    Ok(all)
}
