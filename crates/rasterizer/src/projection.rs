//! EWA projection of one Gaussian: shared by the forward and the backward pass, which loop over blocks of Gaussians.

use crate::constants::{MIN_ALPHA, MIN_COMPENSATION, NEAR};
use crate::elementary::{exp, ln};
use crate::expansion::Expansion;
use crate::pinhole::PinholeF32;
use crate::spherical_harmonics;
use crate::view::RenderOptions;
use ffgs_core::{Gaussians, PixelFilter, sh_coefficients};
use glam::{DVec3, Mat3, Vec3};

/// Standard deviations at which even an opaque splat falls below [`MIN_ALPHA`], `sqrt(2 ln 255)` rounded up.
pub(crate) const MAX_REACH: f32 = 3.33;

/// A projected Gaussian, ready to blend: one cache line.
#[derive(Clone, Copy, Debug, Default)]
#[repr(align(64))]
pub(crate) struct Splat {
    /// Centre (px).
    pub(crate) mean: [f32; 2],
    /// Inverse of the filtered covariance: xx, xy, yy (1/px^2).
    pub(crate) conic: [f32; 3],
    /// Opacity, antialiasing compensation included.
    pub(crate) opacity: f32,
    /// Colour, clamped at 0.
    pub(crate) colour: [f32; 3],
    /// Camera z of the point where the projection is linearised (m).
    pub(crate) depth: f32,
    /// Largest exponent `sigma` at which the splat still contributes.
    pub(crate) reach: f32,
    /// Half the height of the ellipse `sigma <= reach` (px).
    pub(crate) half_height: f32,
    /// Determinant of the conic over `conic.xx^2`: how the ellipse narrows away from its centre row.
    pub(crate) shrink: f32,
    /// Which Gaussian.
    pub(crate) index: u32,
    /// First of its tile spans, and their number.
    pub(crate) spans: (u32, u32),
}

impl Splat {
    /// `2 reach`, slightly generous: rounding in a coverage test must never lose a pixel that the blend accepts.
    #[inline(always)]
    pub(crate) fn squared_reach(&self) -> f32 {
        2.0 * self.reach.max(0.0) * 1.0001 + 1e-4
    }
}

/// The exponent by its square completed: `sigma = a (dx - slope dy)^2 / 2 + dy^2 / (2 yy)`. On a long needle the three
/// terms of `a dx^2 / 2 + b dx dy + c dy^2 / 2` are large and cancel; these two do not.
#[derive(Clone, Copy, Default)]
pub(crate) struct Ridge {
    /// Inverse of the variance along x at a given y (1/px^2).
    pub(crate) a: f32,
    /// How x shifts with y along the ridge.
    pub(crate) slope: f32,
    /// Inverse of the variance along y (1/px^2).
    pub(crate) inverse_yy: f32,
}

impl Ridge {
    #[inline(always)]
    pub(crate) fn of(splat: &Splat) -> Self {
        let [a, b, _] = splat.conic;
        Self { a, slope: -b / a, inverse_yy: a * splat.shrink }
    }
}

/// Everything of the projection that the backward pass needs again.
pub(crate) struct Ewa {
    /// Where the projection is linearised.
    pub(crate) expansion: Expansion,
    /// Centre (px), relative to the principal point.
    pub(crate) mean: [f32; 2],
    /// Clamped x/z, y/z of that point.
    pub(crate) slope: [f32; 2],
    /// Whether the clamp acted.
    pub(crate) clamped: [bool; 2],
    /// Rows of the projection's Jacobian.
    pub(crate) jacobian: [Vec3; 2],
    /// Rows of Jacobian times rotation.
    pub(crate) to_pixels: [Vec3; 2],
    /// Standard deviations (m).
    pub(crate) scales: Vec3,
    /// `rotation * diag(scales)`.
    pub(crate) shape: Mat3,
    /// Projected axes: covariance = rows' inner products.
    pub(crate) axes: [Vec3; 2],
    /// Unfiltered covariance xx, xy, yy (px^2).
    pub(crate) covariance: [f32; 3],
    /// False behind the near plane or where a parameter is not finite; nothing else means anything then.
    pub(crate) valid: bool,
}

