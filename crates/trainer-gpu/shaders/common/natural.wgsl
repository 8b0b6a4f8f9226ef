// A step along the natural gradient. Host side: `NaturalUniform` in trainer-gpu; CPU twin: trainer/src/natural.rs.

// Longest step, in steps that Adam takes where all derivatives agree.
const LONGEST: f32 = 3.0;

struct Natural {
    stamp: u32,
    // Items at the front that stay.
    fixed: u32,
    // Of the way to the minimum, over what one nat is in the loss of a view with the mean number of pixels.
    share: f32,
    means: f32,
    quats: f32,
    scales: f32,
    opacities: f32,
    sh0: f32,
    sh_rest: f32,
    padding_a: u32,
    padding_b: u32,
    padding_c: u32,
}

// A step that is not a number is none: a curvature that cannot be inverted.
fn limited(step: f32, rate: f32) -> f32 {
    if !(abs(step) < 3.4e38) {
        return 0.0;
    }
    return clamp(step, -LONGEST * rate, LONGEST * rate);
}
