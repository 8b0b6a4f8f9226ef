//! All that a report shows, as data.

use ffgs_core::Seconds;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::PathBuf;

/// All that a report shows.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct ReportInput {
    /// Title: what was reconstructed.
    pub title: String,
    /// File of a circle around what moves, a [`crate::Turntable`]; `None` when there is none.
    pub turntable: Option<PathBuf>,
    /// File of the training cameras' photographs, a [`crate::CameraPictures`]; `None` when there is none.
    pub cameras: Option<PathBuf>,
    /// The configuration as text (TOML).
    pub configuration: String,
    /// Program version, machine, seeds: one line each.
    pub facts: Vec<Fact>,
    /// How the capture was made of footage: what was read, made, assumed and skipped; empty when that is not known.
    pub preparation: Vec<Fact>,
    /// Whether the frames' views are views that were trained on, for want of test views.
    pub trained_on: bool,
    /// Frames in order.
    pub frames: Vec<FrameReport>,
    /// What was skipped and how often.
    pub skips: Vec<SkipCount>,
    /// Warnings of the run.
    pub warnings: Vec<String>,
    /// The motion initialisation against ground truth, one entry an estimate; empty when it was not scored.
    pub motion: Vec<MotionAccuracy>,
}

/// Errors of one motion estimate against ground truth, and how well its covariances foretell them.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct MotionAccuracy {
    /// A tracker, or `fused`.
    pub name: String,
    /// Median end-point error (cm).
    pub median_cm: f64,
    /// Its 95th percentile (cm).
    pub p95_cm: f64,
    /// Share of the Gaussians that have an estimate.
    pub measured: f64,
    /// Upper ends of the histogram's bins (cm); a last bin is open.
    pub bins_cm: Vec<f64>,
    /// Share of the estimates in each bin, one more than `bins_cm`.
    pub shares: Vec<f64>,
    /// (probability, share of the truth inside the ellipsoids of that probability).
    pub calibration: Vec<(f64, f64)>,
}

/// A named value.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Fact {
    /// Name.
    pub name: String,
    /// Value with its unit.
    pub value: String,
}

/// Something that was left out.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct SkipCount {
    /// What and why.
    pub what: String,
    /// How often.
    pub count: u64,
}

/// One frame.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct FrameReport {
    /// Frame index in the capture.
    pub index: usize,
    /// Test views, or, as [`ReportInput::trained_on`] says, training views.
    pub views: Vec<ViewReport>,
    /// Mean foreground PSNR before finetuning (dB).
    pub initial_mpsnr: Option<f64>,
    /// Gaussians of the static layer.
    pub static_gaussians: usize,
    /// Gaussians of the dynamic layer.
    pub dynamic_gaussians: usize,
    /// Bytes on disk.
    pub bytes: u64,
    /// Gaussians that came, went or changed their layer in this frame, and why.
    pub changes: BTreeMap<String, u64>,
    /// Seconds per stage, without those that did not run.
    pub seconds: Seconds,
    /// JSON file of the frame's [`crate::FramePictures`]; a frame without is shown without pictures.
    #[serde(skip_serializing)]
    pub pictures: Option<PathBuf>,
}

/// One test or training view of one frame. A metric is absent where it is not defined (an empty mask has no MPSNR).
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(default)]
pub struct ViewReport {
    /// Camera name.
    pub name: String,
    /// PSNR (dB).
    pub psnr: Option<f64>,
    /// PSNR over the foreground mask (dB).
    pub mpsnr: Option<f64>,
    /// Structural similarity.
    pub ssim: Option<f64>,
    /// VMAF (0 to 100) in the view's video.
    pub vmaf: Option<f64>,
    /// Change of the error since the frame before (8-bit levels).
    pub flicker: Option<f64>,
    /// Structural similarity over the foreground.
    pub mssim: Option<f64>,
    /// VMAF (0 to 100) of the video whose background is the photographs'.
    pub mvmaf: Option<f64>,
    /// Flicker over the foreground (8-bit levels).
    pub mflicker: Option<f64>,
}
