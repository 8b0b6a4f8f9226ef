// Footprint sums through shared memory.
// Floor: 56 B read and 36 B written per pair, 4 B per pixel and channel.
//
// twin: rasterizer::footprint::EntrySums
// test: rasterizer-gpu/tests/parity.rs::footprints_and_top_contributors_agree
// bench: gpu/association

@compute @workgroup_size(64)
fn footprint(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    sum_part(linear_group(group, groups), local);
}
