//! `ffgs-lab enlarge`: a capture with larger images, as a quick stand-in for one that was filmed so.

use crate::capture_writer::CaptureWriter;
use anyhow::Result;
use clap::Args;
use ffgs_core::{Camera, DenseMotion, ImageRgb8, ImageSize, Intrinsics, Mask, TrackSet, ViewMotion};
use ffgs_method::{Capture, Split, ViewAt, ViewStep};
use ffgs_pipeline::cli::args::LogArgs;
use ffgs_pipeline::plugins::registry::open_capture;
use rayon::prelude::*;
use std::path::PathBuf;

/// `ffgs-lab enlarge`.
#[derive(Clone, Debug, Args)]
#[command(
    about = "Enlarge the images, masks and tracks of a capture",
    long_about = "Enlarges the images (bilinear), masks, tracks and intrinsics of a capture. No detail is gained: it shows what \
        a run of that many pixels costs, not what quality it has.",
    after_help = "Example:\n  ffgs-lab enlarge fixtures/scenes/fairmont-mini --factor 6 --frames 3 --out out/large"
)]
pub(crate) struct EnlargeArgs {
    /// Folder of the capture
    pub capture: PathBuf,
    /// New folder
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Factor on width and height
    #[arg(long, value_name = "N", default_value_t = 6, value_parser = clap::value_parser!(u8).range(2..=16))]
    pub factor: u8,
    /// Only the first frames [default: all]
    #[arg(long, value_name = "N")]
    pub frames: Option<usize>,
    /// Messages.
    #[command(flatten)]
    pub log: LogArgs,
}

/// Writes the enlarged capture.
///
/// # Errors
/// When the capture cannot be read or the folder not be written.
pub(crate) fn run(args: &EnlargeArgs) -> Result<()> {
    let capture = open_capture(&args.capture)?;
    let writer = CaptureWriter::new(args.out.clone())?;
    let (capture, factor) = (&*capture, usize::from(args.factor));
    let frames = args.frames.map_or(capture.frames(), |n| n.clamp(1, capture.frames()));
    for split in Split::ALL {
        let names = capture.views(split);
        let count = frames.min(capture.frames_of(split));
        let at = |frame| (0..names.len()).map(move |view| ViewAt { split, view, frame });
        let camera = |at| -> Result<Camera> { larger_camera(&capture.camera(at)?, factor) };
        let cameras: Vec<Vec<Camera>> =
            (0..count).map(|frame| at(frame).map(camera).collect()).collect::<Result<_>>()?;
        writer.cameras(split, names, &cameras)?;
        let every: Vec<ViewAt> = (0..count).flat_map(at).collect();
        every.into_par_iter().try_for_each(|at| enlarge_view(&writer, capture, at, factor))?;
    }
    if let Some(points) = capture.points()? {
        writer.points(&points)?;
    }
    enlarge_tracks(&writer, capture, frames, factor)
}

fn larger_camera(camera: &Camera, factor: usize) -> Result<Camera> {
    let Intrinsics { fx, fy, cx, cy } = camera.intrinsics();
    let [fx, fy, cx, cy] = [fx, fy, cx, cy].map(|v| v * factor as f64);
    Ok(Camera::new(Intrinsics { fx, fy, cx, cy }, camera.camera_from_world(), larger(camera.size(), factor))?)
}

fn larger(ImageSize { width, height }: ImageSize, factor: usize) -> ImageSize {
    ImageSize { width: width * factor, height: height * factor }
}

fn enlarge_view(writer: &CaptureWriter, capture: &dyn Capture, at: ViewAt, factor: usize) -> Result<()> {
    let image = capture.image(at)?;
    let size = image.size();
    let mask = capture.mask(at)?.unwrap_or_else(|| Mask::filled(size, false));
    let name = &capture.views(at.split)[at.view];
    writer.view(name, at.frame, &larger_image(&image, factor), &larger_mask(&mask, factor))
}

/// Index below and above a place of the larger row, and the weight of the one above.
fn neighbours(place: usize, factor: usize, side: usize) -> (usize, usize, f32) {
    let at = ((place as f32 + 0.5) / factor as f32 - 0.5).clamp(0.0, (side - 1) as f32);
    let below = at as usize;
    (below, (below + 1).min(side - 1), at - below as f32)
}

fn larger_image(image: &ImageRgb8, factor: usize) -> ImageRgb8 {
    let from = image.size();
    let size = larger(from, factor);
    let mut data = Vec::with_capacity(size.pixels() * 3);
    for y in 0..size.height {
        let (top, bottom, down) = neighbours(y, factor, from.height);
        for x in 0..size.width {
            let (left, right, along) = neighbours(x, factor, from.width);
            for channel in 0..3 {
                let at = |x: usize, y: usize| f32::from(image.data()[(y * from.width + x) * 3 + channel]);
                let row = |y: usize| at(left, y) + along * (at(right, y) - at(left, y));
                data.push((row(top) + down * (row(bottom) - row(top))).round() as u8);
            }
        }
    }
    ImageRgb8::new(size, data).expect("three bytes per pixel")
}

