// One view to render, and what every stage of the rasterizer shares. Host side: `ViewUniform` in rasterizer-gpu.

struct View {
    // Rows of the rotation of camera_from_world.
    rotation: array<vec4f, 3>,
    // Camera centre (m) as the sum of two floats, so that city-scale coordinates lose nothing.
    center_high: vec3f,
    count: u32,
    center_low: vec3f,
    sh_degree: u32,
    focal: vec2f,
    principal: vec2f,
    // Bounds of x/z, y/z at which a projection is linearised.
    slope_low: vec2f,
    slope_high: vec2f,
    size: vec2u,
    tiles: vec2u,
    background: vec3f,
    sh_stride: u32,
    antialiased: u32,
    slots: u32,
    span_capacity: u32,
    pair_capacity: u32,
    // 1: pixels lie between the layers of `layers`; 0: over `background`.
    layered: u32,
    // Number of the training step; a gradient with another stamp is stale.
    stamp: u32,
    with_pose: u32,
    // Gaussians whose hash lies below are left out; 0: none is.
    dropout_threshold: u32,
    dropout_draw: u32,
    // Factor of the opacities of the others.
    dropout_gain: f32,
    // Variance added to the projected covariance (px^2).
    pixel_filter: f32,
    // Factor of distances from the frustum: 0 where every projection is linear around the centre, else 1.
    beyond: f32,
    // Parts of a tile's list that are differentiated side by side, at most.
    parts: u32,
    padding_a: u32,
    padding_b: u32,
    padding_c: u32,
}

// A Gaussian's parameters other than its colour; also their gradients and moments.
struct Geometry {
    mean: vec3f,
    opacity_logit: f32,
    quat: vec4f,
    log_scale: vec3f,
    padding: f32,
}

// A projected Gaussian, ready to blend.
struct Splat {
    // Centre (px).
    mean: vec2f,
    // Camera z of the point where the projection is linearised (m).
    depth: f32,
    // Antialiasing compensation included.
    opacity: f32,
    // The exponent of offset d as a sum of squares, sigma = y (d.x + x d.y)^2 + z d.y^2: the form with the inverse
    // covariance cancels for needles.
    shape: vec3f,
    padding: f32,
    // Clamped at 0.
    colour: vec3f,
    padding2: f32,
}

// Side of a square tile (px).
const TILE: u32 = 16u;
// Pixels per tile.
const AREA: u32 = 256u;
// Contributions below this opacity are skipped.
const MIN_ALPHA: f32 = 1.0 / 255.0;
// Opacity of one contribution is capped here, so that transmittance never reaches 0.
const MAX_ALPHA: f32 = 0.99;
// A pixel is finished before the contribution that would bring its transmittance to this value.
const MIN_TRANSMITTANCE: f32 = 1e-4;
// A tile that is not computed.
const NO_SLOT: u32 = 0xffffffffu;
// Derivatives, or sums, per (tile, splat) entry.
const ENTRY: u32 = 9u;

// Tested on the bits: compilers may assume that a float is never NaN.
fn is_finite(x: f32) -> bool {
    return (bitcast<u32>(x) & 0x7f800000u) != 0x7f800000u;
}

fn all_finite(v: vec3f) -> bool {
    return is_finite(v.x) && is_finite(v.y) && is_finite(v.z);
}
