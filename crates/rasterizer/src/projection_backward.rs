//! From derivatives per (tile, splat) entry to derivatives of the Gaussians' parameters and the camera's pose.

use crate::block::{BLOCK, Block, Column};
use crate::constants::ENTRY;
use crate::gradients::Gradients;
use crate::pinhole::PinholeF32;
use crate::projection::{self, Ewa};
use crate::spherical_harmonics as sh;
use crate::tape::RenderTape;
use crate::view::{RenderOptions, View};
use ffgs_core::{Gaussians, PixelFilter, instructions, sh_coefficients};
use glam::{DMat3, DVec3, Mat3, Vec3};
use pulp::{Simd, WithSimd};
use rayon::prelude::*;

/// Gaussians differentiated as one unit of parallel work; pose sums add up in the order of these chunks.
const CHUNK: usize = 1024;

/// Derivatives of a block of Gaussians, a column each.
#[derive(Default)]
struct BlockGradients {
    mean: [Column; 3],
    quat: [Column; 4],
    log_scale: [Column; 3],
    opacity_logit: Column,
    /// With respect to the camera-space position: what the pose needs.
    centre: [Column; 3],
    /// With respect to the camera's rotation, but for that of the position: pairs of outer products, camera axes with world axes.
    rotation: [[[Column; 3]; 2]; 4],
    /// 0 where the Gaussian has no derivative.
    valid: Column,
}

/// What the block's derivatives start from.
#[derive(Default)]
struct BlockInput {
    block: Block,
    /// Sums over the tiles, in the order of [`ENTRY`].
    entries: [Column; ENTRY],
    /// With respect to the mean, through the viewing direction.
    from_direction: [Column; 3],
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
        camera: PinholeF32::new(view.camera, options),
        options,
        degree: projection::active_degree(gaussians, options),
        half_size: [view.camera.size().width as f32 * 0.5, view.camera.size().height as f32 * 0.5],
        tape,
    };
    let k = gaussians.sh_stride();
    let g = &mut out.gaussians;
    let arch = instructions();
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
            let columns = Columns { means, quats, scales, opacities, sh, touched, norms, seen };
            arch.dispatch(DifferentiateChunk { context: &context, first: c * CHUNK, columns })
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
    /// Adds lane `k` to entry `i`, or overwrites a stale entry when it is the first of this step.
    #[inline(always)]
    fn add(&mut self, i: usize, d: &BlockGradients, k: usize, colour: &ColourGradient) {
        let keep = std::mem::replace(&mut self.touched[i], true);
        for a in 0..3 {
            add(&mut self.means[i][a], d.mean[a][k], keep);
            add(&mut self.scales[i][a], d.log_scale[a][k], keep);
        }
        for a in 0..4 {
            add(&mut self.quats[i][a], d.quat[a][k], keep);
        }
        add(&mut self.opacities[i], d.opacity_logit[k], keep);
        let stride = self.sh.len() / self.means.len();
        let sh = &mut self.sh[i * stride..(i + 1) * stride];
        for (coefficient, &basis) in sh.iter_mut().zip(&colour.basis) {
            for a in 0..3 {
                add(&mut coefficient[a], basis * colour.colour[a], keep);
            }
        }
        self.seen[i] += 1;
    }
}

#[inline(always)]
fn add(old: &mut f32, new: f32, keep: bool) {
    *old = if keep { *old + new } else { new };
}

/// Derivative of one Gaussian's colour before the clamp, the basis it multiplies, and the derivative with respect to
/// the mean through the viewing direction.
#[derive(Clone, Copy, Default)]
struct ColourGradient {
    colour: [f32; 3],
    basis: [f32; 16],
    from_direction: Vec3,
}

struct Context<'a> {
    gaussians: &'a Gaussians,
    camera: PinholeF32,
    options: RenderOptions,
    degree: usize,
    half_size: [f32; 2],
    tape: &'a RenderTape,
}

/// Differentiates up to [`CHUNK`] Gaussians from `first` on.
struct DifferentiateChunk<'a> {
    context: &'a Context<'a>,
    first: usize,
    columns: Columns<'a>,
}

