//! Host twins of the shaders' structs; a test compares every offset with naga's.

use bytemuck::{Pod, Zeroable};

/// `Loss` of `shaders/common/loss_struct.wgsl`.
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct LossUniform {
    pub size: [u32; 2],
    pub tiles: [u32; 2],
    pub slots: u32,
    pub l1_factor: f32,
    pub ssim_factor: f32,
    pub per_sample: f32,
}

/// `Adam` of `shaders/adam.wgsl`.
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct AdamUniform {
    pub items: u32,
    pub width: u32,
    pub stamp: u32,
    /// Items at the front that stay.
    pub fixed: u32,
    /// Whether items that were not seen go on, and the bias correction is that of the training's steps: 0 = no.
    pub coasts: u32,
    pub unused: u32,
    pub padding: [u32; 2],
    pub rates: [[f32; 4]; 12],
}

/// `Carry` of `shaders/carry.wgsl`.
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct CarryUniform {
    pub rows: u32,
    pub width: u32,
    pub dropped: u32,
    pub padding: u32,
}

/// `Sky` of `shaders/common/sky_struct.wgsl`.
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct SkyUniform {
    pub size: u32,
    pub scale: f32,
    pub rate: f32,
    pub epsilon: f32,
}

/// `Prior` of `shaders/common/prior.wgsl`.
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct PriorUniform {
    pub items: u32,
    pub coefficients: u32,
    pub strength: f32,
    pub damping_means: f32,
    pub damping_turns: f32,
    pub damping_scales: f32,
    pub damping_opacities: f32,
    pub damping_sh0: f32,
    pub damping_sh_rest: f32,
    pub padding_a: u32,
    pub padding_b: u32,
    pub padding_c: u32,
}

/// `Natural` of `shaders/common/natural.wgsl`.
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct NaturalUniform {
    pub stamp: u32,
    /// Items at the front that stay.
    pub fixed: u32,
    pub share: f32,
    pub means: f32,
    pub quats: f32,
    pub scales: f32,
    pub opacities: f32,
    pub sh0: f32,
    pub sh_rest: f32,
    pub padding_a: u32,
    pub padding_b: u32,
    pub padding_c: u32,
}
