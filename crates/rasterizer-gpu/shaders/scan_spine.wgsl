// Exclusive prefix sum of the block sums, by one workgroup; the grand total follows behind the last block.
// Floor: 8 B per block of 1024 values.
//
// twin: rasterizer::tile_lists::TileLists
// test: rasterizer-gpu/src/encode.rs::the_radix_sort_is_the_standard_stable_sort
// bench: kernel/scan_spine

@group(0) @binding(0) var<uniform> job: Job;
@group(0) @binding(1) var<storage, read> plan: array<u32>;
@group(0) @binding(2) var<storage, read_write> sums: array<u32>;

@compute @workgroup_size(256)
fn scan_spine(@builtin(local_invocation_index) local: u32) {
    let length = scan_length();
    let blocks = blocks_of(length);
    var carry = 0u;
    for (var first = 0u; first < blocks; first += 256u) {
        let at = first + local;
        var value = 0u;
        if at < blocks {
            value = sums[at];
        }
        let prefix = scan_group(value, local);
        if at < blocks {
            sums[at] = carry + prefix.x;
        }
        carry += prefix.y;
    }
    if local == 0u {
        sums[blocks] = carry;
    }
}
