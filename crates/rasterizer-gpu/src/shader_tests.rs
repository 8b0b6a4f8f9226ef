//! Checks of the shaders that need no GPU.

use crate::{kernels, layout};
use naga::valid::{Capabilities, ValidationFlags, Validator};
use std::mem::offset_of;

fn module(kernel: &ffgs_gpu::Kernel) -> naga::Module {
    let text = kernel.text();
    naga::front::wgsl::parse_str(&text)
        .unwrap_or_else(|e| panic!("{}: {}", kernel.name, e.emit_to_string(&text)))
}

/// What the device is asked for and no more: nothing for a plain kernel.
fn capabilities(kernel: &ffgs_gpu::Kernel) -> Capabilities {
    if kernel.subgroups { Capabilities::SUBGROUP } else { Capabilities::empty() }
}

#[test]
fn every_shader_is_valid_with_the_capabilities_we_request() {
    for kernel in kernels::ALL {
        let module = module(&kernel);
        let mut validator = Validator::new(ValidationFlags::all(), capabilities(&kernel));
        if let Err(error) = validator.validate(&module) {
            panic!("{}: {}", kernel.name, error.emit_to_string(&kernel.text()));
        }
    }
}

#[test]
fn an_invalid_shader_would_be_found() {
    let text = "@compute @workgroup_size(1) fn f() { let x: u32 = 1.0; }";
    assert!(naga::front::wgsl::parse_str(text).is_err());
}

/// Bindings are numbered as `Commands::run` expects, every one is used, and no stage has more than WebGPU's eight
/// storage buffers or 16 KiB of workgroup memory.
#[test]
fn bindings_and_workgroup_memory_stay_within_the_guaranteed_limits() {
    for kernel in kernels::ALL {
        let module = module(&kernel);
        assert_eq!(module.entry_points.len(), 1, "{}", kernel.name);
        assert_eq!(module.entry_points[0].name, kernel.name);
        let info = Validator::new(ValidationFlags::all(), capabilities(&kernel)).validate(&module).unwrap();
        let mut layouter = naga::proc::Layouter::default();
        layouter.update(module.to_ctx()).unwrap();
        let (mut numbers, mut storage, mut shared) = (Vec::new(), 0, 0);
        for (handle, variable) in module.global_variables.iter() {
            let used = !info.get_entry_point(0)[handle].is_empty();
            match variable.space {
                naga::AddressSpace::WorkGroup if used => shared += layouter[variable.ty].size,
                naga::AddressSpace::Storage { .. } => storage += 1,
                _ => {}
            }
            if let Some(binding) = variable.binding {
                assert!(used, "{}: {:?} is not used", kernel.name, variable.name);
                assert_eq!(binding.group, 0, "{}", kernel.name);
                numbers.push(binding.binding);
            }
        }
        numbers.sort_unstable();
        assert!(numbers.iter().enumerate().all(|(i, &b)| b == i as u32), "{}: {numbers:?}", kernel.name);
        assert!(storage <= 8, "{}: {storage} storage buffers", kernel.name);
        assert!(shared <= 16 << 10, "{}: {shared} bytes of workgroup memory", kernel.name);
        let invocations: u32 = module.entry_points[0].workgroup_size.iter().product();
        assert!(invocations <= 256, "{}: {invocations} invocations", kernel.name);
    }
}

/// Offsets of a struct's members, by name.
fn offsets(module: &naga::Module, name: &str) -> Option<(Vec<(String, u32)>, u32)> {
    module.types.iter().find(|(_, ty)| ty.name.as_deref() == Some(name)).map(|(_, ty)| match &ty.inner {
        naga::TypeInner::Struct { members, span } => {
            (members.iter().map(|m| (m.name.clone().unwrap_or_default(), m.offset)).collect(), *span)
        }
        _ => panic!("{name} is no struct"),
    })
}

macro_rules! host_struct {
    ($ty:ty, $($field:ident),+) => {
        (vec![$((stringify!($field).to_owned(), offset_of!($ty, $field) as u32)),+], size_of::<$ty>() as u32)
    };
}

#[test]
fn host_structs_have_the_layout_of_the_shaders() {
    use layout::{Geometry, Job, Ledger, ViewUniform};
    let twins = [
        (
            "View",
            host_struct!(
                ViewUniform,
                rotation,
                center_high,
                count,
                center_low,
                sh_degree,
                focal,
                principal,
                slope_low,
                slope_high,
                size,
                tiles,
                background,
                sh_stride,
                antialiased,
                slots,
                span_capacity,
                pair_capacity,
                layered,
                stamp,
                with_pose,
                padding
            ),
        ),
        ("Geometry", host_struct!(Geometry, mean, opacity_logit, quat, log_scale, padding)),
        ("Ledger", host_struct!(Ledger, stamp, steps, views, gradient_norm)),
        ("Job", host_struct!(Job, length_at, histogram, shift, padding)),
    ];
    for (name, host) in twins {
        let mut found = 0;
        for kernel in kernels::ALL {
            if let Some(shader) = offsets(&module(&kernel), name) {
                assert_eq!(shader, host, "{name} in {}", kernel.name);
                found += 1;
            }
        }
        assert!(found > 0, "{name} is in no shader");
    }
    let splat = offsets(&module(&kernels::BLEND), "Splat").unwrap();
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
