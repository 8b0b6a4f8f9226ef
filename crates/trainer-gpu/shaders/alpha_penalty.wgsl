// Derivative of a penalty on what the trained layer covers outside the loss's region, by its transmittance.
// Floor: 32 B per pixel.
//
// twin: trainer::cpu::cut::penalty
// test: trainer-gpu/tests/gpu_lanes.rs::the_dynamic_lane_agrees_and_a_step_reads_nothing_back
// bench: gpu/dynamic_lane

@group(0) @binding(0) var<uniform> view: View;
// Weight of the penalty per pixel.
@group(0) @binding(1) var<uniform> weight: vec4f;
@group(0) @binding(2) var<storage, read> slots: array<vec4u>;
@group(0) @binding(3) var<storage, read> region: array<u32>;
@group(0) @binding(4) var<storage, read_write> layers: array<vec4f>;

@compute @workgroup_size(256)
fn alpha_penalty(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let slot = linear_group(group, groups);
    if slot >= view.slots {
        return;
    }
    let tile = slots[slot].x;
    let pixel = vec2u(tile % view.tiles.x, tile / view.tiles.x) * TILE + vec2u(local % TILE, local / TILE);
    if any(pixel >= view.size) {
        return;
    }
    let at = pixel.y * view.size.x + pixel.x;
    let outside = (region[at >> 5u] >> (at & 31u) & 1u) == 0u;
    let layer = (slot * AREA + local) * 2u;
    layers[layer + 1u].w = select(0.0, -weight.x * layers[layer].w, outside);
}
