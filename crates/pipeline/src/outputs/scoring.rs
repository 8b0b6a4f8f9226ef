//! Renders the views of a frame that measure it, and measures them: the test views, or training views where a capture has none.

use crate::job::frame::{load_views, test_views, training_views};
use crate::job::provenance::Checksum;
use crate::outputs::record::ViewMetrics;
use anyhow::{Context, Result};
use ffgs_core::{Camera, Exposure, ImageRgb8, PlanarImage, Scene, TrainingView};
use ffgs_dataset::write_image;
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

/// A view as it was photographed, and the exposure in which it is to be rendered.
pub(crate) struct ScoredView {
    at: ViewAt,
    pub truth: TrainingView,
    pub exposure: Exposure,
}

/// Training views that measure a frame where a capture has no test views, at most: a rig that spares no camera has few, and more
/// would say the same at the cost of a picture each.
const MOST_TRAINING_VIEWS: usize = 8;

/// Of the training views `views` (by index) those that measure a frame, evenly chosen; none where the capture has test views.
fn measuring_training_views(capture: &dyn Capture, views: &[usize], frame: usize) -> Vec<ViewAt> {
    if !capture.views(Split::Test).is_empty() {
        return Vec::new();
    }
    training_views(&evenly(views, MOST_TRAINING_VIEWS), frame)
}

/// `most` of the values at most, evenly chosen.
fn evenly(values: &[usize], most: usize) -> Vec<usize> {
    let count = values.len().min(most);
    (0..count).map(|i| values[i * values.len() / count]).collect()
}

/// Views that measure a frame of this capture, at most.
fn scored_views(capture: &dyn Capture) -> usize {
    match capture.views(Split::Test).len() {
        0 => capture.views(Split::Train).len().min(MOST_TRAINING_VIEWS),
        tests => tests,
    }
}

/// The test views of a frame, and the checksums of what they were read from.
pub(crate) fn load_tests(
    capture: &dyn Capture,
    exposures: &Exposures,
    frame: usize,
) -> Result<(Vec<ScoredView>, Vec<Checksum>)> {
    load_scored(capture, exposures, &test_views(capture, frame))
}

/// The views `views` (by index) that a frame was trained on and that measure it where the capture has no test views, as they were
/// photographed.
pub(crate) fn load_trained_on(
    capture: &dyn Capture,
    exposures: &Exposures,
    views: &[usize],
    frame: usize,
) -> Result<Vec<ScoredView>> {
    let shots = measuring_training_views(capture, views, frame);
    load_scored(capture, exposures, &shots).map(|(views, _)| views)
}

fn load_scored(
    capture: &dyn Capture,
    exposures: &Exposures,
    shots: &[ViewAt],
) -> Result<(Vec<ScoredView>, Vec<Checksum>)> {
    let (truths, sums) = load_views(capture, shots)?;
    let with_exposure = |(truth, &at): (TrainingView, &ViewAt)| {
        exposures.of(capture, at).map(|exposure| ScoredView { at, truth, exposure })
    };
    Ok((truths.into_iter().zip(shots).map(with_exposure).collect::<Result<_>>()?, sums))
}

/// The views as their cameras would show the scene.
fn render_views(
    scene: &Scene,
    views: &[&ScoredView],
    trained: &[Camera],
    devices: Devices,
) -> Result<Vec<PlanarImage>> {
    let cameras: Vec<Camera> = views.iter().map(|view| view.truth.camera).collect();
    let mut rendered = render(scene, &cameras, trained, devices)?;
    rendered.iter_mut().zip(views).for_each(|(image, view)| view.exposure.apply(image));
    Ok(rendered)
}

/// Mean foreground PSNR (dB) over the test views, without pictures; `None` where nothing is in the foreground.
pub(crate) fn mean_mpsnr(
    scene: &Scene,
    tests: &[ScoredView],
    trained: &[Camera],
    devices: Devices,
) -> Result<Option<f64>> {
    let tests: Vec<&ScoredView> = tests.iter().filter(|test| test.truth.mask.count() > 0).collect();
    let mut values = Vec::new();
    let rendered = render_views(scene, &tests, trained, devices)?;
    for (ScoredView { truth, .. }, rendered) in tests.iter().zip(rendered) {
        values.extend(mpsnr(&rendered, &truth.image, &truth.mask)?);
    }
    Ok((!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64))
}

/// Renders views and measures them; `trained` are the cameras of the training views. Returns the metrics and, for the report, ground truth,
/// render and error of each view. Test views are written as `folder/test/CAMERA.png`.
pub(crate) fn score(
    capture: &dyn Capture,
    scene: &Scene,
    (views, trained): (&[ScoredView], &[Camera]),
    folder: &Path,
    devices: Devices,
) -> Result<(Vec<ViewMetrics>, Vec<[String; 3]>)> {
    let rendered = render_views(scene, &views.iter().collect::<Vec<_>>(), trained, devices)?;
    let thumbnails = thumbnails(capture);
    let score = |(ScoredView { at, truth, .. }, rendered): (&ScoredView, PlanarImage)| {
        let name = &capture.views(at.split)[at.view];
        let picture = ImageRgb8::from(&rendered);
        if at.split == Split::Test {
            write_image(&folder.join(format!("test/{name}.png")), &picture)?;
        }
        let ssim = SsimMap::new(&rendered, &truth.image)?;
        let metrics = ViewMetrics {
            camera: name.clone(),
            fixed: capture.is_fixed(at.split, at.view).unwrap_or(false),
            psnr: psnr(&rendered, &truth.image)?,
            mpsnr: mpsnr(&rendered, &truth.image, &truth.mask)?,
            ssim: ssim.mean(),
            mssim: ssim.mean_inside(&truth.mask)?,
            ..ViewMetrics::default()
        };
        let pictures = thumbnails.view(&truth.image, &picture)?.context("a render has its camera's size")?;
        Ok((metrics, pictures))
    };
    let views: Vec<_> = views.iter().zip(rendered).collect();
    Ok(views.into_par_iter().map(score).collect::<Result<Vec<_>>>()?.into_iter().unzip())
}

/// Sized for a run over the whole capture, whichever frames were asked for: resuming with more of them keeps the size.
pub(crate) fn thumbnails(capture: &dyn Capture) -> Thumbnails {
    Thumbnails::for_run(capture.frames(), scored_views(capture))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn few_views_are_all_taken_and_many_evenly() {
        assert_eq!(evenly(&[3, 5, 9], 8), [3, 5, 9]);
        assert_eq!(evenly(&(0..20).collect::<Vec<_>>(), 8), [0, 2, 5, 7, 10, 12, 15, 17]);
        assert!(evenly(&[], 8).is_empty());
    }
}
