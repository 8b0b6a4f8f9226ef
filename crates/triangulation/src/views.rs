use ffgs_core::{Camera, Observations};
use glam::{DMat3, DVec2, DVec3};

/// One view's observation of the Gaussian at hand, in coordinates whose origin is the previous mean.
#[derive(Clone, Copy, Debug)]
pub struct View {
    /// Rotation of `camera_from_world`.
    pub rotation: DMat3,
    /// Previous mean in camera coordinates (m).
    pub origin_in_camera: DVec3,
    /// Camera centre relative to the previous mean (m).
    pub center: DVec3,
    /// Unit viewing ray through the target.
    pub ray: DVec3,
    /// Focal lengths (px).
    pub focal: DVec2,
    /// Target less principal point (px).
    pub target: DVec2,
    /// Observation weight, scaled to mean 1 over the Gaussian's views.
    pub weight: f64,
}

/// Residual of a view at a point, with its derivative.
pub struct Residual {
    /// Target less projection (px).
    pub pixel: DVec2,
    /// Rows of d projection / d point (px / m).
    pub jacobian: [DVec3; 2],
}

impl View {
    /// Depth of a point given relative to the previous mean (m).
    pub fn depth(&self, point: DVec3) -> f64 {
        (self.rotation * point + self.origin_in_camera).z
    }

    /// Target less projection (px); `None` when the point is not in front of the camera.
    pub fn error(&self, point: DVec3) -> Option<DVec2> {
        let p = self.rotation * point + self.origin_in_camera;
        let in_front = p.z > 0.0;
        in_front.then(|| self.target - self.focal * p.truncate() / p.z)
    }

    /// Squared residual (px^2), infinite behind the camera.
    pub fn error_squared(&self, point: DVec3) -> f64 {
        self.error(point).map_or(f64::INFINITY, DVec2::length_squared)
    }

    /// Residual and Jacobian; `None` when the point is not in front of the camera.
    pub fn linearise(&self, point: DVec3) -> Option<Residual> {
        let p = self.rotation * point + self.origin_in_camera;
        let in_front = p.z > 0.0;
        in_front.then(|| {
            let (x, y) = (p.x / p.z, p.y / p.z);
            let (fx, fy) = (self.focal.x / p.z, self.focal.y / p.z);
            let world_from_camera = self.rotation.transpose();
            Residual {
                pixel: self.target - self.focal * DVec2::new(x, y),
                jacobian: [
                    world_from_camera * DVec3::new(fx, 0.0, -fx * x),
                    world_from_camera * DVec3::new(0.0, fy, -fy * y),
                ],
            }
        })
    }
}

/// Fills `out` with the views that observed Gaussian `i`, weights scaled to mean 1.
pub fn gather(
    previous: DVec3,
    cameras: &[Camera],
    observations: &Observations,
    i: usize,
    out: &mut Vec<View>,
) {
    out.clear();
    for (v, camera) in cameras.iter().enumerate() {
        let entry = v * observations.gaussians + i;
        let (weight, target) = (observations.weights[entry], observations.targets[entry]);
        if weight > 0.0 && weight.is_finite() && target.is_finite() {
            out.push(view(previous, camera, target, weight));
        }
    }
    let mean = out.iter().map(|view| view.weight).sum::<f64>() / out.len().max(1) as f64;
    for view in out {
        view.weight /= mean;
    }
}

fn view(previous: DVec3, camera: &Camera, target: DVec2, weight: f64) -> View {
    let k = camera.intrinsics();
    let center = camera.center() - previous;
    View {
        rotation: camera.rotation(),
        origin_in_camera: camera.rotation() * -center,
        center,
        ray: camera.ray(target),
        focal: DVec2::new(k.fx, k.fy),
        target: target - DVec2::new(k.cx, k.cy),
        weight,
    }
}
