// Sums per (tile, splat) entry of alpha T times up to eight channels of the pixels, and the number of pixels that count.
// CPU twin: rasterizer/src/footprint.rs (`accumulate`).

@group(0) @binding(0) var<uniform> view: View;
// First plane summed; number of planes; bits of the f32 transmittance at which a pixel is finished.
@group(0) @binding(1) var<uniform> planes: vec4u;
@group(0) @binding(2) var<storage, read> splats: array<Splat>;
@group(0) @binding(3) var<storage, read> list: array<vec2u>;
@group(0) @binding(4) var<storage, read> slots: array<vec4u>;
@group(0) @binding(5) var<storage, read> last: array<u32>;
// Row-major planes; a pixel hits where the very first plane is not zero.
@group(0) @binding(6) var<storage, read> channels: array<f32>;
@group(0) @binding(7) var<storage, read_write> entries: array<f32>;

const CHANNELS: u32 = 8u;

fn channel_at(channel: u32, pixel: u32) -> f32 {
    if channel >= planes.y {
        return 0.0;
    }
    return channels[(planes.x + channel) * view.size.x * view.size.y + pixel];
}

// Four channels of a pixel, from `first` on.
fn channels_at(inside: bool, first: u32, pixel: u32) -> vec4f {
    if !inside {
        return vec4f(0.0);
    }
    return vec4f(
        channel_at(first, pixel),
        channel_at(first + 1u, pixel),
        channel_at(first + 2u, pixel),
        channel_at(first + 3u, pixel),
    );
}

fn hit_at(inside: bool, pixel: u32) -> f32 {
    if !inside {
        return 0.0;
    }
    return select(0.0, 1.0, channels[pixel] != 0.0);
}

fn counted_at(inside: bool, pixel: u32) -> u32 {
    if !inside {
        return 0u;
    }
    return last[pixel];
}

// Part `job % parts` of the list of slot `job / parts`; `job` must not differ inside a workgroup.
fn sum_part(job: u32, local: u32) {
    let slot = job / view.parts;
    let part = job % view.parts;
    var tile = vec4u(0u);
    if slot < view.slots {
        tile = slots[slot];
    }
    let place = local_column(local);
    let first_pixel = tile_origin(tile.x) + place;
    let centres = column_from(first_pixel);
    let inside = column_in_image(first_pixel) & vec4<bool>(slot < view.slots);
    let at = first_pixel.y * view.size.x + first_pixel.x + vec4u(0u, 1u, 2u, 3u) * view.size.x;
    // A column per pixel, a row per channel.
    let low = mat4x4f(
        channels_at(inside.x, 0u, at.x),
        channels_at(inside.y, 0u, at.y),
        channels_at(inside.z, 0u, at.z),
        channels_at(inside.w, 0u, at.w),
    );
    let high = mat4x4f(
        channels_at(inside.x, 4u, at.x),
        channels_at(inside.y, 4u, at.y),
        channels_at(inside.z, 4u, at.z),
        channels_at(inside.w, 4u, at.w),
    );
    let hit = vec4f(hit_at(inside.x, at.x), hit_at(inside.y, at.y), hit_at(inside.z, at.z), hit_at(inside.w, at.w));
    var counted = vec4u(
        counted_at(inside.x, at.x),
        counted_at(inside.y, at.y),
        counted_at(inside.z, at.z),
        counted_at(inside.w, at.w),
    );
    var transmittance = vec4f(1.0);
    let size = part_length(tile.z - tile.y);
    let begin = min(part * size, tile.z - tile.y);
    let length = min(begin + size, tile.z - tile.y);
    if begin > 0u {
        // Stale where no pixel came so far: none of them counts then.
        transmittance = state_of(slot, part, 3u, place);
        counted = select(counted, vec4u(0u), transmittance <= vec4f(bitcast<f32>(planes.z)));
    }
    for (var first = begin; first < length; first += BATCH) {
        workgroupBarrier();
        let at = tile.y + first + local;
        if at < tile.z {
            let item = list[at];
            load_splat(local, item, splats[item.y]);
        }
        workgroupBarrier();
        let batch = min(BATCH, length - first);
        for (var start = 0u; start < batch; start += REDUCED) {
            let reduced = min(REDUCED, batch - start);
            for (var j = 0u; j < reduced; j++) {
                let k = start + j;
                let alpha = alphas_at(k, centres).alpha;
                let shows = (vec4u(first + k) < counted) & (alpha > vec4f(0.0));
                if !any_adds(any(shows)) {
                    keep_nothing(j, local);
                    continue;
                }
                let weight = select(vec4f(0.0), alpha * transmittance, shows);
                let finished = shows & (transmittance - weight <= vec4f(bitcast<f32>(planes.z)));
                let added = select(weight, vec4f(0.0), finished);
                counted = select(counted, vec4u(0u), finished);
                transmittance -= added;
                let hits = dot(hit, select(vec4f(0.0), vec4f(1.0), shows & !finished));
                keep_partials(j, local, low * added, high * added, hits);
            }
            workgroupBarrier();
            for (var row = local; row < reduced * ENTRY; row += 64u) {
                let entry = bitcast<u32>(batch_rest[start + row / ENTRY].y);
                entries[entry * ENTRY + row % ENTRY] = total_of(row);
            }
            workgroupBarrier();
        }
    }
}
