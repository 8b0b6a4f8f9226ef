// From derivatives of pixels to derivatives per (tile, splat) entry, front to back over the same lists as `blend`.
// `behind` starts as everything that a pixel shows, weighted by its derivative, and loses each contribution in turn: no
// transmittance is divided back out of a product. CPU twin: rasterizer/src/backward.rs.

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> splats: array<Splat>;
@group(0) @binding(2) var<storage, read> list: array<vec2u>;
@group(0) @binding(3) var<storage, read> slots: array<vec4u>;
@group(0) @binding(4) var<storage, read> layers: array<vec4f>;
@group(0) @binding(5) var<storage, read> pixels: array<vec4f>;
@group(0) @binding(6) var<storage, read> last: array<u32>;
// Derivatives of the loss by a pixel's RGB and transmittance, row-major.
@group(0) @binding(7) var<storage, read> upstream: array<vec4f>;
// Per entry, with d = dL/dexponent, o = pixel - centre: sums of d o.x, d o.y, d o.x^2, d o.x o.y, d o.y^2,
// dL/dopacity, and of the colour's derivative.
@group(0) @binding(8) var<storage, read_write> entries: array<f32>;

var<workgroup> longest: atomic<u32>;
var<workgroup> longest_shared: u32;

// `slot` must not differ inside a workgroup.
fn differentiate_tile(slot: u32, local: u32) {
    var tile = vec4u(0u);
    if slot < view.slots {
        tile = slots[slot];
    }
    let origin = tile_origin(tile.x);
    var gradient: array<vec3f, 4>;
    var behind: array<f32, 4>;
    var transmittance: array<f32, 4>;
    var counted: array<u32, 4>;
    var most = 0u;
    for (var r = 0u; r < ROWS; r++) {
        let inside = local_pixel(local, r);
        let pixel = origin + inside;
        transmittance[r] = 1.0;
        if slot < view.slots && in_image(pixel) {
            let at = pixel.y * view.size.x + pixel.x;
            var back = vec4f(view.background, 1.0);
            var front = vec4f(0.0);
            if view.layered != 0u {
                let layer = (slot * AREA + inside.y * TILE + inside.x) * 2u;
                back = layers[layer];
                front = layers[layer + 1u];
            }
            let shown = pixels[at];
            let given = upstream[at];
            gradient[r] = given.xyz * back.w;
            behind[r] = dot(given.xyz, shown.xyz - front.xyz) + shown.w * (given.w + front.w);
            counted[r] = last[at];
            most = max(most, counted[r]);
        }
    }
    if local == 0u {
        atomicStore(&longest, 0u);
    }
    workgroupBarrier();
    atomicMax(&longest, most);
    workgroupBarrier();
    if local == 0u {
        longest_shared = atomicLoad(&longest);
    }
    let length = workgroupUniformLoad(&longest_shared);
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
                let shade = colour_of(k);
                let opacity = batch_colour[k].y;
                var around = array<f32, 5>();
                var d_opacity = 0.0;
                var d_colour = vec3f(0.0);
                var adds = false;
                for (var r = 0u; r < ROWS; r++) {
                    let a = alpha_at(k, origin + local_pixel(local, r));
                    if first + k < counted[r] && a.alpha > 0.0 {
                        adds = true;
                        let weight = a.alpha * transmittance[r];
                        let shown = dot(gradient[r], shade);
                        behind[r] -= weight * shown;
                        var d_alpha = transmittance[r] * shown - behind[r] / (1.0 - a.alpha);
                        if !(opacity * a.falloff < MAX_ALPHA) {
                            d_alpha = 0.0;
                        }
                        transmittance[r] -= weight;
                        let d = d_alpha * a.falloff;
                        let e = d * opacity * a.delta;
                        around[0] += e.x;
                        around[1] += e.y;
                        around[2] += e.x * a.delta.x;
                        around[3] += e.x * a.delta.y;
                        around[4] += e.y * a.delta.y;
                        d_opacity += d;
                        d_colour += weight * gradient[r];
                    }
                }
                if !any_adds(adds) {
                    for (var v = 0u; v < ENTRY; v++) {
                        keep_nothing(j, v, local);
                    }
                    continue;
                }
                for (var v = 0u; v < 5u; v++) {
                    keep_partial(j, v, local, around[v]);
                }
                keep_partial(j, 5u, local, d_opacity);
                keep_partial(j, 6u, local, d_colour.x);
                keep_partial(j, 7u, local, d_colour.y);
                keep_partial(j, 8u, local, d_colour.z);
            }
            workgroupBarrier();
            for (var row = local; row < reduced * ENTRY; row += 64u) {
                let entry = bitcast<u32>(batch_rest[start + row / ENTRY].y);
                entries[entry * ENTRY + row % ENTRY] = total_of(row);
            }
            workgroupBarrier();
        }
    }
    // Entries that no pixel reached.
    for (var row = local; row < (tile.z - tile.y - length) * ENTRY; row += 64u) {
        let entry = list[tile.y + length + row / ENTRY].x;
        entries[entry * ENTRY + row % ENTRY] = 0.0;
    }
}
