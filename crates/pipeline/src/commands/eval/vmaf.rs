//! VMAF (Netflix) of a rendered video, through an ffmpeg that has libvmaf.

use anyhow::{Context, Result, bail, ensure};
use ffgs_core::{ImageRgb8, ImageSize};
use serde::Deserialize;
use std::ffi::OsString;
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, Command, Stdio};

/// Names the program to use instead of the `ffmpeg` of the PATH.
const VARIABLE: &str = "FFGS_FFMPEG";
/// The model that is meant when none is named: 1080p television at three times the picture's height.
const MODEL: &str = "vmaf_v0.6.1";
/// ffmpeg must be told a rate; the score does not depend on it.
const RATE: &str = "25";

/// An ffmpeg that has libvmaf.
#[derive(Clone, Debug)]
pub(crate) struct Vmaf(OsString);

impl Vmaf {
    /// The program that `FFGS_FFMPEG` names, or the `ffmpeg` of the PATH.
    ///
    /// # Errors
    /// When there is none, or it has no libvmaf: what to do.
    pub(crate) fn find() -> Result<Self> {
        Self::of(std::env::var_os(VARIABLE).unwrap_or_else(|| "ffmpeg".into()))
    }

    fn of(program: OsString) -> Result<Self> {
        let name = program.display();
        let listed = Command::new(&program).args(["-hide_banner", "-filters"]).stdin(Stdio::null()).output();
        let fault = match &listed {
            Err(error) => format!("cannot start {name} ({error})"),
            Ok(output) if !has_filter(&String::from_utf8_lossy(&output.stdout)) => {
                format!("{name} has no libvmaf")
            }
            Ok(_) => return Ok(Self(program)),
        };
        bail!(
            "{fault}; name an ffmpeg that has libvmaf in {VARIABLE}. One comes with the Python package imageio-ffmpeg \
             (`python3 -c \"import imageio_ffmpeg; print(imageio_ffmpeg.get_ffmpeg_exe())\"` prints its path)"
        )
    }

    /// Begins a video of frames of this size; the scores pass through a file in `folder` that no other video has by this name.
    pub(crate) fn video(&self, name: &str, size: ImageSize, folder: &Path) -> Result<Video> {
        // As a half-written file is called: what a kill leaves is removed by the next run.
        let log = format!("vmaf_{name}.{}.part", std::process::id());
        let mut command = Command::new(&self.0);
        let ImageSize { width, height } = size;
        command.args(["-v", "error", "-f", "rawvideo", "-pix_fmt", "rgb24", "-r", RATE]);
        command.args(["-s", &format!("{width}x{}", 2 * height), "-i", "-"]);
        command.args(["-filter_complex", &graph(size, &log), "-f", "null", "-"]);
        command.current_dir(folder).stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::piped());
        let mut child = command.spawn().with_context(|| format!("cannot start {}", self.0.display()))?;
        let frames = child.stdin.take();
        Ok(Video { child, frames, log: folder.join(log), size })
    }
}

/// Whether the list of filters has libvmaf: flags, name, kinds of its ends and a sentence per line.
fn has_filter(list: &str) -> bool {
    list.lines().any(|line| line.split_whitespace().nth(1) == Some("libvmaf"))
}

/// Photograph above render in one picture; libvmaf wants the render first. It sees their luma, which 4:4:4 keeps whole.
fn graph(ImageSize { width, height }: ImageSize, log: &str) -> String {
    let half = |at: usize| format!("crop={width}:{height}:0:{at},format=yuv444p");
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    format!(
        "[0]split[a][b];[a]{}[photograph];[b]{}[render];\
         [render][photograph]libvmaf=model=version={MODEL}:n_threads={threads}:log_fmt=json:log_path={log}",
        half(0),
        half(height)
    )
}

/// A video on its way through ffmpeg.
pub(crate) struct Video {
    child: Child,
    frames: Option<ChildStdin>,
    log: PathBuf,
    size: ImageSize,
}

