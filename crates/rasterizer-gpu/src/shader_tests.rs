//! Checks of the shaders that need no GPU.

use crate::{kernels, layout};
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
    use layout::{Geometry, Job, Ledger, ViewUniform};
    #[rustfmt::skip]
    let view = host_layout!(
        ViewUniform, rotation, center_high, count, center_low, sh_degree, focal, principal, slope_low, slope_high,
        size, tiles, background, sh_stride, antialiased, slots, span_capacity, pair_capacity, layered, stamp,
        with_pose, padding,
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
fn host_constants_are_those_of_the_shaders() {
    let constants = [
        ("TILE", ffgs_rasterizer::TILE as u32),
        ("ENTRY", layout::ENTRY as u32),
        ("BLOCK", crate::scratch::BLOCK as u32),
        ("DIGITS", crate::scratch::DIGITS as u32),
        ("PLAN_COUNT", layout::plan::COUNT),
        ("PLAN_PAIRS", layout::plan::PAIRS),
        ("PLAN_NEEDED_PAIRS", layout::plan::NEEDED_PAIRS as u32),
        ("PLAN_NEEDED_SPANS", layout::plan::NEEDED_SPANS as u32),
        ("PLAN_SORT", layout::plan::SORT),
        ("PLAN_SCAN", layout::plan::SCAN),
        ("PLAN_EACH", layout::plan::EACH),
    ];
    for (name, host) in constants {
        let line = format!("const {name}: u32 = {host}u;");
        assert!(kernels::ALL.iter().any(|k| k.text().contains(&line)), "no shader has `{line}`");
    }
}
