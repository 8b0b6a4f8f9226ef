//! Camera poses for tests.

use glam::{DMat3, DMat4, DVec3};

/// `camera_from_world` of a camera at `eye` that looks at `at` and holds the world's z axis up (OpenCV axes).
pub fn look_at(eye: DVec3, at: DVec3) -> DMat4 {
    let z = (at - eye).normalize();
    let x = z.cross(DVec3::Z).normalize();
    let rotation = DMat3::from_cols(x, z.cross(x), z).transpose();
    let mut pose = DMat4::from_mat3(rotation);
    pose.w_axis = (-(rotation * eye)).extend(1.0);
    pose
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_target_lies_ahead_and_up_is_up() {
        let (eye, at) = (DVec3::new(3.0, -2.0, 1.0), DVec3::new(-1.0, 4.0, 0.5));
        let pose = look_at(eye, at);
        assert!(pose.transform_point3(eye).length() < 1e-12);
        let ahead = pose.transform_point3(at);
        assert!((ahead - DVec3::new(0.0, 0.0, (at - eye).length())).length() < 1e-12);
        assert!(pose.transform_vector3(DVec3::Z).y < 0.0, "y points down");
        assert!((pose.determinant() - 1.0).abs() < 1e-12);
    }
}
