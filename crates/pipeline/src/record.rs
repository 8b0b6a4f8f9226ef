//! What a run writes, and reads again on resume: frame folders, metrics, the report.

use crate::manifest::Manifest;
use anyhow::{Context, Result, bail};
use ffgs_core::{StageLog, is_present, read_bytes, read_text};
use ffgs_method::{Capture, Split};
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
    /// Digest of the images, masks and tracks that the frame was made from and measured on; absent in old runs.
    #[serde(default)]
    pub inputs: Option<String>,
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

    /// What the method kept; nothing where it kept nothing.
    pub fn read_method_state(&self, frame: usize) -> Result<Vec<u8>> {
        let path = self.method_state(frame);
        if !is_present(&path) {
            return Ok(Vec::new());
        }
        read_bytes(&path, MAX_METHOD_BYTES).with_context(|| format!("cannot read {}", path.display()))
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

    /// Reads the frame's numbers, which must be of this frame and of cameras that the capture has: their names become
    /// paths.
    pub fn read_record(&self, frame: usize, capture: &dyn Capture) -> Result<FrameRecord> {
        let file = self.record(frame);
        let record: FrameRecord = read_json(&file)?;
        let known = |camera: &str| capture.views(Split::Test).iter().any(|view| view == camera);
        let stranger = record.views.iter().find(|view| !known(&view.camera));
        let fault = match stranger {
            _ if record.frame != frame => format!("it is of frame {}", record.frame),
            Some(view) => format!("the capture has no test camera {:?}", view.camera),
            None => return Ok(record),
        };
        bail!("{}: {fault}; remove this frame's folder and resume", file.display())
    }

    /// Removes the half-written files of runs that were killed; only for who holds the folder.
    pub fn remove_half_written(&self) -> Result<()> {
        let mut folders = vec![self.0.clone()];
        for frame in entries(&self.0.join("frames")) {
            folders.extend([frame.join("test"), frame]);
        }
        for file in folders.iter().flat_map(|folder| entries(folder)).filter(|file| is_half_written(file)) {
            std::fs::remove_file(&file).with_context(|| format!("cannot remove {}", file.display()))?;
        }
        Ok(())
    }

    /// The run's own description.
    pub fn manifest(&self) -> PathBuf {
        self.0.join("run.json")
    }
}

/// What a folder holds; nothing for none.
fn entries(folder: &Path) -> Vec<PathBuf> {
    std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path()).collect()
}

/// `NAME.PID.part`, as `write_atomically` calls a file before it is complete.
fn is_half_written(file: &Path) -> bool {
    let name = file.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let process = name.strip_suffix(".part").and_then(|name| name.rsplit_once('.'));
    process.is_some_and(|(_, pid)| pid.parse::<u32>().is_ok())
}

/// Writes JSON through a temporary file.
pub fn write_json(path: &Path, value: &impl Serialize) -> Result<()> {
    ffgs_core::write_atomically(path, |out| {
        serde_json::to_writer_pretty(&mut *out, value)?;
        std::io::Write::write_all(out, b"\n").map_err(anyhow::Error::from)
    })
    .with_context(|| format!("cannot write {}; is the folder writable, the disk full?", path.display()))
}

/// Most bytes that a method may keep for the next frame.
const MAX_METHOD_BYTES: u64 = 1 << 32;
/// Most bytes of a JSON file of a run.
const MAX_JSON_BYTES: u64 = 1 << 28;

/// Reads JSON.
pub fn read_json<T: DeserializeOwned>(path: &Path) -> Result<T> {
    let text = read_text(path, MAX_JSON_BYTES).with_context(|| format!("cannot read {}", path.display()))?;
    serde_json::from_str(&text).with_context(|| {
        format!("{} is damaged; bring it back from a copy, or run again with another --out", path.display())
    })
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
    let report = folder.0.join("report.html");
    ffgs_report::write_report(&report, &input).with_context(|| format!("cannot write {}", report.display()))
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_half_written_files_are_removed() {
        let folder = tempfile::tempdir().unwrap();
        let run = RunFolder(folder.path().to_owned());
        std::fs::create_dir_all(run.frame(0).join("test")).unwrap();
        let [half, report, mine] =
            ["state.ffgs.123.part", "test/a.png.9.part", "my.part"].map(|n| run.frame(0).join(n));
        let outside = folder.path().join("run.json.77.part");
        for file in [&half, &report, &mine, &outside, &run.state(0)] {
            std::fs::write(file, "x").unwrap();
        }
        run.remove_half_written().unwrap();
        assert!(!half.exists() && !report.exists() && !outside.exists());
        assert!(mine.exists() && run.state(0).exists());
    }

    #[test]
    fn a_record_of_another_frame_or_of_names_that_leave_the_folder_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let sample = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/scenes/fairmont-mini");
        let capture = crate::registry::open_capture(&sample).unwrap();
        let run = RunFolder(folder.path().to_owned());
        let known = capture.views(Split::Test)[0].clone();
        let read = |frame, camera: &str| {
            let views = vec![ViewMetrics { camera: camera.into(), ..ViewMetrics::default() }];
            write_json(&run.record(1), &FrameRecord { frame, views, ..FrameRecord::default() }).unwrap();
            run.read_record(1, &*capture).map_err(|error| error.to_string())
        };
        assert_eq!(read(1, &known).unwrap().views.len(), 1);
        assert!(read(2, &known).unwrap_err().contains("frame.json: it is of frame 2"));
        assert!(read(1, "../../../../secret").unwrap_err().contains("no test camera \"../../../../secret\""));
    }
}
