// Adam (Kingma and Ba 2015). Every item counts its own steps. Host side and CPU twin: trainer/src/adam.rs.

const BETA1: f32 = 0.9;
const BETA2: f32 = 0.999;
const EPSILON: f32 = 1e-15;
// Beyond this many steps both bias corrections are 1 within f32 rounding.
const CORRECTED_STEPS: u32 = 16384u;

// First and second moment.
fn next_moments(m: f32, v: f32, g: f32) -> vec2f {
    return vec2f(m + (1.0 - BETA1) * (g - m), v + (1.0 - BETA2) * (g * g - v));
}

// A derivative that is small against `epsilon` moves its parameter by less than `rate`.
fn step_of(moments: vec2f, rate: f32, correction: vec2f, epsilon: f32) -> f32 {
    return rate * (moments.x * correction.x) / (sqrt(moments.y) * correction.y + epsilon);
}
