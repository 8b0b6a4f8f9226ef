// Blends each tile's splats into the image.
// Floor: 8 B per pair and 48 B per pair through the cache, 20 B per pixel written (16 more per part of a list); about 20 operations per pair and
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
// At its end, per part of a list but the first: colour and transmittance where it begins.
@group(0) @binding(7) var<storage, read_write> entries: array<f32>;

var<workgroup> open_pixels: atomic<u32>;
var<workgroup> any_open: u32;

// Puts the colour and transmittance of pixel `row` of a column between its layers.
fn show(slot: u32, place: vec2u, first: vec2u, row: u32, blended: vec4f, counted: u32) {
    var behind = vec4f(view.background, 1.0);
    var front = vec4f(0.0);
    if view.layered != 0u {
        let at = (slot * AREA + (place.y + row) * TILE + place.x) * 2u;
        behind = layers[at];
        front = layers[at + 1u];
    }
    let at = (first.y + row) * view.size.x + first.x;
    pixels[at] = vec4f(front.xyz + behind.w * (blended.xyz + blended.w * behind.xyz), blended.w);
    last[at] = counted;
}

fn keep(at: u32, values: vec4f) {
    entries[at] = values.x;
    entries[at + TILE] = values.y;
    entries[at + 2u * TILE] = values.z;
    entries[at + 3u * TILE] = values.w;
}

fn keep_state(slot: u32, part: u32, place: vec2u, blended: Blended) {
    keep(state_at(slot, part, 0u, place), blended.red);
    keep(state_at(slot, part, 1u, place), blended.green);
    keep(state_at(slot, part, 2u, place), blended.blue);
    keep(state_at(slot, part, 3u, place), blended.transmittance);
}

// Blends splat `k` of the batch that begins with entry `first` of the list.
fn add(blended: ptr<function, Blended>, counted: ptr<function, vec4u>, alpha: vec4f, k: u32, first: u32) {
    if any((*blended).open & (alpha > vec4f(0.0))) {
        let counts = blend_splat(blended, alpha, colour_of(k));
        *counted = select(*counted, vec4u(first + k + 1u), counts);
    }
}

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
    let place = local_column(local);
    let first_pixel = tile_origin(tile.x) + place;
    let centres = column_from(first_pixel);
    let inside = column_in_image(first_pixel) & vec4<bool>(slot < view.slots);
    var blended = nothing_blended(inside);
    var counted = vec4u(0u);
    let length = tile.z - tile.y;
    let part = part_length(length);
    for (var first = 0u; first < length; first += BATCH) {
        if local == 0u {
            atomicStore(&open_pixels, 0u);
        }
        workgroupBarrier();
        if any(blended.open) {
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
        if first > 0u && first % part == 0u {
            keep_state(slot, first / part, place, blended);
        }
        let batch = min(BATCH, length - first);
        // Four splats at a time: their opacities do not wait for each other, what they blend does.
        for (var k = 0u; k < batch; k += 4u) {
            let a = alphas_at(k, centres).alpha;
            let b = alphas_at(k + 1u, centres).alpha;
            let c = alphas_at(k + 2u, centres).alpha;
            let d = alphas_at(k + 3u, centres).alpha;
            add(&blended, &counted, a, k, first);
            if k + 1u < batch {
                add(&blended, &counted, b, k + 1u, first);
            }
            if k + 2u < batch {
                add(&blended, &counted, c, k + 2u, first);
            }
            if k + 3u < batch {
                add(&blended, &counted, d, k + 3u, first);
            }
        }
    }
    if inside.x {
        show(slot, place, first_pixel, 0u, pixel_x(blended), counted.x);
    }
    if inside.y {
        show(slot, place, first_pixel, 1u, pixel_y(blended), counted.y);
    }
    if inside.z {
        show(slot, place, first_pixel, 2u, pixel_z(blended), counted.z);
    }
    if inside.w {
        show(slot, place, first_pixel, 3u, pixel_w(blended), counted.w);
    }
}
