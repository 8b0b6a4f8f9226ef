//! `ffgs render`: pictures of a finished run.

use crate::cli::args::RenderArgs;
use crate::cli::terminal::{self, progress};
use crate::outputs::finished_run::FinishedRun;
use crate::outputs::folder::RunFolder;
use crate::outputs::orbit::{clear_of, orbit};
use crate::outputs::scoring::render as render_scene;
use anyhow::{Context, Result, bail};
use ffgs_core::{Camera, Exposure, ImageRgb8};
use ffgs_dataset::write_image;
use ffgs_method::{Capture, Split, ViewAt};
use ffgs_reconstruction::Devices;
use std::path::Path;
use std::process::{Command, Stdio};

/// Pictures held at a time.
const VIEWS_AT_ONCE: usize = 8;
/// Views of an orbit: two seconds of video.
const ORBIT_VIEWS: usize = 60;
/// Renders a camera or an orbit of one frame into PNGs, an orbit into an mp4 as well.
///
/// # Errors
/// When the run or its capture cannot be read, or a picture cannot be written.
pub(crate) fn render(args: &RenderArgs) -> Result<()> {
    let run = FinishedRun::open(&args.run)?;
    let frame = run.choose(args.frame)?;
    let mut scene = run.scene(frame)?;
    let stem = format!("orbit_{frame:06}");
    let views = match (&args.camera, args.orbit) {
        (Some(name), false) => {
            let at = named_view(&*run.capture, name, frame)?;
            let exposure = run.exposures(frame)?.of(&*run.capture, at)?;
            vec![(format!("{name}_{frame:06}.png"), run.capture.camera(at)?, exposure)]
        }
        (None, true) => {
            let cameras = orbit(&*run.capture, &scene.dynamic.gaussians, frame, ORBIT_VIEWS)?;
            scene = clear_of(&scene, &cameras);
            cameras
                .into_iter()
                .enumerate()
                .map(|(v, camera)| (format!("{stem}_{v:03}.png"), camera, Exposure::NEUTRAL))
                .collect()
        }
        _ => bail!("choose one view: --camera NAME for a camera of the capture, or --orbit for a circle"),
    };
    let out = args.out.clone().map_or_else(|| RunFolder(args.run.clone()).inside(&["renders"]), Ok)?;
    let trained = run.trained_cameras(frame)?;
    let gpus = args.device.open()?;
    let bar = progress(args.log.quiet, "views", views.len());
    for group in views.chunks(VIEWS_AT_ONCE) {
        let cameras: Vec<Camera> = group.iter().map(|(_, camera, _)| *camera).collect();
        let mut pictures = render_scene(&scene, &cameras, &trained, Devices(&gpus))?;
        for ((name, _, exposure), picture) in group.iter().zip(&mut pictures) {
            exposure.apply(picture);
            write_image(&out.join(name), &ImageRgb8::from(&*picture))?;
            bar.inc(1);
        }
    }
    bar.finish_and_clear();
    terminal::print(out.display());
    if args.orbit { write_video(&out, &stem) } else { Ok(()) }
}

/// The view of a camera at a frame, whatever its split.
fn named_view(capture: &dyn Capture, name: &str, frame: usize) -> Result<ViewAt> {
    for split in Split::ALL {
        if let Some(view) = capture.views(split).iter().position(|view| view == name) {
            // Views of the init split have one pose.
            let frame = if split == Split::Init { 0 } else { frame };
            return Ok(ViewAt { split, view, frame });
        }
    }
    let names = Split::ALL.iter().flat_map(|&s| capture.views(s)).map(String::as_str);
    bail!("--camera {name}: the capture has {}", names.collect::<Vec<_>>().join(", "))
}

/// Joins the pictures of an orbit into an mp4 when there is an ffmpeg; without one the pictures remain.
fn write_video(folder: &Path, stem: &str) -> Result<()> {
    let part = format!("{stem}.mp4.{}.part", std::process::id());
    let mut ffmpeg = Command::new("ffmpeg");
    ffmpeg.current_dir(folder).stdin(Stdio::null());
    ffmpeg.args(["-y", "-loglevel", "error", "-framerate", "30", "-i", &format!("{stem}_%03d.png")]);
    // 4:2:0 wants even sizes.
    ffmpeg.args(["-frames:v", &ORBIT_VIEWS.to_string(), "-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2"]);
    ffmpeg.args(["-c:v", "libx264", "-pix_fmt", "yuv420p", "-f", "mp4", &part]);
    let output = match ffmpeg.output() {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
            tracing::info!("no ffmpeg on PATH: pictures only, no mp4");
            return Ok(());
        }
        output => output.context("cannot start ffmpeg")?,
    };
    let (part, video) = (folder.join(part), folder.join(format!("{stem}.mp4")));
    if !output.status.success() {
        // It may never have been created.
        let _ = std::fs::remove_file(&part);
        let reason = String::from_utf8_lossy(&output.stderr);
        bail!("the pictures are written, but ffmpeg made no mp4 of them: {}", reason.trim());
    }
    std::fs::rename(&part, &video).with_context(|| format!("cannot write {}", video.display()))?;
    terminal::print(video.display());
    Ok(())
}
