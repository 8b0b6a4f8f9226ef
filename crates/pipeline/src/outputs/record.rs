//! The numbers of a run: of each frame, and their means.

use crate::outputs::folder::RunFolder;
use crate::outputs::json::read_json;
use anyhow::{Result, bail};
use ffgs_core::{StageLog, stage};
use ffgs_method::{Capture, Split};
use serde::{Deserialize, Serialize};

/// Metrics of one view: a test view, or a training view where a capture has no test views.
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
    /// Structural similarity over the foreground; absent when the mask is empty.
    #[serde(default)]
    pub mssim: Option<f64>,
    /// VMAF (0 to 100) in the view's video; absent until `ffgs eval` has found it.
    #[serde(default)]
    pub vmaf: Option<f64>,
    /// Change of the error since the frame before (8-bit levels); absent in the first frame, and until `ffgs eval` has found
    /// it.
    #[serde(default)]
    pub flicker: Option<f64>,
    /// VMAF of the video whose background is the photographs'; absent as `vmaf`, and when the video's masks are all empty.
    #[serde(default)]
    pub mvmaf: Option<f64>,
    /// Flicker over the foreground; absent as `flicker`, and when the mask is empty.
    #[serde(default)]
    pub mflicker: Option<f64>,
}

/// One finished frame.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct FrameRecord {
    /// Index in the capture.
    pub frame: usize,
    /// Test views.
    pub views: Vec<ViewMetrics>,
    /// Some of the views that the frame was trained on, where the capture has no test views: their quality is higher than that of new
    /// places.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub training_views: Vec<ViewMetrics>,
    /// Mean foreground PSNR over the test views before any finetuning (dB), which measures the motion initialisation.
    #[serde(default)]
    pub initial_mpsnr: Option<f64>,
    /// Gaussians of the static layer.
    pub static_gaussians: usize,
    /// Gaussians of the dynamic layer.
    pub dynamic_gaussians: usize,
    /// Bytes of the files that reproduce the frame: those of the method's own form, else the splat files.
    pub bytes: u64,
    /// Digest of the images, masks and tracks that the frame was made from and measured on; absent in old runs.
    #[serde(default)]
    pub inputs: Option<String>,
    /// Most memory that the program had held when the frame was done (MiB); absent where the system does not say.
    #[serde(default)]
    pub peak_memory_mib: Option<f64>,
    /// Most memory that buffers on one GPU had held when the frame was done (MiB); absent on a CPU.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gpu_memory_mib: Option<f64>,
    /// What the program had read from files when the frame was done (MiB); absent as above.
    #[serde(default)]
    pub read_mib: Option<f64>,
    /// Time on processors, of all threads, when the frame was done (s); absent as above.
    #[serde(default)]
    pub processor_seconds: Option<f64>,
    /// Seconds, skips and warnings of its stages.
    #[serde(flatten)]
    pub log: StageLog,
}

impl FrameRecord {
    /// The views that measure the frame: test views, or training views where there are none.
    pub(crate) fn measured(&self) -> impl Iterator<Item = &ViewMetrics> {
        self.views.iter().chain(&self.training_views)
    }

