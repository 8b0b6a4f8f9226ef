//! The adapters of this machine: which are usable, why others are not, and which is chosen.

use crate::GpuError;
use std::fmt;
use std::path::Path;

/// One adapter of this machine, and what it would be used as.
#[derive(Clone, Debug)]
pub struct AdapterReport {
    /// N in `gpu:N`.
    pub index: usize,
    /// Name the driver gives.
    pub name: String,
    /// Driver and its version.
    pub driver: String,
    /// Vulkan, Metal or DX12.
    pub backend: String,
    /// Whether it is a processor that poses as a GPU.
    pub software: bool,
    /// Largest buffer a kernel can bind (bytes).
    pub max_binding: u64,
    /// Invocations of one workgroup at most.
    pub max_invocations: u32,
    /// Memory that a workgroup shares (bytes).
    pub workgroup_memory: u32,
    /// Subgroup operations, and the subgroups' sizes.
    pub subgroups: Option<[u32; 2]>,
    /// Timestamps of kernels.
    pub timestamps: bool,
    /// Why it cannot be used.
    pub obstacle: Option<String>,
}

/// Invocations of a subgroup at least, for the kernels that reduce by subgroups.
const LEAST_SUBGROUP: u32 = 8;

impl AdapterReport {
    /// Whether the kernels that reduce by subgroups run here.
    pub(crate) fn reduces_by_subgroups(&self) -> bool {
        self.subgroups.is_some_and(|[low, _]| low >= LEAST_SUBGROUP)
    }

    /// Name of the kernel variants that this adapter gets.
    pub fn path(&self) -> &'static str {
        match (&self.obstacle, self.reduces_by_subgroups()) {
            (Some(_), _) => "cannot be used",
            (None, true) => "subgroup reductions",
            (None, false) => "shared-memory reductions",
        }
    }
}

impl fmt::Display for AdapterReport {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let kind = if self.software { "software, never chosen by auto" } else { "hardware" };
        writeln!(f, "gpu:{}  {} ({kind})", self.index, self.name)?;
        writeln!(f, "       {} {}", self.backend, self.driver)?;
        write!(f, "       binding {} MiB, ", self.max_binding >> 20)?;
        write!(f, "workgroup {} invocations, {} KiB", self.max_invocations, self.workgroup_memory >> 10)?;
        match self.subgroups {
            Some([low, high]) => writeln!(f, ", subgroups of {low} to {high}")?,
            None => writeln!(f, ", no subgroups")?,
        }
        write!(f, "       path: {}", self.path())?;
        self.obstacle.as_ref().map_or(Ok(()), |o| write!(f, ", {o}"))
    }
}

/// Share of what the driver says the program may use beyond which buffers are refused, where it says so: further on it
/// moves buffers out of the device's memory, or fails.
const MEMORY_PERCENT: u8 = 95;

pub(crate) fn instance() -> wgpu::Instance {
    let backends = wgpu::Backends::VULKAN | wgpu::Backends::METAL | wgpu::Backends::DX12;
    // Indirect dispatches are bounded by the kernels that write them: no second check on the device.
    let flags = wgpu::InstanceFlags::empty();
    let plain = wgpu::InstanceDescriptor::new_without_display_handle();
    let memory_budget_thresholds =
        wgpu::MemoryBudgetThresholds { for_resource_creation: Some(MEMORY_PERCENT), ..Default::default() };
    wgpu::Instance::new(wgpu::InstanceDescriptor { backends, flags, memory_budget_thresholds, ..plain })
}

pub(crate) fn all(instance: &wgpu::Instance) -> Vec<wgpu::Adapter> {
    pollster::block_on(instance.enumerate_adapters(wgpu::Backends::all()))
}

/// One of these is there on Linux when a kernel driver serves a GPU: any DRM driver, NVIDIA's own, Windows' subsystem,
/// Qualcomm's and Arm's.
const GPU_DEVICE_FILES: [&str; 5] = ["/dev/dri", "/dev/nvidiactl", "/dev/dxg", "/dev/kgsl-3d0", "/dev/mali0"];

/// Every adapter, in the order of `gpu:N`.
pub fn adapters() -> Vec<AdapterReport> {
    all(&instance()).iter().enumerate().map(|(index, adapter)| report(index, adapter)).collect()
}

/// The lanes of a frame, each of which may have an adapter of its own.
const MOST_ADAPTERS: usize = 3;

/// The adapters that `--device auto` takes: the best one and those equal to it, so that no result depends on their number.
/// None where only the CPU or software Vulkan is at hand.
///
/// On Linux without a device file of any GPU no driver is asked: software Vulkan alone takes a moment to load and writes
/// to the error stream.
pub fn hardware_adapters() -> Vec<usize> {
    if cfg!(target_os = "linux") && !GPU_DEVICE_FILES.iter().any(|file| Path::new(file).exists()) {
        return Vec::new();
    }
    equal_to_best(&adapters())
}

fn equal_to_best(reports: &[AdapterReport]) -> Vec<usize> {
    let Some(best) = best(reports).filter(|report| !report.software) else { return Vec::new() };
    let kind = |r: &AdapterReport| (r.software, r.name.clone(), r.driver.clone(), r.backend.clone());
    let equal = reports.iter().filter(|r| r.obstacle.is_none() && kind(r) == kind(best));
    equal.map(|r| r.index).take(MOST_ADAPTERS).collect()
}

