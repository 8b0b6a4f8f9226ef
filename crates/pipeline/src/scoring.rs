//! Renders the test views of a frame and measures them.

use crate::lanes::Lanes;
use crate::record::ViewMetrics;
use anyhow::{Context, Result};
use ffgs_core::{Camera, ImageRgb8, PlanarImage, Scene, TrainingView, write_atomically};
use ffgs_dataset::{Capture, Split};
use ffgs_metrics::{image_ssim, mpsnr, psnr};
use std::path::Path;

/// Depth-sorted renders of all layers over the sky.
pub(crate) fn render(scene: &Scene, cameras: &[Camera], lanes: Lanes) -> Result<Vec<PlanarImage>> {
    lanes.render(&scene.joint(), &scene.sky, cameras)
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

/// The test views of a frame.
fn load_tests(capture: &Capture, frame: usize) -> Result<Vec<TrainingView>> {
    let load = |v: usize| crate::frame::load_view(capture, Split::Test, v, frame);
    (0..capture.views(Split::Test).len()).map(load).collect()
}

/// Mean foreground PSNR (dB) over the test views of `frame`, without pictures; `None` where nothing is in the foreground.
pub(crate) fn mean_mpsnr(
    capture: &Capture,
    scene: &Scene,
    frame: usize,
    lanes: Lanes,
) -> Result<Option<f64>> {
    let mut truths = load_tests(capture, frame)?;
    truths.retain(|truth| truth.mask.count() > 0);
    let cameras: Vec<Camera> = truths.iter().map(|truth| truth.camera).collect();
    let mut values = Vec::new();
    for (truth, rendered) in truths.iter().zip(render(scene, &cameras, lanes)?) {
        values.extend(mpsnr(&rendered, &truth.image, &truth.mask)?);
    }
    Ok((!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64))
}

/// Renders every test view of `frame` into `folder/test/CAMERA.png` and measures it.
pub(crate) fn score(
    capture: &Capture,
    scene: &Scene,
    frame: usize,
    folder: &Path,
    lanes: Lanes,
) -> Result<Vec<ViewMetrics>> {
    let views = capture.views(Split::Test);
    let truths = load_tests(capture, frame)?;
    let cameras: Vec<Camera> = truths.iter().map(|truth| truth.camera).collect();
    let pictures = render(scene, &cameras, lanes)?;
    let mut all = Vec::new();
    for (v, ((view, truth), rendered)) in views.iter().zip(&truths).zip(pictures).enumerate() {
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
