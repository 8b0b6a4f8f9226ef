//! `ffgs view`: a run or a stream in the browser.

use crate::args::LogArgs;
use crate::cameras::Views;
use crate::export::stream::{StreamExport, StreamOptions};
use crate::finished_run::FinishedRun;
use crate::folder::RunFolder;
use crate::page::{ENGINE, FILES, engine};
use crate::terminal;
use anyhow::{Context, Result, bail};
use clap::Args;
use ffgs_method::{Capture, Split, ViewAt};
use ffgs_viewer::{Site, Source, Viewer};
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
///
/// # Errors
/// When the folder is neither a run nor a stream, or the port is taken.
pub fn view(args: &ViewArgs) -> Result<()> {
    let engine = engine()?;
    let is_run = args.folder.join("run.json").exists();
    let stream = if is_run {
        RunFolder(args.folder.clone()).inside(&["export", "stream"])?
    } else {
        args.folder.clone()
    };
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

/// The file of `SPLIT/VIEW/FRAME.png`.
fn photograph(capture: &dyn Capture, name: &str) -> Option<PathBuf> {
    let mut parts = name.strip_suffix(".png")?.split('/');
    let split = parts.next()?;
    let split = Split::ALL.into_iter().find(|s| s.to_string() == split)?;
    let (view, frame) = (parts.next()?.parse().ok()?, parts.next()?.parse().ok()?);
    capture.image_file(ViewAt { split, view, frame })
}
