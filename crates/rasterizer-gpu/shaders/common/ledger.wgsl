// What the trainer keeps of every Gaussian. Host side: `Ledger` in rasterizer-gpu.

struct Ledger {
    // Number of the last training step whose view saw it.
    stamp: u32,
    // Steps of the optimiser; counted with the first gradient of a step.
    steps: u32,
    // Views since the last round of density control, and the sum of |dL/d(projected mean)| over them, in units of
    // half an image size.
    views: u32,
    gradient_norm: f32,
}
