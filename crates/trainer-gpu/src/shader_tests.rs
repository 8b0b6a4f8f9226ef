//! Checks of the shaders that need no GPU.

use crate::kernels;
use crate::layout::{AdamUniform, CarryUniform, LossUniform, PriorUniform, SkyUniform};
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
    let twins = [
        ("Loss", host_layout!(LossUniform, size, tiles, slots, l1_factor, ssim_factor, per_sample)),
        ("Adam", host_layout!(AdamUniform, items, width, stamp, padding, rates)),
        ("Carry", host_layout!(CarryUniform, rows, width, dropped, padding)),
        ("Prior", host_layout!(PriorUniform, items, coefficients, strength, padding)),
        ("Sky", host_layout!(SkyUniform, size, scale, rate, epsilon)),
    ];
    for (name, host) in twins {
        let layouts = kernels::ALL.iter().filter_map(|k| Reflection::of(k).unwrap().layout(name));
        let found: Vec<_> = layouts.collect();
        assert!(!found.is_empty() && found.iter().all(|shader| *shader == host), "{name}: {found:?}");
    }
}