    /// Reads the frame's numbers, which must be of this frame and of cameras that the capture has: their names become
    /// paths.
    ///
    /// # Errors
    /// When there is no such file, or it is of another frame or capture.
    pub fn read(folder: &RunFolder, frame: usize, capture: &dyn Capture) -> Result<Self> {
        let file = folder.record(frame);
        let record: Self = read_json(&file)?;
        let stranger = |views: &[ViewMetrics], split, kind: &str| {
            let known = |view: &ViewMetrics| capture.views(split).contains(&view.camera);
            let unknown = views.iter().find(|view| !known(view));
            unknown.map(|view| format!("the capture has no {kind} camera {:?}", view.camera))
        };
        let stranger = stranger(&record.views, Split::Test, "test")
            .or_else(|| stranger(&record.training_views, Split::Train, "training"));
        let fault = match stranger {
            _ if record.frame != frame => format!("it is of frame {}", record.frame),
            Some(fault) => fault,
            None => return Ok(record),
        };
        bail!("{}: {fault}; remove this frame's folder and resume", file.display())
    }
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
    /// VMAF (0 to 100).
    #[serde(default)]
    pub vmaf: Option<f64>,
    /// Change of the error from frame to frame (8-bit levels).
    #[serde(default)]
    pub flicker: Option<f64>,
    /// Structural similarity over the foreground.
    #[serde(default)]
    pub mssim: Option<f64>,
    /// VMAF of the videos whose background is the photographs' (0 to 100).
    #[serde(default)]
    pub mvmaf: Option<f64>,
    /// Flicker over the foreground (8-bit levels).
    #[serde(default)]
    pub mflicker: Option<f64>,
    /// PSNR over the foreground before finetuning, always over all test views (dB).
    #[serde(default)]
    pub initial_mpsnr: Option<f64>,
    /// Wall clock per frame (s).
    pub seconds_per_frame: Option<f64>,
    /// PSNR / seconds per frame (dB/s), the paper's PE.
    #[serde(default)]
    pub psnr_per_second: Option<f64>,
    /// VMAF / seconds per frame (1/s), the paper's VE.
    #[serde(default)]
    pub vmaf_per_second: Option<f64>,
    /// Gaussians of all layers.
    pub gaussians: Option<f64>,
    /// Bytes of the files that reproduce a frame.
    pub bytes_per_frame: Option<f64>,
    /// The same over all frames, the first with them.
    #[serde(default)]
    pub bytes_per_frame_with_first: Option<f64>,
}

/// Means over frames and training views. Without cost or speed: efficiencies are of quality in new places.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct TrainingMean {
    /// PSNR (dB).
    pub psnr: Option<f64>,
    /// PSNR over the foreground (dB).
    pub mpsnr: Option<f64>,
    /// Structural similarity.
    pub ssim: Option<f64>,
    /// Structural similarity over the foreground.
    pub mssim: Option<f64>,
}

/// `metrics.json`.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Metrics {
    /// Over all test views and the frames after the run's first.
    pub mean: Mean,
    /// Over the test cameras that stand still.
    pub mean_trackside: Mean,
    /// Over the training views of the frames after the run's first where there are no test views; else absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mean_training_views: Option<TrainingMean>,
    /// Every frame.
    pub frames: Vec<FrameRecord>,
}

/// `None` of nothing.
pub(crate) fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, n) = values.fold((0.0, 0_usize), |(s, n), v| (s + v, n + 1));
    (n > 0).then(|| sum / n as f64)
}

/// The frames after the run's first, which is trained from scratch or taken from another run.
pub(crate) fn after_first(frames: &[FrameRecord]) -> &[FrameRecord] {
    frames.get(1..).unwrap_or_default()
}

fn summarise(frames: &[FrameRecord], keep: impl Fn(&ViewMetrics) -> bool) -> Mean {
    let later = after_first(frames);
    let views: Vec<&ViewMetrics> = later.iter().flat_map(|f| &f.views).filter(|v| keep(v)).collect();
    let (psnr, vmaf) = (mean(views.iter().map(|v| v.psnr)), mean(views.iter().filter_map(|v| v.vmaf)));
    let seconds = mean(later.iter().filter_map(|f| f.log.seconds.get(stage::WALL).copied()));
    let per_second = |quality: Option<f64>| Some(quality? / seconds.filter(|seconds| *seconds > 0.0)?);
    Mean {
        psnr,
        mpsnr: mean(views.iter().filter_map(|v| v.mpsnr)),
        ssim: mean(views.iter().map(|v| v.ssim)),
        vmaf,
        flicker: mean(views.iter().filter_map(|v| v.flicker)),
        mssim: mean(views.iter().filter_map(|v| v.mssim)),
        mvmaf: mean(views.iter().filter_map(|v| v.mvmaf)),
        mflicker: mean(views.iter().filter_map(|v| v.mflicker)),
        initial_mpsnr: mean(later.iter().filter_map(|f| f.initial_mpsnr)),
        seconds_per_frame: seconds,
        psnr_per_second: per_second(psnr),
        vmaf_per_second: per_second(vmaf),
        gaussians: mean(later.iter().map(|f| (f.static_gaussians + f.dynamic_gaussians) as f64)),
        bytes_per_frame: mean(later.iter().map(|f| f.bytes as f64)),
        bytes_per_frame_with_first: mean(frames.iter().map(|f| f.bytes as f64)),
    }
}