impl WithSimd for DifferentiateChunk<'_> {
    type Output = PoseGradient;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> PoseGradient {
        let Self { context, first, mut columns } = self;
        let mut pose = PoseGradient { rotation: DMat3::ZERO, translation: DVec3::ZERO };
        let (mut input, mut output) = (BlockInput::default(), BlockGradients::default());
        let mut colours = [ColourGradient::default(); BLOCK];
        let mut members = [(0, 0); BLOCK];
        let mut local = 0;
        while local < columns.means.len() {
            let mut count = 0;
            while count < BLOCK && local < columns.means.len() {
                let slot = context.tape.slot_of[first + local];
                if slot != u32::MAX {
                    members[count] = (local, slot as usize);
                    count += 1;
                }
                local += 1;
            }
            // Sums first and by themselves: their loads come from anywhere in memory and overlap only in a short loop.
            for k in 0..count {
                context.load_sums(&mut input, k, members[k].1);
            }
            for k in 0..count {
                let (local, slot) = members[k];
                colours[k] = context.load(&mut input, k, first + local, slot);
            }
            context.differentiate(&input, &mut output);
            for k in (0..count).filter(|&k| output.valid[k] > 0.0) {
                let local = members[k].0;
                columns.add(local, &output, k, &colours[k]);
                let (x, y) = (input.entries[0][k], input.entries[1][k]);
                let (x, y) = (x * context.half_size[0], y * context.half_size[1]);
                columns.norms[local] += (x * x + y * y).sqrt();
                context.add_pose(&mut pose, first + local, &output, k, colours[k].from_direction);
            }
        }
        pose
    }
}

impl Context<'_> {
    /// Loads Gaussian `i` into lane `k` and differentiates its colour.
    #[inline(always)]
    fn load(&self, input: &mut BlockInput, k: usize, i: usize, slot: usize) -> ColourGradient {
        let factor = self.options.dropout.map_or(1.0, |dropout| dropout.factor(i));
        input.block.load(k, self.gaussians, i, &self.camera, factor);
        let e = &input.entries;
        let colour = self.colour(i, slot, [e[6][k], e[7][k], e[8][k]]);
        for axis in 0..3 {
            input.from_direction[axis][k] = colour.from_direction[axis];
        }
        colour
    }

    /// Sums of a splat's entries over its tiles, in their order, into lane `k`.
    #[inline(always)]
    fn load_sums(&self, input: &mut BlockInput, k: usize, slot: usize) {
        let lists = &self.tape.lists;
        let (start, end) = (lists.entry_starts[slot] as usize, lists.entry_starts[slot + 1] as usize);
        let mut sum = [0.0; ENTRY];
        for &entry in &lists.entries[start..end] {
            let values = &self.tape.entry_gradients[entry as usize];
            for n in 0..ENTRY {
                sum[n] += values[n];
            }
        }
        for (column, &value) in input.entries.iter_mut().zip(&sum) {
            column[k] = value;
        }
    }

    /// Through the colour that the splat shows; a channel at the clamp has no derivative.
    #[inline(always)]
    fn colour(&self, i: usize, slot: usize, upstream: [f32; 3]) -> ColourGradient {
        let shown = &self.tape.splats[slot].colour;
        let mut colour = [0.0; 3];
        for a in 0..3 {
            colour[a] = if shown[a] > 0.0 { upstream[a] } else { 0.0 };
        }
        let offset = projection::offset(self.gaussians.means[i], self.camera.center);
        let direction = offset.normalize_or_zero();
        let basis = sh::basis(self.degree, direction);
        if self.degree == 0 {
            return ColourGradient { colour, basis, from_direction: Vec3::ZERO };
        }
        let gradient = sh::basis_gradient(self.degree, direction);
        let coefficients = &self.gaussians.sh_of(i)[..sh_coefficients(self.degree)];
        let mut along = Vec3::ZERO;
        for (s, &g) in coefficients.iter().zip(&gradient).skip(1) {
            along += g * (s[0] * colour[0] + s[1] * colour[1] + s[2] * colour[2]);
        }
        let from_direction = (along - direction * direction.dot(along)) / offset.length();
        ColourGradient { colour, basis, from_direction }
    }

    /// All lanes of a block. No branches, calls or closures: this loop is vectorised.
    #[inline(always)]
    fn differentiate(&self, input: &BlockInput, out: &mut BlockGradients) {
        let (camera, kind) = (&self.camera, self.gaussians.filter);
        let compensated = kind == PixelFilter::Compensated;
        for k in 0..BLOCK {
            let e = &input.entries;
            let quat = input.block.quat(k);
            let ewa = projection::ewa(input.block.offset(k), quat, input.block.log_scales(k), camera);
            let filtered = projection::filter(&ewa, camera, kind);
            let alpha = input.block.opacity(k);
            let free = compensated & projection::compensation_is_free(&filtered);
            let footprint = FootprintGradient::new(&filtered, [e[2][k], e[3][k], e[4][k]]);
            let compensation = compensation_gradient(&filtered, ewa.covariance, free, e[5][k] * alpha);
            let shape = shape_gradient(&ewa, camera, &footprint, compensation, [e[0][k], e[1][k]]);
            let d_quat = rotation_gradient(quat, &ewa, &shape.shape);
            let mean = camera.rotation.transpose() * shape.centre;
            for a in 0..3 {
                out.mean[a][k] = mean[a] + input.from_direction[a][k];
                out.log_scale[a][k] = shape.log_scales[a];
                out.centre[a][k] = shape.centre[a];
                for (columns, pair) in out.rotation.iter_mut().zip(&shape.rotation) {
                    columns[0][a][k] = pair.0[a];
                    columns[1][a][k] = pair.1[a];
                }
            }
            for a in 0..4 {
                out.quat[a][k] = d_quat[a];
            }
            out.opacity_logit[k] = e[5][k] * filtered.compensation * input.block.opacity_slope(k);
            out.valid[k] = if ewa.valid { 1.0 } else { 0.0 };
        }
    }

    /// Derivative with respect to the pose, through the camera-space position, the projected shape and the camera
    /// centre `-R^-1 t` that the viewing direction starts from.
    #[inline(always)]
    fn add_pose(&self, pose: &mut PoseGradient, i: usize, d: &BlockGradients, k: usize, direction: Vec3) {
        let vector = |v: &[Column; 3]| DVec3::new(f64::from(v[0][k]), f64::from(v[1][k]), f64::from(v[2][k]));
        let rotation = self.camera.rotation.as_dmat3();
        let [x, y, z] = self.gaussians.means[i];
        let (mean, centre) = (DVec3::new(f64::from(x), f64::from(y), f64::from(z)), vector(&d.centre));
        let direction = direction.as_dvec3();
        pose.rotation += outer(centre, mean) - outer(rotation * self.camera.center, direction);
        for [in_camera, in_world] in &d.rotation {
            pose.rotation += outer(vector(in_camera), vector(in_world));
        }
        pose.translation += centre + rotation * direction;
    }
}

