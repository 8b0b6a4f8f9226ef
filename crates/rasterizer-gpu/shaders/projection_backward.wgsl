// From derivatives per entry to derivatives of the Gaussians' parameters: sums each splat's entries in their order
// and goes back through the projection.
// Floor: 36 B per pair; 64 B read and 64 B written per Gaussian in sight, and 36 B per SH coefficient; about 900
// operations.
//
// twin: rasterizer::projection_backward::to_parameters
// test: rasterizer-gpu/tests/parity.rs::random_scenes_agree
// bench: kernel/projection_backward

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> geometry: array<Geometry>;
@group(0) @binding(2) var<storage, read> sh: array<f32>;
@group(0) @binding(3) var<storage, read> extents: array<vec4u>;
@group(0) @binding(4) var<storage, read> entries: array<f32>;
@group(0) @binding(5) var<storage, read_write> geometry_gradient: array<Geometry>;
@group(0) @binding(6) var<storage, read_write> sh_gradient: array<f32>;
@group(0) @binding(7) var<storage, read_write> ledger: array<Ledger>;
// Per Gaussian, derivatives by the rows of the rotation and by the translation of camera_from_world; only when asked for.
@group(0) @binding(8) var<storage, read_write> pose: array<array<f32, 12>>;

// Derivative by the projected axes, a column per axis of the Gaussian: -2 Q G Q a, with Q the conic and G the symmetric
// derivative by it. Q a cancels for needles; in its place adj(C) a = sum over other axes b of (b x a) b' + filter a, where
// b' is b turned by a right angle and the products b x a are the components of `area`.
fn axes_gradient(e: Ewa, conic: vec3f, g: vec3f) -> array<vec3f, 2> {
    let x = e.axes[0];
    let y = e.axes[1];
    let turned_x = vec3f(
        y.y * e.area.z - y.z * e.area.y,
        y.z * e.area.x - y.x * e.area.z,
        y.x * e.area.y - y.y * e.area.x,
    );
    let turned_y = vec3f(
        x.z * e.area.y - x.y * e.area.z,
        x.x * e.area.z - x.z * e.area.x,
        x.y * e.area.x - x.x * e.area.y,
    );
    let qx = (turned_x + view.pixel_filter * x) / e.determinants.y;
    let qy = (turned_y + view.pixel_filter * y) / e.determinants.y;
    let gx = -2.0 * g.x * qx - g.y * qy;
    let gy = -g.y * qx - 2.0 * g.z * qy;
    return array(conic.x * gx + conic.y * gy, conic.y * gx + conic.z * gy);
}

// By the covariance, through compensation = sqrt(det / det_filtered); `upstream` is the derivative by it.
fn compensation_gradient(e: Ewa, upstream: f32) -> vec3f {
    let ratio = e.determinants.x / e.determinants.y;
    if view.antialiased == 0u || !(ratio > MIN_COMPENSATION * MIN_COMPENSATION) {
        return vec3f(0.0);
    }
    let d0 = upstream / (2.0 * compensation_of(e)) / e.determinants.y;
    let d1 = -d0 * ratio;
    let raw = e.covariance;
    return vec3f(
        d0 * raw.z + d1 * e.filtered.z,
        -2.0 * raw.y * (d0 + d1),
        d0 * raw.x + d1 * e.filtered.x,
    );
}

struct ShapeGradient {
    // By the centre and by rotation * diag(scales), and what the pose needs besides.
    moved: ExpansionGradient,
    // By the rows of the Jacobian times the camera's rotation.
    to_pixels: array<vec3f, 2>,
}

fn shape_gradient(e: Ewa, d_axes: array<vec3f, 2>, mean2d: vec2f) -> ShapeGradient {
    var g: ShapeGradient;
    var d_shape: mat3x3f;
    var d_point: vec3f;
    let rotation = camera_rotation();
    let point = e.expansion.point;
    let z = point.z;
    for (var axis = 0u; axis < 2u; axis++) {
        let row = e.to_pixels[axis];
        let d = d_axes[axis];
        d_shape += mat3x3f(row * d.x, row * d.y, row * d.z);
        g.to_pixels[axis] = e.shape * d;
        let f = view.focal[axis];
        let d_jacobian = rotation * g.to_pixels[axis] + e.expansion.rest * mean2d[axis];
        // Jacobian row: f/z on the axis, -f slope / z along the optical axis.
        let along = f * e.slope[axis] / (z * z) * d_jacobian.z;
        d_point.z += along - f / (z * z) * d_jacobian[axis];
        if !e.clamped[axis] {
            d_point[axis] -= f / (z * z) * d_jacobian.z;
            d_point.z += along;
        }
        d_point[axis] += f / z * mean2d[axis];
        d_point.z -= f * point[axis] / (z * z) * mean2d[axis];
    }
    let d_rest = e.jacobian[0] * mean2d.x + e.jacobian[1] * mean2d.y;
    g.moved = expansion_gradient(e.expansion, d_point, d_rest, e.shape, rotation);
    g.moved.shape += d_shape;
    return g;
}

