// Footprint sums by subgroup operations.
// Floor: 56 B read and 36 B written per pair, 4 B per pixel and channel.
//
// twin: rasterizer::footprint::EntrySums
// test: rasterizer-gpu/tests/parity.rs::footprints_and_top_contributors_agree
// bench: gpu/association

@compute @workgroup_size(64)
fn footprint_subgroups(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
    @builtin(subgroup_id) subgroup: u32,
    @builtin(num_subgroups) subgroups: u32,
    @builtin(subgroup_invocation_id) lane: u32,
    @builtin(subgroup_size) size: u32,
) {
    place_in_subgroups(subgroup, subgroups, lane, size);
    sum_part(linear_group(group, groups), local);
}
