// Scales the confidences at a pixel by how far the trackers agree: Algorithm 1, line 12.
// Floor: 20 B per pixel and tracker; about 10 operations per pixel and pair of trackers.
//
// twin: voronoi::agreement::agreement
// test: motion-gpu/tests/parity.rs::agreement_agrees_for_one_to_three_trackers
// bench: gpu/motion_fields

@group(0) @binding(0) var<uniform> job: Fields;
// Per tracker and masked pixel: flow (px), visibility, confidence.
@group(0) @binding(1) var<storage, read_write> fields: array<vec4f>;

@compute @workgroup_size(64)
fn agreement(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let at = linear_group(group, groups) * 64u + local;
    if at >= job.pixels {
        return;
    }
    var flow: array<vec2f, 8>;
    var known: array<bool, 8>;
    var magnitude = 0.0;
    var count = 0.0;
    for (var l = 0u; l < job.trackers; l++) {
        let field = fields[l * job.pixels + at];
        flow[l] = field.xy;
        known[l] = field.w > 0.0 || job.ignore_unknown == 0u;
        if known[l] {
            magnitude += length(field.xy);
            count += 1.0;
        }
    }
    // Equal flows agree perfectly, also where nothing moves and there is no floor (0 / 0).
    for (var l = 0u; l < job.trackers; l++) {
        var disagreement = 0.0;
        for (var m = 0u; m < job.trackers; m++) {
            if m != l && known[m] {
                disagreement += length(flow[l] - flow[m]);
            }
        }
        if known[l] && disagreement > 0.0 {
            let mean = max(magnitude / count, job.magnitude_floor);
            fields[l * job.pixels + at].w *= exp(-(disagreement / (count - 1.0)) / mean);
        }
    }
}
