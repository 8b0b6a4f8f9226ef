//! Host twins of the shaders' structs; a test compares every offset with naga's.

use bytemuck::{Pod, Zeroable};

/// `Densify` of `shaders/densify.wgsl`.
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct DensifyUniform {
    pub pixels: u32,
    pub tracks: u32,
    pub neighbours: u32,
    pub first: u32,
    pub scale: [f32; 2],
    pub half_precision: f32,
    pub use_visibility: u32,
    pub width: u32,
    pub padding: u32,
}

/// `Unpack` of `shaders/unpack_field.wgsl`.
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct UnpackUniform {
    pub middle: [f32; 2],
    pub reach: [f32; 2],
    pub pixels: u32,
    pub first: u32,
    pub padding: [u32; 2],
}

/// `Fields` of `shaders/common/fields.wgsl`.
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct FieldsUniform {
    pub pixels: u32,
    pub plane: u32,
    pub trackers: u32,
    pub ignore_unknown: u32,
    pub magnitude_floor: f32,
    pub flow_floor: f32,
    pub padding: [u32; 2],
}
