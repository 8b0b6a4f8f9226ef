// What is known of a layer before it is trained. Host side: `PriorUniform` in trainer-gpu.

struct Prior {
    items: u32,
    // SH coefficients per Gaussian.
    coefficients: u32,
    // Weight of the penalty in units of the loss, at one sample and one view.
    strength: f32,
    padding: u32,
}
