// EWA projection of one Gaussian, shared by the forward and the backward pass; `view` is the uniform of the entry file.
// CPU twin: rasterizer/src/projection.rs.

// Lower bound of the antialiasing compensation.
const MIN_COMPENSATION: f32 = 0.005;
// Gaussians nearer to the camera plane than this share of their largest standard deviation are not rendered.
const NEAR: f32 = 0.01;
// exp() of more is beyond every opacity and size; infinite parameters end here.
const MAX_EXPONENT: f32 = 80.0;

struct Ewa {
    // Where the projection is linearised.
    expansion: Expansion,
    // Centre (px), relative to the principal point.
    mean: vec2f,
    // Position relative to the camera's centre (m, world axes).
    offset: vec3f,
    // Clamped x/z, y/z of that point, and whether the clamp acted.
    slope: vec2f,
    clamped: vec2<bool>,
    // Rows of the projection's Jacobian, and these times the camera's rotation.
    jacobian: array<vec3f, 2>,
    to_pixels: array<vec3f, 2>,
    // Standard deviations (m).
    scales: vec3f,
    // rotation * diag(scales).
    shape: mat3x3f,
    // Projected axes: the covariance is their rows' inner products.
    axes: array<vec3f, 2>,
    // Their cross product.
    area: vec3f,
    // Unfiltered and filtered covariance xx, xy, yy (px^2) and their determinants.
    covariance: vec3f,
    filtered: vec3f,
    determinants: vec2f,
    valid: bool,
}

fn camera_rotation() -> mat3x3f {
    return transpose(mat3x3f(view.rotation[0].xyz, view.rotation[1].xyz, view.rotation[2].xyz));
}

// Rotation matrix of a unit quaternion (w, x, y, z).
fn rotation_of(q: vec4f) -> mat3x3f {
    let w = q.x;
    let x = q.y;
    let y = q.z;
    let z = q.w;
    return mat3x3f(
        vec3f(1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)),
        vec3f(2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)),
        vec3f(2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)),
    );
}

// Unit quaternion; the identity for a zero quaternion.
fn unit_quaternion(q: vec4f) -> vec4f {
    let squared = dot(q, q);
    return select(vec4f(1.0, 0.0, 0.0, 0.0), q / sqrt(squared), squared > 0.0);
}

fn sigmoid(x: f32) -> f32 {
    return 1.0 / (1.0 + exp(-clamp(x, -MAX_EXPONENT, MAX_EXPONENT)));
}

fn is_number(g: Geometry) -> bool {
    // Infinite sizes and opacities have a limit; an infinite place or turn has none.
    let sizes = all(g.log_scale == g.log_scale) && g.opacity_logit == g.opacity_logit;
    let turn = all_finite(g.quat.xyz) && is_finite(g.quat.w);
    return sizes && turn && all_finite(g.mean);
}

fn project_shape(g: Geometry) -> Ewa {
    var e: Ewa;
    let rotation = camera_rotation();
    e.offset = (g.mean - view.center_high) - view.center_low;
    let centre = rotation * e.offset;
    e.scales = exp(clamp(g.log_scale, vec3f(-MAX_EXPONENT), vec3f(MAX_EXPONENT)));
    let nearest = NEAR * max(e.scales.x, max(e.scales.y, e.scales.z));
    if !(is_number(g) && centre.z >= nearest && all_finite(centre)) {
        return e;
    }
    let turn = rotation_of(unit_quaternion(g.quat));
    e.shape = mat3x3f(turn[0] * e.scales.x, turn[1] * e.scales.y, turn[2] * e.scales.z);
    e.expansion = expansion_of(centre, e.shape, rotation);
    let point = e.expansion.point;
    if !(point.z >= nearest && all_finite(point)) {
        return e;
    }
    let raw = point.xy / point.z;
    e.slope = clamp(raw, view.slope_low, view.slope_high);
    e.clamped = raw != e.slope;
    let f = view.focal / point.z;
    e.jacobian[0] = vec3f(f.x, 0.0, -f.x * e.slope.x);
    e.jacobian[1] = vec3f(0.0, f.y, -f.y * e.slope.y);
    e.mean = view.focal * raw + vec2f(dot(e.jacobian[0], e.expansion.rest), dot(e.jacobian[1], e.expansion.rest));
    e.to_pixels[0] = e.jacobian[0] * rotation;
    e.to_pixels[1] = e.jacobian[1] * rotation;
    e.axes[0] = e.to_pixels[0] * e.shape;
    e.axes[1] = e.to_pixels[1] * e.shape;
    e.covariance = vec3f(dot(e.axes[0], e.axes[0]), dot(e.axes[0], e.axes[1]), dot(e.axes[1], e.axes[1]));
    e.filtered = e.covariance + vec3f(view.pixel_filter, 0.0, view.pixel_filter);
    // xx yy - xy^2 cancels for needles; as the squared area of the projected axes nothing does (Lagrange's identity).
    e.area = cross(e.axes[0], e.axes[1]);
    let determinant = dot(e.area, e.area);
    let trace = e.covariance.x + e.covariance.z;
    e.determinants = vec2f(determinant, determinant + view.pixel_filter * trace + view.pixel_filter * view.pixel_filter);
    e.valid = all_finite(e.filtered) && is_finite(e.determinants.y) && e.determinants.y > 0.0;
    return e;
}

// PCG-RXS-M-XS, as in rasterizer/src/dropout.rs.
fn hash(value: u32) -> u32 {
    let state = value * 747796405u + 2891336453u;
    let word = ((state >> ((state >> 28u) + 4u)) ^ state) * 277803737u;
    return (word >> 22u) ^ word;
}

// Factor of the opacity of Gaussian i: 0 where it is left out, 1 without dropout.
fn dropout_factor(i: u32) -> f32 {
    return select(view.dropout_gain, 0.0, hash(i + hash(view.dropout_draw)) < view.dropout_threshold);
}

// Inverse of the filtered covariance: xx, xy, yy (1/px^2).
fn conic_of(e: Ewa) -> vec3f {
    return vec3f(e.filtered.z, -e.filtered.y, e.filtered.x) / e.determinants.y;
}

// The same as `Splat.shape`: its Cholesky factors.
fn shape_of(e: Ewa) -> vec3f {
    return vec3f(-e.filtered.y / e.filtered.z, 0.5 * e.filtered.z / e.determinants.y, 0.5 / e.filtered.z);
}

// Share of the splat that survives the pixel filter (Mip-Splatting); 1 when not asked for.
fn compensation_of(e: Ewa) -> f32 {
    let ratio = max(e.determinants.x / e.determinants.y, MIN_COMPENSATION * MIN_COMPENSATION);
    return select(1.0, sqrt(ratio), view.antialiased != 0u);
}
