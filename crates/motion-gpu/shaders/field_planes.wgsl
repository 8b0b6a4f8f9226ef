// What association sums over a Gaussian's footprint, as planes of the image: the mask, and per tracker whether it
// knows a motion, flow x, flow y where it does, and the weight. The planes hold zeros before.
// Floor: 16 B read and 16 B written per pixel and tracker.
//
// twin: rasterizer::association::Association
// test: motion-gpu/tests/parity.rs::planes_hold_what_association_sums
// bench: gpu/motion_fields

@group(0) @binding(0) var<uniform> job: Fields;
// Masked pixels, row-major numbers.
@group(0) @binding(1) var<storage, read> pixels: array<u32>;
@group(0) @binding(2) var<storage, read> fields: array<vec4f>;
@group(0) @binding(3) var<storage, read_write> planes: array<f32>;

@compute @workgroup_size(256)
fn field_planes(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let at = linear_group(group, groups) * 256u + local;
    if at >= job.pixels {
        return;
    }
    let pixel = pixels[at];
    planes[pixel] = 1.0;
    for (var l = 0u; l < job.trackers; l++) {
        let field = fields[l * job.pixels + at];
        let first = (1u + 4u * l) * job.plane + pixel;
        // A tracker that knows nothing at a pixel must not pull the mean displacement toward zero.
        if field.w > 0.0 {
            planes[first] = 1.0;
            planes[first + job.plane] = field.x;
            planes[first + 2u * job.plane] = field.y;
            planes[first + 3u * job.plane] = field.w * max(length(field.xy), job.flow_floor);
        }
    }
}
