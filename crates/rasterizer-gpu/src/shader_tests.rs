//! Checks of the shaders that need no GPU.

use crate::{kernels, layout};
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
    use layout::{Geometry, Job, Ledger, ViewUniform};
    #[rustfmt::skip]
    let view = host_layout!(
        ViewUniform, rotation, center_high, count, center_low, sh_degree, focal, principal, slope_low, slope_high,
        size, tiles, background, sh_stride, antialiased, slots, span_capacity, pair_capacity, layered, stamp,
        with_pose, dropout_threshold, dropout_draw, dropout_gain, pixel_filter, beyond, parts, padding_a, padding_b,
        padding_c,
    );
    let twins = [
        ("View", view),
        ("Geometry", host_layout!(Geometry, mean, opacity_logit, quat, log_scale, padding)),
        ("Ledger", host_layout!(Ledger, stamp, steps, views, gradient_norm)),
        ("Job", host_layout!(Job, length_at, histogram, shift, padding)),
    ];
    for (name, host) in twins {
        let layouts = kernels::ALL.iter().filter_map(|k| Reflection::of(k).unwrap().layout(name));
        let found: Vec<_> = layouts.collect();
        assert!(!found.is_empty() && found.iter().all(|shader| *shader == host), "{name}: {found:?}");
    }
    let splat = Reflection::of(&kernels::BLEND).unwrap().layout("Splat").unwrap();
    assert_eq!(u64::from(splat.1), layout::SPLAT_BYTES);
}

#[test]
fn constants_are_those_of_the_host() {
    use ffgs_rasterizer::constants as host;
    let shared = [
        ("TILE", host::TILE as f64),
        ("AREA", host::AREA as f64),
        ("ENTRY", host::ENTRY as f64),
        ("MIN_ALPHA", f64::from(host::MIN_ALPHA)),
        ("MAX_ALPHA", f64::from(host::MAX_ALPHA)),
        ("MIN_TRANSMITTANCE", f64::from(host::MIN_TRANSMITTANCE)),
        ("MIN_COMPENSATION", f64::from(host::MIN_COMPENSATION)),
        ("NEAR", f64::from(host::NEAR)),
        ("LEAST_VARIANCE", f64::from(host::LEAST_VARIANCE)),
        ("BLOCK", crate::scratch::BLOCK as f64),
        ("DIGITS", crate::scratch::DIGITS as f64),
        ("CHANNELS", crate::footprint::CHANNELS as f64),
        ("MOST", crate::footprint::MOST_CONTRIBUTORS as f64),
        ("NO_SLOT", f64::from(crate::view::NO_SLOT)),
        ("PLAN_COUNT", f64::from(layout::plan::COUNT)),
        ("PLAN_PAIRS", f64::from(layout::plan::PAIRS)),
        ("PLAN_NEEDED_PAIRS", layout::plan::NEEDED_PAIRS as f64),
        ("PLAN_NEEDED_SPANS", layout::plan::NEEDED_SPANS as f64),
        ("PLAN_SORT", f64::from(layout::plan::SORT)),
        ("PLAN_SCAN", f64::from(layout::plan::SCAN)),
        ("PLAN_EACH", f64::from(layout::plan::EACH)),
        ("SH_C0", f64::from(ffgs_rasterizer::sh_basis(1, glam::Vec3::Z)[0])),
        ("SH_C1", f64::from(ffgs_rasterizer::sh_basis(1, glam::Vec3::Z)[2])),
    ];
    // How a kernel shares out its work, and marks that it alone reads.
    let device_only = [
        "REDUCED",
        "REDUCE_STRIDE",
        "MOST_SUBGROUPS",
        "BATCH",
        "ROWS",
        "MAX_EXPONENT",
        "OUT_OF_SIGHT",
        "FAR",
    ];
    assert_eq!(constant_faults(kernels::ALL, &shared, &device_only).unwrap(), [""; 0]);
}
