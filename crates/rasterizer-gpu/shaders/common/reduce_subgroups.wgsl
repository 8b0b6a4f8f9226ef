// Sums of nine values over the 64 invocations of a workgroup, for sixteen splats at a time, by subgroup operations.
// The order of a sum is the adapter's own and always the same: equal inputs give equal bits.

const REDUCED: u32 = 16u;
// The smallest subgroups have four invocations.
const MOST_SUBGROUPS: u32 = 16u;

var<workgroup> partial_sums: array<f32, 2304>;
var<private> own_subgroup: u32;
var<private> subgroup_count: u32;
var<private> own_lane: u32;

fn place_in_subgroups(subgroup: u32, subgroups: u32, lane: u32) {
    own_subgroup = subgroup;
    subgroup_count = min(subgroups, MOST_SUBGROUPS);
    own_lane = lane;
}

// Whether any invocation of the subgroup has something to add; the others then need not.
fn any_adds(adds: bool) -> bool {
    return subgroupAny(adds);
}

fn keep_nothing(slot: u32, local: u32) {
    store(slot, vec4f(0.0), vec4f(0.0), 0.0);
}

fn keep_partials(slot: u32, local: u32, a: vec4f, b: vec4f, c: f32) {
    store(slot, subgroupAdd(a), subgroupAdd(b), subgroupAdd(c));
}

fn store(slot: u32, a: vec4f, b: vec4f, c: f32) {
    if own_lane != 0u {
        return;
    }
    let at = slot * ENTRY * MOST_SUBGROUPS + own_subgroup;
    partial_sums[at] = a.x;
    partial_sums[at + MOST_SUBGROUPS] = a.y;
    partial_sums[at + 2u * MOST_SUBGROUPS] = a.z;
    partial_sums[at + 3u * MOST_SUBGROUPS] = a.w;
    partial_sums[at + 4u * MOST_SUBGROUPS] = b.x;
    partial_sums[at + 5u * MOST_SUBGROUPS] = b.y;
    partial_sums[at + 6u * MOST_SUBGROUPS] = b.z;
    partial_sums[at + 7u * MOST_SUBGROUPS] = b.w;
    partial_sums[at + 8u * MOST_SUBGROUPS] = c;
}

fn total_of(row: u32) -> f32 {
    var sum = 0.0;
    for (var i = 0u; i < subgroup_count; i++) {
        sum += partial_sums[row * MOST_SUBGROUPS + i];
    }
    return sum;
}
