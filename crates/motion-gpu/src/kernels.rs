//! The compute shaders of `shaders/`, each with the shared pieces it needs.

use ffgs_gpu::{kernels, wgsl};

const FIELDS: &str = wgsl!("common/fields");

kernels! {
    DENSIFY = "densify" of 64, [];
    UNPACK_FIELD = "unpack_field" of 256, [];
    AGREEMENT = "agreement" of 64, [FIELDS];
    FIELD_PLANES = "field_planes" of 256, [FIELDS];
}
