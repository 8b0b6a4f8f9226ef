// Sums each Gaussian's footprint over its tiles, in the order of its entries.
// Floor: 36 B per pair, 52 B per Gaussian.
//
// twin: rasterizer::footprint::FootprintSums
// test: rasterizer-gpu/tests/parity.rs::footprints_and_top_contributors_agree
// bench: gpu/association

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var<storage, read> extents: array<vec4u>;
@group(0) @binding(2) var<storage, read> entries: array<f32>;
// (Gaussian, 9).
@group(0) @binding(3) var<storage, read_write> totals: array<f32>;

@compute @workgroup_size(256)
fn footprint_totals(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let i = linear_group(group, groups) * 256u + local;
    if i >= view.count {
        return;
    }
    let extent = extents[i];
    var a = vec4f(0.0);
    var b = vec4f(0.0);
    var c = 0.0;
    if extent.x > 0u {
        let end = min(extent.w + extent.x, view.pair_capacity);
        for (var entry = extent.w; entry < end; entry++) {
            let at = entry * ENTRY;
            a += vec4f(entries[at], entries[at + 1u], entries[at + 2u], entries[at + 3u]);
            b += vec4f(entries[at + 4u], entries[at + 5u], entries[at + 6u], entries[at + 7u]);
            c += entries[at + 8u];
        }
    }
    let at = i * ENTRY;
    totals[at] = a.x;
    totals[at + 1u] = a.y;
    totals[at + 2u] = a.z;
    totals[at + 3u] = a.w;
    totals[at + 4u] = b.x;
    totals[at + 5u] = b.y;
    totals[at + 6u] = b.z;
    totals[at + 7u] = b.w;
    totals[at + 8u] = c;
}
