//! What the adapter can do at best: multiply-adds, and memory traffic as bytes read plus bytes written.

use crate::rows::Rows;
use ffgs_gpu::{Buffer, Gpu, GpuError, Groups, Kernel};
use ffgs_trainer_gpu::Floor;

/// Far larger than a cache (bytes), where the adapter binds so much.
const ARRAY: u64 = 256 << 20;
/// Invocations of the multiply-adds; each has eight chains of four.
const INVOCATIONS: usize = 1 << 18;
/// Multiply-adds of one invocation and round.
const CHAINS: f64 = 32.0;

const COPY: Kernel = Kernel {
    name: "machine_copy",
    source: &["
@group(0) @binding(0) var<storage, read> source: array<vec4f>;
@group(0) @binding(1) var<storage, read_write> copied: array<vec4f>;
@compute @workgroup_size(256)
fn machine_copy(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32) {
    let at = (group.y * groups.x + group.x) * 256u + local;
    if at < arrayLength(&source) { copied[at] = source[at]; }
}"],
    group: 256,
    subgroups: false,
};

const FMA: Kernel = Kernel {
    name: "machine_fma",
    source: &["
@group(0) @binding(0) var<uniform> rounds: vec4u;
@group(0) @binding(1) var<storage, read_write> results: array<vec4f>;
@compute @workgroup_size(256)
fn machine_fma(@builtin(workgroup_id) group: vec3u, @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32) {
    let at = (group.y * groups.x + group.x) * 256u + local;
    let a = vec4f(0.999);
    let b = vec4f(f32(rounds.y) * 1e-3);
    var s0 = vec4f(f32(at));
    var s1 = s0 + 1.0;
    var s2 = s0 + 2.0;
    var s3 = s0 + 3.0;
    var s4 = s0 + 4.0;
    var s5 = s0 + 5.0;
    var s6 = s0 + 6.0;
    var s7 = s0 + 7.0;
    for (var i = 0u; i < rounds.x; i++) {
        s0 = fma(s0, a, b);
        s1 = fma(s1, a, b);
        s2 = fma(s2, a, b);
        s3 = fma(s3, a, b);
        s4 = fma(s4, a, b);
        s5 = fma(s5, a, b);
        s6 = fma(s6, a, b);
        s7 = fma(s7, a, b);
    }
    if at < arrayLength(&results) { results[at] = s0 + s1 + s2 + s3 + s4 + s5 + s6 + s7; }
}"],
    group: 256,
    subgroups: false,
};

/// Rows `machine/copy` and `machine/fma`.
pub(crate) fn rates(gpu: &Gpu, rows: &mut Rows) -> Result<(), GpuError> {
    let bytes = ARRAY.min(gpu.report().max_binding);
    let (source, copied) = (gpu.buffer("source", bytes)?, gpu.buffer("copy", bytes)?);
    let groups = || Groups::Items((bytes / 16) as usize);
    let seconds = rows.time_on(gpu, || submit(gpu, &COPY, &[&source, &copied], groups()))?;
    rows.add("machine/copy", seconds, Some(Floor { bytes: 2.0 * bytes as f64, operations: 0.0 }));
    let results = gpu.buffer("results", 16 * INVOCATIONS as u64)?;
    let groups = || Groups::Items(INVOCATIONS);
    // As many rounds as take long beside a submission.
    let mut rounds = 16_u32;
    loop {
        let uniform = gpu.uniform("rounds", &[rounds, 0, 0, 0])?;
        let seconds = rows.time_on(gpu, || submit(gpu, &FMA, &[&uniform, &results], groups()))?;
        if seconds > 0.01 || rounds > 1 << 20 {
            let operations = CHAINS * f64::from(rounds) * INVOCATIONS as f64;
            rows.add("machine/fma", seconds, Some(Floor { bytes: 0.0, operations }));
            return Ok(());
        }
        rounds *= 4;
    }
}

fn submit(gpu: &Gpu, kernel: &Kernel, buffers: &[&Buffer], groups: Groups) -> Result<(), GpuError> {
    let mut commands = gpu.commands();
    commands.run(kernel, buffers, groups);
    gpu.submit(commands)
}
