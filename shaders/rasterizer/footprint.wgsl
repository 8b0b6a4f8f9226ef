// Footprint sums through shared memory. Floor: 56 B read and 36 B written a pair, 4 B a pixel and channel.

@compute @workgroup_size(64)
fn footprint(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    sum_tile(linear_group(group, groups), local);
}
