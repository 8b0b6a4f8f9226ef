// One step of Adam for the texels that were seen; clears their derivatives.
// Floor: 76 B per texel that was seen.
//
// twin: trainer::adam::AdamVec
// test: trainer-gpu/tests/gpu_lanes.rs::the_sky_agrees
// bench: gpu/sky_lane

@group(0) @binding(0) var<uniform> sky: Sky;
@group(0) @binding(1) var<storage, read> corrections: array<vec2f>;
@group(0) @binding(2) var<storage, read_write> gradient: array<i32>;
@group(0) @binding(3) var<storage, read_write> texels: array<f32>;
// Steps of each texel.
@group(0) @binding(4) var<storage, read_write> steps: array<u32>;
// First and second moment of each value.
@group(0) @binding(5) var<storage, read_write> moments: array<vec2f>;

@compute @workgroup_size(256)
fn sky_adam(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let texel = linear_group(group, groups) * 256u + local;
    if texel >= 6u * sky.size * sky.size {
        return;
    }
    let at = texel * 3u;
    let sums = vec3i(gradient[at], gradient[at + 1u], gradient[at + 2u]);
    if all(sums == vec3i(0)) {
        return;
    }
    steps[texel] += 1u;
    let correction = corrections[min(steps[texel], CORRECTED_STEPS)];
    for (var c = 0u; c < 3u; c++) {
        let next = next_moments(moments[at + c].x, moments[at + c].y, f32(sums[c]) / sky.scale);
        moments[at + c] = next;
        texels[at + c] -= step_of(next, sky.rate, correction, sky.epsilon);
        gradient[at + c] = 0;
    }
}
