//! Constants that the CPU and the GPU share; a test of `ffgs-rasterizer-gpu` compares them with those of the shaders.

/// Side of a square tile in pixels: one 16-lane vector per row.
pub const TILE: usize = 16;
/// Pixels per tile.
pub const AREA: usize = TILE * TILE;
/// Contributions below this opacity are skipped.
pub const MIN_ALPHA: f32 = 1.0 / 255.0;
/// Opacity of one contribution is capped here, so that transmittance never reaches 0.
pub const MAX_ALPHA: f32 = 0.99;
/// A pixel is finished before the contribution that would bring its transmittance to this value.
pub const MIN_TRANSMITTANCE: f32 = 1e-4;
/// Variance added to the projected covariance (px^2): the pixel filter of 3D Gaussian Splatting.
pub const PIXEL_FILTER: f32 = 0.3;
/// Lower bound of the antialiasing compensation.
pub const MIN_COMPENSATION: f32 = 0.005;
/// A projection is linearised around a Gaussian's centre inside the frustum widened by this share of its half-angle's tangent, and
/// around a point that is seen outside of it.
pub const FRUSTUM_MARGIN: f32 = 0.3;
/// Gaussians nearer to the camera plane than this share of their largest standard deviation are not rendered: their projection
/// is not affine at all. A share and no distance, as captures have no common unit.
pub const NEAR: f32 = 0.01;
/// Least variance of a Gaussian along the normal of a frustum's side (m^2): keeps one without extent finite.
pub const LEAST_VARIANCE: f32 = 1e-30;
/// Number of sums per entry: derivatives with respect to mean x, y; second moments of the derivative with respect to the
/// exponent, about the ridge (e^2, e dy, dy^2); derivatives with respect to opacity; colour r, g, b.
pub const ENTRY: usize = 9;
