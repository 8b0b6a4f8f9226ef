//! New Gaussians join the moving layer.

use crate::pixel_sizes;
use ffgs_core::{Dynamic, Gaussians, TrainingView};
use ffgs_fusion::steps_of_nearest;
use glam::{DMat3, DVec3};

/// Standard deviation of a newborn's place (px): what the photographs tell of it is not counted yet.
const DOUBT_PX: f64 = 10.0;

/// Appends `born` to the layer. They are taken to have come as far as their nearest neighbours, and as rigid as these.
pub fn join(dynamic: &mut Dynamic, born: &Gaussians, views: &[TrainingView]) {
    let pixel_m = pixel_sizes(&born.positions(), views.iter().map(|view| &view.camera));
    let doubt = pixel_m.iter().map(|pixel| DMat3::from_diagonal(DVec3::splat((DOUBT_PX * pixel).powi(2))));
    dynamic.covariances.extend(doubt);
    if let Some(steps) = dynamic.known_steps() {
        let taken = steps_of_nearest(&dynamic.gaussians.means, steps, &born.means);
        dynamic.steps.extend(taken);
    }
    if dynamic.known_flexibility().is_some() {
        dynamic.flexibility.resize(dynamic.gaussians.len() + born.len(), 0.0);
    }
    dynamic.gaussians.extend(born);
    // They first make up for what is gone: a limit that rose with each birth would let flickering masks grow the layer for ever.
    dynamic.growth_limit = dynamic.growth_limit.max(dynamic.gaussians.len());
    dynamic.number_new();
}

#[cfg(test)]
mod tests {
    use super::*;
    use ffgs_core::{Camera, ImageRgb8, ImageSize, Intrinsics, Mask};
    use glam::DMat4;

    fn at(places: &[[f32; 3]]) -> Gaussians {
        let mut gaussians = Gaussians::zeros(places.len(), 0);
        gaussians.means.copy_from_slice(places);
        gaussians
    }

    fn view() -> TrainingView {
        let size = ImageSize { width: 40, height: 30 };
        let intrinsics = Intrinsics { fx: 20.0, fy: 20.0, cx: 20.0, cy: 15.0 };
        let camera = Camera::new(intrinsics, DMat4::IDENTITY, size).unwrap();
        let image = ImageRgb8::new(size, vec![0; 3 * size.pixels()]).unwrap();
        TrainingView { camera, image, mask: Mask::filled(size, true) }
    }

    #[test]
    fn every_column_grows_and_steps_are_those_of_the_nearest() {
        let mut dynamic = Dynamic {
            gaussians: at(&[[0.0, 0.0, 2.0], [1.0, 0.0, 2.0]]),
            covariances: vec![DMat3::IDENTITY; 2],
            steps: vec![DVec3::X, DVec3::Y],
            flexibility: vec![-3.0, 4.0],
            growth_limit: 2,
            ..Dynamic::default()
        };
        dynamic.number_new();
        join(&mut dynamic, &at(&[[0.9, 0.1, 2.0]]), &[view()]);
        assert_eq!(dynamic.steps, [DVec3::X, DVec3::Y, DVec3::Y]);
        assert_eq!((dynamic.flexibility, dynamic.growth_limit), (vec![-3.0, 4.0, 0.0], 3));
        assert_eq!((dynamic.ids, dynamic.next_id), (vec![0, 1, 2], 3));
        // A pixel is 10 cm wide there.
        assert!((dynamic.covariances[2].x_axis.x - 1.0).abs() < 1e-9);
    }

    #[test]
    fn a_layer_without_history_keeps_none() {
        let mut dynamic = Dynamic::default();
        join(&mut dynamic, &at(&[[0.0, 0.0, 2.0]]), &[view()]);
        assert!(dynamic.steps.is_empty() && dynamic.flexibility.is_empty());
        assert_eq!((dynamic.gaussians.len(), dynamic.covariances.len(), dynamic.ids.len()), (1, 1, 1));
    }
}
