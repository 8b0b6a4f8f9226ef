//! EWA projection of one Gaussian: shared by the forward and the backward pass.

use crate::contract::RenderOptions;
use crate::spherical_harmonics;
use ffgs_core::{Camera, Gaussians, sh_coefficients, sigmoid};
use glam::{DVec3, Mat3, Vec3};

/// Variance added to the projected covariance (px^2): the pixel filter of 3D Gaussian Splatting.
const PIXEL_FILTER: f32 = 0.3;
/// The projection's Jacobian is evaluated inside the frustum widened by this share of its half-angle's tangent.
const FRUSTUM_MARGIN: f32 = 0.3;
/// Lower bound of the antialiasing compensation.
const MIN_COMPENSATION: f32 = 0.005;
/// Gaussians nearer to the camera plane than this (m) are not rendered.
const NEAR: f32 = 0.01;
/// Contributions below this opacity are skipped.
pub(crate) const MIN_ALPHA: f32 = 1.0 / 255.0;

/// A camera in the rasterizer's precision; positions are taken relative to the centre in f64 first, so that
/// city-scale coordinates lose nothing.
pub(crate) struct PinholeF32 {
    pub(crate) rotation: Mat3,
    pub(crate) center: DVec3,
    pub(crate) focal: [f32; 2],
    principal: [f32; 2],
    low: [f32; 2],
    high: [f32; 2],
}

impl From<&Camera> for PinholeF32 {
    fn from(camera: &Camera) -> Self {
        let (k, size) = (camera.intrinsics(), camera.size());
        let (w, h) = (size.width as f32, size.height as f32);
        let (focal, principal) = ([k.fx as f32, k.fy as f32], [k.cx as f32, k.cy as f32]);
        let margin = [0.5 * FRUSTUM_MARGIN * w / focal[0], 0.5 * FRUSTUM_MARGIN * h / focal[1]];
        Self {
            rotation: camera.rotation().as_mat3(),
            center: camera.center(),
            focal,
            principal,
            low: [-principal[0] / focal[0] - margin[0], -principal[1] / focal[1] - margin[1]],
            high: [(w - principal[0]) / focal[0] + margin[0], (h - principal[1]) / focal[1] + margin[1]],
        }
    }
}

/// A projected Gaussian, ready to blend.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Splat {
    /// Centre (px).
    pub(crate) mean: [f32; 2],
    /// Inverse of the filtered covariance: xx, xy, yy (1/px^2).
    pub(crate) conic: [f32; 3],
    /// Opacity, antialiasing compensation included.
    pub(crate) opacity: f32,
    /// Colour, clamped at 0.
    pub(crate) colour: [f32; 3],
    /// Camera z (m).
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

/// Everything of the projection that the backward pass needs again.
pub(crate) struct Ewa {
    /// Position in the camera (m).
    pub(crate) point: Vec3,
    /// Clamped x/z, y/z.
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
}

/// Filtered covariance, its inverse and the antialiasing compensation.
pub(crate) struct Filtered {
    pub(crate) covariance: [f32; 3],
    pub(crate) conic: [f32; 3],
    pub(crate) determinants: [f32; 2],
    pub(crate) compensation: f32,
}

/// Rotation matrix of a unit quaternion (w, x, y, z).
pub(crate) fn rotation_of([w, x, y, z]: [f32; 4]) -> Mat3 {
    Mat3::from_cols(
        Vec3::new(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)),
        Vec3::new(2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)),
        Vec3::new(2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)),
    )
}

/// Unit quaternion and the length it had; the identity for a zero quaternion.
pub(crate) fn normalised(q: [f32; 4]) -> ([f32; 4], f32) {
    let length = q.iter().map(|v| v * v).sum::<f32>().sqrt();
    if length > 0.0 { (q.map(|v| v / length), length) } else { ([1.0, 0.0, 0.0, 0.0], 1.0) }
}

/// Position of a Gaussian relative to the camera's centre (m, world axes).
pub(crate) fn offset(mean: [f32; 3], center: DVec3) -> Vec3 {
    (DVec3::new(f64::from(mean[0]), f64::from(mean[1]), f64::from(mean[2])) - center).as_vec3()
}

