// What is known of a layer before it is trained. Host side: `PriorUniform` in trainer-gpu.

struct Prior {
    items: u32,
    // SH coefficients per Gaussian.
    coefficients: u32,
    // Weight of the penalty in units of the loss, at one sample and one view.
    strength: f32,
    // What natural steps add to the information of each kind of parameter.
    damping_means: f32,
    damping_turns: f32,
    damping_scales: f32,
    damping_opacities: f32,
    damping_sh0: f32,
    damping_sh_rest: f32,
    padding_a: u32,
    padding_b: u32,
    padding_c: u32,
}
