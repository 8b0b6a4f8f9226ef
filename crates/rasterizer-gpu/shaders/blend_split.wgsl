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

// Colour and transmittance of the splats in front, and of those behind, of a pixel.
fn store(pixel: u32, near: vec4f, far: vec4f) {
    let behind = far.xyz + far.w * layers[pixel * 2u].xyz;
    layers[pixel * 2u] = vec4f(behind, near.w);
    layers[pixel * 2u + 1u] = vec4f(near.xyz, 0.0);
}

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
    let place = local_column(local);
    let centres = column_from(tile_origin(tile.x) + place);
    var near = nothing_blended(vec4<bool>(true));
    var far = near;
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
            let alpha = alphas_at(k, centres).alpha;
            if bitcast<u32>(batch_rest[k].y) == 0u {
                blend_splat(&near, alpha, colour_of(k));
            } else {
                blend_splat(&far, alpha, colour_of(k));
            }
        }
    }
    if slot >= view.slots {
        return;
    }
    let at = slot * AREA + place.y * TILE + place.x;
    store(at, pixel_x(near), pixel_x(far));
    store(at + TILE, pixel_y(near), pixel_y(far));
    store(at + 2u * TILE, pixel_z(near), pixel_z(far));
    store(at + 3u * TILE, pixel_w(near), pixel_w(far));
}
