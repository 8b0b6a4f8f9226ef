//! Where to compute: `--device auto | cpu | gpu[:N,N]`.

use crate::cli::terminal;
use anyhow::Result;
use ffgs_gpu::Gpu;
use ffgs_rasterizer_gpu::SceneDevice;
use std::str::FromStr;

/// Where to compute.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Device {
    /// The hardware GPUs that equal the best one, else the CPU; never software Vulkan, which is slower than the CPU path.
    #[default]
    Auto,
    /// All cores of this machine.
    Cpu,
    /// These adapters of `ffgs devices`, the lanes distributed over them; none = the best one.
    Gpu(Vec<usize>),
}

impl FromStr for Device {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let numbers = |list: &str| list.split(',').map(str::parse).collect::<Result<_, _>>();
        match (text, text.strip_prefix("gpu:").map(numbers)) {
            ("auto", _) => Ok(Self::Auto),
            ("cpu", _) => Ok(Self::Cpu),
            ("gpu", _) => Ok(Self::Gpu(Vec::new())),
            (_, Some(Ok(indices))) => Ok(Self::Gpu(indices)),
            _ => Err("expected auto, cpu, gpu, gpu:N or gpu:N,N, N as `ffgs devices` lists them".to_owned()),
        }
    }
}

impl Device {
    /// Opens the GPUs; none = compute on the CPU. A GPU that was asked for and cannot be opened is an error.
    ///
    /// # Errors
    /// When an adapter that was asked for does not exist or cannot be used.
    pub fn open(&self) -> Result<Vec<SceneDevice>> {
        self.open_within(None)
    }

    /// As [`open`](Self::open); each GPU may take so much memory (MiB) at most.
    ///
    /// # Errors
    /// Those of [`open`](Self::open).
    pub(crate) fn open_within(&self, memory: Option<usize>) -> Result<Vec<SceneDevice>> {
        let gpus: Vec<Gpu> = match self {
            Self::Cpu => Vec::new(),
            Self::Auto => ffgs_gpu::hardware_adapters().into_iter().filter_map(open_or_warn).collect(),
            Self::Gpu(indices) if indices.is_empty() => vec![Gpu::open(None)?],
            Self::Gpu(indices) => indices.iter().map(|&i| Gpu::open(Some(i))).collect::<Result<_, _>>()?,
        };
        if let Some(gpu) = gpus.iter().find(|gpu| gpu.report().software) {
            tracing::warn!("{} is software: --device cpu is faster", gpu.report().name);
        }
        if gpus.is_empty() {
            tracing::info!("computing on the CPU");
        }
        let limited = |gpu: Gpu| match memory {
            Some(mib) => gpu.with_memory_limit((mib as u64) << 20),
            None => gpu,
        };
        Ok(gpus.into_iter().map(limited).map(SceneDevice::new).collect())
    }
}

fn open_or_warn(index: usize) -> Option<Gpu> {
    Gpu::open(Some(index)).map_err(|error| tracing::warn!("gpu:{index} is left out: {error}")).ok()
}

/// Most memory that any of some GPUs has held (MiB); `None` without GPUs.
pub(crate) fn peak_mib(gpus: &[SceneDevice]) -> Option<f64> {
    let peak = gpus.iter().map(|device| device.gpu.memory_peak()).max()?;
    Some(peak as f64 / f64::from(1 << 20))
}

/// Name of what computes, for the record of a run: results are the same on equal devices only, however many.
pub(crate) fn name(gpus: &[SceneDevice]) -> String {
    let mut names: Vec<&str> = gpus.iter().map(|device| device.gpu.report().name.as_str()).collect();
    names.dedup();
    if names.is_empty() { "cpu".to_owned() } else { format!("gpu, {}", names.join(" + ")) }
}

/// Prints every adapter, and what `auto` takes.
pub fn list() {
    let adapters = ffgs_gpu::adapters();
    for adapter in &adapters {
        terminal::print(adapter);
    }
    if adapters.is_empty() {
        terminal::print("no GPU adapter");
    }
    let chosen: Vec<String> = ffgs_gpu::hardware_adapters().iter().map(ToString::to_string).collect();
    let chosen = if chosen.is_empty() { "cpu".to_owned() } else { format!("gpu:{}", chosen.join(",")) };
    terminal::print(format_args!("--device auto: {chosen}"));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_devices() {
        assert_eq!("gpu".parse(), Ok(Device::Gpu(Vec::new())));
        assert_eq!("gpu:2".parse(), Ok(Device::Gpu(vec![2])));
        assert_eq!("gpu:0,1,0".parse(), Ok(Device::Gpu(vec![0, 1, 0])));
        assert_eq!("auto".parse(), Ok(Device::Auto));
        for wrong in ["gpu:", "gpu:x", "gpu:0,", "gpu:0,x", "cuda", ""] {
            assert!(wrong.parse::<Device>().is_err(), "{wrong}");
        }
    }

    #[test]
    fn an_adapter_that_does_not_exist_is_named() {
        let error = Device::Gpu(vec![99]).open().err().unwrap();
        assert!(error.to_string().contains("gpu:99"), "{error}");
    }
}
