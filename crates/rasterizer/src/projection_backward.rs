//! From derivatives per (tile, splat) entry to derivatives of the Gaussians' parameters and the camera's pose.

use crate::backward::ENTRY;
use crate::contract::{RenderOptions, View};
use crate::gradients::Gradients;
use crate::projection::{self, Ewa, PinholeF32};
use crate::spherical_harmonics as sh;
use crate::tape::RenderTape;
use ffgs_core::{Gaussians, sh_coefficients, sigmoid};
use glam::{DMat3, DVec3, Mat3, Vec3};
use rayon::prelude::*;

/// Gaussians differentiated as one unit of parallel work; pose sums add up in the order of these chunks.
const CHUNK: usize = 1024;

/// Derivatives of one Gaussian's parameters.
struct ParameterGradients {
    mean: Vec3,
    quat: [f32; 4],
    log_scale: Vec3,
    opacity_logit: f32,
    /// Derivative of the colour before the clamp, and the basis it multiplies.
    colour: Vec3,
    basis: [f32; 16],
    mean2d: [f32; 2],
    pose: PoseGradient,
}

/// Derivative with respect to `camera_from_world`.
#[derive(Clone, Copy)]
struct PoseGradient {
    rotation: DMat3,
    translation: DVec3,
}

/// Adds the derivatives of one view to `out`.
pub(crate) fn to_parameters(
    gaussians: &Gaussians,
    view: &View,
    options: RenderOptions,
    tape: &mut RenderTape,
    out: &mut Gradients,
) {
    index_slots(gaussians.len(), tape);
    let tape = &*tape;
    let context = Context {
        gaussians,
        camera: PinholeF32::from(view.camera),
        options,
        degree: projection::active_degree(gaussians, options),
        half_size: [view.camera.size().width as f32 * 0.5, view.camera.size().height as f32 * 0.5],
        tape,
    };
    let k = gaussians.sh_stride();
    let g = &mut out.gaussians;
    let poses: Vec<PoseGradient> = g
        .means
        .par_chunks_mut(CHUNK)
        .zip(g.quats.par_chunks_mut(CHUNK))
        .zip(g.log_scales.par_chunks_mut(CHUNK))
        .zip(g.opacity_logits.par_chunks_mut(CHUNK))
        .zip(g.sh.par_chunks_mut(CHUNK * k))
        .zip(out.touched.par_chunks_mut(CHUNK))
        .zip(out.mean2d_norm.par_chunks_mut(CHUNK))
        .zip(out.views_seen.par_chunks_mut(CHUNK))
        .enumerate()
        .map(|(c, (((((((means, quats), scales), opacities), sh), touched), norms), seen))| {
            let first = c * CHUNK;
            let mut columns = Columns { means, quats, scales, opacities, sh, touched, norms, seen };
            context.differentiate_chunk(first, &mut columns)
        })
        .collect();
    for pose in poses {
        out.camera_rotation += pose.rotation;
        out.camera_translation += pose.translation;
    }
}

fn index_slots(n: usize, tape: &mut RenderTape) {
    tape.slot_of.clear();
    tape.slot_of.resize(n, u32::MAX);
    for (slot, splat) in tape.splats.iter().enumerate() {
        tape.slot_of[splat.index as usize] = slot as u32;
    }
}

/// Mutable columns of one chunk of Gaussians.
struct Columns<'a> {
    means: &'a mut [[f32; 3]],
    quats: &'a mut [[f32; 4]],
    scales: &'a mut [[f32; 3]],
    opacities: &'a mut [f32],
    sh: &'a mut [[f32; 3]],
    touched: &'a mut [bool],
    norms: &'a mut [f32],
    seen: &'a mut [u32],
}

impl Columns<'_> {
    /// Adds to entry `i`, or overwrites a stale entry when it is the first of this step.
    fn add(&mut self, i: usize, d: &ParameterGradients, half_size: [f32; 2]) {
        let keep = if std::mem::replace(&mut self.touched[i], true) { 1.0 } else { 0.0 };
        let add = |old: &mut f32, new: f32| *old = if keep > 0.0 { *old + new } else { new };
        (0..3).for_each(|a| add(&mut self.means[i][a], d.mean[a]));
        (0..4).for_each(|a| add(&mut self.quats[i][a], d.quat[a]));
        (0..3).for_each(|a| add(&mut self.scales[i][a], d.log_scale[a]));
        add(&mut self.opacities[i], d.opacity_logit);
        let k = self.sh.len() / self.means.len();
        for (coefficient, &basis) in self.sh[i * k..(i + 1) * k].iter_mut().zip(&d.basis) {
            (0..3).for_each(|a| add(&mut coefficient[a], basis * d.colour[a]));
        }
        self.norms[i] += (d.mean2d[0] * half_size[0]).hypot(d.mean2d[1] * half_size[1]);
        self.seen[i] += 1;
    }
}

