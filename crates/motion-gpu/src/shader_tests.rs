//! Checks of the shaders that need no GPU.

use crate::layout::{DensifyUniform, FieldsUniform, UnpackUniform};
use crate::{fields, kernels};
use ffgs_gpu::host_layout;
use ffgs_gpu::reflection::{Reflection, constant_faults};

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

#[test]
fn constants_are_those_of_the_host() {
    let shared = [
        ("MOST_NEIGHBOURS", fields::MOST_NEIGHBOURS as f64),
        ("MOST_TRACKERS", fields::MOST_TRACKERS as f64),
    ];
    assert_eq!(constant_faults(kernels::ALL, &shared, &[]).unwrap(), [""; 0]);
}
