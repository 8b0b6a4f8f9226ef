//! Errors of the device: no adapter, too little memory, a lost device, a wrong kernel.

use thiserror::Error;

/// Why the GPU cannot do what was asked.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum GpuError {
    /// No driver gives an adapter.
    #[error("no GPU adapter: install a Vulkan, Metal or DX12 driver, or use --device cpu")]
    NoAdapter,
    /// The number after `gpu:` is too large.
    #[error("gpu:{index} does not exist; `ffgs devices` lists {count}")]
    NoSuchAdapter {
        /// The number asked for.
        index: usize,
        /// Adapters there are.
        count: usize,
    },
    /// The adapter lacks something that every kernel needs.
    #[error("{adapter} cannot run the kernels: {reason}")]
    Unsupported {
        /// Name of the adapter.
        adapter: String,
        /// What is missing.
        reason: String,
    },
    /// One buffer would exceed what a kernel can bind.
    #[error(
        "{what} needs {bytes} bytes in one buffer; this device binds at most {limit}: use fewer Gaussians or smaller images"
    )]
    TooLarge {
        /// What the buffer is for.
        what: String,
        /// Size asked for.
        bytes: u64,
        /// Largest binding of the device.
        limit: u64,
    },
    /// The device's memory is full.
    #[error(
        "the GPU's memory is full: use fewer Gaussians or smaller images, a larger --memory where it is given, or --device cpu"
    )]
    OutOfMemory,
    /// The driver took the device away.
    #[error("the GPU was lost ({0}); finished frames are safe, go on with --resume")]
    Lost(String),
    /// A command was refused: a fault of this program or of the driver.
    #[error("the GPU refused a command: {0}")]
    Refused(String),
}
