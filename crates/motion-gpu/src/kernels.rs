//! The compute shaders of `shaders/motion`, each with the shared pieces it needs.

use ffgs_gpu::{Kernel, wgsl};

macro_rules! kernel {
    ($name:ident, $file:literal, [$($piece:expr),*]) => {
        pub(crate) const $name: Kernel = Kernel {
            name: $file,
            source: &[$($piece,)* GROUPS, wgsl!(concat!("motion/", $file))],
            subgroups: false,
        };
    };
}

const GROUPS: &str = wgsl!("common/groups");
const FIELDS: &str = wgsl!("common/fields");

kernel!(DENSIFY, "densify", []);
kernel!(UNPACK_FIELD, "unpack_field", []);
kernel!(AGREEMENT, "agreement", [FIELDS]);
kernel!(FIELD_PLANES, "field_planes", [FIELDS]);

/// Every kernel of this crate.
#[cfg(test)]
pub(crate) const ALL: [Kernel; 4] = [DENSIFY, UNPACK_FIELD, AGREEMENT, FIELD_PLANES];
