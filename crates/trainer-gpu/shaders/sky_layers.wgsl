// Puts the sky behind the Gaussians of a view, with nothing in front.
// Floor: 48 B read and 32 B written per pixel.
//
// twin: trainer::background::SkyBehind
// test: trainer-gpu/tests/gpu_lanes.rs::the_static_lane_agrees_and_its_layer_stays_on_the_device
// bench: gpu/dynamic_lane

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<uniform> sky: Sky;
@group(0) @binding(2) var<storage, read> slots: array<vec4u>;
// (texel, RGB).
@group(0) @binding(3) var<storage, read> texels: array<f32>;
@group(0) @binding(4) var<storage, read_write> layers: array<vec4f>;

@compute @workgroup_size(256)
fn sky_layers(
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
    let sample = sky_sample(pixel, sky.size);
    var colour = vec3f(0.0);
    for (var k = 0u; k < 4u; k++) {
        let at = sample.texels[k] * 3u;
        colour += sample.weights[k] * vec3f(texels[at], texels[at + 1u], texels[at + 2u]);
    }
    let at = (slot * AREA + local) * 2u;
    layers[at] = vec4f(colour, 1.0);
    layers[at + 1u] = vec4f(0.0);
}
