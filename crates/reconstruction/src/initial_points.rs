//! Where the first frame's training starts.

use crate::config::ReconstructionConfig;
use anyhow::{Context, Result};
use ffgs_core::{ImageSize, PixelFilter, SkyCube, TrainingView, spatial_order};
use ffgs_method::Capture;
use ffgs_trainer::{FirstFrame, INITIAL_OPACITY, from_points};

/// Gaussians at the capture's points, with colours of a degree, before a sky of one colour.
pub(crate) fn start(
    capture: &dyn Capture,
    config: &ReconstructionConfig,
    degree: usize,
    views: &[TrainingView],
) -> Result<FirstFrame> {
    let (points, repeated) = capture.points()?.context("the capture has no initial points")?.distinct();
    if repeated > 0 {
        tracing::warn!("{repeated} initial points lie exactly where others lie and are left out");
    }
    let gaussians = from_points(&points.positions, &points.colours, degree, INITIAL_OPACITY);
    let chosen = gaussians.select(&thinned(spatial_order(&gaussians.means), config.first_frame.max_points));
    let filter = if config.first_frame.antialiased { PixelFilter::Compensated } else { PixelFilter::Plain };
    let gaussians = chosen.with_filter(filter);
    Ok(FirstFrame { gaussians, sky: SkyCube::filled(config.sky_face_size, mean_colour(views)) })
}

/// At most `limit` of the items, evenly over their order; all for a limit of 0.
fn thinned(items: Vec<usize>, limit: usize) -> Vec<usize> {
    let count = items.len();
    if limit == 0 || count <= limit {
        return items;
    }
    tracing::info!("training starts from {limit} of {count} initial points (first_frame.max_points)");
    (0..limit).map(|i| items[i * count / limit]).collect()
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_are_thinned_evenly_and_to_the_limit() {
        let all: Vec<usize> = (0..10).rev().collect();
        assert_eq!(thinned(all.clone(), 0), all);
        assert_eq!(thinned(all.clone(), 10), all);
        assert_eq!(thinned(all.clone(), 4), [9, 7, 4, 2]);
        assert_eq!(thinned(all, 1), [9]);
        assert_eq!(thinned(Vec::new(), 3), Vec::<usize>::new());
    }
}
