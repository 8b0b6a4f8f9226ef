// Adam's moments after a round of density control, a row of `width` values per Gaussian: kept ones keep theirs, new
// ones start at zero.
// Floor: 8 B per value and 4 B per Gaussian.
//
// twin: trainer::adam::remap
// test: trainer-gpu/src/tests.rs::moments_are_carried_over_a_round_of_density_control
// bench: gpu/round_trip

struct Carry {
    // Rows after the round, and values of a row.
    rows: u32,
    width: u32,
    // Column that starts at zero for all; none when it is beyond the width.
    dropped: u32,
    padding: u32,
}

@group(0) @binding(0) var<uniform> job: Carry;
// Row before the round, or NEW.
@group(0) @binding(1) var<storage, read> sources: array<u32>;
@group(0) @binding(2) var<storage, read> before: array<f32>;
@group(0) @binding(3) var<storage, read_write> moments: array<f32>;

const NEW: u32 = 0xffffffffu;

@compute @workgroup_size(256)
fn carry(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let at = linear_group(group, groups) * 256u + local;
    let row = at / job.width;
    if row >= job.rows {
        return;
    }
    let column = at % job.width;
    let source = sources[row];
    var value = 0.0;
    if source != NEW && column != job.dropped {
        value = before[source * job.width + column];
    }
    moments[at] = value;
}
