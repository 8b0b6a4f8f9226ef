use crate::normal::{Normal, outer};
use crate::views::View;
use glam::{DMat3, DVec3};

/// Weighted least-squares meeting point of the viewing rays (Algorithm 1, line 23), relative to the previous mean.
///
/// `A = sum w W`, `b = sum w W c`, `W = I - d d^T`; `extra` scales each view's weight.
pub fn solve(views: &[View], extra: impl Fn(&View) -> f64) -> Option<DVec3> {
    normal(views, extra).solve()
}

/// The normal system of [`solve`].
pub fn normal(views: &[View], extra: impl Fn(&View) -> f64) -> Normal {
    let mut normal = Normal::default();
    for view in views {
        let weighted = (DMat3::IDENTITY - outer(view.ray)) * (view.weight * extra(view));
        normal.add(weighted, weighted * view.center);
    }
    normal
}

/// `(f / z)^2` at `point`: turns a squared distance to the ray (m^2) into px^2. A point behind the camera or beside
/// it takes its distance for the depth: the first guess may be that bad and still be mended by the other views.
pub fn pixels_per_metre_squared(view: &View, point: DVec3) -> f64 {
    let distance = (point - view.center).length().max(1e-9);
    let depth = view.depth(point);
    let depth = if depth > 0.05 * distance { depth } else { distance };
    view.focal.x * view.focal.y / (depth * depth)
}

/// Squared distance of `point` to the view's ray in pixels; infinite behind the camera.
pub fn residual_squared(view: &View, point: DVec3) -> f64 {
    if !(view.depth(point) > 0.0) {
        return f64::INFINITY;
    }
    let offset = point - view.center;
    let across = offset - view.ray * view.ray.dot(offset);
    across.length_squared() * pixels_per_metre_squared(view, point)
}
