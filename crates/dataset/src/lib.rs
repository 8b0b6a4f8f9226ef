//! Multi-view captures in the Dynamic3DGaussians layout: cameras, images, masks, points, and their validation.
//!
//! ```text
//! CAPTURE/train_meta.json      w, h, k[t][c] 3x3, w2c[t][c] 4x4, fn[t][c] = "CAMERA/FRAME.png", cam_id[t][c]
//! CAPTURE/test_meta.json       the same for held-out cameras (optional)
//! CAPTURE/init_meta.json       the same for views of frame 0 only (optional)
//! CAPTURE/ims/CAMERA/FRAME.png, CAPTURE/seg/CAMERA/FRAME.png (optional, 0/1 or 0/255)
//! CAPTURE/init_pt_cld.npz      data (N, 7): xyz (m), rgb 0..=1, foreground 0 or 1
//! ```
//!
//! Architecture invariant: nothing is cached; an image is read when asked for and kept as u8.

#![warn(clippy::missing_errors_doc)]

mod capture;
mod check;
mod error;
mod format;
mod mask_suspicions;
mod meta;
mod origin;
mod outlines;
mod pixels;
mod points;
mod report;
mod suspicions;

pub use capture::Capture;
pub use check::{ImageCheck, check, check_with_progress};
pub use error::DatasetError;
pub use ffgs_method::{Fault, Points, Split};
pub use format::Dynamic3dGaussians;
pub use meta::View;
pub use pixels::{probe_image, read_image, read_image_with_file, read_mask, write_image, write_mask};
pub use report::{CheckReport, Note, SplitSummary, ViewSummary};