/// Filtered covariance, its inverse and the antialiasing compensation.
pub(crate) struct Filtered {
    pub(crate) covariance: [f32; 3],
    pub(crate) conic: [f32; 3],
    pub(crate) determinants: [f32; 2],
    pub(crate) compensation: f32,
}

/// Rotation matrix of a unit quaternion (w, x, y, z).
#[inline(always)]
pub(crate) fn rotation_of([w, x, y, z]: [f32; 4]) -> Mat3 {
    Mat3::from_cols(
        Vec3::new(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)),
        Vec3::new(2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)),
        Vec3::new(2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)),
    )
}

/// Unit quaternion and the length it had; the identity for a zero quaternion.
#[inline(always)]
pub(crate) fn normalised([w, x, y, z]: [f32; 4]) -> ([f32; 4], f32) {
    let length = (w * w + x * x + y * y + z * z).sqrt();
    let zero = length == 0.0;
    let length = if zero { 1.0 } else { length };
    let real = if zero { 1.0 } else { w / length };
    ([real, x / length, y / length, z / length], length)
}

/// Position of a Gaussian relative to the camera's centre (m, world axes).
#[inline(always)]
pub(crate) fn offset(mean: [f32; 3], center: DVec3) -> Vec3 {
    (DVec3::new(f64::from(mean[0]), f64::from(mean[1]), f64::from(mean[2])) - center).as_vec3()
}

/// Projects the shape of a Gaussian, given its position relative to the camera's centre (m, world axes). No branches,
/// calls or closures: the loops that use it are vectorised across Gaussians.
#[allow(
    clippy::needless_bitwise_bool,
    reason = "a lazy operator is a branch, and a branch keeps the loop from being vectorised"
)]
#[inline(always)]
pub(crate) fn ewa(offset: Vec3, quat: [f32; 4], log_scales: [f32; 3], camera: &PinholeF32) -> Ewa {
    let rotation = rotation_of(normalised(quat).0);
    let scales = Vec3::new(exp(log_scales[0]), exp(log_scales[1]), exp(log_scales[2]));
    let shape =
        Mat3::from_cols(rotation.x_axis * scales.x, rotation.y_axis * scales.y, rotation.z_axis * scales.z);
    let centre = camera.rotation * offset;
    let expansion = Expansion::new(centre, shape, camera);
    let point = expansion.point;
    let (sx, sy) = (point.x / point.z, point.y / point.z);
    let slope = [sx.max(camera.low[0]).min(camera.high[0]), sy.max(camera.low[1]).min(camera.high[1])];
    let (fx, fy) = (camera.focal[0] / point.z, camera.focal[1] / point.z);
    let jacobian = [Vec3::new(fx, 0.0, -fx * slope[0]), Vec3::new(0.0, fy, -fy * slope[1])];
    let mean = [
        camera.focal[0] * sx + jacobian[0].dot(expansion.rest),
        camera.focal[1] * sy + jacobian[1].dot(expansion.rest),
    ];
    let back = camera.rotation.transpose();
    let to_pixels = [back * jacobian[0], back * jacobian[1]];
    let across = shape.transpose();
    let axes = [across * to_pixels[0], across * to_pixels[1]];
    let covariance = [axes[0].dot(axes[0]), axes[0].dot(axes[1]), axes[1].dot(axes[1])];
    let clamped = [sx != slope[0], sy != slope[1]];
    // A sum is finite only if every part is.
    let sum = point.x.abs() + point.y.abs() + point.z + covariance[0] + covariance[1].abs() + covariance[2];
    let nearest = NEAR * scales.x.max(scales.y).max(scales.z);
    let valid = (centre.z >= nearest) & (point.z >= nearest) & (sum < f32::INFINITY);
    Ewa { expansion, mean, slope, clamped, jacobian, to_pixels, scales, shape, axes, covariance, valid }
}