fn summarise_training_views(frames: &[FrameRecord]) -> Option<TrainingMean> {
    let views = || after_first(frames).iter().flat_map(|f| &f.training_views);
    frames.iter().any(|f| !f.training_views.is_empty()).then(|| TrainingMean {
        psnr: mean(views().map(|v| v.psnr)),
        mpsnr: mean(views().filter_map(|v| v.mpsnr)),
        ssim: mean(views().map(|v| v.ssim)),
        mssim: mean(views().filter_map(|v| v.mssim)),
    })
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
        self.mean_training_views = summarise_training_views(&self.frames);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::outputs::json::write_json;
    use std::path::Path;

    #[test]
    fn efficiencies_are_quality_by_seconds_and_bytes_are_told_with_and_without_the_first_frame() {
        let frame = |frame, psnr, vmaf, bytes, wall| {
            let views = vec![ViewMetrics { psnr, vmaf, ..ViewMetrics::default() }];
            let mut record = FrameRecord { frame, views, bytes, ..FrameRecord::default() };
            record.log.seconds.insert("wall".into(), wall);
            record
        };
        let first = frame(0, 99.0, Some(99.0), 9000, 50.0);
        let of = |frames: &[&FrameRecord]| Metrics::of(frames.iter().map(|f| (*f).clone()).collect()).mean;
        let mean = of(&[&first, &frame(1, 20.0, Some(40.0), 1000, 3.0), &frame(2, 30.0, None, 2000, 5.0)]);
        assert_eq!((mean.psnr, mean.vmaf, mean.seconds_per_frame), (Some(25.0), Some(40.0), Some(4.0)));
        assert_eq!((mean.psnr_per_second, mean.vmaf_per_second), (Some(6.25), Some(10.0)));
        assert_eq!((mean.bytes_per_frame, mean.bytes_per_frame_with_first), (Some(1500.0), Some(4000.0)));
        let timeless = of(&[&first, &frame(1, 20.0, None, 1, 0.0)]);
        assert_eq!((timeless.psnr_per_second, timeless.vmaf_per_second), (None, None));
    }

    #[test]
    fn a_record_of_another_frame_or_of_names_that_leave_the_folder_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let sample = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/scenes/fairmont-mini");
        let capture = crate::plugins::registry::open_capture(&sample).unwrap();
        let run = RunFolder(folder.path().to_owned());
        let known = capture.views(Split::Test)[0].clone();
        let read = |frame, camera: &str| {
            let views = vec![ViewMetrics { camera: camera.into(), ..ViewMetrics::default() }];
            write_json(&run.record(1), &FrameRecord { frame, views, ..FrameRecord::default() }).unwrap();
            FrameRecord::read(&run, 1, &*capture).map_err(|error| error.to_string())
        };
        assert_eq!(read(1, &known).unwrap().views.len(), 1);
        assert!(read(2, &known).unwrap_err().contains("frame.json: it is of frame 2"));
        assert!(read(1, "../../../../secret").unwrap_err().contains("no test camera \"../../../../secret\""));
        let trained = |camera: &str| {
            let training_views = vec![ViewMetrics { camera: camera.into(), ..ViewMetrics::default() }];
            let record = FrameRecord { frame: 1, training_views, ..FrameRecord::default() };
            write_json(&run.record(1), &record).unwrap();
            FrameRecord::read(&run, 1, &*capture).map_err(|error| error.to_string())
        };
        assert_eq!(trained(&capture.views(Split::Train)[0]).unwrap().training_views.len(), 1);
        assert!(trained(&known).unwrap_err().contains("no training camera"));
    }
}
