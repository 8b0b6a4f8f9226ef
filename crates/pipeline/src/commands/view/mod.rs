//! `ffgs view`: a run, a stream or a capture in the browser.

pub(crate) mod cameras;
pub(crate) mod page;
pub(crate) mod points_stream;

use crate::cli::args::LogArgs;
use crate::cli::terminal;
use crate::commands::export::stream::{StreamExport, StreamOptions, has_uncertainty};
use crate::commands::view::cameras::Views;
use crate::commands::view::page::{ENGINE, FILES, engine};
use crate::commands::view::points_stream::write_points;
use crate::job::manifest::Manifest;
use crate::job::request::RunRequest;
use crate::outputs::finished_run::FinishedRun;
use crate::outputs::folder::RunFolder;
use crate::outputs::json::read_json;
use crate::plugins::registry::open_capture;
use anyhow::{Context, Result};
use clap::Args;
use ffgs_method::{Capture, Split, ViewAt};
use ffgs_viewer::{Site, Source, Viewer};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// `ffgs view`.
#[derive(Clone, Debug, Args)]
#[command(
    about = "Show a run, a stream or a capture in the browser",
    long_about = "Shows a run, finished or still going on, or a 4D stream in the browser: time line, orbit, fly, \
        follow, the cameras of the capture with their photographs. A run is written as a stream into RUN/export/stream; of a \
        capture its initial points are shown. \
        The server answers on this machine only, at the address that it prints, until it is stopped (Ctrl-C).",
    after_help = "Examples:\n  ffgs view out/mini\n  ffgs view out/mini/export/stream --port 8080\n  ffgs view path/to/capture"
)]
pub struct ViewArgs {
    /// Output folder of a run, folder of a stream or of a capture
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
/// When the folder is neither a run nor a stream nor a capture, or the port is taken.
pub(crate) fn view(args: &ViewArgs) -> Result<()> {
    let folder = &args.folder;
    let run = RunFolder(folder.clone());
    if run.manifest().exists() {
        let manifest: Manifest = read_json(&run.manifest())?;
        let stream = run.inside(&["export", "stream"])?;
        let capture = open_capture(&manifest.capture_path)?;
        let _viewer = serve(Some((capture, Some(&run))), &stream, args.port)?;
        follow(folder, &stream)
    } else if folder.join("manifest.json").exists() {
        serve(None, folder, args.port)?.wait();
    } else {
        let capture = open_capture(folder).with_context(|| {
            format!("{} is neither a run (run.json) nor a stream (manifest.json)", folder.display())
        })?;
        let stream = tempfile::tempdir()?;
        write_points(&*capture, stream.path())?;
        serve(Some((capture, None)), stream.path(), args.port)?.wait();
    }
    Ok(())
}

/// Serves a run that is about to begin, beside it.
///
/// # Errors
/// When the capture cannot be opened, or the page's engine is not there.
pub(crate) fn beside(request: &RunRequest) -> Result<Viewer> {
    let stream = request.out.join("export").join("stream");
    // What exposures a run will find is not known before.
    let viewer = serve(Some((open_capture(&request.capture)?, None)), &stream, 0)?;
    let folder = request.out.clone();
    std::thread::spawn(move || follow(&folder, &stream));
    Ok(viewer)
}

/// The page with the stream in a folder, the cameras of a capture and their photographs, in the exposures that a run found.
fn serve(
    capture: Option<(Box<dyn Capture>, Option<&RunFolder>)>,
    stream: &Path,
    port: u16,
) -> Result<Viewer> {
    let engine = engine()?;
    let mut site = FILES.iter().fold(Site::default(), |site, (name, bytes)| {
        site.with(name, Source::Bytes(bytes.as_bytes().to_vec()))
    });
    site = site
        .with(ENGINE, Source::Bytes(std::fs::read(&engine).with_context(|| engine.display().to_string())?));
    if let Some((capture, run)) = capture {
        let views = Views::of(&*capture, run, true)?;
        site = site.with("cameras.json", Source::Bytes(serde_json::to_vec(&views)?));
        site = site.with("photo", Source::Lookup(Box::new(move |name| photograph(&*capture, name))));
    }
    let viewer = Viewer::start(site.with("", Source::Folder(stream.to_owned())), port)?;
    terminal::print(viewer.url());
    Ok(viewer)
}

/// Appends the frames of a run to its stream as they are finished, until the process ends. While another process does the
/// same, the page shows what that one writes.
fn follow(folder: &Path, stream: &Path) -> ! {
    let (mut export, mut said) = (None, String::new());
    loop {
        // A run without a finished frame is looked at again.
        if let Err(error) = catch_up(&mut export, folder, stream) {
            let text = format!("{error:#}");
            if text != said && FinishedRun::open(folder).is_ok() {
                tracing::warn!("the page gets no further frames from this process: {text}");
            }
            said = text;
        }
        std::thread::sleep(LOOK_EVERY);
    }
}

/// Leaves no export behind an error: the next look opens it again.
fn catch_up(export: &mut Option<StreamExport>, folder: &Path, stream: &Path) -> Result<()> {
    let run = FinishedRun::open(folder)?;
    let mut going_on = match export.take() {
        Some(export) => export,
        None => open(&run, stream)?,
    };
    going_on.catch_up(&run, true)?;
    *export = Some(going_on);
    Ok(())
}

/// Begins a stream with uncertainties, or goes on with one as it is.
fn open(run: &FinishedRun, stream: &Path) -> Result<StreamExport> {
    run.folder.inside(&["export", "stream"])?;
    let uncertainty = has_uncertainty(stream).ok().flatten().unwrap_or(true);
    StreamExport::open(run, stream, &StreamOptions { uncertainty, ..StreamOptions::default() })
}

/// The file of `SPLIT/VIEW/FRAME.png`.
fn photograph(capture: &dyn Capture, name: &str) -> Option<PathBuf> {
    let mut parts = name.strip_suffix(".png")?.split('/');
    let split = parts.next()?;
    let split = Split::ALL.into_iter().find(|s| s.to_string() == split)?;
    let (view, frame) = (parts.next()?.parse().ok()?, parts.next()?.parse().ok()?);
    capture.image_file(ViewAt { split, view, frame })
}
