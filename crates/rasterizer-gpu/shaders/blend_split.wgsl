// Blends each tile in two parts, nearer than a depth and the rest, and stores them as the layers in front of and
// behind what will be trained between them (docs/adr/0003). The layers hold the background on entry.
// Floor: as `blend`, and 64 B per pixel.
//
// twin: rasterizer::split::SplitLayers
// test: trainer-gpu/tests/gpu_lanes.rs::the_dynamic_lane_agrees_and_a_step_reads_nothing_back
// bench: gpu/dynamic_lane

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> splats: array<Splat>;
@group(0) @binding(2) var<storage, read> list: array<vec2u>;
@group(0) @binding(3) var<storage, read> slots: array<vec4u>;
// Where to cut, per computed tile (m).
@group(0) @binding(4) var<storage, read> depths: array<f32>;
@group(0) @binding(5) var<storage, read_write> layers: array<vec4f>;

@compute @workgroup_size(64)
fn blend_split(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let slot = linear_group(group, groups);
    var tile = vec4u(0u);
    var cut = 0.0;
    if slot < view.slots {
        tile = slots[slot];
        cut = depths[slot];
    }
    let origin = tile_origin(tile.x);
    // Four pixels of the front part, then the same four of the part behind.
    var colour: array<vec3f, 8>;
    var transmittance = array<f32, 8>(1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0);
    var open = array<bool, 8>(true, true, true, true, true, true, true, true);
    let length = tile.z - tile.y;
    for (var first = 0u; first < length; first += BATCH) {
        workgroupBarrier();
        let at = tile.y + first + local;
        if at < tile.z {
            let item = list[at];
            let splat = splats[item.y];
            // The entry is not needed here; its place tells on which side of the cut the splat lies.
            load_splat(local, vec2u(u32(splat.depth >= cut), item.y), splat);
        }
        workgroupBarrier();
        let batch = min(BATCH, length - first);
        for (var k = 0u; k < batch; k++) {
            let shade = colour_of(k);
            let part = bitcast<u32>(batch_rest[k].y) * ROWS;
            for (var r = 0u; r < ROWS; r++) {
                let a = alpha_at(k, origin + local_pixel(local, r));
                let i = part + r;
                if open[i] && a.alpha > 0.0 {
                    let weight = a.alpha * transmittance[i];
                    let next = transmittance[i] - weight;
                    if next > MIN_TRANSMITTANCE {
                        colour[i] += weight * shade;
                        transmittance[i] = next;
                    } else {
                        open[i] = false;
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
        let at = (slot * AREA + inside.y * TILE + inside.x) * 2u;
        let behind = colour[ROWS + r] + transmittance[ROWS + r] * layers[at].xyz;
        layers[at] = vec4f(behind, transmittance[r]);
        layers[at + 1u] = vec4f(colour[r], 0.0);
    }
}
