// Counts the views in which each Gaussian touches a computed tile.
// Floor: 20 B per Gaussian.
//
// twin: rasterizer::tape::visible_indices
// test: trainer-gpu/src/tests.rs::views_that_see_a_gaussian_are_counted_as_on_the_cpu
// bench: gpu/dynamic_lane

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> extents: array<vec4u>;
@group(0) @binding(2) var<storage, read_write> counts: array<u32>;

@compute @workgroup_size(256)
fn count_views(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let i = linear_group(group, groups) * 256u + local;
    if i < view.count && extents[i].x > 0u {
        counts[i] += 1u;
    }
}
