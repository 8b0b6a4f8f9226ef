//! From affine motions in views to a place and a rotation in space.

use super::footprints::{Footprint, rays};
use ffgs_core::Camera;
use glam::{DMat2, DMat3, DQuat, DVec3};
use nalgebra::{Matrix3, Matrix4, Matrix6, Vector4, Vector6};

/// More views than these must say something, and more pixels in all of them.
const VIEWS: usize = 2;
const HITS: u32 = 3;
/// Of the smallest singular value of the place's equations (normalised device coordinates), and of the sum of their errors.
const MAX_SINGULAR: f64 = 1.0;
const MAX_PLACE_ERROR: f64 = 2.0;
/// Of the determinant of the shape's normal matrix, and of the mean error of its equations (px^2).
const MIN_DETERMINANT: f64 = 1e-9;
const MAX_SHAPE_ERROR: f64 = 0.5;

/// One Gaussian as a view saw it at t - 1, and where.
pub(super) struct Seen<'a> {
    /// Camera at t - 1 and at t.
    pub cameras: [&'a Camera; 2],
    pub footprint: Footprint,
}

/// A Gaussian before the motion: place (m), rotation, and standard deviations (m).
pub(super) struct Shape {
    pub place: DVec3,
    pub turn: DQuat,
    pub axes: DVec3,
}

/// What was solved, with how far it is trusted.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Solved {
    /// Translation (m).
    pub moved: Option<(DVec3, f64)>,
    /// Rotation of the world's axes.
    pub turned: Option<(DQuat, f64)>,
}

/// Of one Gaussian, by the views in which it has an affine motion.
pub(super) fn solve(shape: &Shape, views: &[Seen]) -> Solved {
    let hits: u32 = views.iter().map(|view| view.footprint.hits).sum();
    let mut place = Place::default();
    let mut covariance = Covariance::default();
    for view in views {
        let [before, now] = view.cameras;
        let Some(affine) = view.footprint.affine else { continue };
        let Some(seen) = before.project(shape.place) else { continue };
        let Some(rows) = before.pixel_derivative(shape.place) else { continue };
        place.add(rays(now, affine.of(seen.pixel)));
        covariance.add(shape, rows, affine.matrix, view.footprint.weight);
    }
    if place.rows.len() <= 2 * VIEWS || hits <= HITS {
        return Solved::default();
    }
    Solved {
        moved: place.solve().map(|(to, trust)| (to - shape.place, trust)),
        turned: covariance.solve(shape),
    }
}

/// Homogeneous equations of a place, unweighted (DLT).
#[derive(Default)]
struct Place {
    rows: Vec<[f64; 4]>,
}

impl Place {
    fn add(&mut self, rows: [[f64; 4]; 2]) {
        self.rows.extend(rows);
    }

    fn solve(&self) -> Option<(DVec3, f64)> {
        let gram = self.rows.iter().map(|row| Vector4::from(*row)).map(|row| row * row.transpose());
        let eigen = gram.sum::<Matrix4<f64>>().symmetric_eigen();
        let smallest = eigen.eigenvalues.imin();
        let singular = eigen.eigenvalues[smallest].max(0.0).sqrt();
        let point = eigen.eigenvectors.column(smallest);
        let point = point / point[3];
        let error: f64 = self.rows.iter().map(|row| Vector4::from(*row).dot(&point).abs()).sum();
        let place = DVec3::new(point[0], point[1], point[2]);
        let trust = (1.0 - error / MAX_PLACE_ERROR) / (1.0 + singular);
        (singular < MAX_SINGULAR && error < MAX_PLACE_ERROR && place.is_finite()).then_some((place, trust))
    }
}

/// Normal equations of the six entries of a covariance (m^2), from its images in views (px^2).
#[derive(Default)]
struct Covariance {
    rows: Vec<(Vector6<f64>, f64)>,
    normal: Matrix6<f64>,
    right: Vector6<f64>,
    weight: f64,
}