#[inline(always)]
fn rotation_gradient(quat: [f32; 4], ewa: &Ewa, d_shape: &Mat3) -> [f32; 4] {
    let d_rotation = Mat3::from_cols(
        d_shape.x_axis * ewa.scales.x,
        d_shape.y_axis * ewa.scales.y,
        d_shape.z_axis * ewa.scales.z,
    );
    let (unit, length) = projection::normalised(quat);
    let d = quaternion_gradient(unit, &d_rotation);
    let along = d[0] * unit[0] + d[1] * unit[1] + d[2] * unit[2] + d[3] * unit[3];
    let inverse = 1.0 / length;
    let tangent = |k: usize| (d[k] - along * unit[k]) * inverse;
    [tangent(0), tangent(1), tangent(2), tangent(3)]
}

#[inline(always)]
fn outer(a: DVec3, b: DVec3) -> DMat3 {
    DMat3::from_cols(a * b.x, a * b.y, a * b.z)
}

/// Derivatives with respect to the filtered covariance, in the terms of [`projection::Ridge`].
struct FootprintGradient {
    slope: f32,
    /// With respect to `1 / a`, the variance along x at a given y.
    across: f32,
    /// With respect to the slope, over the variance along y.
    turn: f32,
    /// With respect to the variance along y.
    along: f32,
}

impl FootprintGradient {
    /// From the second moments that an entry holds.
    #[inline(always)]
    fn new(f: &projection::Filtered, [across, mixed, along]: [f32; 3]) -> Self {
        let (a, inverse_yy) = (f.conic[0], 1.0 / f.covariance[2]);
        Self {
            slope: f.covariance[1] * inverse_yy,
            across: 0.5 * a * a * across,
            turn: a * mixed * inverse_yy,
            along: 0.5 * inverse_yy * inverse_yy * along,
        }
    }
}

/// With respect to the covariance (xx, xy, yy) through `compensation = sqrt(det / det_filtered)` where it is `free`;
/// `upstream` is the derivative with respect to it.
#[inline(always)]
fn compensation_gradient(f: &projection::Filtered, raw: [f32; 3], free: bool, upstream: f32) -> [f32; 3] {
    let [det, det_filtered] = f.determinants;
    let ratio = upstream / (2.0 * f.compensation);
    let (d0, d1) = (ratio / det_filtered, -ratio * det / (det_filtered * det_filtered));
    let (d0, d1) = if free { (d0, d1) } else { (0.0, 0.0) };
    [d0 * raw[2] + d1 * f.covariance[2], -2.0 * raw[1] * (d0 + d1), d0 * raw[0] + d1 * f.covariance[0]]
}

