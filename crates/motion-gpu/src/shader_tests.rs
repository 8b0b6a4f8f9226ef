//! Checks of the shaders that need no GPU.

use crate::kernels;
use crate::layout::{DensifyUniform, FieldsUniform, UnpackUniform};
use ffgs_gpu::host_layout;
use ffgs_gpu::reflection::Reflection;

#[test]
fn every_shader_is_valid_and_within_the_guaranteed_limits() {
    for kernel in kernels::ALL {
        assert_eq!(Reflection::of(kernel).unwrap().fault(kernel), None);
    }
}

#[test]
fn host_structs_have_the_layout_of_the_shaders() {
    #[rustfmt::skip]
    let densify = host_layout!(
        DensifyUniform, pixels, tracks, neighbours, first, scale, half_precision, use_visibility, width, padding,
    );
    #[rustfmt::skip]
    let fields = host_layout!(
        FieldsUniform, pixels, plane, trackers, ignore_unknown, magnitude_floor, flow_floor, padding,
    );
    let unpack = host_layout!(UnpackUniform, middle, reach, pixels, first, padding);
    for (name, host) in [("Densify", densify), ("Fields", fields), ("Unpack", unpack)] {
        let layouts = kernels::ALL.iter().filter_map(|k| Reflection::of(k).unwrap().layout(name));
        let found: Vec<_> = layouts.collect();
        assert!(!found.is_empty() && found.iter().all(|shader| *shader == host), "{name}: {found:?}");
    }
}