impl Covariance {
    fn add(&mut self, shape: &Shape, [u, v]: [DVec3; 2], affine: DMat2, weight: f64) {
        let own = |w: DVec3| shape.axes * (shape.turn.inverse() * w);
        let (a, b) = (own(u), own(v));
        let image = DMat2::from_cols_array(&[a.dot(a), a.dot(b), a.dot(b), b.dot(b)]);
        let moved = affine * image * affine.transpose();
        for (row, value) in [
            (quadratic(u, u), moved.x_axis.x),
            (quadratic(u, v), moved.x_axis.y),
            (quadratic(v, v), moved.y_axis.y),
        ] {
            self.normal += weight * row * row.transpose();
            self.right += weight * value * row;
            self.rows.push((row, value));
        }
        self.weight += weight;
    }

    fn solve(&self, shape: &Shape) -> Option<(DQuat, f64)> {
        let determinant = (self.normal / self.weight).determinant();
        if !(determinant > MIN_DETERMINANT) {
            return None;
        }
        let entries = self.normal.cholesky()?.solve(&self.right);
        let error =
            self.rows.iter().map(|(row, value)| (row.dot(&entries) - value).abs()).sum::<f64>() / self.weight;
        let [xx, xy, xz, yy, yz, zz] = entries.into();
        let eigen = Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz).symmetric_eigen();
        if !(error < MAX_SHAPE_ERROR && eigen.eigenvalues.min() >= 0.0) {
            return None;
        }
        let axes = [0, 1, 2].map(|k| {
            let axis = eigen.eigenvectors.column(k);
            (DVec3::new(axis[0], axis[1], axis[2]), eigen.eigenvalues[k].sqrt())
        });
        let logistic = |x: f64| 1.0 / (1.0 + 1.0 / x);
        let trust =
            logistic(self.weight) * (2.0 * logistic(determinant / MIN_DETERMINANT) - 1.0) * (1.0 - error);
        Some((turn_to(shape, &axes), trust)).filter(|(turn, _)| turn.is_finite())
    }
}

/// Coefficients of the entries xx, xy, xz, yy, yz, zz of a symmetric matrix S in `a^T S b`.
fn quadratic(a: DVec3, b: DVec3) -> Vector6<f64> {
    Vector6::new(
        a.x * b.x,
        a.x * b.y + a.y * b.x,
        a.x * b.z + a.z * b.x,
        a.y * b.y,
        a.y * b.z + a.z * b.y,
        a.z * b.z,
    )
}

/// The rotation from the old axes to new ones, in the order that is nearest to the old directions and lengths, each in the sense
/// of the old one.
fn turn_to(shape: &Shape, axes: &[(DVec3, f64); 3]) -> DQuat {
    const ORDERS: [[usize; 3]; 6] = [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];
    let old = DMat3::from_quat(shape.turn);
    let aligned = |order: [usize; 3]| {
        let mut columns = [0, 1, 2].map(|k| {
            let axis = axes[order[k]].0;
            if axis.dot(old.col(k)) < 0.0 { -axis } else { axis }
        });
        if DMat3::from_cols_array_2d(&columns.map(|c| c.to_array())).determinant() < 0.0 {
            let across = |k: &usize| columns[*k].dot(old.col(*k));
            let least = (0..3).min_by(|a, b| across(a).total_cmp(&across(b))).unwrap_or(0);
            columns[least] = -columns[least];
        }
        DMat3::from_cols(columns[0], columns[1], columns[2])
    };
    let far = |order: [usize; 3]| {
        let new = aligned(order);
        let directions: f64 = (0..3).map(|k| (new.col(k) - old.col(k)).abs().element_sum()).sum();
        directions + (0..3).map(|k| (axes[order[k]].1 - shape.axes[k]).abs()).sum::<f64>()
    };
    let nearest = ORDERS.into_iter().min_by(|a, b| far(*a).total_cmp(&far(*b))).unwrap_or([0, 1, 2]);
    (DQuat::from_mat3(&aligned(nearest)) * shape.turn.inverse()).normalize()
}

#[cfg(test)]
mod tests {
    use super::super::footprints::Affine;
    use super::*;
    use ffgs_core::{ImageSize, Intrinsics};
    use ffgs_testkit::look_at;
    use glam::DVec2;

