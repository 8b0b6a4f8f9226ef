// One step along the natural gradient of the SH coefficients, for the Gaussians that the step's view saw: the first moment
// over what is known, in units of the loss.
// Floor: 28 B per value of those Gaussians.
//
// twin: trainer::natural::Curvature
// test: trainer-gpu/src/tests.rs::natural_steps_agree
// bench: gpu/prior

@group(0) @binding(0) var<uniform> prior: Prior;
@group(0) @binding(1) var<uniform> natural: Natural;
@group(0) @binding(2) var<storage, read> ledger: array<Ledger>;
// Factors of the two moments by number of steps.
@group(0) @binding(3) var<storage, read> corrections: array<vec2f>;
// Views that see each Gaussian.
@group(0) @binding(4) var<storage, read> seen: array<u32>;
// (Gaussian, coefficient, RGB), and so the others.
@group(0) @binding(5) var<storage, read> known: array<f32>;
@group(0) @binding(6) var<storage, read> gradient: array<f32>;
@group(0) @binding(7) var<storage, read_write> now: array<f32>;
@group(0) @binding(8) var<storage, read_write> first: array<f32>;

@compute @workgroup_size(256)
fn natural_colours(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let at = linear_group(group, groups) * 256u + local;
    let width = 3u * prior.coefficients;
    let i = at / width;
    if i >= prior.items || i < natural.fixed || ledger[i].stamp != natural.stamp {
        return;
    }
    let base = at % width < 3u;
    let damping = select(prior.damping_sh_rest, prior.damping_sh0, base);
    let rate = select(natural.sh_rest, natural.sh0, base);
    let correction = corrections[min(ledger[i].steps, CORRECTED_STEPS)].x;
    let per_nat = natural.share * correction * f32(max(seen[i], 1u));
    let mean = first[at] + (1.0 - BETA1) * (gradient[at] - first[at]);
    first[at] = mean;
    now[at] -= limited(per_nat * mean / (known[at] + damping), rate);
}