// By the entries of a quaternion, given the derivative by the rotation matrix of its unit quaternion.
fn quaternion_gradient(q: vec4f, d: mat3x3f) -> vec4f {
    let u = unit_quaternion(q);
    let w = u.x;
    let x = u.y;
    let y = u.z;
    let z = u.w;
    let by_unit = vec4f(
        2.0 * (x * (d[1][2] - d[2][1]) + y * (d[2][0] - d[0][2]) + z * (d[0][1] - d[1][0])),
        2.0 * (y * (d[1][0] + d[0][1]) + z * (d[2][0] + d[0][2]) + w * (d[1][2] - d[2][1]))
            - 4.0 * x * (d[1][1] + d[2][2]),
        2.0 * (x * (d[1][0] + d[0][1]) + z * (d[2][1] + d[1][2]) + w * (d[2][0] - d[0][2]))
            - 4.0 * y * (d[0][0] + d[2][2]),
        2.0 * (x * (d[2][0] + d[0][2]) + y * (d[2][1] + d[1][2]) + w * (d[0][1] - d[1][0]))
            - 4.0 * z * (d[0][0] + d[1][1]),
    );
    let squared = dot(q, q);
    let length = select(1.0, sqrt(squared), squared > 0.0);
    return (by_unit - dot(by_unit, u) * u) / length;
}

// Adds to the derivative by a coefficient; a fresh one starts here.
fn add_sh(i: u32, k: u32, by: vec3f, fresh: bool) {
    let at = (i * view.sh_stride + k) * 3u;
    var d = by;
    if !fresh {
        d += vec3f(sh_gradient[at], sh_gradient[at + 1u], sh_gradient[at + 2u]);
    }
    sh_gradient[at] = d.x;
    sh_gradient[at + 1u] = d.y;
    sh_gradient[at + 2u] = d.z;
}

// The same for coefficient k with its basis value; returns the derivative by the direction, given that of the basis.
fn add_band(i: u32, k: u32, basis: f32, slope: vec3f, shown: vec3f, fresh: bool) -> vec3f {
    add_sh(i, k, basis * shown, fresh);
    return slope * dot(sh_at(i, k), shown);
}

// Writes the SH derivatives and returns that by the mean through the viewing direction.
fn colour_gradient(i: u32, offset: vec3f, upstream: vec3f, fresh: bool) -> vec3f {
    let distance = length(offset);
    let direction = select(vec3f(0.0), offset / distance, distance > 0.0);
    let colour = sh_colour(i, view.sh_degree, direction);
    let shown = select(vec3f(0.0), upstream, colour > vec3f(0.0));
    let b = sh_basis(view.sh_degree, direction);
    let g = sh_basis_gradient(view.sh_degree, direction);
    add_sh(i, 0u, b[0] * shown, fresh);
    var along = vec3f(0.0);
    if view.sh_degree >= 1u {
        along += add_band(i, 1u, b[1], g[1], shown, fresh);
        along += add_band(i, 2u, b[2], g[2], shown, fresh);
        along += add_band(i, 3u, b[3], g[3], shown, fresh);
    }
    if view.sh_degree >= 2u {
        along += add_band(i, 4u, b[4], g[4], shown, fresh);
        along += add_band(i, 5u, b[5], g[5], shown, fresh);
        along += add_band(i, 6u, b[6], g[6], shown, fresh);
        along += add_band(i, 7u, b[7], g[7], shown, fresh);
        along += add_band(i, 8u, b[8], g[8], shown, fresh);
    }
    if view.sh_degree >= 3u {
        along += add_band(i, 9u, b[9], g[9], shown, fresh);
        along += add_band(i, 10u, b[10], g[10], shown, fresh);
        along += add_band(i, 11u, b[11], g[11], shown, fresh);
        along += add_band(i, 12u, b[12], g[12], shown, fresh);
        along += add_band(i, 13u, b[13], g[13], shown, fresh);
        along += add_band(i, 14u, b[14], g[14], shown, fresh);
        along += add_band(i, 15u, b[15], g[15], shown, fresh);
    }
    if fresh {
        for (var k = sh_coefficients(view.sh_degree); k < view.sh_stride; k++) {
            add_sh(i, k, vec3f(0.0), true);
        }
    }
    if view.sh_degree == 0u || !(distance > 0.0) {
        return vec3f(0.0);
    }
    return (along - direction * dot(direction, along)) / distance;
}

