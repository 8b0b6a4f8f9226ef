// One step along the natural gradient of all parameters but the colours, for the Gaussians that the step's view saw: the
// first moment over what is known, in units of the loss.
// Floor: 260 B per Gaussian.
//
// twin: trainer::natural::Curvature
// test: trainer-gpu/src/tests.rs::natural_steps_agree
// bench: gpu/prior

@group(0) @binding(0) var<uniform> prior: Prior;
@group(0) @binding(1) var<uniform> natural: Natural;
@group(0) @binding(2) var<storage, read> ledger: array<Ledger>;
// Factors of the two moments by number of steps.
@group(0) @binding(3) var<storage, read> corrections: array<vec2f>;
// Views that see each Gaussian.
@group(0) @binding(4) var<storage, read> seen: array<u32>;
// Diagonal: turns about the body's axes in the last three places of `quat`; `mean` is not used.
@group(0) @binding(5) var<storage, read> known: array<Geometry>;
// xx, xy, xz, yy; yz, zz of the positions.
@group(0) @binding(6) var<storage, read> positions: array<array<vec4f, 2>>;
@group(0) @binding(7) var<storage, read> gradient: array<Geometry>;
@group(0) @binding(8) var<storage, read_write> now: array<Geometry>;
@group(0) @binding(9) var<storage, read_write> first: array<Geometry>;

// Solves `matrix x = b`, symmetric; scaled by the trace, as products of three informations would overflow.
fn solved(p: array<vec4f, 2>, damping: f32, b: vec3f) -> vec3f {
    let trace = p[0].x + p[0].w + p[1].y + 3.0 * damping;
    let m = mat3x3f(
        vec3f(p[0].x + damping, p[0].y, p[0].z) / trace,
        vec3f(p[0].y, p[0].w + damping, p[1].x) / trace,
        vec3f(p[0].z, p[1].x, p[1].y + damping) / trace,
    );
    let columns = mat3x3f(cross(m[1], m[2]), cross(m[2], m[0]), cross(m[0], m[1]));
    return (transpose(columns) * b) / (dot(m[0], columns[0]) * trace);
}

@compute @workgroup_size(256)
fn natural_geometry(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let i = linear_group(group, groups) * 256u + local;
    if i >= prior.items || i < natural.fixed || ledger[i].stamp != natural.stamp {
        return;
    }
    let correction = corrections[min(ledger[i].steps, CORRECTED_STEPS)].x;
    let per_nat = natural.share * correction * f32(max(seen[i], 1u));
    let down = gradient[i];
    var mean = first[i];
    mean.mean += (1.0 - BETA1) * (down.mean - mean.mean);
    mean.quat += (1.0 - BETA1) * (down.quat - mean.quat);
    mean.log_scale += (1.0 - BETA1) * (down.log_scale - mean.log_scale);
    mean.opacity_logit += (1.0 - BETA1) * (down.opacity_logit - mean.opacity_logit);
    first[i] = mean;

    let step = per_nat * solved(positions[i], prior.damping_means, mean.mean);
    now[i].mean -= vec3f(
        limited(step.x, natural.means),
        limited(step.y, natural.means),
        limited(step.z, natural.means),
    );
    // Columns: twice the changes of w, x, y, z with turns about x, y and z.
    let q = now[i].quat;
    let about_x = vec4f(-q.y, q.x, q.w, -q.z);
    let about_y = vec4f(-q.z, -q.w, q.x, q.y);
    let about_z = vec4f(-q.w, q.z, -q.y, q.x);
    let slope = 0.5 * vec3f(dot(about_x, mean.quat), dot(about_y, mean.quat), dot(about_z, mean.quat));
    let turn = per_nat * slope / (known[i].quat.yzw + prior.damping_turns);
    now[i].quat -= 0.5 * (limited(turn.x, natural.quats) * about_x
        + limited(turn.y, natural.quats) * about_y
        + limited(turn.z, natural.quats) * about_z);
    let scale = per_nat * mean.log_scale / (known[i].log_scale + prior.damping_scales);
    now[i].log_scale -= vec3f(
        limited(scale.x, natural.scales),
        limited(scale.y, natural.scales),
        limited(scale.z, natural.scales),
    );
    let opacity = per_nat * mean.opacity_logit / (known[i].opacity_logit + prior.damping_opacities);
    now[i].opacity_logit -= limited(opacity, natural.opacities);
}
