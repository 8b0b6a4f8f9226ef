// Derivatives per (tile, splat) entry, sums by subgroup operations: a quarter of the barriers of `blend_backward`.
// Floor: 56 B read and 36 B written per pair, 40 B per pixel; about 50 operations per pair and pixel.
//
// twin: rasterizer::backward::TileBackward
// test: rasterizer-gpu/tests/parity.rs::random_scenes_agree
// bench: kernel/blend_backward_subgroups

@compute @workgroup_size(64)
fn blend_backward_subgroups(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
    @builtin(subgroup_id) subgroup: u32,
    @builtin(num_subgroups) subgroups: u32,
    @builtin(subgroup_invocation_id) lane: u32,
    @builtin(subgroup_size) size: u32,
) {
    place_in_subgroups(subgroup, subgroups, lane, size);
    differentiate_part(linear_group(group, groups), local);
}
