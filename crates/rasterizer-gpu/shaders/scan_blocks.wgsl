// Sums of blocks of 1024 values: first of three kernels of an exclusive prefix sum of any length.
// Floor: 4 B read per value.
//
// twin: rasterizer::tile_lists::TileLists
// test: rasterizer-gpu/src/encode.rs::the_radix_sort_is_the_standard_stable_sort
// bench: kernel/scan_blocks

@group(0) @binding(0) var<uniform> job: Job;
@group(0) @binding(1) var<storage, read> plan: array<u32>;
@group(0) @binding(2) var<storage, read> values: array<u32>;
@group(0) @binding(3) var<storage, read_write> sums: array<u32>;

@compute @workgroup_size(256)
fn scan_blocks(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let block = linear_group(group, groups);
    let length = scan_length();
    var sum = 0u;
    for (var k = 0u; k < 4u; k++) {
        let at = block * BLOCK + local * 4u + k;
        if at < length {
            sum += values[at];
        }
    }
    let total = scan_group(sum, local).y;
    if local == 0u && block < blocks_of(length) {
        sums[block] = total;
    }
}
