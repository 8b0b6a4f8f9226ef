//! Host twins of the shaders' structs; a test compares every offset with naga's.

use bytemuck::{Pod, Zeroable};
use ffgs_core::Gaussians;

/// `View` of `shaders/common/view.wgsl`.
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct ViewUniform {
    pub rotation: [[f32; 4]; 3],
    pub center_high: [f32; 3],
    pub count: u32,
    pub center_low: [f32; 3],
    pub sh_degree: u32,
    pub focal: [f32; 2],
    pub principal: [f32; 2],
    pub slope_low: [f32; 2],
    pub slope_high: [f32; 2],
    pub size: [u32; 2],
    pub tiles: [u32; 2],
    pub background: [f32; 3],
    pub sh_stride: u32,
    pub antialiased: u32,
    pub slots: u32,
    pub span_capacity: u32,
    pub pair_capacity: u32,
    pub layered: u32,
    pub stamp: u32,
    pub with_pose: u32,
    pub dropout_threshold: u32,
    pub dropout_draw: u32,
    pub dropout_gain: f32,
    pub pixel_filter: f32,
    pub beyond: f32,
    pub parts: u32,
    pub padding_a: u32,
    pub padding_b: u32,
    pub padding_c: u32,
}

/// `Geometry` of `shaders/common/view.wgsl`: a Gaussian's parameters other than colour, their gradients or moments.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Geometry {
    /// Position (m).
    pub mean: [f32; 3],
    /// Logit of the opacity.
    pub opacity_logit: f32,
    /// Rotation (w, x, y, z).
    pub quat: [f32; 4],
    /// Logarithms of the standard deviations (m).
    pub log_scale: [f32; 3],
    /// Zero.
    pub padding: f32,
}

impl Geometry {
    /// Row of Gaussian `i`.
    pub fn of(gaussians: &Gaussians, i: usize) -> Self {
        Self {
            mean: gaussians.means[i],
            opacity_logit: gaussians.opacity_logits[i],
            quat: gaussians.quats[i],
            log_scale: gaussians.log_scales[i],
            padding: 0.0,
        }
    }

    /// Overwrites Gaussian `i`.
    pub fn store(&self, gaussians: &mut Gaussians, i: usize) {
        gaussians.means[i] = self.mean;
        gaussians.opacity_logits[i] = self.opacity_logit;
        gaussians.quats[i] = self.quat;
        gaussians.log_scales[i] = self.log_scale;
    }
}

/// `Ledger` of `shaders/common/ledger.wgsl`: what the trainer keeps of a Gaussian.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Ledger {
    /// Last training step whose view saw it.
    pub stamp: u32,
    /// Steps of the optimiser.
    pub steps: u32,
    /// Views since the last round of density control.
    pub views: u32,
    /// Sum of the norms of the derivative by the projected mean, in units of half an image size.
    pub gradient_norm: f32,
}

/// `Job` of `shaders/common/plan.wgsl`.
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct Job {
    pub length_at: u32,
    pub histogram: u32,
    pub shift: u32,
    pub padding: u32,
}

/// Bytes of a `Splat` of `shaders/common/view.wgsl`.
pub(crate) const SPLAT_BYTES: u64 = 48;

/// Entries of the plan buffer, `shaders/common/plan.wgsl`.
pub(crate) mod plan {
    pub(crate) const COUNT: u32 = 0;
    pub(crate) const PAIRS: u32 = 1;
    pub(crate) const NEEDED_PAIRS: usize = 2;
    pub(crate) const NEEDED_SPANS: usize = 3;
    pub(crate) const SORT: u32 = 4;
    pub(crate) const SCAN: u32 = 7;
    pub(crate) const EACH: u32 = 10;
    pub(crate) const LENGTH: usize = 13;
}