impl Video {
    /// The next frame, in time order.
    pub(crate) fn push(&mut self, photograph: &ImageRgb8, render: &ImageRgb8) -> Result<()> {
        for image in [photograph, render] {
            ensure!(image.size() == self.size, "the size of the camera's images changes");
            let Some(frames) = &mut self.frames else { continue };
            match frames.write_all(image.data()) {
                // It has ended early: `finish` tells why.
                Err(error) if error.kind() == ErrorKind::BrokenPipe => self.frames = None,
                written => written.context("cannot write to ffmpeg")?,
            }
        }
        Ok(())
    }

    /// The score of each frame, 0 to 100.
    pub(crate) fn finish(mut self) -> Result<Vec<f64>> {
        drop(self.frames.take());
        let output = self.child.wait_with_output().context("cannot wait for ffmpeg")?;
        let log = std::fs::read(&self.log);
        // There is none when ffmpeg failed before it.
        let _ = std::fs::remove_file(&self.log);
        let said = String::from_utf8_lossy(&output.stderr);
        ensure!(output.status.success(), "ffmpeg: {}", said.lines().take(3).collect::<Vec<_>>().join("; "));
        scores(&log.with_context(|| format!("cannot read {}", self.log.display()))?)
    }
}

#[derive(Deserialize)]
struct Log {
    frames: Vec<LogFrame>,
}

#[derive(Deserialize)]
struct LogFrame {
    metrics: LogMetrics,
}

#[derive(Deserialize)]
struct LogMetrics {
    vmaf: f64,
}

fn scores(log: &[u8]) -> Result<Vec<f64>> {
    let log: Log = serde_json::from_slice(log).context("the log of libvmaf is not understood")?;
    Ok(log.frames.into_iter().map(|frame| frame.metrics.vmaf).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_libvmaf_the_message_says_what_to_do() {
        for program in ["no-such-ffmpeg", "true"] {
            let error = Vmaf::of(program.into()).unwrap_err().to_string();
            assert!(
                error.contains(program) && error.contains(VARIABLE) && error.contains("imageio-ffmpeg"),
                "{error}"
            );
        }
        assert!(has_filter(
            " .. libvmaf           VV->V      Calculate the VMAF between two video streams.\n"
        ));
        assert!(!has_filter(" ... vmafmotion        V->V       Calculate the VMAF Motion score.\n"));
    }

    #[test]
    fn the_log_gives_a_score_per_frame() {
        let log = br#"{"version":"3.0.0","fps":9.1,"frames":[{"frameNum":0,"metrics":{"integer_motion":0.0,"vmaf":87.5}},
            {"frameNum":1,"metrics":{"vmaf":90.25}}],"pooled_metrics":{"vmaf":{"mean":88.9}}}"#;
        assert_eq!(scores(log).unwrap(), [87.5, 90.25]);
        assert!(scores(b"{}").is_err());
    }

    /// Where an ffmpeg with libvmaf is found: what is equal is near 100, what is worse is lower, and the order counts.
    #[test]
    fn equal_videos_score_high_and_damaged_ones_low() {
        let Ok(vmaf) = Vmaf::find() else {
            println!("skipped: no ffmpeg with libvmaf");
            return;
        };
        let size = ImageSize { width: 161, height: 91 };
        let picture = |shift: usize, error: usize| {
            let value = |i: usize| {
                let (x, y) = (i / 3 % size.width + shift, i / 3 / size.width);
                (128 + 60 * usize::from((x / 9 + y / 7) % 2 == 0) - (x * 31 + y * 17) % 23
                    + error * ((x * 7 + y * 13) % 5)) as u8
            };
            ImageRgb8::new(size, (0..3 * size.pixels()).map(value).collect()).unwrap()
        };
        let folder = tempfile::tempdir().unwrap();
        let score = |error: usize| {
            let mut video = vmaf.video("test", size, folder.path()).unwrap();
            (0..3).for_each(|t| video.push(&picture(2 * t, 0), &picture(2 * t, error)).unwrap());
            let scores = video.finish().unwrap();
            assert_eq!(scores.len(), 3);
            scores.iter().sum::<f64>() / 3.0
        };
        let (equal, worse, bad) = (score(0), score(4), score(16));
        assert!(equal > 95.0 && equal > worse + 0.1 && worse > bad + 0.1, "{equal} {worse} {bad}");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0, "the log is left behind");
    }
}
