//! What the cameras of a capture tell together: which way is up, which of them stand still, and whether the scene lies far from zero.

use crate::Camera;
use glam::DVec3;

/// Against gravity, as far as the cameras are held upright: the mean of their up directions (a unit vector of the world). z where they have
/// none in common.
pub fn up<'a>(cameras: impl IntoIterator<Item = &'a Camera>) -> DVec3 {
    cameras.into_iter().map(|camera| -camera.rotation().row(1)).sum::<DVec3>().normalize_or(DVec3::Z)
}

/// Whether a camera stands still: it has one pose and one lens in all of its `frames`.
///
/// # Errors
/// Those of the frames, the first one.
pub fn is_fixed<E>(frames: impl IntoIterator<Item = Result<Camera, E>>) -> Result<bool, E> {
    let mut frames = frames.into_iter();
    let Some(first) = frames.next().transpose()? else { return Ok(true) };
    frames.try_fold(true, |fixed, camera| Ok(fixed & (camera? == first)))
}

/// Where the cameras stand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RigExtent {
    /// Mean of their centres (m); zero of no camera.
    pub middle: DVec3,
    /// Largest distance of a centre from the mean (m).
    pub radius: f64,
}

impl RigExtent {
    /// Distance of the middle from zero, in radii, up to which coordinates stay as they are: f32 then resolves a hundred-thousandth of
    /// the radius.
    const FAR: f64 = 100.0;

    /// Of cameras with these centres (m).
    pub fn of(centres: &[DVec3]) -> Self {
        let middle = centres.iter().sum::<DVec3>() / centres.len().max(1) as f64;
        let radius = centres.iter().map(|centre| centre.distance(middle)).fold(0.0, f64::max);
        Self { middle, radius }
    }

    /// Whether f32 would blur positions about zero, so that they have to be counted from a place near the cameras.
    pub fn is_far_from_zero(self) -> bool {
        self.middle.length() > Self::FAR * self.radius
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{ImageSize, Intrinsics};
    use glam::{DMat3, DMat4};

    /// At the origin, looking along +y with +z up, then rolled about its axis (rad).
    fn rolled(roll: f64) -> Camera {
        let level = DMat3::from_cols(DVec3::X, DVec3::NEG_Z, DVec3::Y).transpose();
        let pose = DMat4::from_mat3(DMat3::from_rotation_z(roll) * level);
        let intrinsics = Intrinsics { fx: 50.0, fy: 50.0, cx: 32.0, cy: 24.0 };
        Camera::new(intrinsics, pose, ImageSize { width: 64, height: 48 }).unwrap()
    }

    #[test]
    fn up_is_what_cameras_have_in_common() {
        assert!(up(&[rolled(0.0)]).distance(DVec3::Z) < 1e-12);
        assert!(up(&[rolled(0.3), rolled(-0.3)]).distance(DVec3::Z) < 1e-12, "rolls cancel");
        assert!(up(&[rolled(std::f64::consts::FRAC_PI_2)]).z.abs() < 1e-12, "on its side");
        assert_eq!(up(&[]), DVec3::Z);
    }

    #[test]
    fn a_camera_that_comes_back_or_zooms_is_not_fixed() {
        let of = |frames: &[Result<Camera, &'static str>]| is_fixed(frames.iter().copied());
        let (here, there) = (rolled(0.0), rolled(0.1));
        let zoomed = Intrinsics { fx: 51.0, ..here.intrinsics() };
        let zoomed = Camera::new(zoomed, here.camera_from_world(), here.size()).unwrap();
        assert_eq!([of(&[]), of(&[Ok(here)]), of(&[Ok(here); 3])], [Ok(true); 3]);
        assert_eq!([of(&[Ok(here), Ok(there), Ok(here)]), of(&[Ok(here), Ok(zoomed)])], [Ok(false); 2]);
        assert_eq!(of(&[Ok(here), Ok(there), Err("damaged")]), Err("damaged"));
    }

    #[test]
    fn a_rig_is_far_from_zero_by_its_own_size() {
        let rig =
            |middle: f64, radius: f64| RigExtent::of(&[-radius, radius].map(|x| DVec3::X * (middle + x)));
        assert_eq!(rig(300.0, 10.0), RigExtent { middle: DVec3::X * 300.0, radius: 10.0 });
        assert!(!rig(990.0, 10.0).is_far_from_zero() && rig(1010.0, 10.0).is_far_from_zero());
        assert!(rig(1.01, 0.01).is_far_from_zero(), "whatever the unit");
        assert!(!RigExtent::of(&[]).is_far_from_zero());
    }
}
