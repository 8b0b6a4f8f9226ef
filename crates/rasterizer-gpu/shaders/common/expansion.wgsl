// Where the projection of a Gaussian is linearised (docs/adr/0064-projections-are-linear-where-they-are-seen.md); `view` is the
// uniform of the entry file.
// CPU twin: rasterizer/src/expansion.rs.

// Least variance along a normal (m^2): keeps a Gaussian without any extent finite.
const LEAST_VARIANCE: f32 = 1e-30;

struct Expansion {
    // The point in the camera (m), and from there to the centre; 0 inside the widened frustum.
    point: vec3f,
    rest: vec3f,
    // Normal of the frustum's side, and the covariance times this normal; camera axes.
    normal: vec3f,
    along: vec3f,
    // shape^T R^T normal.
    scaled: vec3f,
    // Variance along the normal, and the centre's distance from the side in units of the normal.
    variance: f32,
    distance: f32,
}

// From the side to the mean of what lies behind it: factor of the distance, and its derivative, for the square of the distance
// in standard deviations.
fn to_mean(squared: f32) -> vec2f {
    let damped = 1.0 / (1.0 + squared);
    return vec2f(1.0 + damped, -damped * damped);
}

// Of a Gaussian at `centre` (m, camera axes) of `shape`, rotation * diag(scales) in world axes.
fn expansion_of(centre: vec3f, shape: mat3x3f, rotation: mat3x3f) -> Expansion {
    var e: Expansion;
    let raw = centre.xy / centre.z;
    let slope = clamp(raw, view.slope_low, view.slope_high);
    let distances = select(view.beyond * (centre.xy - slope * centre.z), vec2f(0.0), raw == slope);
    let normals = array(vec3f(1.0, 0.0, -slope.x), vec3f(0.0, 1.0, -slope.y));
    let scaled = array((normals[0] * rotation) * shape, (normals[1] * rotation) * shape);
    let variances = max(vec2f(dot(scaled[0], scaled[0]), dot(scaled[1], scaled[1])), vec2f(LEAST_VARIANCE));
    // By standard deviations.
    let ratios = distances * distances * variances.yx;
    let side = select(1u, 0u, ratios.x >= ratios.y);
    e.normal = normals[side];
    e.scaled = scaled[side];
    e.variance = variances[side];
    e.along = rotation * (shape * e.scaled);
    e.distance = distances[side];
    let factor = to_mean(e.distance * e.distance / e.variance).x;
    e.rest = e.along * (factor * e.distance / e.variance);
    e.point = centre - e.rest;
    return e;
}

// Derivatives by what the point of linearisation depends on.
struct ExpansionGradient {
    // By the centre in the camera.
    centre: vec3f,
    // By rotation * diag(scales).
    shape: mat3x3f,
    // By the camera's rotation: outer products of the former, camera axes, with the latter, world axes.
    in_camera: array<vec3f, 2>,
    in_world: array<vec3f, 2>,
}

// From the derivatives by point and rest.
fn expansion_gradient(
    e: Expansion,
    by_point: vec3f,
    by_rest: vec3f,
    shape: mat3x3f,
    rotation: mat3x3f,
) -> ExpansionGradient {
    var g: ExpansionGradient;
    g.centre = by_point;
    if e.distance == 0.0 {
        return g;
    }
    let d_rest = by_rest - by_point;
    let ratio = e.distance / e.variance;
    let squared = e.distance * ratio;
    let factor = to_mean(squared);
    let d_share = dot(d_rest, e.along);
    let d_distance = d_share * (factor.x + 2.0 * factor.y * squared) / e.variance;
    let d_variance = -d_share * ratio * (factor.x + factor.y * squared) / e.variance;
    let d_along = d_rest * (factor.x * ratio);
    let d_along_world = d_along * rotation;
    let normal_world = e.normal * rotation;
    let d_scaled = d_along_world * shape + 2.0 * d_variance * e.scaled;
    g.centre += e.normal * d_distance;
    g.shape = mat3x3f(
        d_along_world * e.scaled.x + normal_world * d_scaled.x,
        d_along_world * e.scaled.y + normal_world * d_scaled.y,
        d_along_world * e.scaled.z + normal_world * d_scaled.z,
    );
    g.in_camera = array(d_along, e.normal);
    g.in_world = array(shape * e.scaled, shape * d_scaled);
    return g;
}
