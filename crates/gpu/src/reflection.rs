//! Struct layouts and constants of a kernel's source, read without a GPU, for tests that compare them with the host's.

use crate::Kernel;
use std::collections::BTreeSet;
use wgpu::naga::valid::{Capabilities, ValidationFlags, Validator};
use wgpu::naga::{AddressSpace, Expression, Literal, Module, TypeInner, front::wgsl, proc::Layouter};

/// A struct of a shader: its members with their offsets, in order, and its size (bytes).
pub type StructLayout = (Vec<(String, u32)>, u32);

/// A parsed and validated kernel.
pub struct Reflection {
    module: Module,
    /// Name of the one entry point.
    pub entry: String,
    /// Numbers of the bindings of group 0 that the entry point uses, ascending.
    pub bindings: Vec<u32>,
    /// Bindings that are declared and not used.
    pub unused: Vec<String>,
    /// Storage buffers.
    pub storage_buffers: usize,
    /// Workgroup memory in use (bytes).
    pub workgroup_bytes: u32,
    /// Invocations of a workgroup.
    pub invocations: u32,
}

impl Reflection {
    /// Parses and validates a kernel with exactly the capabilities that [`crate::Gpu::open`] asks for.
    ///
    /// # Errors
    /// The compiler's message, with the kernel's name.
    pub fn of(kernel: &Kernel) -> Result<Self, String> {
        let text = kernel.text();
        let named = |message: String| format!("{}: {message}", kernel.name);
        let module = wgsl::parse_str(&text).map_err(|e| named(e.emit_to_string(&text)))?;
        let capabilities = if kernel.subgroups { Capabilities::SUBGROUP } else { Capabilities::empty() };
        let info = Validator::new(ValidationFlags::all(), capabilities)
            .validate(&module)
            .map_err(|e| named(e.emit_to_string(&text)))?;
        let [entry] = &module.entry_points[..] else {
            return Err(named(format!("{} entry points", module.entry_points.len())));
        };
        let mut layouter = Layouter::default();
        layouter.update(module.to_ctx()).map_err(|e| named(e.to_string()))?;
        let mut out = Self {
            entry: entry.name.clone(),
            bindings: Vec::new(),
            unused: Vec::new(),
            storage_buffers: 0,
            workgroup_bytes: 0,
            invocations: entry.workgroup_size.iter().product(),
            module: Module::default(),
        };
        for (handle, variable) in module.global_variables.iter() {
            let used = !info.get_entry_point(0)[handle].is_empty();
            match variable.space {
                AddressSpace::WorkGroup if used => out.workgroup_bytes += layouter[variable.ty].size,
                AddressSpace::Storage { .. } => out.storage_buffers += 1,
                _ => {}
            }
            match &variable.binding {
                Some(binding) if used && binding.group == 0 => out.bindings.push(binding.binding),
                Some(_) => out.unused.push(variable.name.clone().unwrap_or_default()),
                None => {}
            }
        }
        out.bindings.sort_unstable();
        out.module = module;
        Ok(out)
    }

    /// A fault by the rules of this project, if there is one: WebGPU's guaranteed limits, bindings numbered from 0
    /// without a gap and all used, and an entry point of the kernel's name.
    pub fn fault(&self, kernel: &Kernel) -> Option<String> {
        let limits = wgpu::Limits::default();
        let in_order = self.bindings.iter().enumerate().all(|(i, &b)| b == i as u32);
        let rules = [
            (self.entry == kernel.name, format!("the entry point is {}", self.entry)),
            (in_order, format!("bindings {:?}", self.bindings)),
            (self.unused.is_empty(), format!("unused bindings {:?}", self.unused)),
            (
                self.storage_buffers <= limits.max_storage_buffers_per_shader_stage as usize,
                format!("{} storage buffers", self.storage_buffers),
            ),
            (
                self.workgroup_bytes <= limits.max_compute_workgroup_storage_size,
                format!("{} bytes of workgroup memory", self.workgroup_bytes),
            ),
            (
                self.invocations as usize == kernel.group,
                format!("{} invocations, not {}", self.invocations, kernel.group),
            ),
            (
                self.invocations <= limits.max_compute_invocations_per_workgroup,
                format!("{} invocations", self.invocations),
            ),
        ];
        rules.into_iter().find(|(holds, _)| !holds).map(|(_, what)| format!("{}: {what}", kernel.name))
    }

    /// The value of a number that the text names; `None` when the kernel has none of that name.
    pub fn constant(&self, name: &str) -> Option<f64> {
        let (_, constant) = self.module.constants.iter().find(|(_, c)| c.name.as_deref() == Some(name))?;
        match self.module.global_expressions[constant.init] {
            Expression::Literal(Literal::F32(value)) => Some(f64::from(value)),
            Expression::Literal(Literal::U32(value)) => Some(f64::from(value)),
            Expression::Literal(Literal::I32(value)) => Some(f64::from(value)),
            _ => None,
        }
    }

