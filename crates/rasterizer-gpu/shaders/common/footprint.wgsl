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

fn sum_tile(slot: u32, local: u32) {
    var tile = vec4u(0u);
    if slot < view.slots {
        tile = slots[slot];
    }
    let origin = tile_origin(tile.x);
    let plane_size = view.size.x * view.size.y;
    var transmittance = array<f32, 4>(1.0, 1.0, 1.0, 1.0);
    var counted: array<u32, 4>;
    var place: array<u32, 4>;
    var hit: array<f32, 4>;
    for (var r = 0u; r < ROWS; r++) {
        let pixel = origin + local_pixel(local, r);
        if slot < view.slots && in_image(pixel) {
            place[r] = pixel.y * view.size.x + pixel.x;
            counted[r] = last[place[r]];
            hit[r] = select(0.0, 1.0, channels[place[r]] != 0.0);
        }
    }
    let length = tile.z - tile.y;
    for (var first = 0u; first < length; first += BATCH) {
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
                var sums: array<f32, 9>;
                for (var r = 0u; r < ROWS; r++) {
                    let a = alpha_at(k, origin + local_pixel(local, r));
                    if first + k < counted[r] && a.alpha > 0.0 {
                        let weight = a.alpha * transmittance[r];
                        let next = transmittance[r] - weight;
                        if next <= bitcast<f32>(planes.z) {
                            counted[r] = 0u;
                            continue;
                        }
                        transmittance[r] = next;
                        for (var c = 0u; c < planes.y; c++) {
                            sums[c] += weight * channels[(planes.x + c) * plane_size + place[r]];
                        }
                        sums[CHANNELS] += hit[r];
                    }
                }
                for (var v = 0u; v < ENTRY; v++) {
                    keep_partial(j, v, local, sums[v]);
                }
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
