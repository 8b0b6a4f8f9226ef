// Numbers of tile pairs in depth order, to be summed into places; and empty ranges for all tiles.
// Floor: 28 B per Gaussian.
//
// twin: rasterizer::tile_lists::TileLists
// test: rasterizer-gpu/tests/parity.rs::random_scenes_agree
// bench: kernel/rank_counts

@group(0) @binding(0) var<uniform> view: View;
// (depth, Gaussian), nearest first.
@group(0) @binding(1) var<storage, read> order: array<vec2u>;
@group(0) @binding(2) var<storage, read> extents: array<vec4u>;
@group(0) @binding(3) var<storage, read_write> counts: array<u32>;
// Per computed tile: its number, first and end entry.
@group(0) @binding(4) var<storage, read_write> slots: array<vec4u>;

@compute @workgroup_size(256)
fn rank_counts(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let i = linear_group(group, groups) * 256u + local;
    if i < view.count {
        counts[i] = extents[order[i].y].x;
    }
    if i < view.slots {
        slots[i] = vec4u(slots[i].x, 0u, 0u, 0u);
    }
}
