// A dense tracker's field from half floats: flow relative to its mean, confidence and visibility.
// Host side: motion-gpu/src/packed.rs. Floor: 8 B read and 16 B written a pixel.

struct Unpack {
    pixels: u32,
    // Row of the tracker's first pixel in `fields`.
    first: u32,
    // Mean flow (px).
    mean: vec2f,
}

@group(0) @binding(0) var<uniform> job: Unpack;
@group(0) @binding(1) var<storage, read> halves: array<vec2u>;
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
    let flow = unpack2x16float(halves[at].x);
    let certainty = unpack2x16float(halves[at].y);
    fields[job.first + at] = vec4f(flow + job.mean, certainty);
}
