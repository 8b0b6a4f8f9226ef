// Pieces of every prefix sum.

// Number of values; `job` and `plan` are bindings of the entry file.
fn scan_length() -> u32 {
    let items = plan[job.length_at];
    return select(items, DIGITS * blocks_of(items), job.histogram != 0u);
}

var<workgroup> scan_values: array<u32, 256>;

// Exclusive prefix sum over the 256 invocations of a workgroup: sum over lower invocations (x) and over all (y). Every invocation must call it.
fn scan_group(value: u32, local: u32) -> vec2u {
    scan_values[local] = value;
    workgroupBarrier();
    for (var step = 1u; step < 256u; step *= 2u) {
        var below = 0u;
        if local >= step {
            below = scan_values[local - step];
        }
        workgroupBarrier();
        scan_values[local] += below;
        workgroupBarrier();
    }
    let inclusive = scan_values[local];
    let total = scan_values[255];
    workgroupBarrier();
    return vec2u(inclusive - value, total);
}
