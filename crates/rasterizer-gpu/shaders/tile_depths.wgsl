// The nearest depth in each tile of the splats that were binned last; a tile without any takes the nearest of the closest tiles
// that have some, so that a layer which grows a little stays in front of what is behind it.
// Floor: 68 B per tile.
//
// twin: rasterizer::split::TileDepths
// test: trainer-gpu/tests/gpu_lanes.rs::the_dynamic_lane_agrees_and_a_step_reads_nothing_back
// bench: gpu/dynamic_lane

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> splats: array<Splat>;
@group(0) @binding(2) var<storage, read> list: array<vec2u>;
@group(0) @binding(3) var<storage, read> slots: array<vec4u>;
@group(0) @binding(4) var<storage, read> tile_slots: array<u32>;
@group(0) @binding(5) var<storage, read_write> depths: array<f32>;

// Behind everything.
const FAR: f32 = 3.0e38;

fn depth_at(x: i32, y: i32) -> f32 {
    if x < 0 || y < 0 || x >= i32(view.tiles.x) || y >= i32(view.tiles.y) {
        return FAR;
    }
    let slot = tile_slots[u32(y) * view.tiles.x + u32(x)];
    if slot == NO_SLOT || slots[slot].y >= slots[slot].z {
        return FAR;
    }
    return splats[list[slots[slot].y].y].depth;
}

@compute @workgroup_size(256)
fn tile_depths(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let slot = linear_group(group, groups) * 256u + local;
    if slot >= view.slots {
        return;
    }
    let x = i32(slots[slot].x % view.tiles.x);
    let y = i32(slots[slot].x / view.tiles.x);
    var depth = depth_at(x, y);
    let farthest = i32(max(view.tiles.x, view.tiles.y));
    for (var ring = 1; ring < farthest && depth >= FAR; ring++) {
        for (var step = -ring; step <= ring; step++) {
            depth = min(depth, min(depth_at(x + step, y - ring), depth_at(x + step, y + ring)));
            depth = min(depth, min(depth_at(x - ring, y + step), depth_at(x + ring, y + step)));
        }
    }
    depths[slot] = depth;
}
