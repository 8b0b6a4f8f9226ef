//! Cameras between cameras, from where a viewer may look.

use ffgs_core::{Camera, Intrinsics};
use glam::{DMat3, DMat4, DQuat};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// A camera lies between one of the rig and one of so many nearest to that.
const NEIGHBOURS: usize = 6;

/// `count` cameras, each at a random place between a camera of the rig and one of its neighbours: position, rotation and focal length are
/// interpolated; image size and principal point are those of the first. Nothing for a rig of one camera. Equal seeds give equal cameras.
pub(crate) fn cameras_between(cameras: &[Camera], count: usize, seed: u64) -> Vec<Camera> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let neighbours: Vec<Vec<Camera>> = (0..cameras.len()).map(|i| nearest(cameras, i)).collect();
    let ends = (0..cameras.len()).cycle().take(if cameras.len() > 1 { count } else { 0 });
    ends.filter_map(|i| {
        let other = &neighbours[i][random.random_range(0..neighbours[i].len())];
        between(&cameras[i], other, random.random())
    })
    .collect()
}

/// The cameras nearest to camera `i`, without itself.
fn nearest(cameras: &[Camera], i: usize) -> Vec<Camera> {
    let centre = cameras[i].center();
    let mut others = [&cameras[..i], &cameras[i + 1..]].concat();
    others.sort_by(|a, b| a.center().distance(centre).total_cmp(&b.center().distance(centre)));
    others.truncate(NEIGHBOURS);
    others
}

/// The camera at `share` of the way from `a` to `b`.
fn between(a: &Camera, b: &Camera, share: f64) -> Option<Camera> {
    let rotation = DQuat::from_mat3(&a.rotation()).slerp(DQuat::from_mat3(&b.rotation()), share);
    let rotation = DMat3::from_quat(rotation);
    let mut pose = DMat4::from_mat3(rotation);
    pose.w_axis = (-(rotation * a.center().lerp(b.center(), share))).extend(1.0);
    // Focal lengths of the other are in its own pixels.
    let pixels = a.size().width as f64 / b.size().width as f64;
    let (from, to) = (a.intrinsics(), b.intrinsics());
    let focal = |from: f64, to: f64| from * (to * pixels / from).powf(share);
    let lens = Intrinsics { fx: focal(from.fx, to.fx), fy: focal(from.fy, to.fy), ..from };
    Camera::new(lens, pose, a.size()).ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use ffgs_core::ImageSize;
    use glam::DVec3;

    /// At (`x`, 0, 0), turned by `angle` about y.
    fn camera(x: f64, angle: f64, fx: f64, width: usize) -> Camera {
        let rotation = DMat3::from_rotation_y(angle);
        let mut pose = DMat4::from_mat3(rotation);
        pose.w_axis = (-(rotation * DVec3::new(x, 0.0, 0.0))).extend(1.0);
        let lens = Intrinsics { fx, fy: fx, cx: 3.0, cy: 4.0 };
        Camera::new(lens, pose, ImageSize { width, height: 8 }).unwrap()
    }

    #[test]
    fn half_way_is_the_mean_place_and_turn_and_the_geometric_mean_of_the_lenses() {
        // The second has twice the pixels: its focal length of 80 px is one of 40 px of the first.
        let found = between(&camera(0.0, 0.0, 10.0, 8), &camera(2.0, 0.6, 80.0, 16), 0.5).unwrap();
        assert!(found.center().distance(DVec3::X) < 1e-12);
        assert!(
            (found.rotation() - DMat3::from_rotation_y(0.3)).to_cols_array().iter().all(|v| v.abs() < 1e-12)
        );
        let Intrinsics { fx, fy, cx, cy } = found.intrinsics();
        assert!((fx - 20.0).abs() < 1e-9 && (fy - 20.0).abs() < 1e-9, "{fx} {fy}");
        assert_eq!((cx, cy, found.size().width), (3.0, 4.0, 8));
    }

    #[test]
    fn they_lie_between_neighbours_and_one_camera_has_none() {
        let rig: Vec<Camera> = (0..20).map(|i| camera(f64::from(i), 0.1 * f64::from(i), 10.0, 8)).collect();
        let found = cameras_between(&rig, 50, 7);
        assert_eq!(found.len(), 50);
        for (k, camera) in found.iter().enumerate() {
            let away = (camera.center().x - (k % 20) as f64).abs();
            assert!(away <= NEIGHBOURS as f64, "{k}: {away}");
        }
        assert_eq!(found, cameras_between(&rig, 50, 7));
        assert_ne!(found, cameras_between(&rig, 50, 8));
        assert_eq!(cameras_between(&rig[..1], 50, 7), []);
        assert_eq!(cameras_between(&rig[..2], 3, 7).len(), 3);
    }
}
