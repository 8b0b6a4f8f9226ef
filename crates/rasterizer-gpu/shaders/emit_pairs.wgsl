// Writes the (tile slot, entry) pairs of each splat, splats in depth order: entries of one splat are neighbours.
// Floor: 12 B per pair.
//
// twin: rasterizer::tile_lists::TileLists
// test: rasterizer-gpu/tests/parity.rs::random_scenes_agree
// bench: kernel/emit_pairs

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> order: array<vec2u>;
// Entry at which each splat starts, by rank.
@group(0) @binding(2) var<storage, read> offsets: array<u32>;
@group(0) @binding(3) var<storage, read> spans: array<u32>;
// Slot of each tile, or NO_SLOT.
@group(0) @binding(4) var<storage, read> tile_slots: array<u32>;
@group(0) @binding(5) var<storage, read_write> extents: array<vec4u>;
@group(0) @binding(6) var<storage, read_write> pairs: array<vec2u>;
@group(0) @binding(7) var<storage, read_write> pair_splats: array<u32>;

@compute @workgroup_size(256)
fn emit_pairs(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let rank = linear_group(group, groups) * 256u + local;
    if rank >= view.count {
        return;
    }
    let i = order[rank].y;
    let extent = extents[i];
    var entry = offsets[rank];
    extents[i].w = entry;
    let end = min(entry + extent.x, view.pair_capacity);
    let first_row = extent.z & 0xffffu;
    let rows = select(extent.z >> 16u, 0u, extent.x == 0u);
    for (var r = 0u; r < rows; r++) {
        let span = spans[extent.y + r];
        let row = (first_row + r) * view.tiles.x;
        for (var tile = row + (span & 0xffffu); tile < row + (span >> 16u); tile++) {
            let slot = tile_slots[tile];
            if slot != NO_SLOT && entry < end {
                pairs[entry] = vec2u(slot, entry);
                pair_splats[entry] = i;
                entry++;
            }
        }
    }
}
