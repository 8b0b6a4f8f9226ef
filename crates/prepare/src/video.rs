//! Videos, through the system's ffmpeg and ffprobe.

use crate::PrepareError;
use ffgs_core::{ImageRgb8, ImageSize};
use serde::Deserialize;
use std::io::{BufRead, BufReader, ErrorKind, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, Stdio};

/// What ffprobe says of a video.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct VideoFacts {
    /// Frames, by the packets of its container.
    pub frames: usize,
    /// Frames a second.
    pub rate: f64,
    /// When each frame is shown (s after the first), where the container says it.
    pub times: Option<Vec<f64>>,
}

#[derive(Deserialize)]
struct Probe {
    streams: Vec<Stream>,
    #[serde(default)]
    packets: Vec<Packet>,
}

#[derive(Deserialize)]
struct Stream {
    avg_frame_rate: String,
}

#[derive(Deserialize)]
struct Packet {
    pts_time: Option<String>,
    #[serde(default)]
    flags: String,
}

/// A video that is a playlist in truth cannot make ffmpeg fetch anything.
const FILES_ONLY: [&str; 2] = ["-protocol_whitelist", "file"];

/// Number and rate of the frames of a video.
pub(crate) fn probe(file: &Path) -> Result<VideoFacts, PrepareError> {
    let mut command = Command::new("ffprobe");
    command.args(["-v", "error", "-select_streams", "v:0", "-of", "json=compact=1"]);
    command.args(["-show_entries", "stream=avg_frame_rate:packet=pts_time,flags"]).args(FILES_ONLY).arg(file);
    let output = command.stdin(Stdio::null()).output().map_err(|e| start_error(file, "ffprobe", e))?;
    let probe: Option<Probe> = serde_json::from_slice(&output.stdout).ok();
    let facts = probe.and_then(|p| facts(&p));
    facts.ok_or_else(|| {
        PrepareError::picture(file, format!("no video that ffmpeg can read. {}", said(&output.stderr)))
    })
}

fn facts(probe: &Probe) -> Option<VideoFacts> {
    let (up, down) = probe.streams.first()?.avg_frame_rate.split_once('/')?;
    let rate = up.parse::<f64>().ok()? / down.parse::<f64>().ok()?;
    // Packets that an edit list discards are decoded and not shown.
    let shown = || probe.packets.iter().filter(|packet| !packet.flags.contains('D'));
    let frames = shown().count();
    let times = shown().map(|packet| packet.pts_time.as_ref()?.parse::<f64>().ok()).collect::<Option<_>>();
    let facts = VideoFacts { frames, rate, times: times.and_then(in_order) };
    (frames > 0 && rate > 0.0 && rate.is_finite()).then_some(facts)
}

/// Times as frames are shown, which packets are not in the order of; `None` where two are the same.
fn in_order(mut times: Vec<f64>) -> Option<Vec<f64>> {
    times.sort_unstable_by(f64::total_cmp);
    let first = *times.first()?;
    times.iter_mut().for_each(|time| *time -= first);
    times.windows(2).all(|pair| pair[0] < pair[1]).then_some(times)
}

fn start_error(file: &Path, program: &'static str, error: std::io::Error) -> PrepareError {
    match error.kind() {
        ErrorKind::NotFound => PrepareError::NoFfmpeg { program },
        _ => PrepareError::io(file, error),
    }
}

fn said(stderr: &[u8]) -> String {
    String::from_utf8_lossy(stderr).lines().take(2).collect::<Vec<_>>().join("; ")
}

/// The frames of a video from the first one on, decoded as they are asked for.
pub(crate) struct Frames {
    file: PathBuf,
    child: Child,
    stream: BufReader<ChildStdout>,
}

impl Frames {
    /// Starts ffmpeg on a video; frames come as they are stored, none doubled or dropped for a constant rate.
    pub(crate) fn open(file: &Path) -> Result<Self, PrepareError> {
        Self::start(file, None)
    }

    /// As [`Frames::open`] with the first frame at or after a time in seconds.
    pub(crate) fn open_at(file: &Path, seconds: f64) -> Result<Self, PrepareError> {
        Self::start(file, Some(seconds))
    }

    fn start(file: &Path, seek: Option<f64>) -> Result<Self, PrepareError> {
        let mut command = Command::new("ffmpeg");
        command.args(["-v", "error", "-nostdin"]);
        if let Some(seconds) = seek {
            command.args(["-ss", &format!("{seconds:.3}")]);
        }
        command.args(FILES_ONLY).arg("-i").arg(file);
        if seek.is_some() {
            command.args(["-frames:v", "1"]);
        }
        // PPM, because every frame then says its own size: ffmpeg turns pictures as the video's header asks.
        command.args(["-map", "0:v:0", "-vsync", "passthrough", "-f", "image2pipe", "-c:v", "ppm", "-"]);
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::null());
        let mut child = command.spawn().map_err(|e| start_error(file, "ffmpeg", e))?;
        let stdout = child.stdout.take().expect("stdout is piped");
        Ok(Self { file: file.to_owned(), child, stream: BufReader::with_capacity(1 << 20, stdout) })
    }

    /// The next frame; `None` at the end.
    pub(crate) fn next(&mut self) -> Result<Option<ImageRgb8>, PrepareError> {
        let io = |e| PrepareError::io(&self.file, e);
        if self.stream.fill_buf().map_err(io)?.is_empty() {
            return Ok(None);
        }
        let size = self.header()?;
        let mut data = vec![0; size.pixels() * 3];
        self.stream.read_exact(&mut data).map_err(|e| PrepareError::io(&self.file, e))?;
        Ok(ImageRgb8::new(size, data))
    }

    /// "P6", width, height and 255, each ended by one white space.
    fn header(&mut self) -> Result<ImageSize, PrepareError> {
        let mut words = Vec::new();
        for _ in 0..4 {
            words.push(self.word().map_err(|e| PrepareError::io(&self.file, e))?);
        }
        let number = |i: usize| words[i].parse::<usize>().ok();
        match (words[0].as_str(), number(1), number(2), words[3].as_str()) {
            ("P6", Some(width), Some(height), "255") => Ok(ImageSize { width, height }),
            _ => Err(PrepareError::picture(
                &self.file,
                format!("ffmpeg sent {words:?} where a picture should start"),
            )),
        }
    }

    fn word(&mut self) -> std::io::Result<String> {
        let mut word = Vec::new();
        let mut byte = [0];
        loop {
            self.stream.read_exact(&mut byte)?;
            if byte[0].is_ascii_whitespace() {
                return Ok(String::from_utf8_lossy(&word).into_owned());
            }
            word.push(byte[0]);
        }
    }
}

impl Drop for Frames {
    fn drop(&mut self) {
        // The rest of the video is not needed; a program that has ended already cannot be killed, which is as well.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