    /// Names of all numbers that the text names.
    pub fn constants(&self) -> Vec<&str> {
        let names = self.module.constants.iter().filter_map(|(_, c)| c.name.as_deref());
        names.filter(|name| self.constant(name).is_some()).collect()
    }

    /// The layout of a struct; `None` when the kernel has none of that name.
    pub fn layout(&self, name: &str) -> Option<StructLayout> {
        let ty = self.module.types.iter().find(|(_, ty)| ty.name.as_deref() == Some(name))?.1;
        let TypeInner::Struct { members, span } = &ty.inner else { return None };
        let offsets = members.iter().map(|m| (m.name.clone().unwrap_or_default(), m.offset)).collect();
        Some((offsets, *span))
    }
}

/// Where the numbers that kernels name differ from those of the host: each is in `shared`, with the host's value, or in
/// `device_only`, and each of those is in some kernel.
///
/// # Errors
/// When a kernel does not compile.
pub fn constant_faults(
    kernels: &[Kernel],
    shared: &[(&str, f64)],
    device_only: &[&str],
) -> Result<Vec<String>, String> {
    let (mut faults, mut seen) = (Vec::new(), BTreeSet::new());
    for kernel in kernels {
        let reflection = Reflection::of(kernel)?;
        for name in reflection.constants() {
            seen.insert(name.to_owned());
            let host = shared.iter().find(|(known, _)| *known == name).map(|known| known.1);
            let device = reflection.constant(name);
            if device != host && !device_only.contains(&name) {
                faults.push(format!("{}: {name} is {device:?}, on the host {host:?}", kernel.name));
            }
        }
    }
    let listed = shared.iter().map(|known| known.0).chain(device_only.iter().copied());
    faults.extend(listed.filter(|name| !seen.contains(*name)).map(|name| format!("{name}: in no kernel")));
    Ok(faults)
}

/// The layout of a host struct, to compare with [`Reflection::layout`].
#[macro_export]
macro_rules! host_layout {
    ($ty:ty, $($field:ident),+ $(,)?) => {
        (
            vec![$((stringify!($field).to_owned(), std::mem::offset_of!($ty, $field) as u32)),+],
            size_of::<$ty>() as u32,
        )
    };
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEAD: &str = "@group(0) @binding(0) var<storage, read_write> a: array<u32>;";

    fn kernel(source: &'static [&'static str]) -> Kernel {
        Kernel { name: "f", source, group: 1, subgroups: false }
    }

    #[test]
    fn faults_are_found() {
        let good = kernel(&[HEAD, "@compute @workgroup_size(64) fn f() { a[0] = 1u; }"]);
        let good = Kernel { group: 64, ..good };
        assert_eq!(Reflection::of(&good).unwrap().fault(&good), None);
        let other_size = Kernel { group: 32, ..good };
        assert!(Reflection::of(&other_size).unwrap().fault(&other_size).is_some());
        let wrong = [
            kernel(&[HEAD, "@compute @workgroup_size(64) fn g() { a[0] = 1u; }"]),
            kernel(&[HEAD, "@compute @workgroup_size(512) fn f() { a[0] = 1u; }"]),
            kernel(&[HEAD, "@compute @workgroup_size(64) fn f() {}"]),
            kernel(&[
                HEAD,
                "var<workgroup> w: array<u32, 5000>;
                @compute @workgroup_size(64) fn f() { w[0] = 1u; a[0] = w[0]; }",
            ]),
        ];
        for kernel in &wrong {
            let kernel = &Kernel { group: Reflection::of(kernel).unwrap().invocations as usize, ..*kernel };
            let found = Reflection::of(kernel).map(|r| r.fault(kernel));
            assert!(matches!(found, Ok(Some(_))), "{:?}: {found:?}", kernel.source);
        }
        let subgroups = kernel(&[HEAD, "@compute @workgroup_size(64) fn f() { a[0] = subgroupAdd(1u); }"]);
        assert!(Reflection::of(&subgroups).is_err(), "a capability that was not asked for");
        assert!(Reflection::of(&kernel(&["fn f() { let x: u32 = 1.0; }"])).is_err());
    }

    #[test]
    fn constants_that_differ_from_the_host_are_found() {
        const SOURCE: &[&str] = &[
            HEAD,
            "const A: f32 = 1.0 / 4.0;
            const B: u32 = 3u;
            @compute @workgroup_size(1) fn f() { a[0] = B + u32(A); }",
        ];
        let kernels = [kernel(SOURCE)];
        let faults = |shared: &[(&str, f64)], device_only: &[&str]| {
            constant_faults(&kernels, shared, device_only).unwrap().len()
        };
        assert_eq!(faults(&[("A", 0.25), ("B", 3.0)], &[]), 0);
        assert_eq!(faults(&[("A", 0.25)], &["B"]), 0);
        assert_eq!(faults(&[("A", 0.25)], &[]), 1, "a number that nobody lists");
        assert_eq!(faults(&[("A", 0.5), ("B", 3.0)], &[]), 1, "another value");
        assert_eq!(faults(&[("A", 0.25), ("B", 3.0), ("C", 1.0)], &[]), 1, "no kernel has C");
    }
}
