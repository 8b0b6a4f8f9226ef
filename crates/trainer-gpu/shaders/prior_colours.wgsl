// Adds the derivative of `1/2 d^T Lambda d`, d = change since the start, to the gradient of the step: the SH
// coefficients of the Gaussians that the step's view saw, shared out over the views that see each.
// Floor: 20 B per value of those Gaussians.
//
// twin: trainer::prior::Penalty
// test: trainer-gpu/src/tests.rs::the_pull_of_the_prior_agrees
// bench: gpu/prior

@group(0) @binding(0) var<uniform> prior: Prior;
@group(0) @binding(1) var<uniform> loss: Loss;
@group(0) @binding(2) var<uniform> view: View;
@group(0) @binding(3) var<storage, read> ledger: array<Ledger>;
// Views that see each Gaussian.
@group(0) @binding(4) var<storage, read> seen: array<u32>;
// (Gaussian, coefficient, RGB), and so the others.
@group(0) @binding(5) var<storage, read> now: array<f32>;
@group(0) @binding(6) var<storage, read> start: array<f32>;
@group(0) @binding(7) var<storage, read> known: array<f32>;
@group(0) @binding(8) var<storage, read_write> gradient: array<f32>;

@compute @workgroup_size(256)
fn prior_colours(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let at = linear_group(group, groups) * 256u + local;
    let i = at / (3u * prior.coefficients);
    if i >= prior.items || ledger[i].stamp != view.stamp {
        return;
    }
    let share = prior.strength * loss.per_sample / f32(max(seen[i], 1u));
    gradient[at] += share * known[at] * (now[at] - start[at]);
}
