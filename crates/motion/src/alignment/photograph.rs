//! A photograph between its pixels.

use super::surface::{SurfacePoint, brightness};
use ffgs_core::{Camera, TrainingView};
use ffgs_fusion::RigidMotion;
use glam::{DVec2, DVec3};
use nalgebra::Vector6;

/// Step (m) and rotation vector (rad).
pub(crate) type Unknowns = Vector6<f64>;

/// A pixel: photograph minus layer, and its derivative by the motion.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Row {
    /// Derivative (1/m, 1/rad).
    pub derivative: Unknowns,
    /// Difference of brightness.
    pub difference: f64,
}

/// A group in a view.
pub(crate) struct Patch<'a> {
    /// The view at t.
    pub view: &'a TrainingView,
    /// What the layer shows of the group there.
    pub points: &'a [SurfacePoint],
}

/// Size of a pixel (m) at a place; infinite behind the camera.
pub(crate) fn pixel_m(camera: &Camera, place: DVec3) -> f64 {
    camera.project(place).map_or(f64::INFINITY, |p| p.depth / camera.intrinsics().focal())
}

impl Patch<'_> {
    /// The pixels that show the foreground when the group has moved.
    pub(crate) fn rows(&self, motion: &RigidMotion) -> Vec<Row> {
        self.points.iter().filter_map(|point| self.row(point, motion)).collect()
    }

    fn row(&self, point: &SurfacePoint, motion: &RigidMotion) -> Option<Row> {
        let (camera, place) = (&self.view.camera, motion.apply(point.place));
        let (value, gradient) = self.bicubic(camera.project(place)?.pixel)?;
        let [x, y] = camera.pixel_derivative(place)?;
        let slope = x * gradient.x + y * gradient.y;
        let turn = (place - motion.centre - motion.step).cross(slope);
        let derivative = Unknowns::new(slope.x, slope.y, slope.z, turn.x, turn.y, turn.z);
        Some(Row { derivative, difference: value - point.value })
    }

    /// Brightness at a pixel position and its derivative (1/px) by Catmull-Rom splines; `None` unless all sixteen pixels
    /// show the foreground.
    pub(crate) fn bicubic(&self, pixel: DVec2) -> Option<(f64, DVec2)> {
        let size = self.view.mask.size();
        let at = pixel - 0.5;
        let corner = at.floor();
        let first = |v: f64, count: usize| (v >= 1.0 && v + 3.0 <= count as f64).then(|| v as usize - 1);
        let (column, row) = (first(corner.x, size.width)?, first(corner.y, size.height)?);
        let (wx, wy) = (catmull_rom(at.x - corner.x), catmull_rom(at.y - corner.y));
        let (mut value, mut gradient) = (0.0, DVec2::ZERO);
        for (j, y) in wy.iter().enumerate() {
            for (i, x) in wx.iter().enumerate() {
                let index = (row + j) * size.width + column + i;
                if self.view.mask.data()[index] == 0 {
                    return None;
                }
                let v = brightness(self.view.image.pixel(index));
                value += x[0] * y[0] * v;
                gradient += DVec2::new(x[1] * y[0], x[0] * y[1]) * v;
            }
        }
        Some((value, gradient))
    }
}

/// Weights of the four samples around a place `t` (0..1) between the middle two, and their derivatives.
fn catmull_rom(t: f64) -> [[f64; 2]; 4] {
    let (t2, t3) = (t * t, t * t * t);
    [
        [0.5 * (-t3 + 2.0 * t2 - t), 0.5 * (-3.0 * t2 + 4.0 * t - 1.0)],
        [0.5 * (3.0 * t3 - 5.0 * t2 + 2.0), 0.5 * (9.0 * t2 - 10.0 * t)],
        [0.5 * (-3.0 * t3 + 4.0 * t2 + t), 0.5 * (-9.0 * t2 + 8.0 * t + 1.0)],
        [0.5 * (t3 - t2), 0.5 * (3.0 * t2 - 2.0 * t)],
    ]
}
