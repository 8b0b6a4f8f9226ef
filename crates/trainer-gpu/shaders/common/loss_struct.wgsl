// The kernels' description of a view's loss. Host side: `LossUniform` in trainer-gpu.

struct Loss {
    size: vec2u,
    // Columns and rows of tiles.
    tiles: vec2u,
    // Computed tiles.
    slots: u32,
    // Factors of the two gradients, the mean over counted samples included.
    l1_factor: f32,
    ssim_factor: f32,
    // 1 / (3 counted pixels); 0 without any.
    per_sample: f32,
}
