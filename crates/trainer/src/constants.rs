//! Constants that the CPU and the GPU share; a test of `ffgs-trainer-gpu` compares them with those of the shaders.
/// Decay of the first moment (Kingma and Ba 2015).
pub const BETA1: f32 = 0.9;
/// Decay of the second moment.
pub const BETA2: f32 = 0.999;
/// As in 3DGS: gradients of a mean over pixels are tiny, a larger epsilon would damp them.
pub const EPSILON: f32 = 1e-15;
/// Beyond this many steps both bias corrections are 1 within f32 rounding: 0.999^16384 = 7.6e-8.
pub const CORRECTED_STEPS: usize = 16_384;
/// Longest natural step, in steps that Adam takes where all derivatives agree.
pub const LONGEST: f32 = 3.0;
/// Half width of SSIM's window (px).
pub const RADIUS: usize = 5;
/// Stabilises the means of SSIM, for a dynamic range of 1 (Wang et al. 2004).
pub const C1: f32 = 0.01 * 0.01;
/// Stabilises the variances, likewise.
pub const C2: f32 = 0.03 * 0.03;
/// Least transmittance at which a pixel says anything of the sky: behind less, a wall of the wrong colour outweighs it.
pub const MIN_THROUGH: f32 = 0.1;
/// Weight of the newest step in the running means of loss and squared error: an average over some twenty views.
pub const RUNNING_RATE: f64 = 0.05;
