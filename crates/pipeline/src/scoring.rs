//! Renders the test views of a frame and measures them.

use crate::devices::Devices;
use crate::frame::{load_views, test_views};
use crate::record::ViewMetrics;
use anyhow::{Context, Result};
use ffgs_core::{Camera, ImageRgb8, PlanarImage, Scene, TrainingView, write_atomically};
use ffgs_method::{Capture, Split, ViewAt};
use ffgs_metrics::{image_ssim, mpsnr, psnr};
use ffgs_report::Thumbnails;
use rayon::prelude::*;
use std::path::Path;

/// Depth-sorted renders of all layers over the sky.
pub(crate) fn render(scene: &Scene, cameras: &[Camera], devices: Devices) -> Result<Vec<PlanarImage>> {
    devices.render(scene, cameras)
}

/// Writes a PNG through a temporary file.
///
/// # Errors
/// When the file cannot be written.
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
fn is_fixed(capture: &dyn Capture, view: usize) -> bool {
    let camera = |frame| capture.camera(ViewAt { split: Split::Test, view, frame }).ok();
    (1..capture.frames_of(Split::Test)).all(|frame| camera(frame) == camera(0))
}

/// The test views of a frame.
pub(crate) fn load_tests(capture: &dyn Capture, frame: usize) -> Result<Vec<TrainingView>> {
    load_views(capture, &test_views(capture, frame)).map(|(views, _)| views)
}

/// Mean foreground PSNR (dB) over the test views `truths`, without pictures; `None` where nothing is in the foreground.
pub(crate) fn mean_mpsnr(scene: &Scene, truths: &[TrainingView], devices: Devices) -> Result<Option<f64>> {
    let truths: Vec<&TrainingView> = truths.iter().filter(|truth| truth.mask.count() > 0).collect();
    let cameras: Vec<Camera> = truths.iter().map(|truth| truth.camera).collect();
    let mut values = Vec::new();
    for (truth, rendered) in truths.iter().zip(render(scene, &cameras, devices)?) {
        values.extend(mpsnr(&rendered, &truth.image, &truth.mask)?);
    }
    Ok((!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64))
}

/// Renders the test views `truths` into `folder/test/CAMERA.png` and measures them. Returns the metrics and, for the
/// report, ground truth, render and error of each view.
pub(crate) fn score(
    capture: &dyn Capture,
    scene: &Scene,
    truths: &[TrainingView],
    folder: &Path,
    devices: Devices,
) -> Result<(Vec<ViewMetrics>, Vec<[String; 3]>)> {
    let cameras: Vec<Camera> = truths.iter().map(|truth| truth.camera).collect();
    let rendered = render(scene, &cameras, devices)?;
    let thumbnails = thumbnails(capture);
    let score = |(v, (truth, rendered)): (usize, (&TrainingView, PlanarImage))| {
        let name = &capture.views(Split::Test)[v];
        let picture = ImageRgb8::from(&rendered);
        write_png(&folder.join(format!("test/{name}.png")), &picture)?;
        let metrics = ViewMetrics {
            camera: name.clone(),
            fixed: is_fixed(capture, v),
            psnr: psnr(&rendered, &truth.image)?,
            mpsnr: mpsnr(&rendered, &truth.image, &truth.mask)?,
            ssim: image_ssim(&rendered, &truth.image)?,
            vmaf: None,
            flicker: None,
        };
        let pictures = thumbnails.view(&truth.image, &picture)?.context("a render has its camera's size")?;
        Ok((metrics, pictures))
    };
    let views: Vec<_> = truths.iter().zip(rendered).enumerate().collect();
    Ok(views.into_par_iter().map(score).collect::<Result<Vec<_>>>()?.into_iter().unzip())
}

/// Sized for a run over the whole capture, whichever frames were asked for: resuming with more of them keeps the size.
pub(crate) fn thumbnails(capture: &dyn Capture) -> Thumbnails {
    Thumbnails::for_run(capture.frames(), capture.views(Split::Test).len())
}