// Through the camera-space position, the projected shape and the camera centre that the viewing direction starts from.
fn write_pose(i: u32, mean: vec3f, e: Ewa, shape: ShapeGradient, from_direction: vec3f) {
    let rotation = camera_rotation();
    let toward_center = rotation * from_direction;
    let center = rotation * (view.center_high + view.center_low);
    for (var row = 0u; row < 3u; row++) {
        var d = shape.moved.centre[row] * mean - center[row] * from_direction;
        for (var pair = 0u; pair < 2u; pair++) {
            d += e.jacobian[pair][row] * shape.to_pixels[pair];
            d += shape.moved.in_camera[pair][row] * shape.moved.in_world[pair];
        }
        pose[i][row * 3u] = d.x;
        pose[i][row * 3u + 1u] = d.y;
        pose[i][row * 3u + 2u] = d.z;
        pose[i][9u + row] = shape.moved.centre[row] + toward_center[row];
    }
}

@compute @workgroup_size(256)
fn projection_backward(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let i = linear_group(group, groups) * 256u + local;
    if i >= view.count {
        return;
    }
    let extent = extents[i];
    if extent.x == 0u {
        return;
    }
    // As `entries` of common/backward.wgsl.
    var moments = vec4f(0.0);
    var more = vec4f(0.0);
    var blue = 0.0;
    let end = min(extent.w + extent.x, view.pair_capacity);
    for (var entry = extent.w; entry < end; entry++) {
        let at = entry * ENTRY;
        moments += vec4f(entries[at], entries[at + 1u], entries[at + 2u], entries[at + 3u]);
        more += vec4f(entries[at + 4u], entries[at + 5u], entries[at + 6u], entries[at + 7u]);
        blue += entries[at + 8u];
    }
    let g = geometry[i];
    let e = project_shape(g);
    let conic = conic_of(e);
    let mean2d = vec2f(conic.x * moments.x + conic.y * moments.y, conic.y * moments.x + conic.z * moments.y);
    let alpha = sigmoid(g.opacity_logit);
    let factor = dropout_factor(i);
    var d_axes = axes_gradient(e, conic, vec3f(-0.5 * moments.z, -moments.w, -0.5 * more.x));
    let compensation = compensation_gradient(e, more.y * min(alpha * factor, 1.0));
    d_axes[0] += 2.0 * compensation.x * e.axes[0] + compensation.y * e.axes[1];
    d_axes[1] += compensation.y * e.axes[0] + 2.0 * compensation.z * e.axes[1];
    let shape = shape_gradient(e, d_axes, mean2d);

    let fresh = ledger[i].stamp != view.stamp;
    let from_direction = colour_gradient(i, e.offset, vec3f(more.zw, blue), fresh);
    var d: Geometry;
    if !fresh {
        d = geometry_gradient[i];
    }
    d.mean += transpose(camera_rotation()) * shape.moved.centre + from_direction;
    let by_shape = shape.moved.shape;
    let turn = mat3x3f(by_shape[0] * e.scales.x, by_shape[1] * e.scales.y, by_shape[2] * e.scales.z);
    d.quat += quaternion_gradient(g.quat, turn);
    d.log_scale += vec3f(
        dot(by_shape[0], e.shape[0]),
        dot(by_shape[1], e.shape[1]),
        dot(by_shape[2], e.shape[2]),
    );
    // None at the bound of 1.
    let slope = select(alpha * (1.0 - alpha) * factor, 0.0, alpha * factor > 1.0);
    d.opacity_logit += more.y * compensation_of(e) * slope;
    geometry_gradient[i] = d;
    ledger[i].stamp = view.stamp;
    if fresh {
        ledger[i].steps += 1u;
    }
    ledger[i].views += 1u;
    ledger[i].gradient_norm += length(mean2d * vec2f(view.size) * 0.5);
    if view.with_pose != 0u {
        write_pose(i, g.mean, e, shape, from_direction);
    }
}
