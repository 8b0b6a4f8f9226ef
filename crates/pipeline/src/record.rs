//! What a run writes, and reads again on resume: frame folders, metrics, the report.

use crate::manifest::Manifest;
use anyhow::{Context, Result};
use ffgs_core::StageLog;
use ffgs_report::{Fact, FrameReport, ReportInput, SkipCount, ViewReport};
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Metrics of one test view.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct ViewMetrics {
    /// Camera.
    pub camera: String,
    /// Whether the camera stands still over the capture (trackside).
    pub fixed: bool,
    /// PSNR (dB).
    pub psnr: f64,
    /// PSNR over the foreground (dB); absent when the mask is empty.
    pub mpsnr: Option<f64>,
    /// Structural similarity.
    pub ssim: f64,
}

/// One finished frame.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct FrameRecord {
    /// Index in the capture.
    pub frame: usize,
    /// Test views.
    pub views: Vec<ViewMetrics>,
    /// Mean foreground PSNR over the test views before any finetuning (dB): the grade of the motion initialisation.
    #[serde(default)]
    pub initial_mpsnr: Option<f64>,
    /// Gaussians of the static layer.
    pub static_gaussians: usize,
    /// Gaussians of the dynamic layer.
    pub dynamic_gaussians: usize,
    /// Bytes of the frame's splat files.
    pub bytes: u64,
    /// Most memory that the program had held when the frame was done (MiB); absent where the system does not say.
    #[serde(default)]
    pub peak_memory_mib: Option<f64>,
    /// Seconds, skips and warnings of its stages.
    #[serde(flatten)]
    pub log: StageLog,
}

/// Means over frames and views.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Mean {
    /// PSNR (dB).
    pub psnr: Option<f64>,
    /// PSNR over the foreground (dB).
    pub mpsnr: Option<f64>,
    /// Structural similarity.
    pub ssim: Option<f64>,
    /// PSNR over the foreground before finetuning, always over all test views (dB).
    #[serde(default)]
    pub initial_mpsnr: Option<f64>,
    /// Wall clock a frame (s).
    pub seconds_per_frame: Option<f64>,
    /// Gaussians of all layers.
    pub gaussians: Option<f64>,
    /// Bytes of a frame's splat files.
    pub bytes_per_frame: Option<f64>,
}

/// `metrics.json`.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Metrics {
    /// Over all test views and frames >= 1.
    pub mean: Mean,
    /// Over the test cameras that stand still.
    pub mean_trackside: Mean,
    /// Every frame.
    pub frames: Vec<FrameRecord>,
}

fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, n) = values.fold((0.0, 0_usize), |(s, n), v| (s + v, n + 1));
    (n > 0).then(|| sum / n as f64)
}

fn summarise(frames: &[FrameRecord], keep: impl Fn(&ViewMetrics) -> bool) -> Mean {
    let later: Vec<&FrameRecord> = frames.iter().filter(|f| f.frame > 0).collect();
    let views: Vec<&ViewMetrics> = later.iter().flat_map(|f| &f.views).filter(|v| keep(v)).collect();
    Mean {
        psnr: mean(views.iter().map(|v| v.psnr)),
        mpsnr: mean(views.iter().filter_map(|v| v.mpsnr)),
        ssim: mean(views.iter().map(|v| v.ssim)),
        initial_mpsnr: mean(later.iter().filter_map(|f| f.initial_mpsnr)),
        seconds_per_frame: mean(later.iter().filter_map(|f| f.log.seconds.get("wall").copied())),
        gaussians: mean(later.iter().map(|f| (f.static_gaussians + f.dynamic_gaussians) as f64)),
        bytes_per_frame: mean(later.iter().map(|f| f.bytes as f64)),
    }
}

impl Metrics {
    /// Summarises finished frames.
    pub fn of(frames: Vec<FrameRecord>) -> Self {
        let mut metrics = Self { frames, ..Self::default() };
        metrics.summarise();
        metrics
    }

    /// Adds a finished frame.
    pub fn push(&mut self, frame: FrameRecord) {
        self.frames.push(frame);
        self.summarise();
    }

    fn summarise(&mut self) {
        self.mean = summarise(&self.frames, |_| true);
        self.mean_trackside = summarise(&self.frames, |v| v.fixed);
    }
}

