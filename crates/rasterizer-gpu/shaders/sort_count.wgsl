// Histogram of one 4-bit digit per block of 1024 pairs: first half of a stable radix sort's pass.
// Floor: 4 B per pair (the key).
//
// twin: rasterizer::tile_lists::TileLists
// test: rasterizer-gpu/src/encode.rs::the_radix_sort_is_the_standard_stable_sort
// bench: kernel/sort_count

@group(0) @binding(0) var<uniform> job: Job;
@group(0) @binding(1) var<storage, read> plan: array<u32>;
@group(0) @binding(2) var<storage, read> pairs: array<vec2u>;
// Digit-major: entry digit * blocks + block.
@group(0) @binding(3) var<storage, read_write> histogram: array<u32>;

var<workgroup> counts: array<atomic<u32>, 16>;

@compute @workgroup_size(256)
fn sort_count(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let block = linear_group(group, groups);
    let length = plan[job.length_at];
    let blocks = blocks_of(length);
    if local < DIGITS {
        atomicStore(&counts[local], 0u);
    }
    workgroupBarrier();
    for (var k = 0u; k < 4u; k++) {
        let at = block * BLOCK + k * 256u + local;
        if at < length {
            atomicAdd(&counts[(pairs[at].x >> job.shift) & (DIGITS - 1u)], 1u);
        }
    }
    workgroupBarrier();
    if local < DIGITS && block < blocks {
        histogram[local * blocks + block] = atomicLoad(&counts[local]);
    }
}
