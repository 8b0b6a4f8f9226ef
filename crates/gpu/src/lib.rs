//! Compute on any GPU: the only crate that names wgpu types.
//!
//! A [`Gpu`] is one opened adapter. It makes [`Buffer`]s (refused with a readable error before they are allocated when a
//! limit forbids them), runs [`Kernel`]s recorded into [`Commands`], and counts every byte that crosses between host and
//! device, so that a test can hold a training step to reading nothing back. A lost device, exhausted memory or a
//! refused command is an error of the next call and never a panic.
//!
//! ```
//! use ffgs_gpu::{Gpu, Groups, Kernel};
//! const DOUBLE: Kernel = Kernel {
//!     name: "double",
//!     source: &["@group(0) @binding(0) var<storage, read_write> values: array<u32>;
//!         @compute @workgroup_size(4) fn double(@builtin(global_invocation_id) id: vec3u) { values[id.x] *= 2u; }"],
//!     group: 4,
//!     subgroups: false,
//! };
//! // Adapters differ between machines, and a machine may have none.
//! if let Ok(gpu) = Gpu::open(None) {
//!     let values = gpu.upload("values", &[1_u32, 2, 3, 4])?;
//!     let mut commands = gpu.commands();
//!     commands.run(&DOUBLE, &[&values], Groups::Items(4));
//!     gpu.submit(commands)?;
//!     assert_eq!(gpu.download::<u32>(&values, 4)?, [2, 4, 6, 8]);
//! }
//! # Ok::<(), ffgs_gpu::GpuError>(())
//! ```

mod adapter;
mod buffer;
mod clock;
mod commands;
mod device;
mod error;
mod kernel;
mod profile;
pub mod reflection;

pub use adapter::{AdapterReport, adapters, hardware_adapters};
pub use buffer::Buffer;
pub use clock::KernelTime;
pub use commands::{Commands, Groups};
pub use device::{Gpu, Traffic};
pub use error::GpuError;
pub use kernel::{GROUPS, Kernel};
