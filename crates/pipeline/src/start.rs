//! Where the first frame's training starts.

use crate::config::Config;
use anyhow::{Context, Result};
use ffgs_core::{ImageSize, SkyCube, TrainingView, spatial_order};
use ffgs_method::Capture;
use ffgs_trainer::{FirstFrame, INITIAL_OPACITY, from_points};

/// Gaussians at the capture's points, with colours of a degree, before a sky of one colour.
///
/// # Errors
/// When the capture has no initial points or they cannot be read.
pub fn start(
    capture: &dyn Capture,
    config: &Config,
    degree: usize,
    views: &[TrainingView],
) -> Result<FirstFrame> {
    let (points, repeated) = capture.points()?.context("the capture has no initial points")?.distinct();
    if repeated > 0 {
        tracing::warn!("{repeated} initial points lie exactly where others lie and are left out");
    }
    let gaussians = from_points(&points.positions, &points.colours, degree, INITIAL_OPACITY);
    let gaussians = gaussians.select(&spatial_order(&gaussians.means));
    Ok(FirstFrame { gaussians, sky: SkyCube::filled(config.sky_face_size, mean_colour(views)) })
}

/// Mean colour of the top rows, where outdoor views show the sky.
fn mean_colour(views: &[TrainingView]) -> [f32; 3] {
    let mut sum = [0.0_f64; 3];
    let mut count = 0.0;
    for view in views {
        let ImageSize { width, height } = view.image.size();
        for pixel in 0..width * (height / 8).max(1) {
            let rgb = view.image.pixel(pixel);
            (0..3).for_each(|c| sum[c] += f64::from(rgb[c]));
            count += 1.0;
        }
    }
    sum.map(|s| (s / f64::max(count, 1.0)) as f32)
}
