// How many pairs there are, and the dispatch sizes of every kernel that works on them.
//
// twin: rasterizer::tile_lists::TileLists
// test: rasterizer-gpu/tests/parity.rs::random_scenes_agree
// bench: kernel/plan_pairs

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> spans_used: array<u32>;
// Block sums of the scan over Gaussians; the total is behind the last.
@group(0) @binding(2) var<storage, read> sums: array<u32>;
@group(0) @binding(3) var<storage, read_write> plan: array<u32>;

fn set_groups(at: u32, groups: u32) {
    let rows = max(1u, (groups + 65534u) / 65535u);
    plan[at] = (groups + rows - 1u) / rows;
    plan[at + 1u] = select(rows, 0u, groups == 0u);
    plan[at + 2u] = 1u;
}

@compute @workgroup_size(1)
fn plan_pairs() {
    let needed = sums[blocks_of(view.count)];
    let used = min(needed, view.pair_capacity);
    plan[PLAN_PAIRS] = used;
    plan[PLAN_NEEDED_PAIRS] = max(plan[PLAN_NEEDED_PAIRS], needed);
    plan[PLAN_NEEDED_SPANS] = max(plan[PLAN_NEEDED_SPANS], spans_used[0]);
    set_groups(PLAN_SORT, blocks_of(used));
    set_groups(PLAN_SCAN, blocks_of(DIGITS * blocks_of(used)));
    set_groups(PLAN_EACH, (used + 255u) / 256u);
}
