// Exclusive prefix sum by one workgroup: for short lists, where three kernels would cost more than they share out.
// Floor: 8 B per value.
//
// twin: rasterizer::tile_lists::TileLists
// test: rasterizer-gpu/src/encode.rs::the_radix_sort_is_the_standard_stable_sort
// bench: kernel/scan_single

@group(0) @binding(0) var<uniform> job: Job;
@group(0) @binding(1) var<storage, read> plan: array<u32>;
@group(0) @binding(2) var<storage, read_write> values: array<u32>;

@compute @workgroup_size(256)
fn scan_single(@builtin(local_invocation_index) local: u32) {
    let length = scan_length();
    var carry = 0u;
    for (var start = 0u; start < length; start += BLOCK) {
        let first = start + local * 4u;
        var mine: vec4u;
        for (var k = 0u; k < 4u; k++) {
            if first + k < length {
                mine[k] = values[first + k];
            }
        }
        let prefix = scan_group(mine.x + mine.y + mine.z + mine.w, local);
        var running = carry + prefix.x;
        for (var k = 0u; k < 4u; k++) {
            if first + k < length {
                values[first + k] = running;
            }
            running += mine[k];
        }
        carry += prefix.y;
    }
}