struct Context<'a> {
    gaussians: &'a Gaussians,
    camera: PinholeF32,
    options: RenderOptions,
    degree: usize,
    half_size: [f32; 2],
    tape: &'a RenderTape,
}

impl Context<'_> {
    fn differentiate_chunk(&self, first: usize, columns: &mut Columns) -> PoseGradient {
        let mut pose = PoseGradient { rotation: DMat3::ZERO, translation: DVec3::ZERO };
        for local in 0..columns.means.len() {
            let slot = self.tape.slot_of[first + local];
            if slot == u32::MAX {
                continue;
            }
            if let Some(d) = self.differentiate(first + local, &self.sum_entries(slot as usize)) {
                pose.rotation += d.pose.rotation;
                pose.translation += d.pose.translation;
                columns.add(local, &d, self.half_size);
            }
        }
        pose
    }

    fn sum_entries(&self, slot: usize) -> [f32; ENTRY] {
        let lists = &self.tape.lists;
        let (start, end) = (lists.entry_starts[slot] as usize, lists.entry_starts[slot + 1] as usize);
        let mut sum = [0.0; ENTRY];
        for &entry in &lists.entries[start..end] {
            sum.iter_mut().zip(&self.tape.entry_gradients[entry as usize]).for_each(|(s, v)| *s += v);
        }
        sum
    }

    fn differentiate(&self, i: usize, entry: &[f32; ENTRY]) -> Option<ParameterGradients> {
        let &[mx, my, a, b, c, opacity, red, green, blue] = entry;
        let ewa = projection::ewa(self.gaussians, i, &self.camera)?;
        let filtered = projection::filter(ewa.covariance, self.options.antialiased);
        let mut covariance = conic_to_covariance(filtered.conic, [a, b, c]);
        let alpha = sigmoid(self.gaussians.opacity_logits[i]);
        if self.options.antialiased && projection::compensation_is_free(&filtered) {
            add_compensation(&filtered, ewa.covariance, opacity * alpha, &mut covariance);
        }
        let (colour, basis, from_direction) = self.colour(i, Vec3::new(red, green, blue));
        let shape = shape_gradient(&ewa, &self.camera, covariance, [mx, my]);
        let (quat, log_scale) = self.rotation_and_scale(i, &ewa, shape.shape);
        let rotation = self.camera.rotation;
        Some(ParameterGradients {
            mean: rotation.transpose() * shape.point + from_direction,
            quat,
            log_scale,
            opacity_logit: opacity * filtered.compensation * alpha * (1.0 - alpha),
            colour,
            basis,
            mean2d: [mx, my],
            pose: self.pose(i, &ewa, &shape, from_direction),
        })
    }

    /// Colour derivative before the clamp, its basis, and the derivative with respect to the mean through the
    /// viewing direction.
    fn colour(&self, i: usize, upstream: Vec3) -> (Vec3, [f32; 16], Vec3) {
        let offset = projection::offset(self.gaussians.means[i], self.camera.center);
        let (direction, distance) = (offset.normalize_or_zero(), offset.length());
        let basis = sh::basis(self.degree, direction);
        let coefficients = &self.gaussians.sh_of(i)[..sh_coefficients(self.degree)];
        let shows = sh::colour(&basis, coefficients).cmpgt(Vec3::ZERO);
        let colour = Vec3::select(shows, upstream, Vec3::ZERO);
        if self.degree == 0 {
            return (colour, basis, Vec3::ZERO);
        }
        let gradient = sh::basis_gradient(self.degree, direction);
        let along = coefficients
            .iter()
            .zip(&gradient)
            .fold(Vec3::ZERO, |sum, (&s, &g)| sum + g * Vec3::from(s).dot(colour));
        (colour, basis, (along - direction * direction.dot(along)) / distance)
    }

    fn rotation_and_scale(&self, i: usize, ewa: &Ewa, d_shape: Mat3) -> ([f32; 4], Vec3) {
        let columns = [0, 1, 2].map(|k| d_shape.col(k).dot(ewa.shape.col(k)));
        let d_rotation = d_shape * Mat3::from_diagonal(ewa.scales);
        let (unit, length) = projection::normalised(self.gaussians.quats[i]);
        let d = quaternion_gradient(unit, &d_rotation);
        let along: f32 = (0..4).map(|k| d[k] * unit[k]).sum();
        ([0, 1, 2, 3].map(|k| (d[k] - along * unit[k]) / length), Vec3::from(columns))
    }

    /// Derivative with respect to the pose, through the camera-space position, the projected shape and the camera
    /// centre `-R^-1 t` that the viewing direction starts from.
    fn pose(&self, i: usize, ewa: &Ewa, shape: &ShapeGradient, from_direction: Vec3) -> PoseGradient {
        let rotation = self.camera.rotation.as_dmat3();
        let mean = DVec3::from_array(self.gaussians.means[i].map(f64::from));
        let (point, center) = (shape.point.as_dvec3(), self.camera.center);
        let toward_center = rotation * from_direction.as_dvec3();
        let mut d_rotation = outer(point, mean) - outer(rotation * center, from_direction.as_dvec3());
        for k in 0..2 {
            d_rotation += outer(ewa.jacobian[k].as_dvec3(), shape.to_pixels[k].as_dvec3());
        }
        PoseGradient { rotation: d_rotation, translation: point + toward_center }
    }
}

