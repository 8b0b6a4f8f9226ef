//! Poses that take a camera to the world, where those that take the world to the camera are meant.

use crate::views::View;
use crate::{PrepareError, stereo};
use ffgs_core::Camera;

/// From so many points per view on, the poses are right.
const SURE: usize = 50;
/// They are inverted when their inverses give so many points per view at least, and so many times as many. Of two calibrations that were, inverses gave
/// 27 and 42 times as many.
const LEAST: usize = 10;
const TIMES: usize = 8;

/// Refuses poses of `views` of which only few points follow, `found`, and of their inverses many.
///
/// # Errors
/// When the poses are inverted.
pub(crate) fn refuse(views: &[View], found: usize) -> Result<(), PrepareError> {
    if found >= SURE * views.len() {
        return Ok(());
    }
    let inverse = |view: &View| -> Option<View> {
        let pose = view.camera.camera_from_world().inverse();
        let camera = Camera::new(view.camera.intrinsics(), pose, view.camera.size()).ok()?;
        Some(View { camera, image: view.image.clone(), mask: view.mask.clone() })
    };
    let Some(inverses) = views.iter().map(inverse).collect::<Option<Vec<_>>>() else { return Ok(()) };
    let others = stereo::points(&inverses).len();
    if others < LEAST * views.len() || others < TIMES * found {
        return Ok(());
    }
    Err(PrepareError::Footage(format!(
        "{found} points are matched between the cameras as they are calibrated, and {others} with the inverse of each pose: the calibration \
         holds camera-to-world; write world-to-camera into it, the inverse of each"
    )))
}

#[cfg(test)]
mod tests {
    use super::*;
    use ffgs_core::{ImageRgb8, ImageSize, Intrinsics};
    use glam::{DMat3, DMat4, DVec3};

    const SIZE: ImageSize = ImageSize { width: 240, height: 180 };

    /// Cameras in an arc before a wall of coloured squares.
    fn views(count: usize) -> Vec<View> {
        let view = |i: usize| {
            let angle = 0.25 * i as f64 - 0.4;
            let eye = DVec3::new(3.0 * angle.sin(), 0.5 - 0.3 * i as f64, -3.0 * angle.cos());
            let forward = (DVec3::new(0.2, 0.1, 0.0) - eye).normalize();
            let right = DVec3::NEG_Y.cross(forward).normalize() * -1.0;
            let rotation = DMat3::from_cols(right, forward.cross(right), forward).transpose();
            let mut pose = DMat4::from_mat3(rotation);
            pose.w_axis = (-(rotation * eye)).extend(1.0);
            let intrinsics = Intrinsics { fx: 220.0, fy: 220.0, cx: 120.0, cy: 90.0 };
            let camera = Camera::new(intrinsics, pose, SIZE).unwrap();
            let grey = |p: usize| {
                let at = glam::DVec2::new((p % SIZE.width) as f64 + 0.5, (p / SIZE.width) as f64 + 0.5);
                let ray = camera.ray(at);
                let place = camera.center() - ray * (camera.center().z / ray.z);
                let [x, y] = [place.x, place.y].map(|v| (v / 0.09).floor() as i64 as u64);
                (x.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ y.wrapping_mul(0xC2B2_AE3D_27D4_EB4F))
                    .wrapping_mul(0xD6E8_FEB8_6659_FD93)
                    >> 56
            };
            let image =
                ImageRgb8::new(SIZE, (0..SIZE.pixels()).flat_map(|p| [grey(p) as u8; 3]).collect()).unwrap();
            View { camera, image, mask: None }
        };
        (0..count).map(view).collect()
    }

    fn inverses(views: &[View]) -> Vec<View> {
        let inverse = |view: &View| {
            let pose = view.camera.camera_from_world().inverse();
            let camera = Camera::new(view.camera.intrinsics(), pose, SIZE).unwrap();
            View { camera, image: view.image.clone(), mask: None }
        };
        views.iter().map(inverse).collect()
    }

    #[test]
    fn inverted_poses_are_refused_and_right_ones_are_not() {
        let right = views(4);
        let wrong = inverses(&right);
        let [of_right, of_wrong] = [&right, &wrong].map(|views| stereo::points(views).len());
        assert!(of_right > TIMES * of_wrong && of_right > LEAST * right.len(), "{of_right} {of_wrong}");
        let told = refuse(&wrong, of_wrong).unwrap_err().to_string();
        assert!(told.contains("camera-to-world") && told.contains(&of_right.to_string()), "{told}");
        refuse(&right, of_right).unwrap();
        let grey = ImageRgb8::new(SIZE, vec![90; 3 * SIZE.pixels()]).unwrap();
        let blind: Vec<View> = wrong.into_iter().map(|view| View { image: grey.clone(), ..view }).collect();
        refuse(&blind, 0).unwrap();
    }
}