/// Derivatives with respect to the pieces of the EWA projection.
struct ShapeGradient {
    /// With respect to the camera-space position.
    centre: Vec3,
    /// With respect to `rotation * diag(scales)`.
    shape: Mat3,
    /// With respect to the log scales.
    log_scales: Vec3,
    /// With respect to the camera's rotation, but for that of the position: pairs of outer products, camera axes with world axes.
    rotation: [(Vec3, Vec3); 4],
}

#[inline(always)]
fn shape_gradient(
    ewa: &Ewa,
    camera: &PinholeF32,
    f: &FootprintGradient,
    [xx, xy, yy]: [f32; 3],
    mean2d: [f32; 2],
) -> ShapeGradient {
    let [u, v] = ewa.axes;
    // Distance of the axes' tips from the ridge: small along a needle, where u and slope v are large.
    let w = u - f.slope * v;
    let by_u = 2.0 * f.across * w + f.turn * v;
    let by_v = f.turn * w + 2.0 * f.along * v;
    let rest = [2.0 * xx * u + xy * v, xy * u + 2.0 * yy * v];
    let d_axes = [by_u + rest[0], by_v - f.slope * by_u + rest[1]];
    let log_scales = w * by_u + v * by_v + u * rest[0] + v * rest[1];
    let [p, q] = ewa.to_pixels;
    let shape = Mat3::from_cols(
        p * d_axes[0].x + q * d_axes[1].x,
        p * d_axes[0].y + q * d_axes[1].y,
        p * d_axes[0].z + q * d_axes[1].z,
    );
    let to_pixels = [ewa.shape * d_axes[0], ewa.shape * d_axes[1]];
    let expansion = &ewa.expansion;
    let [mx, my] = mean2d;
    let rows = [
        camera.rotation * to_pixels[0] + expansion.rest * mx,
        camera.rotation * to_pixels[1] + expansion.rest * my,
    ];
    let point = expansion.point;
    let (dx, x_by_z) = axis_gradient(ewa, camera.focal[0], 0, [rows[0].x, rows[0].z, mx, point.x]);
    let (dy, y_by_z) = axis_gradient(ewa, camera.focal[1], 1, [rows[1].y, rows[1].z, my, point.y]);
    let d_rest = ewa.jacobian[0] * mx + ewa.jacobian[1] * my;
    let moved = expansion.gradient(Vec3::new(dx, dy, x_by_z + y_by_z), d_rest, ewa.shape, camera);
    let stretched = Vec3::new(
        ewa.shape.x_axis.dot(moved.shape.x_axis),
        ewa.shape.y_axis.dot(moved.shape.y_axis),
        ewa.shape.z_axis.dot(moved.shape.z_axis),
    );
    let [first, second] = moved.rotation;
    ShapeGradient {
        centre: moved.centre,
        shape: shape + moved.shape,
        log_scales: log_scales + stretched,
        rotation: [(ewa.jacobian[0], to_pixels[0]), (ewa.jacobian[1], to_pixels[1]), first, second],
    }
}

/// Derivatives with respect to one image axis' coordinate and z of the camera-space position, given those with respect
/// to the two entries of the Jacobian's row (f/z on the axis, -f slope / z along the optical axis) and to the mean.
#[inline(always)]
fn axis_gradient(ewa: &Ewa, f: f32, axis: usize, [on, along, mean, at]: [f32; 4]) -> (f32, f32) {
    let inverse = 1.0 / ewa.expansion.point.z;
    let (first, second) = (f * inverse, f * inverse * inverse);
    let through_slope = second * ewa.slope[axis] * along;
    let free = if ewa.clamped[axis] { 0.0 } else { 1.0 };
    let d_axis = first * mean - free * second * along;
    (d_axis, through_slope + free * through_slope - second * on - second * at * mean)
}

/// Derivative of `L(rotation_of(q))` with respect to the unit quaternion's entries.
#[inline(always)]
fn quaternion_gradient([w, x, y, z]: [f32; 4], d: &Mat3) -> [f32; 4] {
    let m = d.to_cols_array();
    let at = |row: usize, column: usize| m[3 * column + row];
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
