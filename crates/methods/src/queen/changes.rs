//! Changes in the photographs since the last frame, gathered by the Gaussians of that frame.

use super::QueenConfig;
use crate::photographs::Comparison;
use ffgs_core::{Camera, Gaussians, ImageRgb8, ImageSize, Mask, PlanarImage, SkyCube, TrainingView};
use ffgs_method::Step;
use ffgs_rasterizer::{Background, CpuRasterizer, Gradients, RenderTape, View};
use ffgs_trainer::SkyView;

/// Per Gaussian, the sum over the views of the norm by which its projected place would move otherwise for the photographs at t than for
/// those at t-1 (normalised device coordinates), the loss being the mean distance of the colours.
pub(super) fn changes(step: &Step, gaussians: &Gaussians, sky: &SkyCube) -> Vec<f32> {
    let mut sum = vec![0.0; gaussians.len()];
    let (mut comparison, mut gradients) = (Comparison::new(), Gradients::default());
    for (before, now) in step.before.iter().zip(step.now) {
        let size = now.camera.size();
        let mut behind = PlanarImage::zeros(size);
        SkyView::new(&now.camera, sky.face_size()).render(sky, &mut behind);
        let background = Background::Image(&behind);
        let pull = |image: &PlanarImage, by: &mut PlanarImage| pulls(image, [&before.image, &now.image], by);
        comparison.forward_by(gaussians, &now.camera, background, pull);
        comparison.backward(gaussians, &now.camera, background, &mut gradients);
        let touched = gradients.mean2d_norm.iter().zip(&gradients.touched);
        sum.iter_mut().zip(touched).for_each(|(sum, (norm, touched))| {
            if *touched && norm.is_finite() {
                *sum += norm;
            }
        });
    }
    sum
}

/// Derivative of `mean |image - now| - mean |image - before|` by the pixels, norms over the colours; 0 at the tip of a norm.
fn pulls(image: &PlanarImage, [before, now]: [&ImageRgb8; 2], by: &mut PlanarImage) {
    by.reset(image.size());
    let share = 1.0 / image.size().pixels() as f32;
    for i in 0..image.size().pixels() {
        let rendered = image.pixel(i);
        let away = |from: [f32; 3]| {
            let far = [0, 1, 2].map(|c| rendered[c] - from[c]);
            let norm = far.iter().map(|far| far * far).sum::<f32>().sqrt();
            far.map(|far| if norm > 0.0 { far / norm } else { 0.0 })
        };
        if before.size() == now.size() {
            let (from_now, from_before) = (away(now.pixel(i)), away(before.pixel(i)));
            by.set_pixel(i, [0, 1, 2].map(|c| share * (from_now[c] - from_before[c])));
        }
    }
}

/// The pixels of each view in cells where Gaussians of much change are opaque.
pub(super) fn masks(
    views: &[TrainingView],
    gaussians: &Gaussians,
    changes: &[f32],
    config: &QueenConfig,
) -> Vec<Mask> {
    let chosen: Vec<usize> = (0..changes.len()).filter(|&i| changes[i] > config.mask_gradient).collect();
    let chosen = gaussians.select(&chosen);
    views.iter().map(|view| cells(&opaque(&chosen, &view.camera), config.mask_cell)).collect()
}

fn opaque(gaussians: &Gaussians, camera: &Camera) -> Mask {
    let rasterizer = CpuRasterizer::default();
    let (view, mut tape) =
        (View { camera, background: Background::Colour([0.0; 3]), tiles: None }, RenderTape::default());
    rasterizer.render(gaussians, &view, &mut tape);
    let inside = tape.transmittance().iter().map(|&t| u8::from(t < 0.5)).collect();
    Mask::new(camera.size(), inside).expect("a value per pixel")
}

/// Max pooling over whole cells of so many pixels, stretched to the image again.
fn cells(mask: &Mask, cell: usize) -> Mask {
    let size = mask.size();
    let [columns, rows] = [size.width, size.height].map(|length| (length / cell).max(1));
    let mut pooled = vec![0; columns * rows];
    for row in 0..size.height {
        for column in 0..size.width {
            let (x, y) = (column / cell, row / cell);
            // What is left of a last cell counts nowhere, as in the official code, unless it is the only one.
            let at = if columns == 1 { 0 } else { x } + columns * if rows == 1 { 0 } else { y };
            if mask.contains(column, row) && (x < columns || columns == 1) && (y < rows || rows == 1) {
                pooled[at] = 1;
            }
        }
    }
    let ImageSize { width, height } = size;
    let nearest = |i: usize| pooled[i % width * columns / width + columns * (i / width * rows / height)];
    Mask::new(size, (0..size.pixels()).map(nearest).collect()).expect("a value per pixel")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::World;
    use glam::Vec3;

    #[test]
    fn what_moves_changes_more_than_what_stands_still_and_still_views_change_nothing() {
        let world = World::moving(Vec3::new(0.03, 0.0, 0.0));
        let gaussians = world.gaussians();
        let found = world.with_step(1, |step| changes(step, &gaussians, &world.sky));
        let mean = |part: &[f32]| part.iter().sum::<f32>() / part.len() as f32;
        let (body, backdrop) = found.split_at(crate::world::BODY);
        assert!(mean(body) > 1.5 * mean(backdrop), "{} {}", mean(body), mean(backdrop));
        let still = World::new();
        let found = still.with_step(1, |step| changes(step, &gaussians, &still.sky));
        assert!(found.iter().all(|change| *change == 0.0));
    }

    #[test]
    fn masks_are_whole_cells() {
        let size = ImageSize { width: 10, height: 8 };
        let mut inside = vec![0; 80];
        (inside[3 * 10 + 5], inside[7 * 10 + 9]) = (1, 1);
        // Two columns and two rows of 4 pixels, stretched to 5 and 4; the pixel in the last half cell is left out.
        let found = cells(&Mask::new(size, inside).unwrap(), 4);
        for (i, value) in found.data().iter().enumerate() {
            assert_eq!(*value == 1, i % 10 >= 5 && i / 10 < 4, "{i}");
        }
        assert_eq!(cells(&found, 48).count(), 80, "an image smaller than a cell is one");
    }
}
