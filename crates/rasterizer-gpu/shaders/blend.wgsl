// Blends each tile's splats into the image.
// Floor: 8 B per pair and 48 B per pair through the cache, 20 B per pixel written; about 20 operations per pair and
// pixel.
//
// twin: rasterizer::blend::walk
// test: rasterizer-gpu/tests/parity.rs::random_scenes_agree
// bench: kernel/blend

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> splats: array<Splat>;
// (entry, Gaussian), tile by tile, nearest first.
@group(0) @binding(2) var<storage, read> list: array<vec2u>;
// Per computed tile: its number, first and end of its list.
@group(0) @binding(3) var<storage, read> slots: array<vec4u>;
// Two per pixel, tile by tile: colour behind and transmittance in front; colour in front and a derivative.
@group(0) @binding(4) var<storage, read> layers: array<vec4f>;
// Row-major RGB and the transmittance of these Gaussians.
@group(0) @binding(5) var<storage, read_write> pixels: array<vec4f>;
// Number of list entries up to the last one that counts.
@group(0) @binding(6) var<storage, read_write> last: array<u32>;

var<workgroup> open_pixels: atomic<u32>;
var<workgroup> any_open: u32;

@compute @workgroup_size(64)
fn blend(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let slot = linear_group(group, groups);
    var tile = vec4u(0u);
    if slot < view.slots {
        tile = slots[slot];
    }
    let origin = tile_origin(tile.x);
    var colour: array<vec3f, 4>;
    var transmittance: array<f32, 4>;
    var counted: array<u32, 4>;
    var open: array<bool, 4>;
    for (var r = 0u; r < ROWS; r++) {
        transmittance[r] = 1.0;
        open[r] = slot < view.slots && in_image(origin + local_pixel(local, r));
    }
    let length = tile.z - tile.y;
    for (var first = 0u; first < length; first += BATCH) {
        if local == 0u {
            atomicStore(&open_pixels, 0u);
        }
        workgroupBarrier();
        if open[0] || open[1] || open[2] || open[3] {
            atomicOr(&open_pixels, 1u);
        }
        let at = tile.y + first + local;
        if at < tile.z {
            let item = list[at];
            load_splat(local, item, splats[item.y]);
        }
        workgroupBarrier();
        if local == 0u {
            any_open = atomicLoad(&open_pixels);
        }
        if workgroupUniformLoad(&any_open) == 0u {
            break;
        }
        let batch = min(BATCH, length - first);
        for (var k = 0u; k < batch; k++) {
            let shade = colour_of(k);
            for (var r = 0u; r < ROWS; r++) {
                let a = alpha_at(k, origin + local_pixel(local, r));
                if open[r] && a.alpha > 0.0 {
                    let weight = a.alpha * transmittance[r];
                    let next = transmittance[r] - weight;
                    if next > MIN_TRANSMITTANCE {
                        colour[r] += weight * shade;
                        transmittance[r] = next;
                        counted[r] = first + k + 1u;
                    } else {
                        open[r] = false;
                    }
                }
            }
        }
    }
    if slot >= view.slots {
        return;
    }
    for (var r = 0u; r < ROWS; r++) {
        let inside = local_pixel(local, r);
        let pixel = origin + inside;
        if in_image(pixel) {
            var behind = vec4f(view.background, 1.0);
            var front = vec4f(0.0);
            if view.layered != 0u {
                let at = (slot * AREA + inside.y * TILE + inside.x) * 2u;
                behind = layers[at];
                front = layers[at + 1u];
            }
            let rgb = front.xyz + behind.w * (colour[r] + transmittance[r] * behind.xyz);
            let at = pixel.y * view.size.x + pixel.x;
            pixels[at] = vec4f(rgb, transmittance[r]);
            last[at] = counted[r];
        }
    }
}
