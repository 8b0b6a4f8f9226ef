//! Renders the test views of a frame and measures them.

use crate::job::frame::{load_views, test_views};
use crate::job::provenance::Checksum;
use crate::outputs::record::ViewMetrics;
use anyhow::{Context, Result};
use ffgs_core::{Camera, Exposure, ImageRgb8, PlanarImage, Scene, TrainingView, write_atomically};
use ffgs_method::{Capture, Split, ViewAt};
use ffgs_metrics::{SsimMap, mpsnr, psnr};
use ffgs_reconstruction::{Devices, Exposures, unveiled};
use ffgs_report::Thumbnails;
use rayon::prelude::*;
use std::path::Path;

/// Depth-sorted renders of all layers over the sky, without what veils them: `trained` are the cameras of the training views.
pub(crate) fn render(
    scene: &Scene,
    cameras: &[Camera],
    trained: &[Camera],
    devices: Devices,
) -> Result<Vec<PlanarImage>> {
    let mut pictures = devices.render(scene, cameras)?;
    for (picture, camera) in pictures.iter_mut().zip(cameras) {
        if let Some(scene) = unveiled(scene, camera, trained) {
            *picture = devices.render(&scene, &[*camera])?.swap_remove(0);
        }
    }
    Ok(pictures)
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

/// A test view as it was photographed, and the exposure in which it is to be rendered.
pub(crate) struct TestView {
    pub truth: TrainingView,
    pub exposure: Exposure,
}

/// The test views of a frame, and the checksums of what they were read from.
pub(crate) fn load_tests(
    capture: &dyn Capture,
    exposures: &Exposures,
    frame: usize,
) -> Result<(Vec<TestView>, Vec<Checksum>)> {
    let shots = test_views(capture, frame);
    let (truths, sums) = load_views(capture, &shots)?;
    let with_exposure = |(truth, &at): (TrainingView, &ViewAt)| {
        exposures.of(capture, at).map(|exposure| TestView { truth, exposure })
    };
    Ok((truths.into_iter().zip(&shots).map(with_exposure).collect::<Result<_>>()?, sums))
}

/// The test views as their cameras would show the scene.
fn render_tests(
    scene: &Scene,
    tests: &[&TestView],
    trained: &[Camera],
    devices: Devices,
) -> Result<Vec<PlanarImage>> {
    let cameras: Vec<Camera> = tests.iter().map(|test| test.truth.camera).collect();
    let mut rendered = render(scene, &cameras, trained, devices)?;
    rendered.iter_mut().zip(tests).for_each(|(image, test)| test.exposure.apply(image));
    Ok(rendered)
}

/// Mean foreground PSNR (dB) over the test views, without pictures; `None` where nothing is in the foreground.
pub(crate) fn mean_mpsnr(
    scene: &Scene,
    tests: &[TestView],
    trained: &[Camera],
    devices: Devices,
) -> Result<Option<f64>> {
    let tests: Vec<&TestView> = tests.iter().filter(|test| test.truth.mask.count() > 0).collect();
    let mut values = Vec::new();
    let rendered = render_tests(scene, &tests, trained, devices)?;
    for (TestView { truth, .. }, rendered) in tests.iter().zip(rendered) {
        values.extend(mpsnr(&rendered, &truth.image, &truth.mask)?);
    }
    Ok((!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64))
}

/// Renders the test views into `folder/test/CAMERA.png` and measures them; `trained` are the cameras of the training views. Returns the metrics and, for the
/// report, ground truth, render and error of each view.
pub(crate) fn score(
    capture: &dyn Capture,
    scene: &Scene,
    (tests, trained): (&[TestView], &[Camera]),
    folder: &Path,
    devices: Devices,
) -> Result<(Vec<ViewMetrics>, Vec<[String; 3]>)> {
    let rendered = render_tests(scene, &tests.iter().collect::<Vec<_>>(), trained, devices)?;
    let thumbnails = thumbnails(capture);
    let score = |(v, (TestView { truth, .. }, rendered)): (usize, (&TestView, PlanarImage))| {
        let name = &capture.views(Split::Test)[v];
        let picture = ImageRgb8::from(&rendered);
        write_png(&folder.join(format!("test/{name}.png")), &picture)?;
        let ssim = SsimMap::new(&rendered, &truth.image)?;
        let metrics = ViewMetrics {
            camera: name.clone(),
            fixed: is_fixed(capture, v),
            psnr: psnr(&rendered, &truth.image)?,
            mpsnr: mpsnr(&rendered, &truth.image, &truth.mask)?,
            ssim: ssim.mean(),
            mssim: ssim.mean_inside(&truth.mask)?,
            ..ViewMetrics::default()
        };
        let pictures = thumbnails.view(&truth.image, &picture)?.context("a render has its camera's size")?;
        Ok((metrics, pictures))
    };
    let views: Vec<_> = tests.iter().zip(rendered).enumerate().collect();
    Ok(views.into_par_iter().map(score).collect::<Result<Vec<_>>>()?.into_iter().unzip())
}

/// Sized for a run over the whole capture, whichever frames were asked for: resuming with more of them keeps the size.
pub(crate) fn thumbnails(capture: &dyn Capture) -> Thumbnails {
    Thumbnails::for_run(capture.frames(), capture.views(Split::Test).len())
}