/// Projects the shape of Gaussian `i`; `None` behind the near plane or where a parameter is not finite.
pub(crate) fn ewa(g: &Gaussians, i: usize, camera: &PinholeF32) -> Option<Ewa> {
    let point = camera.rotation * offset(g.means[i], camera.center);
    if !(point.z >= NEAR && point.is_finite()) {
        return None;
    }
    let raw = [point.x / point.z, point.y / point.z];
    let slope = [0, 1].map(|a| raw[a].clamp(camera.low[a], camera.high[a]));
    let [fx, fy] = camera.focal.map(|f| f / point.z);
    let jacobian = [Vec3::new(fx, 0.0, -fx * slope[0]), Vec3::new(0.0, fy, -fy * slope[1])];
    let to_pixels = jacobian.map(|row| camera.rotation.transpose() * row);
    let rotation = rotation_of(normalised(g.quats[i]).0);
    let scales = Vec3::from(g.log_scales[i].map(f32::exp));
    let shape = rotation * Mat3::from_diagonal(scales);
    let axes = to_pixels.map(|row| shape.transpose() * row);
    let covariance = [axes[0].dot(axes[0]), axes[0].dot(axes[1]), axes[1].dot(axes[1])];
    let clamped = [raw[0] != slope[0], raw[1] != slope[1]];
    let ewa = Ewa { point, slope, clamped, jacobian, to_pixels, scales, shape, axes, covariance };
    covariance.iter().all(|v| v.is_finite()).then_some(ewa)
}

/// Applies the pixel filter to a projected covariance.
pub(crate) fn filter(covariance: [f32; 3], antialiased: bool) -> Filtered {
    let [xx, xy, yy] = covariance;
    let (fxx, fyy) = (xx + PIXEL_FILTER, yy + PIXEL_FILTER);
    // Long needles cancel here: f64 keeps their conic.
    let determinant = |p: f32, q: f32| (f64::from(p) * f64::from(q) - f64::from(xy) * f64::from(xy)) as f32;
    let determinants = [determinant(xx, yy), determinant(fxx, fyy)];
    let ratio = (determinants[0] / determinants[1]).max(MIN_COMPENSATION * MIN_COMPENSATION);
    let inverse = 1.0 / determinants[1];
    Filtered {
        covariance: [fxx, xy, fyy],
        conic: [fyy * inverse, -xy * inverse, fxx * inverse],
        determinants,
        compensation: if antialiased { ratio.sqrt() } else { 1.0 },
    }
}

/// Whether the compensation is above its floor, so that it has a derivative.
pub(crate) fn compensation_is_free(filtered: &Filtered) -> bool {
    filtered.determinants[0] / filtered.determinants[1] > MIN_COMPENSATION * MIN_COMPENSATION
}

/// The splat of Gaussian `i` without colour and spans, and its filtered covariance; `None` when it cannot show.
pub(crate) fn splat(
    g: &Gaussians,
    i: usize,
    camera: &PinholeF32,
    options: RenderOptions,
) -> Option<(Splat, [f32; 3])> {
    let opacity = sigmoid(g.opacity_logits[i]);
    if !(opacity >= MIN_ALPHA) {
        return None;
    }
    let ewa = ewa(g, i, camera)?;
    let filtered = filter(ewa.covariance, options.antialiased);
    let opacity = opacity * filtered.compensation;
    // A needle can round to a singular covariance; there is nothing sensible to blend then.
    if !(filtered.determinants[1] > 0.0 && opacity >= MIN_ALPHA) {
        return None;
    }
    let mean = [0, 1].map(|a| camera.focal[a] * ewa.point[a] / ewa.point.z + camera.principal[a]);
    let [a, _, _] = filtered.conic;
    let mut splat = Splat {
        mean,
        conic: filtered.conic,
        opacity,
        depth: ewa.point.z,
        reach: (255.0 * opacity).ln(),
        shrink: 1.0 / (filtered.determinants[1] * a * a),
        index: i as u32,
        ..Splat::default()
    };
    splat.half_height = (splat.squared_reach() * filtered.covariance[2]).sqrt() + 1e-3;
    Some((splat, filtered.covariance))
}

/// Degree to evaluate: the options', bounded by the Gaussians' own.
pub(crate) fn active_degree(g: &Gaussians, options: RenderOptions) -> usize {
    options.sh_degree.map_or(g.sh_degree(), |d| d.min(g.sh_degree()))
}

/// Colour of Gaussian `i` seen from the camera before the clamp at 0.
pub(crate) fn view_colour(g: &Gaussians, i: usize, camera: &PinholeF32, degree: usize) -> Vec3 {
    let direction = offset(g.means[i], camera.center).normalize_or_zero();
    let basis = spherical_harmonics::basis(degree, direction);
    spherical_harmonics::colour(&basis, &g.sh_of(i)[..sh_coefficients(degree)])
}
