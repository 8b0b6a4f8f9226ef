// Where each tile's list starts and ends, and the list itself as (entry, Gaussian).
// Floor: 20 B per pair.
//
// twin: rasterizer::tile_lists::TileLists
// test: rasterizer-gpu/tests/parity.rs::random_scenes_agree
// bench: kernel/tile_ranges

@group(0) @binding(0) var<storage, read> plan: array<u32>;
// Sorted by slot; inside a slot nearest first.
@group(0) @binding(1) var<storage, read> pairs: array<vec2u>;
@group(0) @binding(2) var<storage, read> pair_splats: array<u32>;
@group(0) @binding(3) var<storage, read_write> list: array<vec2u>;
@group(0) @binding(4) var<storage, read_write> slots: array<vec4u>;

@compute @workgroup_size(256)
fn tile_ranges(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let at = linear_group(group, groups) * 256u + local;
    let count = plan[PLAN_PAIRS];
    if at >= count {
        return;
    }
    let pair = pairs[at];
    list[at] = vec2u(pair.y, pair_splats[pair.y]);
    if at == 0u || pairs[at - 1u].x != pair.x {
        slots[pair.x].y = at;
    }
    if at + 1u == count || pairs[at + 1u].x != pair.x {
        slots[pair.x].z = at + 1u;
    }
}
