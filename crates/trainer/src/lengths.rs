//! Lengths that step sizes are measured in, and how far around a mask is looked.

use ffgs_core::{Camera, Gaussians};

/// Pixels around the mask whose tiles are computed: a splat that leaves the mask must still be seen there.
pub const TILE_DILATION: usize = 4;

/// Radius (m) around the median position that holds 90 % of the Gaussians: outliers must not set the step size.
pub fn robust_extent(gaussians: &Gaussians) -> f32 {
    if gaussians.is_empty() {
        return 0.0;
    }
    let n = gaussians.len();
    let center = [0, 1, 2].map(|a| {
        let mut axis: Vec<f32> = gaussians.means.iter().map(|m| m[a]).collect();
        axis.sort_by(f32::total_cmp);
        axis[n / 2]
    });
    let distance = |m: &[f32; 3]| (0..3).map(|a| (m[a] - center[a]).powi(2)).sum::<f32>().sqrt();
    let mut distances: Vec<f32> = gaussians.means.iter().map(distance).collect();
    distances.sort_by(f32::total_cmp);
    distances[(n * 9 / 10).min(n - 1)]
}

/// Gaussians at most whose pixels are looked at, spread evenly over all.
const SAMPLES: usize = 4096;

/// Median size of a pixel (m) at the Gaussians, over the cameras that see them: depth over focal length. 0 where none does.
pub fn pixel_length<'a>(gaussians: &Gaussians, cameras: impl IntoIterator<Item = &'a Camera>) -> f32 {
    let means = gaussians.positions();
    let stride = means.len().div_ceil(SAMPLES).max(1);
    let of_camera = |camera: &'a Camera| {
        let seen = means.iter().step_by(stride).filter_map(|&mean| camera.project(mean));
        let sizes =
            seen.filter(|seen| camera.shows(seen.pixel)).map(|seen| seen.depth / camera.intrinsics().focal());
        sizes.collect::<Vec<f64>>()
    };
    let mut sizes: Vec<f64> = cameras.into_iter().flat_map(of_camera).collect();
    let middle = sizes.len() / 2;
    if sizes.is_empty() { 0.0 } else { *sizes.select_nth_unstable_by(middle, f64::total_cmp).1 as f32 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::from_points;
    use ffgs_core::{ImageSize, Intrinsics};
    use glam::{DMat4, DVec3};

    fn at(places: &[[f32; 3]]) -> Gaussians {
        from_points(places, &vec![[0.5; 3]; places.len()], 0, 0.5)
    }

    /// At `z` (m), looking along z.
    fn camera(z: f64, focal: f64) -> Camera {
        let intrinsics = Intrinsics { fx: focal, fy: focal, cx: 16.0, cy: 16.0 };
        let pose = DMat4::from_translation(DVec3::new(0.0, 0.0, -z));
        Camera::new(intrinsics, pose, ImageSize { width: 32, height: 32 }).unwrap()
    }

    #[test]
    fn a_pixel_is_depth_over_focal_length_where_gaussians_are_seen() {
        let ball = at(&[[0.0, 0.0, 10.0], [0.1, 0.0, 10.0], [0.0, 0.1, 10.0], [0.0, 0.0, -50.0]]);
        assert!((pixel_length(&ball, &[camera(0.0, 100.0)]) - 0.1).abs() < 1e-6);
        // Two of three cameras are twice as far away.
        let rig = [camera(0.0, 100.0), camera(-10.0, 100.0), camera(-10.0, 100.0)];
        assert!((pixel_length(&ball, &rig) - 0.2).abs() < 1e-6);
        assert_eq!(pixel_length(&ball, &[camera(20.0, 100.0)]), 0.0, "behind the camera");
        assert_eq!((pixel_length(&ball, &[]), pixel_length(&at(&[]), &rig)), (0.0, 0.0));
    }

    /// With half of the focal length, a pixel is twice as large.
    #[test]
    fn it_follows_the_resolution_and_the_unit_but_not_how_far_bodies_are_apart() {
        let pair = |apart: f32| at(&[[0.0, 0.0, 10.0], [apart, 0.0, 10.0]]);
        let [near, far] = [0.1, 1.0].map(|apart| pixel_length(&pair(apart), &[camera(0.0, 100.0)]));
        assert_eq!(near, far);
        assert!(robust_extent(&pair(1.0)) > 5.0 * robust_extent(&pair(0.1)));
        assert_eq!(pixel_length(&pair(0.1), &[camera(0.0, 50.0)]), 2.0 * near);
        let in_centimetres = at(&[[0.0, 0.0, 1000.0], [10.0, 0.0, 1000.0]]);
        assert_eq!(pixel_length(&in_centimetres, &[camera(0.0, 100.0)]), 100.0 * near);
    }

    #[test]
    fn outliers_do_not_set_the_extent() {
        let mut places = vec![[0.0; 3]; 50];
        (0..46).for_each(|i| places[i][0] = i as f32 * 0.01);
        (46..50).for_each(|i| places[i][1] = 1e6);
        assert!(robust_extent(&at(&places)) < 0.5);
        assert_eq!(robust_extent(&at(&[])), 0.0);
    }
}
