//! Image quality: PSNR, PSNR over a mask, SSIM (with gradients), flicker over time, and the 3DGS training loss.
//!
//! Sums run in a fixed order, so every value is bit-identical for any number of threads.

mod flicker;
mod psnr;
mod ssim;
mod window;

pub use flicker::{Seen, flicker, masked_flicker};
pub use psnr::{mpsnr, psnr};
pub use ssim::{Border, LossAndGradient, SsimError, SsimMap, SsimPair, loss_3dgs, ssim, ssim_and_gradient};
pub use window::WINDOW;

use ffgs_core::ImageSize;
use thiserror::Error;

/// Two images (or an image and its mask) that are compared differ in size.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error("sizes differ: rendered {}x{}, reference {}x{}", .rendered.width, .rendered.height,
    .reference.width, .reference.height)]
pub struct SizeMismatch {
    /// Size of the rendered image (px).
    pub rendered: ImageSize,
    /// Size of the target image or mask (px).
    pub reference: ImageSize,
}

fn same_size(rendered: ImageSize, reference: ImageSize) -> Result<(), SizeMismatch> {
    if rendered == reference { Ok(()) } else { Err(SizeMismatch { rendered, reference }) }
}