/// The most capable usable adapter: hardware before software, discrete ones come first from the drivers.
pub(crate) fn best(reports: &[AdapterReport]) -> Option<&AdapterReport> {
    reports.iter().filter(|r| r.obstacle.is_none()).min_by_key(|r| (r.software, r.index))
}

pub(crate) fn report(index: usize, adapter: &wgpu::Adapter) -> AdapterReport {
    let (info, limits, features) = (adapter.get_info(), adapter.limits(), adapter.features());
    let subgroups = features
        .contains(wgpu::Features::SUBGROUP)
        .then_some([info.subgroup_min_size, info.subgroup_max_size]);
    AdapterReport {
        index,
        name: info.name.clone(),
        driver: format!("{} {}", info.driver, info.driver_info),
        backend: info.backend.to_string(),
        software: info.device_type == wgpu::DeviceType::Cpu,
        max_binding: limits.max_storage_buffer_binding_size.min(limits.max_buffer_size),
        max_invocations: limits.max_compute_invocations_per_workgroup,
        workgroup_memory: limits.max_compute_workgroup_storage_size,
        subgroups,
        timestamps: features.contains(wgpu::Features::TIMESTAMP_QUERY),
        obstacle: obstacle(&limits),
    }
}

/// The least that the kernels are written for: WebGPU's guaranteed limits.
fn obstacle(limits: &wgpu::Limits) -> Option<String> {
    let need = wgpu::Limits::default();
    let checks = [
        (
            "storage buffers",
            limits.max_storage_buffers_per_shader_stage,
            need.max_storage_buffers_per_shader_stage,
        ),
        (
            "invocations",
            limits.max_compute_invocations_per_workgroup,
            need.max_compute_invocations_per_workgroup,
        ),
        (
            "workgroup bytes",
            limits.max_compute_workgroup_storage_size,
            need.max_compute_workgroup_storage_size,
        ),
        ("groups", limits.max_compute_workgroups_per_dimension, need.max_compute_workgroups_per_dimension),
    ];
    checks
        .iter()
        .find(|(_, has, needs)| has < needs)
        .map(|(what, has, needs)| format!("{has} {what}, {needs} are needed"))
}

/// The limits to ask for: the guaranteed ones, with buffers as large as the adapter has.
pub(crate) fn requested_limits(adapter: &wgpu::Adapter) -> wgpu::Limits {
    let has = adapter.limits();
    wgpu::Limits {
        max_buffer_size: has.max_buffer_size,
        max_storage_buffer_binding_size: has.max_storage_buffer_binding_size,
        ..wgpu::Limits::default()
    }
}

/// Adapter number `index`, or the best.
pub(crate) fn choose(
    adapters: Vec<wgpu::Adapter>,
    index: Option<usize>,
) -> Result<(wgpu::Adapter, AdapterReport), GpuError> {
    let reports: Vec<_> = adapters.iter().enumerate().map(|(i, a)| report(i, a)).collect();
    let count = reports.len();
    let chosen = match index {
        Some(index) => reports.get(index).ok_or(GpuError::NoSuchAdapter { index, count })?,
        None => best(&reports).ok_or(GpuError::NoAdapter)?,
    };
    if let Some(reason) = &chosen.obstacle {
        return Err(GpuError::Unsupported { adapter: chosen.name.clone(), reason: reason.clone() });
    }
    let adapter = adapters.into_iter().nth(chosen.index).ok_or(GpuError::NoAdapter)?;
    Ok((adapter, chosen.clone()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn adapter(index: usize, software: bool, obstacle: Option<&str>) -> AdapterReport {
        AdapterReport {
            index,
            name: "A".into(),
            driver: "D".into(),
            backend: "Vulkan".into(),
            software,
            max_binding: 128 << 20,
            max_invocations: 256,
            workgroup_memory: 16 << 10,
            subgroups: None,
            timestamps: false,
            obstacle: obstacle.map(str::to_owned),
        }
    }

    #[test]
    fn hardware_comes_before_software_and_what_cannot_run_never() {
        let reports = [adapter(0, true, None), adapter(1, false, Some("old")), adapter(2, false, None)];
        assert_eq!(best(&reports).map(|r| r.index), Some(2));
        assert_eq!(best(&reports[..2]).map(|r| r.index), Some(0));
        assert!(best(&reports[1..2]).is_none());
    }

    #[test]
    fn auto_takes_equal_hardware_adapters_and_at_most_one_a_lane() {
        let mut reports: Vec<_> = (0..6).map(|i| adapter(i, i == 0, None)).collect();
        reports[2].driver = "other".into();
        assert_eq!(equal_to_best(&reports), [1, 3, 4]);
        assert_eq!(equal_to_best(&reports[..1]), [0; 0]);
        assert_eq!(equal_to_best(&reports[..3]), [1]);
    }

    #[test]
    fn subgroups_of_four_reduce_in_shared_memory() {
        let path = |subgroups| AdapterReport { subgroups, ..adapter(0, false, None) }.path();
        assert_eq!(path(Some([8, 32])), "subgroup reductions");
        assert_eq!([path(Some([4, 32])), path(None)], ["shared-memory reductions"; 2]);
    }

    #[test]
    fn too_small_limits_are_named() {
        let small = wgpu::Limits { max_storage_buffers_per_shader_stage: 4, ..wgpu::Limits::default() };
        assert_eq!(obstacle(&small).as_deref(), Some("4 storage buffers, 8 are needed"));
        assert_eq!(obstacle(&wgpu::Limits::default()), None);
    }
}
