// One step of Adam over a column set of `width` values per item, for the items that the step's views saw, or for all: what they did not see
// goes on by its momentum.
// Floor: 28 B per value of those items, 24 B of the others.
//
// twin: trainer::adam::Adam
// test: trainer-gpu/src/tests.rs::steps_of_the_optimiser_agree
// bench: kernel/adam

struct Adam {
    items: u32,
    width: u32,
    stamp: u32,
    // Items at the front that stay.
    fixed: u32,
    // Whether items that were not seen go on, and the bias correction is that of the training's steps: 0 = no.
    coasts: u32,
    unused: u32,
    padding: vec2u,
    // Step size per value of an item; 0 leaves the value and its moments alone.
    rates: array<vec4f, 12>,
}

@group(0) @binding(0) var<uniform> adam_step: Adam;
@group(0) @binding(1) var<storage, read> ledger: array<Ledger>;
// Factors of the two moments by number of steps.
@group(0) @binding(2) var<storage, read> corrections: array<vec2f>;
@group(0) @binding(3) var<storage, read> gradient: array<f32>;
@group(0) @binding(4) var<storage, read_write> parameters: array<f32>;
@group(0) @binding(5) var<storage, read_write> first: array<f32>;
@group(0) @binding(6) var<storage, read_write> second: array<f32>;

@compute @workgroup_size(256)
fn adam(
    @builtin(workgroup_id) group: vec3u,
    @builtin(num_workgroups) groups: vec3u,
    @builtin(local_invocation_index) local: u32,
) {
    let at = linear_group(group, groups) * 256u + local;
    let item = at / adam_step.width;
    if item >= adam_step.items || item < adam_step.fixed {
        return;
    }
    let column = at % adam_step.width;
    let rate = adam_step.rates[column / 4u][column % 4u];
    let entry = ledger[item];
    let seen = entry.stamp == adam_step.stamp;
    if rate == 0.0 || !(seen || adam_step.coasts != 0u) {
        return;
    }
    // The gradient of an item that was not seen is that of an earlier step.
    let moments = next_moments(first[at], second[at], select(0.0, gradient[at], seen));
    first[at] = moments.x;
    second[at] = moments.y;
    let steps = select(entry.steps, adam_step.stamp, adam_step.coasts != 0u);
    parameters[at] -= step_of(moments, rate, corrections[min(steps, CORRECTED_STEPS)], EPSILON);
}