    fn ring() -> Vec<Camera> {
        let camera = |k: usize| {
            let angle = k as f64;
            let eye = DVec3::new(4.0 * angle.cos(), 4.0 * angle.sin(), 1.0 + 0.7 * (k % 3) as f64);
            let lens = Intrinsics { fx: 300.0, fy: 310.0, cx: 150.0, cy: 110.0 };
            Camera::new(lens, look_at(eye, DVec3::ZERO), ImageSize { width: 320, height: 240 }).unwrap()
        };
        (0..6).map(camera).collect()
    }

    fn shape() -> Shape {
        let turn = DQuat::from_euler(glam::EulerRot::XYZ, 0.3, -0.5, 0.8);
        Shape { place: DVec3::new(0.2, -0.1, 0.3), turn, axes: DVec3::new(0.05, 0.02, 0.1) }
    }

    /// What the views see of a rigid motion to first order: the place exactly, the footprint by the derivative.
    fn seen<'a>(cameras: &'a [Camera], shape: &Shape, turn: DQuat, step: DVec3) -> Vec<Seen<'a>> {
        let of = |camera: &'a Camera| {
            let [u, v] = camera.pixel_derivative(shape.place).unwrap();
            let [p, q] = camera.pixel_derivative(shape.place + step).unwrap();
            // The affine map of a plane through the Gaussian that faces the camera: only its effect on the image of the
            // covariance is asked for, so any matrix that maps the one image to the other serves.
            let axes = |u: DVec3, v: DVec3, turn: DQuat| {
                let own = |w: DVec3| shape.axes * (turn.inverse() * w);
                let (a, b) = (own(u), own(v));
                let l11 = a.dot(a).sqrt();
                let l21 = a.dot(b) / l11;
                DMat2::from_cols(DVec2::new(l11, l21), DVec2::new(0.0, (b.dot(b) - l21 * l21).sqrt()))
            };
            let matrix = axes(p, q, turn * shape.turn) * axes(u, v, shape.turn).inverse();
            let [from, to] =
                [shape.place, shape.place + step].map(|place| camera.project(place).unwrap().pixel);
            let affine = Some(Affine { matrix, shift: to - matrix * from });
            let footprint = Footprint { weight: 5.0, hits: 20, still: 0.0, affine };
            Seen { cameras: [camera, camera], footprint }
        };
        cameras.iter().map(of).collect()
    }

    #[test]
    fn nothing_moves_without_motion() {
        let (cameras, shape) = (ring(), shape());
        let solved = solve(&shape, &seen(&cameras, &shape, DQuat::IDENTITY, DVec3::ZERO));
        let ((moved, _), (turned, _)) = (solved.moved.unwrap(), solved.turned.unwrap());
        assert!(moved.length() < 1e-9, "{moved}");
        assert!(turned.angle_between(DQuat::IDENTITY) < 1e-6, "{turned}");
    }

    /// However far: the equations know no reach. The shape's image is taken at the old place, so the rotation is that of a small step.
    #[test]
    fn a_rigid_motion_is_recovered() {
        let (cameras, shape) = (ring(), shape());
        let turn = DQuat::from_axis_angle(DVec3::new(1.0, 2.0, -1.0).normalize(), 0.2);
        let solved = solve(&shape, &seen(&cameras, &shape, turn, DVec3::ZERO));
        assert!(solved.turned.unwrap().0.angle_between(turn) < 1e-6);
        let step = DVec3::new(0.3, -0.4, 0.2);
        let solved = solve(&shape, &seen(&cameras, &shape, DQuat::IDENTITY, step));
        assert!(solved.moved.unwrap().0.distance(step) < 1e-9, "{solved:?}");
    }

    #[test]
    fn two_views_are_too_few_and_views_that_contradict_are_refused() {
        let (cameras, shape) = (ring(), shape());
        let all = || seen(&cameras, &shape, DQuat::IDENTITY, DVec3::ZERO);
        assert_eq!(solve(&shape, &all()[..2]), Solved::default());
        let mut torn = all();
        for (k, view) in torn.iter_mut().enumerate() {
            let away = if k % 2 == 0 { 200.0 } else { -200.0 };
            view.footprint.affine.as_mut().unwrap().shift.x += away;
        }
        assert!(solve(&shape, &torn).moved.is_none());
        let mut silent = all();
        silent.iter_mut().for_each(|view| view.footprint.affine = None);
        assert_eq!(solve(&shape, &silent), Solved::default());
    }
}