fn outer(a: DVec3, b: DVec3) -> DMat3 {
    DMat3::from_cols(a * b.x, a * b.y, a * b.z)
}

/// `dL/dcov = -Q G Q` with `G` the symmetric derivative of the conic; the off-diagonal counts both entries.
fn conic_to_covariance([a, b, c]: [f32; 3], [ga, gb, gc]: [f32; 3]) -> [f32; 3] {
    let h = 0.5 * gb;
    let (p00, p01) = (a * ga + b * h, a * h + b * gc);
    let (p10, p11) = (b * ga + c * h, b * h + c * gc);
    [-(p00 * a + p01 * b), -2.0 * (p00 * b + p01 * c), -(p10 * b + p11 * c)]
}

/// Through `compensation = sqrt(det / det_filtered)`; `upstream` is the derivative with respect to it.
fn add_compensation(f: &projection::Filtered, raw: [f32; 3], upstream: f32, out: &mut [f32; 3]) {
    let [det, det_filtered] = f.determinants;
    let ratio = upstream / (2.0 * f.compensation);
    let (d0, d1) = (ratio / det_filtered, -ratio * det / (det_filtered * det_filtered));
    out[0] += d0 * raw[2] + d1 * f.covariance[2];
    out[1] -= 2.0 * raw[1] * (d0 + d1);
    out[2] += d0 * raw[0] + d1 * f.covariance[0];
}

/// Derivatives with respect to the pieces of the EWA projection.
struct ShapeGradient {
    /// With respect to the camera-space position.
    point: Vec3,
    /// With respect to `rotation * diag(scales)`.
    shape: Mat3,
    /// With respect to the rows of Jacobian times camera rotation.
    to_pixels: [Vec3; 2],
}

fn shape_gradient(ewa: &Ewa, camera: &PinholeF32, [xx, xy, yy]: [f32; 3], mean2d: [f32; 2]) -> ShapeGradient {
    let [u, v] = ewa.axes;
    let d_axes = [2.0 * xx * u + xy * v, xy * u + 2.0 * yy * v];
    let mut shape = Mat3::ZERO;
    for (row, d) in ewa.to_pixels.iter().zip(&d_axes) {
        shape += Mat3::from_cols(*row * d.x, *row * d.y, *row * d.z);
    }
    let to_pixels = d_axes.map(|d| ewa.shape * d);
    let z = ewa.point.z;
    let mut point = Vec3::ZERO;
    for axis in 0..2 {
        let f = camera.focal[axis];
        let d_jacobian = camera.rotation * to_pixels[axis];
        // Jacobian row: f/z on the axis, -f slope / z along the optical axis.
        point.z -= f / (z * z) * d_jacobian[axis];
        point.z += f * ewa.slope[axis] / (z * z) * d_jacobian.z;
        if !ewa.clamped[axis] {
            point[axis] -= f / (z * z) * d_jacobian.z;
            point.z += f * ewa.slope[axis] / (z * z) * d_jacobian.z;
        }
        point[axis] += f / z * mean2d[axis];
        point.z -= f * ewa.point[axis] / (z * z) * mean2d[axis];
    }
    ShapeGradient { point, shape, to_pixels }
}

/// Derivative of `L(rotation_of(q))` with respect to the unit quaternion's entries.
fn quaternion_gradient([w, x, y, z]: [f32; 4], d: &Mat3) -> [f32; 4] {
    let at = |row: usize, column: usize| d.col(column)[row];
    [
        2.0 * (x * (at(2, 1) - at(1, 2)) + y * (at(0, 2) - at(2, 0)) + z * (at(1, 0) - at(0, 1))),
        2.0 * (y * (at(0, 1) + at(1, 0)) + z * (at(0, 2) + at(2, 0)) + w * (at(2, 1) - at(1, 2)))
            - 4.0 * x * (at(1, 1) + at(2, 2)),
        2.0 * (x * (at(0, 1) + at(1, 0)) + z * (at(1, 2) + at(2, 1)) + w * (at(0, 2) - at(2, 0)))
            - 4.0 * y * (at(0, 0) + at(2, 2)),
        2.0 * (x * (at(0, 2) + at(2, 0)) + y * (at(1, 2) + at(2, 1)) + w * (at(1, 0) - at(0, 1)))
            - 4.0 * z * (at(0, 0) + at(1, 1)),
    ]
}
