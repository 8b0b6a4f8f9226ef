// Derivatives per (tile, splat) entry, sums through shared memory: for adapters without subgroup operations.
// Floor: 56 B read and 36 B written per pair, 40 B per pixel; about 50 operations per pair and pixel.
//
// twin: rasterizer::backward::TileBackward
// test: rasterizer-gpu/tests/parity.rs::random_scenes_agree
// bench: gpu/backward

@compute @workgroup_size(64)
fn blend_backward(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    differentiate_part(linear_group(group, groups), local);
}
