// The sky and its step. Host side: `SkyUniform` in trainer-gpu.

struct Sky {
    // Texels along the edge of a face.
    size: u32,
    // Derivatives are summed as whole numbers, so that the order cannot matter: this many to 1.
    scale: f32,
    rate: f32,
    // A derivative of this size moves its texel at half the rate.
    epsilon: f32,
}
