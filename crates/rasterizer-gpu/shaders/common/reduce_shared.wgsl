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

fn keep_nothing(slot: u32, value: u32, local: u32) {
    keep_partial(slot, value, local, 0.0);
}

fn keep_partial(slot: u32, value: u32, local: u32, x: f32) {
    partial_sums[(slot * ENTRY + value) * REDUCE_STRIDE + local] = x;
}

fn total_of(row: u32) -> f32 {
    var sum = 0.0;
    for (var i = 0u; i < 64u; i++) {
        sum += partial_sums[row * REDUCE_STRIDE + i];
    }
    return sum;
}
