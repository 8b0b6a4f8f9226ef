// Sums of nine values over the 64 invocations of a workgroup, for 32 splats at a time, by subgroup operations.
// The order of a sum is the adapter's own and always the same: equal inputs give equal bits.

const REDUCED: u32 = 32u;
// The smallest subgroups that this is used with have eight invocations.
const MOST_SUBGROUPS: u32 = 8u;

var<workgroup> partial_sums: array<f32, 2304>;
var<private> own_subgroup: u32;
var<private> subgroup_count: u32;
var<private> own_lane: u32;
// Invocations of the subgroup that are in the workgroup.
var<private> lanes: u32;

fn place_in_subgroups(subgroup: u32, subgroups: u32, lane: u32, size: u32) {
    own_subgroup = subgroup;
    subgroup_count = min(subgroups, MOST_SUBGROUPS);
    own_lane = lane;
    lanes = min(size, 64u);
}

// Whether any invocation of the subgroup has something to add; the others then need not.
fn any_adds(adds: bool) -> bool {
    return subgroupAny(adds);
}

fn keep_nothing(slot: u32, local: u32) {
    keep(slot, own_lane, 0.0, 0.0);
}

// Eight sums together: an invocation gives half of what it holds to a neighbour and takes the other half, three times; then
// lane l has a share of sum number `l`, its bits reversed. A sum for each value would exchange three times as much.
fn keep_partials(slot: u32, local: u32, a: vec4f, b: vec4f, c: f32) {
    let odd = (own_lane & 1u) != 0u;
    let four = select(a, b, odd) + subgroupShuffleXor(select(b, a, odd), 1u);
    let second = (own_lane & 2u) != 0u;
    let two = select(four.xy, four.zw, second) + subgroupShuffleXor(select(four.zw, four.xy, second), 2u);
    let third = (own_lane & 4u) != 0u;
    var sum = select(two.x, two.y, third) + subgroupShuffleXor(select(two.y, two.x, third), 4u);
    for (var stride = 8u; stride < lanes; stride *= 2u) {
        sum += subgroupShuffleXor(sum, stride);
    }
    let value = (own_lane & 1u) * 4u + (own_lane & 2u) + ((own_lane >> 2u) & 1u);
    keep(slot, value, sum, subgroupAdd(c));
}

// The first eight lanes have a value each, and all the ninth.
fn keep(slot: u32, value: u32, x: f32, ninth: f32) {
    let at = slot * ENTRY * MOST_SUBGROUPS + own_subgroup;
    if own_lane < 8u {
        partial_sums[at + value * MOST_SUBGROUPS] = x;
    }
    if own_lane == 0u {
        partial_sums[at + 8u * MOST_SUBGROUPS] = ninth;
    }
}

fn total_of(row: u32) -> f32 {
    var sum = 0.0;
    for (var i = 0u; i < subgroup_count; i++) {
        sum += partial_sums[row * MOST_SUBGROUPS + i];
    }
    return sum;
}
