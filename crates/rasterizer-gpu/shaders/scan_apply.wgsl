// Exclusive prefix sum inside each block, on top of the sum of the blocks before it.
// Floor: 8 B per value.
//
// twin: rasterizer::tile_lists::TileLists
// test: rasterizer-gpu/src/encode.rs::the_radix_sort_is_the_standard_stable_sort
// bench: kernel/scan_apply

@group(0) @binding(0) var<uniform> job: Job;
@group(0) @binding(1) var<storage, read> plan: array<u32>;
@group(0) @binding(2) var<storage, read> sums: array<u32>;
@group(0) @binding(3) var<storage, read_write> values: array<u32>;

@compute @workgroup_size(256)
fn scan_apply(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let block = linear_group(group, groups);
    let length = scan_length();
    let first = block * BLOCK + local * 4u;
    var mine: vec4u;
    for (var k = 0u; k < 4u; k++) {
        if first + k < length {
            mine[k] = values[first + k];
        }
    }
    var running = scan_group(mine.x + mine.y + mine.z + mine.w, local).x;
    if block < blocks_of(length) {
        running += sums[block];
    }
    for (var k = 0u; k < 4u; k++) {
        if first + k < length {
            values[first + k] = running;
        }
        running += mine[k];
    }
}
