//! `ffgs view`: a run or a stream in the browser.

use crate::cli::LogArgs;
use crate::export_stream::{StreamExport, StreamOptions};
use crate::page::{ENGINE, FILES, engine};
use crate::render::FinishedRun;
use crate::terminal;
use anyhow::{Context, Result, bail};
use clap::Args;
use ffgs_method::{Capture, Split, ViewAt};
use ffgs_viewer::{Site, Source, Viewer};
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// `ffgs view`.
#[derive(Clone, Debug, Args)]
#[command(
    long_about = "Shows a run, finished or still going on, or a 4D stream in the browser: time line, orbit, fly, \
        follow, the cameras of the capture with their photographs. A run is first written as a stream into RUN/export/stream. \
        The server answers on this machine only, at the address that it prints, until it is stopped (Ctrl-C).",
    after_help = "Examples:\n  ffgs view out/mini\n  ffgs view out/mini/export/stream --port 8080"
)]
pub struct ViewArgs {
    /// Output folder of a run, or folder of a stream
    pub folder: PathBuf,
    /// Port on this machine; 0 = any that is free
    #[arg(long, default_value_t = 0)]
    pub port: u16,
    /// Messages.
    #[command(flatten)]
    pub log: LogArgs,
}

/// How often a run is looked at for new frames.
const LOOK_EVERY: Duration = Duration::from_secs(2);

/// Serves until the process is stopped.
pub fn view(args: &ViewArgs) -> Result<()> {
    let engine = engine()?;
    let is_run = args.folder.join("run.json").exists();
    let stream = if is_run { args.folder.join("export/stream") } else { args.folder.clone() };
    if !is_run && !stream.join("manifest.json").exists() {
        bail!(
            "{} is neither a run (run.json) nor a stream (manifest.json); reconstruct a capture with ffgs run first",
            args.folder.display()
        );
    }
    let mut site = FILES.iter().fold(Site::default(), |site, (name, bytes)| {
        site.with(name, Source::Bytes(bytes.as_bytes().to_vec()))
    });
    site = site
        .with(ENGINE, Source::Bytes(std::fs::read(&engine).with_context(|| engine.display().to_string())?));
    if is_run {
        let run = FinishedRun::open(&args.folder)?;
        std::fs::create_dir_all(&stream)?;
        let views = Views::of(&*run.capture, true)?;
        site = site.with("cameras.json", Source::Bytes(serde_json::to_vec(&views)?));
        site = site.with("photo", Source::Lookup(Box::new(move |name| photograph(&*run.capture, name))));
    }
    let viewer = Viewer::start(site.with("", Source::Folder(stream.clone())), args.port)?;
    terminal::print(viewer.url());
    if is_run {
        return follow(&args.folder, &stream);
    }
    viewer.wait();
    Ok(())
}

/// Appends the frames of a run to its stream as they are finished, until the process ends.
fn follow(folder: &Path, stream: &Path) -> Result<()> {
    let mut export = StreamExport::open(&FinishedRun::open(folder)?, stream, &StreamOptions::default())?;
    loop {
        // A frame that cannot be read yet may be readable the next time.
        if let Err(error) = FinishedRun::open(folder).and_then(|run| export.catch_up(&run, true)) {
            tracing::warn!("{error:#}");
        }
        std::thread::sleep(LOOK_EVERY);
    }
}

/// `cameras.json`: the cameras of a capture.
#[derive(Debug, Serialize)]
pub(crate) struct Views {
    views: Vec<ViewOf>,
}

#[derive(Debug, Serialize)]
struct ViewOf {
    name: String,
    split: String,
    width: usize,
    height: usize,
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    /// Per frame the first three rows of the pose, row by row; one where the camera stands still.
    world_from_camera: Vec<[f64; 12]>,
    /// Per frame, where the page has them.
    photographs: Option<Vec<String>>,
}

impl Views {
    /// The training and test cameras, those that cannot be read left out.
    pub(crate) fn of(capture: &dyn Capture, with_photographs: bool) -> Result<Self> {
        let mut views = Vec::new();
        for split in [Split::Test, Split::Train] {
            for (index, name) in capture.views(split).iter().enumerate() {
                views.extend(view_of(capture, split, index, name, with_photographs)?);
            }
        }
        Ok(Self { views })
    }
}

fn view_of(
    capture: &dyn Capture,
    split: Split,
    index: usize,
    name: &str,
    with_photographs: bool,
) -> Result<Option<ViewOf>> {
    let frames = 0..capture.frames_of(split);
    let cameras = frames.clone().map(|frame| capture.camera(ViewAt { split, view: index, frame }));
    let cameras = cameras.collect::<Result<Vec<_>, _>>()?;
    let Some(first) = cameras.first() else { return Ok(None) };
    let (lens, size) = (first.intrinsics(), first.size());
    let pose = |camera: &ffgs_core::Camera| {
        let (turn, centre) = (camera.rotation().transpose(), camera.center());
        let row = |k: usize| [turn.row(k).x, turn.row(k).y, turn.row(k).z, centre[k]];
        let [a, b, c] = [0, 1, 2].map(row);
        std::array::from_fn(|i| [a, b, c][i / 4][i % 4])
    };
    let mut poses: Vec<[f64; 12]> = cameras.iter().map(pose).collect();
    if poses.iter().all(|p| *p == poses[0]) {
        poses.truncate(1);
    }
    let photographs = frames.map(|t| format!("photo/{split}/{index}/{t}.png")).collect();
    Ok(Some(ViewOf {
        name: name.to_owned(),
        split: split.to_string(),
        width: size.width,
        height: size.height,
        fx: lens.fx,
        fy: lens.fy,
        cx: lens.cx,
        cy: lens.cy,
        world_from_camera: poses,
        photographs: with_photographs.then_some(photographs),
    }))
}

/// The file of `SPLIT/VIEW/FRAME.png`.
fn photograph(capture: &dyn Capture, name: &str) -> Option<PathBuf> {
    let mut parts = name.strip_suffix(".png")?.split('/');
    let split = parts.next()?;
    let split = Split::ALL.into_iter().find(|s| s.to_string() == split)?;
    let (view, frame) = (parts.next()?.parse().ok()?, parts.next()?.parse().ok()?);
    capture.image_file(ViewAt { split, view, frame })
}
