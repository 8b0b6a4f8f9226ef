// Sums what the pixels say of the texels they see, through the transmittance that the Gaussians leave, and weighted
// by it once more: the error of a hidden pixel is not the sky's.
// Floor: 32 B read per pixel and 12 atomic additions where the sky shows.
//
// twin: trainer::texel_gradients::TexelGradients
// test: trainer-gpu/tests/gpu_lanes.rs::the_sky_agrees
// bench: gpu/sky_lane

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<uniform> sky: Sky;
@group(0) @binding(2) var<storage, read> slots: array<vec4u>;
@group(0) @binding(3) var<storage, read> pixels: array<vec4f>;
@group(0) @binding(4) var<storage, read> upstream: array<vec4f>;
@group(0) @binding(5) var<storage, read_write> gradient: array<atomic<i32>>;

// Least transmittance at which a pixel says anything of the sky. CPU twin: `sky_share`.
const MIN_THROUGH: f32 = 0.1;
// One pixel's share of the range of a sum: 2^31 holds 2048 pixels at this limit.
const LIMIT: f32 = 1048576.0;

@compute @workgroup_size(256)
fn sky_gradient(
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
    let through = pixels[at].w;
    if through < MIN_THROUGH {
        return;
    }
    let g = upstream[at].xyz * (through * through);
    if all(g == vec3f(0.0)) {
        return;
    }
    let sample = sky_sample(pixel, sky.size);
    for (var k = 0u; k < 4u; k++) {
        let share = vec3i(round(clamp(sample.weights[k] * g * sky.scale, vec3f(-LIMIT), vec3f(LIMIT))));
        let texel = sample.texels[k] * 3u;
        atomicAdd(&gradient[texel], share.x);
        atomicAdd(&gradient[texel + 1u], share.y);
        atomicAdd(&gradient[texel + 2u], share.z);
    }
}
