// Moves each pair to its place by one 4-bit digit: second half of a stable radix sort's pass. Inside a block of 1024
// pairs an invocation owns four consecutive ones. Sixteen counters per invocation, two to a word, are summed over the
// invocations before it: no subgroup operations, three barriers.
// Floor: 16 B per pair.
//
// twin: rasterizer::tile_lists::TileLists
// test: rasterizer-gpu/src/encode.rs::the_radix_sort_is_the_standard_stable_sort
// bench: kernel/sort_scatter

@group(0) @binding(0) var<uniform> job: Job;
@group(0) @binding(1) var<storage, read> plan: array<u32>;
// Exclusive prefix sums: where each digit of each block starts.
@group(0) @binding(2) var<storage, read> starts: array<u32>;
@group(0) @binding(3) var<storage, read> pairs: array<vec2u>;
@group(0) @binding(4) var<storage, read_write> sorted: array<vec2u>;

// Counts of at most 1024 fit in half a word. Rows of 256 invocations; row w holds the digits 2 w and 2 w + 1.
var<workgroup> counts: array<u32, 2048>;
// Sums of 8 neighbours of a row, 32 to a row.
var<workgroup> segments: array<u32, 256>;

fn digit_of(key: u32) -> u32 {
    return (key >> job.shift) & (DIGITS - 1u);
}

@compute @workgroup_size(256)
fn sort_scatter(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let block = linear_group(group, groups);
    let length = plan[job.length_at];
    let blocks = blocks_of(length);
    let first = block * BLOCK + local * 4u;
    for (var word = 0u; word < 8u; word++) {
        counts[word * 256u + local] = 0u;
    }
    // Ranks among the invocation's own pairs of the same digit.
    var ranks: vec4u;
    for (var k = 0u; k < 4u; k++) {
        if first + k < length {
            let digit = digit_of(pairs[first + k].x);
            let shift = (digit & 1u) * 16u;
            let at = (digit >> 1u) * 256u + local;
            ranks[k] = (counts[at] >> shift) & 0xffffu;
            counts[at] += 1u << shift;
        }
    }
    workgroupBarrier();
    let segment = local * 8u;
    var sum = 0u;
    for (var k = 0u; k < 8u; k++) {
        sum += counts[segment + k];
    }
    segments[local] = sum;
    workgroupBarrier();
    var running = 0u;
    for (var before = local & ~31u; before < local; before++) {
        running += segments[before];
    }
    for (var k = 0u; k < 8u; k++) {
        let count = counts[segment + k];
        counts[segment + k] = running;
        running += count;
    }
    workgroupBarrier();
    for (var k = 0u; k < 4u; k++) {
        if first + k < length {
            let pair = pairs[first + k];
            let digit = digit_of(pair.x);
            let before = (counts[(digit >> 1u) * 256u + local] >> ((digit & 1u) * 16u)) & 0xffffu;
            sorted[starts[digit * blocks + block] + before + ranks[k]] = pair;
        }
    }
}
