// Adds the derivative of `1/2 d^T Lambda d`, d = change since the start, to the gradient of the step: all parameters
// but the colours, for the Gaussians that the step's view saw, shared out over the views that see each.
// Floor: 240 B per Gaussian.
//
// twin: trainer::prior::Penalty
// test: trainer-gpu/src/tests.rs::the_pull_of_the_prior_agrees
// bench: gpu/prior

@group(0) @binding(0) var<uniform> prior: Prior;
@group(0) @binding(1) var<uniform> loss: Loss;
@group(0) @binding(2) var<uniform> view: View;
@group(0) @binding(3) var<storage, read> ledger: array<Ledger>;
// Views that see each Gaussian.
@group(0) @binding(4) var<storage, read> seen: array<u32>;
@group(0) @binding(5) var<storage, read> now: array<Geometry>;
@group(0) @binding(6) var<storage, read> start: array<Geometry>;
// Diagonal: turns about the body's axes in the last three places of `quat`; `mean` is not used.
@group(0) @binding(7) var<storage, read> known: array<Geometry>;
@group(0) @binding(8) var<storage, read_write> gradient: array<Geometry>;
// xx, xy, xz, yy; yz, zz of the positions.
@group(0) @binding(9) var<storage, read> positions: array<array<vec4f, 2>>;

// Derivative by the quaternion (w, x, y, z) of half the information times the squared turn, for small turns.
fn turn_pull(q: vec4f, moved: vec4f, information: vec3f) -> vec4f {
    let scale = 2.0 / max(dot(q, q), 1.17549435e-38);
    // Columns: how changes of w, x, y, z turn about x, y and z.
    let about_x = vec4f(-q.y, q.x, q.w, -q.z);
    let about_y = vec4f(-q.z, -q.w, q.x, q.y);
    let about_z = vec4f(-q.w, q.z, -q.y, q.x);
    let turn = scale * vec3f(dot(about_x, moved), dot(about_y, moved), dot(about_z, moved));
    let pull = information * turn * scale;
    return pull.x * about_x + pull.y * about_y + pull.z * about_z;
}

@compute @workgroup_size(256)
fn prior_geometry(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let i = linear_group(group, groups) * 256u + local;
    if i >= prior.items || ledger[i].stamp != view.stamp {
        return;
    }
    let share = prior.strength * loss.per_sample / f32(max(seen[i], 1u));
    let moved = now[i].mean - start[i].mean;
    let p = positions[i];
    let row_x = vec3f(p[0].x, p[0].y, p[0].z);
    let row_y = vec3f(p[0].y, p[0].w, p[1].x);
    let row_z = vec3f(p[0].z, p[1].x, p[1].y);
    gradient[i].mean += share * vec3f(dot(row_x, moved), dot(row_y, moved), dot(row_z, moved));
    gradient[i].quat += share * turn_pull(start[i].quat, now[i].quat, known[i].quat.yzw);
    gradient[i].log_scale += share * known[i].log_scale * (now[i].log_scale - start[i].log_scale);
    gradient[i].opacity_logit +=
        share * known[i].opacity_logit * (now[i].opacity_logit - start[i].opacity_logit);
}
