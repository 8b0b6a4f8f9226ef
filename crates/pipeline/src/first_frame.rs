//! What surrounds the training of frame 0: the views that it sees, and the layers that it is split into.

use crate::frame::{cameras_and_masks, init_views, load_views, training_views};
use anyhow::Result;
use ffgs_core::{Dynamic, Gaussians, Scene, SkyCube, TrainingView, spatial_order};
use ffgs_fusion::{Silhouettes, initial_covariance};
use ffgs_method::Capture;
use ffgs_motion::{MarkingConfig, pixel_sizes};
use ffgs_trainer::shows_sky;
use std::sync::Arc;

/// The training views `views` (by index) of a frame, and after them those that only frame 0 has.
///
/// # Errors
/// When one of them cannot be read.
pub fn all_views(capture: &dyn Capture, views: &[usize], frame: usize) -> Result<Vec<TrainingView>> {
    load_views(capture, &[training_views(views, frame), init_views(capture, frame)].concat())
        .map(|(views, _)| views)
}

/// The trained Gaussians as layers: those inside the masks of all that was trained on (`training`) move. `views` are those that later
/// frames have: they say how large a pixel is where a Gaussian lies.
///
/// # Errors
/// When the masks do not fit their cameras.
pub fn split(
    marking: &MarkingConfig,
    all: &Gaussians,
    sky: SkyCube,
    views: &[TrainingView],
    training: &[TrainingView],
) -> Result<Scene> {
    let (cameras, masks) = cameras_and_masks(training);
    let silhouettes = Silhouettes::new(&cameras, &masks, marking.dilation, marking.slack())?;
    let moving = silhouettes.hold(&all.positions())?;
    // Training left what it added at the end; all later frames keep this order.
    let order = spatial_order(&all.means);
    let indices = |keep: bool| order.iter().copied().filter(|&i| moving[i] == keep).collect::<Vec<_>>();
    let gaussians = all.select(&indices(true));
    if gaussians.is_empty() {
        tracing::warn!("no Gaussian lies inside the masks: nothing is dynamic");
    }
    let pixel_m = pixel_sizes(&gaussians.positions(), views.iter().map(|view| &view.camera));
    let smallest = |s: &[f32; 3]| f64::from(s.iter().copied().fold(f32::INFINITY, f32::min).exp());
    let axes = gaussians.log_scales.iter().map(smallest);
    let covariances = axes.zip(pixel_m).map(|(axis, pixel)| initial_covariance(axis, pixel)).collect();
    let growth_limit = gaussians.len();
    let mut dynamic = Dynamic { gaussians, covariances, growth_limit, ..Dynamic::default() };
    dynamic.number_new();
    let static_layer = Arc::new(all.select(&indices(false)));
    Ok(Scene { static_layer, hidden: Vec::new(), static_colours: Vec::new(), dynamic, sky })
}

/// The sky, or one colour where no view shows any. Indoors no sky is seen; what frame 0 made of it would show as soon as something
/// before it moves.
pub fn sky_or_none(sky: SkyCube, layer: &Gaussians, views: &[TrainingView]) -> SkyCube {
    if shows_sky(layer, views) {
        return sky;
    }
    tracing::info!(
        "the views see no sky (indoors?): one colour stands behind everything, and the sky lane rests"
    );
    SkyCube::none(sky.mean())
}
