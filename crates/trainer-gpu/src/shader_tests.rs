//! Checks of the shaders that need no GPU.

use crate::kernels;
use crate::layout::{AdamUniform, CarryUniform, LossUniform, NaturalUniform, PriorUniform, SkyUniform};
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
    let prior = host_layout!(
        PriorUniform,
        items,
        coefficients,
        strength,
        damping_means,
        damping_turns,
        damping_scales,
        damping_opacities,
        damping_sh0,
        damping_sh_rest,
        padding_a,
        padding_b,
        padding_c
    );
    let natural = host_layout!(
        NaturalUniform,
        stamp,
        fixed,
        share,
        means,
        quats,
        scales,
        opacities,
        sh0,
        sh_rest,
        padding_a,
        padding_b,
        padding_c
    );
    let twins = [
        ("Loss", host_layout!(LossUniform, size, tiles, slots, l1_factor, ssim_factor, per_sample)),
        ("Adam", host_layout!(AdamUniform, items, width, stamp, fixed, coasts, unused, padding, rates)),
        ("Carry", host_layout!(CarryUniform, rows, width, dropped, padding)),
        ("Prior", prior),
        ("Natural", natural),
        ("Sky", host_layout!(SkyUniform, size, scale, rate, epsilon)),
    ];
    for (name, host) in twins {
        let layouts = kernels::ALL.iter().filter_map(|k| Reflection::of(k).unwrap().layout(name));
        let found: Vec<_> = layouts.collect();
        assert!(!found.is_empty() && found.iter().all(|shader| *shader == host), "{name}: {found:?}");
    }
}

#[test]
fn constants_are_those_of_the_host() {
    use ffgs_rasterizer::constants as rasterizer;
    use ffgs_trainer::constants as host;
    let shared = [
        ("BETA1", f64::from(host::BETA1)),
        ("BETA2", f64::from(host::BETA2)),
        ("EPSILON", f64::from(host::EPSILON)),
        ("CORRECTED_STEPS", host::CORRECTED_STEPS as f64),
        ("C1", f64::from(host::C1)),
        ("C2", f64::from(host::C2)),
        ("LONGEST", f64::from(host::LONGEST)),
        ("RADIUS", host::RADIUS as f64),
        ("HALO", (rasterizer::TILE + 2 * host::RADIUS) as f64),
        ("TILE", rasterizer::TILE as f64),
        ("AREA", rasterizer::AREA as f64),
        ("ENTRY", rasterizer::ENTRY as f64),
        ("MIN_ALPHA", f64::from(rasterizer::MIN_ALPHA)),
        ("MAX_ALPHA", f64::from(rasterizer::MAX_ALPHA)),
        ("MIN_TRANSMITTANCE", f64::from(rasterizer::MIN_TRANSMITTANCE)),
        ("MIN_THROUGH", f64::from(host::MIN_THROUGH)),
        ("RATE", f64::from(host::RUNNING_RATE as f32)),
        ("NEW", f64::from(crate::optimiser::NEW)),
    ];
    // Bounds of sums of whole numbers, and a mark that the rasterizer's test compares.
    let device_only = ["LIMIT", "NO_SLOT"];
    assert_eq!(constant_faults(kernels::ALL, &shared, &device_only).unwrap(), [""; 0]);
}
