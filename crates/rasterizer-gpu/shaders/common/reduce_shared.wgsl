// Sums of nine values over the 64 invocations of a workgroup, for four splats at a time, through shared memory.
// The order of a sum is fixed: equal inputs give equal bits.

const REDUCED: u32 = 4u;
// One more than the invocations, so that the rows start in different banks.
const REDUCE_STRIDE: u32 = 65u;

var<workgroup> partial_sums: array<f32, 2340>;

// Whether this invocation has something to add.
fn any_adds(adds: bool) -> bool {
    return adds;
}

fn keep_nothing(slot: u32, local: u32) {
    keep_partials(slot, local, vec4f(0.0), vec4f(0.0), 0.0);
}

fn keep_partials(slot: u32, local: u32, a: vec4f, b: vec4f, c: f32) {
    let at = slot * ENTRY * REDUCE_STRIDE + local;
    partial_sums[at] = a.x;
    partial_sums[at + REDUCE_STRIDE] = a.y;
    partial_sums[at + 2u * REDUCE_STRIDE] = a.z;
    partial_sums[at + 3u * REDUCE_STRIDE] = a.w;
    partial_sums[at + 4u * REDUCE_STRIDE] = b.x;
    partial_sums[at + 5u * REDUCE_STRIDE] = b.y;
    partial_sums[at + 6u * REDUCE_STRIDE] = b.z;
    partial_sums[at + 7u * REDUCE_STRIDE] = b.w;
    partial_sums[at + 8u * REDUCE_STRIDE] = c;
}

fn total_of(row: u32) -> f32 {
    var sum = 0.0;
    for (var i = 0u; i < 64u; i++) {
        sum += partial_sums[row * REDUCE_STRIDE + i];
    }
    return sum;
}