fn larger_mask(mask: &Mask, factor: usize) -> Mask {
    let size = larger(mask.size(), factor);
    let pixels =
        (0..size.pixels()).map(|p| u8::from(mask.contains(p % size.width / factor, p / size.width / factor)));
    Mask::new(size, pixels.collect()).expect("one byte per pixel")
}

fn enlarge_tracks(writer: &CaptureWriter, capture: &dyn Capture, frames: usize, factor: usize) -> Result<()> {
    let mut trackers = Vec::new();
    for source in ffgs_tracks::sources(capture)? {
        let step = |(frame, view)| -> Result<ViewStep> {
            let before = ViewAt { split: Split::Train, view, frame: frame - 1 };
            Ok(ViewStep { capture, view, frame, size: capture.camera(before)?.size() })
        };
        let steps: Vec<(usize, usize)> =
            (1..frames).flat_map(|t| (0..capture.views(Split::Train).len()).map(move |v| (t, v))).collect();
        let written = steps.into_par_iter().map(|at| -> Result<Option<bool>> {
            let step = step(at)?;
            let Some(tracked) = source.motion(&step)? else { return Ok(None) };
            let motion = larger_motion(&tracked.motion, factor);
            writer.motion(source.name(), step.camera(), step.frame, &motion)?;
            Ok(Some(matches!(motion, ViewMotion::Dense(_))))
        });
        let dense: Vec<Option<bool>> = written.collect::<Result<_>>()?;
        trackers.extend(dense.into_iter().flatten().next().map(|dense| (source.name().to_owned(), dense)));
    }
    if trackers.is_empty() { Ok(()) } else { writer.trackers(&trackers) }
}

fn larger_motion(motion: &ViewMotion, factor: usize) -> ViewMotion {
    let times = |places: &[[f32; 2]]| places.iter().map(|p| p.map(|v| v * factor as f32)).collect();
    match motion {
        ViewMotion::Tracks(TrackSet { src, tgt, visibility }) => {
            ViewMotion::Tracks(TrackSet { src: times(src), tgt: times(tgt), visibility: visibility.clone() })
        }
        ViewMotion::Dense(dense) => {
            let size = larger(dense.size, factor);
            let mut out = DenseMotion::unknown(size);
            for p in 0..size.pixels() {
                let from = p / size.width / factor * dense.size.width + p % size.width / factor;
                out.flow[p] = dense.flow[from].map(|v| v * factor as f32);
                (out.visibility[p], out.confidence[p]) = (dense.visibility[from], dense.confidence[from]);
            }
            ViewMotion::Dense(out)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    #[test]
    fn a_capture_twice_as_large_shows_and_moves_the_same() {
        let place = tempfile::tempdir().unwrap();
        let small = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/scenes/fairmont-mini");
        let out = place.path().join("large");
        let log = LogArgs::default();
        run(&EnlargeArgs { capture: small.clone(), out: out.clone(), factor: 2, frames: Some(2), log })
            .unwrap();
        let (small, large) = (open_capture(&small).unwrap(), open_capture(&out).unwrap());
        assert_eq!(large.views(Split::Train), small.views(Split::Train));
        let at = ViewAt { split: Split::Train, view: 3, frame: 1 };
        let (a, b) = (small.camera(at).unwrap(), large.camera(at).unwrap());
        let point = a.center() + 5.0 * a.ray(glam::DVec2::new(100.0, 60.0));
        let [in_small, in_large] = [&a, &b].map(|camera| camera.project(point).unwrap().pixel);
        assert!((2.0 * in_small - in_large).length() < 1e-9);
        let [few, many] = [&small, &large].map(|c| c.mask(at).unwrap().unwrap().count());
        assert_eq!(4 * few, many);
        let motion = |capture: &dyn Capture, tracker: usize, size| {
            let step = ViewStep { capture, view: 3, frame: 1, size };
            ffgs_tracks::sources(capture).unwrap()[tracker].motion(&step).unwrap().unwrap().motion
        };
        for tracker in 0..3 {
            let expected = larger_motion(&motion(&*small, tracker, a.size()), 2);
            let found = motion(&*large, tracker, b.size());
            match (expected, found) {
                (ViewMotion::Tracks(a), ViewMotion::Tracks(b)) => assert_eq!(a, b),
                (ViewMotion::Dense(a), ViewMotion::Dense(b)) => {
                    assert_eq!(a.confidence, b.confidence);
                    let far = |(a, b): (&[f32; 2], &[f32; 2])| (a[0] - b[0]).abs().max((a[1] - b[1]).abs());
                    let known = a.flow.iter().zip(&b.flow).zip(&a.confidence).filter(|(_, c)| **c > 0.0);
                    assert!(known.map(|(pair, _)| far(pair)).fold(0.0, f32::max) < 0.05);
                }
                _ => panic!("the format of tracker {tracker} has changed its kind"),
            }
        }
    }
}
