// A dense tracker's field from 16-bit numbers: flow in steps of its range, visibility and confidence.
// Floor: 8 B read and 16 B written per pixel.
//
// twin: motion-gpu::packed::Packed
// test: motion-gpu/tests/parity.rs::agreement_agrees_for_one_to_three_trackers
// bench: gpu/motion_fields

struct Unpack {
    // Middle of the flow's range, and from there to its ends (px).
    middle: vec2f,
    reach: vec2f,
    pixels: u32,
    // Row of the tracker's first pixel in `fields`.
    first: u32,
    padding: vec2u,
}

@group(0) @binding(0) var<uniform> job: Unpack;
@group(0) @binding(1) var<storage, read> packed: array<vec2u>;
@group(0) @binding(2) var<storage, read_write> fields: array<vec4f>;

@compute @workgroup_size(256)
fn unpack_field(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let at = linear_group(group, groups) * 256u + local;
    if at >= job.pixels {
        return;
    }
    let certainty = unpack2x16unorm(packed[at].y);
    var flow = vec2f(0.0);
    if certainty.y > 0.0 {
        flow = job.middle + unpack2x16snorm(packed[at].x) * job.reach;
    }
    fields[job.first + at] = vec4f(flow, certainty);
}
