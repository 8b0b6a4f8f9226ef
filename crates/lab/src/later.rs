//! `ffgs-lab later`: a capture that begins at a later frame, to tell what was lost on the way there from what the cameras show by then.

use crate::capture_writer::CaptureWriter;
use anyhow::{Context, Result, ensure};
use clap::Args;
use ffgs_core::Mask;
use ffgs_method::{Points, Split, ViewAt};
use ffgs_motion_eval::Truth;
use ffgs_pipeline::cli::args::LogArgs;
use ffgs_pipeline::plugins::registry::open_capture;
use glam::DVec3;
use rayon::prelude::*;
use std::path::PathBuf;

/// `ffgs-lab later`.
#[derive(Clone, Debug, Args)]
#[command(
    about = "Make a capture of one later frame, to tell what a run has lost by then",
    long_about = "Makes a capture of one later frame: its photographs, masks and cameras, and the initial points, of which those that move \
        have gone with their true motion. Trained as a first frame, it shows what can be had from that frame alone, with true points: what \
        a run has at that frame beyond it is what earlier frames taught. The capture needs truth/poses.json and truth/tracks.npz.",
    after_help = "Example:\n  ffgs-lab later fixtures/scenes/fairmont-mini --frame 5 --out out/later\n  ffgs run out/later --out out/alone"
)]
pub(crate) struct LaterArgs {
    /// Folder of the capture
    pub capture: PathBuf,
    /// The frame
    #[arg(long, value_name = "N")]
    pub frame: usize,
    /// New folder
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Messages.
    #[command(flatten)]
    pub log: LogArgs,
}

/// Writes the capture.
///
/// # Errors
/// When the capture or its truth cannot be read, does not have the frame, or the folder cannot be written.
pub(crate) fn run(args: &LaterArgs) -> Result<()> {
    let capture = open_capture(&args.capture)?;
    let (capture, frame) = (&*capture, args.frame);
    let truth = Truth::read(&args.capture)?.relative_to(capture.origin());
    let frames = capture.frames().min(truth.frames());
    ensure!(frame < frames, "--frame {frame}: {} has the frames 0..{frames}", args.capture.display());
    let points =
        capture.points()?.with_context(|| format!("{} has no initial points", args.capture.display()))?;
    let writer = CaptureWriter::new(args.out.clone())?;
    for split in [Split::Train, Split::Test].into_iter().filter(|&split| frame < capture.frames_of(split)) {
        let names = capture.views(split);
        let shots: Vec<ViewAt> = (0..names.len()).map(|view| ViewAt { split, view, frame }).collect();
        let cameras = shots.iter().map(|&at| Ok(capture.camera(at)?)).collect::<Result<_>>()?;
        writer.cameras(split, names, &[cameras])?;
        shots.into_par_iter().try_for_each(|at| -> Result<()> {
            let image = capture.image(at)?;
            let mask = capture.mask(at)?.unwrap_or_else(|| Mask::filled(image.size(), false));
            writer.view(&names[at.view], 0, &image, &mask)
        })?;
    }
    writer.points(&carried(&points, &truth, frame)?)
}

/// The initial points at a later frame. Those that move but are on no part, or on one that is gone by then, are left out.
fn carried(points: &Points, truth: &Truth, frame: usize) -> Result<Points> {
    let places: Vec<DVec3> = points.positions.iter().map(|p| DVec3::from(p.map(f64::from))).collect();
    let parts = truth.parts_at(0, &places)?;
    let mut out = Points { dropped: points.dropped, ..Points::default() };
    for (i, place) in places.into_iter().enumerate() {
        let goes = || truth.motion(parts[i]?, 0, frame).map(|motion| motion.transform_point3(place));
        let Some(place) = (if points.foreground[i] { goes() } else { Some(place) }) else { continue };
        out.positions.push(place.as_vec3().to_array());
        out.colours.push(points.colours[i]);
        out.foreground.push(points.foreground[i]);
    }
    let gone = points.len() - out.len();
    if gone > 0 {
        tracing::info!("{gone} of {} points are on no part that is there in frame {frame}", points.len());
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use ffgs_method::Capture;
    use std::path::Path;

    #[test]
    fn a_later_frame_begins_with_its_points_in_its_masks() {
        let place = tempfile::tempdir().unwrap();
        let sample = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/scenes/fairmont-mini");
        let later = |frame: usize| {
            let out = place.path().join(frame.to_string());
            run(&LaterArgs { capture: sample.clone(), frame, out: out.clone(), log: LogArgs::default() })
                .map(|()| open_capture(&out).unwrap())
        };
        let (whole, last) = (open_capture(&sample).unwrap(), later(5).unwrap());
        assert_eq!((last.frames(), last.views(Split::Train)), (1, whole.views(Split::Train)));
        assert!(last.views(Split::Init).is_empty(), "their photographs are of frame 0");
        let at = |frame| ViewAt { split: Split::Train, view: 3, frame };
        assert_eq!(last.image(at(0)).unwrap(), whole.image(at(5)).unwrap());
        assert_eq!(last.camera(at(0)).unwrap(), whole.camera(at(5)).unwrap());
        // Share of the moving points in view that are in the masks of the last frame.
        let inside = |capture: &dyn Capture| {
            let points = capture.points().unwrap().unwrap();
            let (mut inside, mut all) = (0, 0);
            for view in 0..whole.views(Split::Train).len() {
                let at = ViewAt { split: Split::Train, view, frame: 5 };
                let (camera, mask) = (whole.camera(at).unwrap(), whole.mask(at).unwrap().unwrap());
                for (point, _) in points.positions.iter().zip(&points.foreground).filter(|(_, moves)| **moves)
                {
                    let Some((x, y)) = camera.pixel_of(DVec3::from(point.map(f64::from))) else { continue };
                    all += 1;
                    inside += usize::from(mask.contains(x, y));
                }
            }
            f64::from(inside as u32) / f64::from(all)
        };
        let [before, after] = [inside(&*whole), inside(&*last)];
        assert!(after > 0.9 && before < 0.6, "{before} and {after}");
        let error = later(99).map(|_| ()).unwrap_err().to_string();
        assert!(error.contains("--frame 99") && error.contains("0..6"), "{error}");
    }
}
