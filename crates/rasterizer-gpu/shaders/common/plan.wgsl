// Sizes that only the device knows. Host side: `plan` in rasterizer-gpu.

// Entries of the plan buffer.
const PLAN_COUNT: u32 = 0u;        // Gaussians (written by the host)
const PLAN_PAIRS: u32 = 1u;        // (tile, splat) pairs, at most the capacity
const PLAN_NEEDED_PAIRS: u32 = 2u; // pairs there would be with room for all
const PLAN_NEEDED_SPANS: u32 = 3u; // spans likewise
const PLAN_SORT: u32 = 4u;         // groups of the sort over pairs: x, y, z
const PLAN_SCAN: u32 = 7u;         // groups of the scan over its histogram: x, y, z
const PLAN_EACH: u32 = 10u;        // groups of a kernel with 256 pairs per group: x, y, z

// Elements of one block of the scan and of the sort.
const BLOCK: u32 = 1024u;
// Values of one digit of the sort.
const DIGITS: u32 = 16u;

// What a scan or a pass of the sort works on.
struct Job {
    // Entry of the plan that holds the number of items.
    length_at: u32,
    // Scan: 1 = over the histogram of a sort of that many items.
    histogram: u32,
    // Sort: lowest bit of the digit.
    shift: u32,
    padding: u32,
}

fn blocks_of(items: u32) -> u32 {
    return (items + BLOCK - 1u) / BLOCK;
}