/// Where the files of a run lie.
#[derive(Clone, Debug)]
pub struct RunFolder(pub PathBuf);

impl RunFolder {
    /// Folder of one frame.
    pub fn frame(&self, frame: usize) -> PathBuf {
        self.0.join(format!("frames/{frame:06}"))
    }

    /// The frame's exact state; it exists when, and only when, the frame is finished.
    pub fn state(&self, frame: usize) -> PathBuf {
        self.frame(frame).join("state.ffgs")
    }

    /// What the method keeps for the next frame, where it keeps anything.
    pub fn method_state(&self, frame: usize) -> PathBuf {
        self.frame(frame).join("method.state")
    }

    /// The frame's numbers.
    pub fn record(&self, frame: usize) -> PathBuf {
        self.frame(frame).join("frame.json")
    }

    /// The frame's encoded pictures, a [`ffgs_report::FramePictures`].
    pub fn pictures(&self, frame: usize) -> PathBuf {
        self.frame(frame).join("pictures.json")
    }

    /// How near to the truth the motion initialisation was, once `ffgs-lab motion-eval --run` has scored it.
    pub fn motion_accuracy(&self) -> PathBuf {
        self.0.join("motion-accuracy.json")
    }

    /// The run's own description.
    pub fn manifest(&self) -> PathBuf {
        self.0.join("run.json")
    }
}

/// Writes JSON through a temporary file.
pub fn write_json(path: &Path, value: &impl Serialize) -> Result<()> {
    ffgs_core::write_atomically(path, |out| {
        serde_json::to_writer_pretty(&mut *out, value)?;
        std::io::Write::write_all(out, b"\n").map_err(anyhow::Error::from)
    })
    .with_context(|| format!("cannot write {}; is the folder writable, the disk full?", path.display()))
}

/// Reads JSON.
pub fn read_json<T: DeserializeOwned>(path: &Path) -> Result<T> {
    let text = std::fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    serde_json::from_str(&text)
        .with_context(|| format!("{} is damaged; remove it and resume", path.display()))
}

/// Writes `metrics.json` and `report.html`. The report copies the encoded pictures of each frame from its folder.
pub fn publish(folder: &RunFolder, manifest: &Manifest, metrics: &Metrics) -> Result<()> {
    let mut facts = manifest.facts();
    write_json(&folder.0.join("metrics.json"), metrics)?;
    let mut skips = BTreeMap::<String, u64>::new();
    for (what, count) in metrics.frames.iter().flat_map(|f| &f.log.skips) {
        *skips.entry(what.clone()).or_default() += count;
    }
    if let Some(peak) = metrics.frames.iter().filter_map(|f| f.peak_memory_mib).reduce(f64::max) {
        facts.push(Fact { name: "peak memory".into(), value: format!("{peak:.0} MiB") });
    }
    let scored = folder.motion_accuracy();
    let input = ReportInput {
        motion: if scored.exists() { read_json(&scored)? } else { Vec::new() },
        title: format!("fastflowgs: {}", manifest.capture),
        configuration: manifest.config.to_toml()?,
        facts,
        frames: metrics.frames.iter().map(|f| frame_report(folder, f)).collect(),
        skips: skips.into_iter().map(|(what, count)| SkipCount { what, count }).collect(),
        warnings: metrics
            .frames
            .iter()
            .flat_map(|f| f.log.warnings.iter().map(|w| format!("frame {}: {w}", f.frame)))
            .collect(),
    };
    Ok(ffgs_report::write_report(&folder.0.join("report.html"), &input)?)
}

fn frame_report(folder: &RunFolder, f: &FrameRecord) -> FrameReport {
    let view = |v: &ViewMetrics| ViewReport {
        name: v.camera.clone(),
        psnr: Some(v.psnr),
        mpsnr: v.mpsnr,
        ssim: Some(v.ssim),
    };
    FrameReport {
        index: f.frame,
        views: f.views.iter().map(view).collect(),
        initial_mpsnr: f.initial_mpsnr,
        static_gaussians: f.static_gaussians,
        dynamic_gaussians: f.dynamic_gaussians,
        bytes: f.bytes,
        seconds: f.log.seconds.clone(),
        pictures: Some(folder.pictures(f.frame)).filter(|path| path.exists()),
    }
}
