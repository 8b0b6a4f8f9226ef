// Derivative of half the squared error over the counted pixels: what the sky alone is trained on.
// Floor: 19 B read and 16 B written per pixel.
//
// twin: trainer::cpu::sky::derivative
// test: trainer-gpu/tests/gpu_lanes.rs::the_sky_agrees
// bench: gpu/sky_lane

@group(0) @binding(0) var<uniform> loss: Loss;
@group(0) @binding(1) var<storage, read> slots: array<vec4u>;
@group(0) @binding(2) var<storage, read> region: array<u32>;
@group(0) @binding(3) var<storage, read> photograph: array<u32>;
@group(0) @binding(4) var<storage, read> pixels: array<vec4f>;
@group(0) @binding(5) var<storage, read_write> upstream: array<vec4f>;

@compute @workgroup_size(256)
fn squared_error(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let slot = min(linear_group(group, groups), loss.slots - 1u);
    let p = tile_origin(slots[slot].x) + vec2i(i32(local % TILE), i32(local / TILE));
    if !in_image(p) {
        return;
    }
    let pixel = index_of(p);
    let truth = vec3f(target_at(pixel, 0u), target_at(pixel, 1u), target_at(pixel, 2u));
    upstream[pixel] = vec4f(select(vec3f(0.0), pixels[pixel].xyz - truth, is_counted(pixel)), 0.0);
}
