//! Where to compute: `--device auto | cpu | gpu[:N]`.

use anyhow::Result;
use ffgs_gpu::Gpu;
use std::str::FromStr;

/// Where to compute.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Device {
    /// A hardware GPU where there is one, else the CPU; never software Vulkan, which is slower than the CPU path.
    #[default]
    Auto,
    /// All cores of this machine.
    Cpu,
    /// This adapter of `ffgs devices`, or the best one.
    Gpu(Option<usize>),
}

impl FromStr for Device {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match (text, text.strip_prefix("gpu:").map(str::parse)) {
            ("auto", _) => Ok(Self::Auto),
            ("cpu", _) => Ok(Self::Cpu),
            ("gpu", _) => Ok(Self::Gpu(None)),
            (_, Some(Ok(index))) => Ok(Self::Gpu(Some(index))),
            _ => Err("expected auto, cpu, gpu or gpu:N, N as `ffgs devices` lists them".to_owned()),
        }
    }
}

impl Device {
    /// Opens the GPU; `None` = compute on the CPU. A GPU that was asked for and cannot be opened is an error.
    pub fn open(self) -> Result<Option<Gpu>> {
        let gpu = match self {
            Self::Cpu => None,
            Self::Auto => ffgs_gpu::hardware_adapter().and_then(open_or_warn),
            Self::Gpu(index) => Some(Gpu::open(index)?),
        };
        match &gpu {
            Some(gpu) if gpu.report().software => {
                tracing::warn!("{} is software: --device cpu is faster", gpu.report().name);
            }
            Some(_) => {}
            None => tracing::info!("computing on the CPU"),
        }
        Ok(gpu)
    }
}

fn open_or_warn(index: usize) -> Option<Gpu> {
    Gpu::open(Some(index)).map_err(|error| tracing::warn!("computing on the CPU: {error}")).ok()
}

/// Name of what computes, for the record of a run: results are the same on one device only.
pub(crate) fn name(gpu: Option<&Gpu>) -> String {
    gpu.map_or_else(|| "cpu".to_owned(), |gpu| format!("gpu, {}", gpu.report().name))
}

/// Prints every adapter, and what `auto` takes.
pub fn list() {
    let adapters = ffgs_gpu::adapters();
    for adapter in &adapters {
        println!("{adapter}");
    }
    if adapters.is_empty() {
        println!("no GPU adapter");
    }
    match ffgs_gpu::hardware_adapter() {
        Some(index) => println!("--device auto: gpu:{index}"),
        None => println!("--device auto: cpu"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_devices() {
        assert_eq!("gpu".parse(), Ok(Device::Gpu(None)));
        assert_eq!("gpu:2".parse(), Ok(Device::Gpu(Some(2))));
        assert_eq!("auto".parse(), Ok(Device::Auto));
        for wrong in ["gpu:", "gpu:x", "cuda", ""] {
            assert!(wrong.parse::<Device>().is_err(), "{wrong}");
        }
    }

    #[test]
    fn automatic_choice_is_never_software() {
        let chosen = ffgs_gpu::hardware_adapter();
        let software = |i: usize| ffgs_gpu::adapters().iter().any(|a| a.index == i && a.software);
        assert!(chosen.is_none_or(|i| !software(i)));
    }

    #[test]
    fn an_adapter_that_does_not_exist_is_named() {
        let error = Device::Gpu(Some(99)).open().err().unwrap();
        assert!(error.to_string().contains("gpu:99"), "{error}");
    }
}