/// Applies the pixel filter of the camera to a projected covariance.
#[inline(always)]
pub(crate) fn filter(ewa: &Ewa, camera: &PinholeF32, kind: PixelFilter) -> Filtered {
    let variance = camera.filter;
    let [xx, xy, yy] = ewa.covariance;
    // |u|^2 |v|^2 - (u.v)^2 = |u x v|^2 (Lagrange): of a long needle the left side would cancel to nothing.
    let raw = ewa.axes[0].cross(ewa.axes[1]).length_squared();
    let determinants = [raw, raw + variance * (xx + yy) + variance * variance];
    let ratio = (determinants[0] / determinants[1]).max(MIN_COMPENSATION * MIN_COMPENSATION);
    let inverse = 1.0 / determinants[1];
    let (fxx, fyy) = (xx + variance, yy + variance);
    Filtered {
        covariance: [fxx, xy, fyy],
        conic: [fyy * inverse, -xy * inverse, fxx * inverse],
        determinants,
        compensation: match kind {
            PixelFilter::Compensated => ratio.sqrt(),
            PixelFilter::Plain => 1.0,
        },
    }
}

/// Whether the compensation is above its floor, so that it has a derivative.
#[inline(always)]
pub(crate) fn compensation_is_free(filtered: &Filtered) -> bool {
    filtered.determinants[0] / filtered.determinants[1] > MIN_COMPENSATION * MIN_COMPENSATION
}

/// What the coverage test needs besides the splat.
pub(crate) struct Extent {
    /// Variance along x and covariance (px^2), filtered.
    pub(crate) covariance: [f32; 2],
    /// Half the width of the ellipse `sigma <= reach` (px).
    pub(crate) half_width: f32,
}

/// The splat without colour, index and spans, and its extent; its opacity is 0 where it cannot show, be it because it
/// lies outside the image of `size` (px). `bare` is the opacity without compensation.
#[allow(
    clippy::needless_bitwise_bool,
    reason = "a lazy operator is a branch, and a branch keeps the loop from being vectorised"
)]
#[inline(always)]
pub(crate) fn splat(
    offset: Vec3,
    quat: [f32; 4],
    log_scales: [f32; 3],
    bare: f32,
    camera: &PinholeF32,
    kind: PixelFilter,
    size: [f32; 2],
) -> (Splat, Extent) {
    let ewa = ewa(offset, quat, log_scales, camera);
    let filtered = filter(&ewa, camera, kind);
    let opacity = bare * filtered.compensation;
    let mean = [ewa.mean[0] + camera.principal[0], ewa.mean[1] + camera.principal[1]];
    let a = filtered.conic[0];
    let mut splat = Splat {
        mean,
        conic: filtered.conic,
        opacity,
        depth: ewa.expansion.point.z,
        reach: ln(255.0 * opacity),
        shrink: 1.0 / (filtered.determinants[1] * a * a),
        ..Splat::default()
    };
    let reach = splat.squared_reach();
    splat.half_height = (reach * filtered.covariance[2]).sqrt() + 1e-3;
    let half_width = (reach * filtered.covariance[0]).sqrt() + 1e-2;
    // A needle can round to a singular covariance; there is nothing sensible to blend then.
    let shows = ewa.valid & (filtered.determinants[1] > 0.0) & (bare >= MIN_ALPHA) & (opacity >= MIN_ALPHA);
    let inside = (mean[0] + half_width >= 0.0)
        & (mean[0] - half_width <= size[0])
        & (mean[1] + splat.half_height >= 0.0)
        & (mean[1] - splat.half_height <= size[1]);
    splat.opacity = if shows & inside { opacity } else { 0.0 };
    (splat, Extent { covariance: [filtered.covariance[0], filtered.covariance[1]], half_width })
}

/// Degree to evaluate: the options', bounded by the Gaussians' own.
pub(crate) fn active_degree(g: &Gaussians, options: RenderOptions) -> usize {
    options.sh_degree.map_or(g.sh_degree(), |d| d.min(g.sh_degree()))
}

/// Colour of Gaussian `i` seen from the camera before the clamp at 0.
#[inline(always)]
pub(crate) fn view_colour(g: &Gaussians, i: usize, camera: &PinholeF32, degree: usize) -> Vec3 {
    let direction = offset(g.means[i], camera.center).normalize_or_zero();
    let basis = spherical_harmonics::basis(degree, direction);
    spherical_harmonics::colour(&basis, &g.sh_of(i)[..sh_coefficients(degree)])
}
