//! `ffgs-lab expose`: a capture whose exposures and light change from frame to frame.

use anyhow::{Context, Result, ensure};
use clap::Args;
use ffgs_core::Exposure;
use ffgs_dataset::write_image;
use ffgs_method::{Capture, Split, ViewAt};
use ffgs_pipeline::cli::args::LogArgs;
use ffgs_pipeline::plugins::registry::open_capture;
use ffgs_trainer::normal;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use std::fs;
use std::path::{Path, PathBuf};

/// `ffgs-lab expose`.
#[derive(Clone, Debug, Args)]
#[command(
    about = "Give the photographs of a capture exposures that change from frame to frame",
    long_about = "Copies a capture and gives its photographs other exposures, frame by frame, as offsets of the log odds of their values (1 EV \
        is about 0.55 at mid-grey). The first frame stays as it is. The photographs must be PNG files; masks, tracks and truth are copied as they are.",
    after_help = "Examples:\n  ffgs-lab expose fixtures/scenes/fairmont-mini --drift 0.15 --out out/drift      automatic exposure\n  \
        ffgs-lab expose fixtures/scenes/fairmont-mini --light -0.12 --out out/dusk      the light goes"
)]
pub(crate) struct ExposeArgs {
    /// Folder of the capture
    pub capture: PathBuf,
    /// New folder
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Standard deviation of the change of each training camera from one frame to the next
    #[arg(long, value_name = "OFFSET", default_value_t = 0.0)]
    pub drift: f64,
    /// Change of all cameras from one frame to the next
    #[arg(long, value_name = "OFFSET", default_value_t = 0.0, allow_negative_numbers = true)]
    pub light: f64,
    /// Standard deviation of an offset that all cameras share, of each frame anew
    #[arg(long, value_name = "OFFSET", default_value_t = 0.0)]
    pub flicker: f64,
    /// Seed of what is random
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
    /// Messages.
    #[command(flatten)]
    pub log: LogArgs,
}

/// Writes the capture.
///
/// # Errors
/// When the capture cannot be read, its photographs are no PNG files in its folder, or the new folder cannot be written.
pub(crate) fn run(args: &ExposeArgs) -> Result<()> {
    let sizes = [args.drift, args.light, args.flicker];
    ensure!(sizes.iter().all(|v| v.abs() <= 5.0), "--drift, --light and --flicker are from -5 to 5");
    let empty = fs::read_dir(&args.out).map_or(true, |mut entries| entries.next().is_none());
    ensure!(empty, "{} is not empty; choose another --out or remove it", args.out.display());
    let capture = open_capture(&args.capture)?;
    let exposures = exposures(args, &*capture);
    // Before anything is copied.
    let places = exposures.iter().map(|(at, _)| place(args, &*capture, *at)).collect::<Result<Vec<_>>>()?;
    copy(&args.capture, &args.out)?;
    exposures.into_par_iter().zip(places).try_for_each(|((at, exposure), place)| {
        Ok(write_image(&args.out.join(place), &exposure.removed(&capture.image(at)?))?)
    })
}

/// The photographs that change, and what is to be removed from them.
fn exposures(args: &ExposeArgs, capture: &dyn Capture) -> Vec<(ViewAt, Exposure)> {
    let mut random = ChaCha8Rng::seed_from_u64(args.seed);
    let mut shared = Vec::new();
    for frame in 0..capture.frames() {
        let flicker = args.flicker * f64::from(normal(&mut random));
        shared.push(args.light * frame as f64 + flicker);
    }
    let mut out = Vec::new();
    for split in [Split::Train, Split::Test] {
        for view in 0..capture.views(split).len() {
            let mut own = 0.0;
            for frame in 1..capture.frames_of(split) {
                own += if split == Split::Train { args.drift * f64::from(normal(&mut random)) } else { 0.0 };
                let offset = own + shared[frame];
                out.push((ViewAt { split, view, frame }, Exposure { offsets: [-offset; 3] }));
            }
        }
    }
    out
}

/// Where a photograph lies in the capture's folder.
fn place(args: &ExposeArgs, capture: &dyn Capture, at: ViewAt) -> Result<PathBuf> {
    let named = || format!("{} has no file for a photograph of frame {}", args.capture.display(), at.frame);
    let file = capture.image_file(at).with_context(named)?;
    ensure!(file.extension().is_some_and(|e| e.eq_ignore_ascii_case("png")), "{} is no PNG", file.display());
    let inside = file.strip_prefix(capture.root());
    Ok(inside.with_context(|| format!("{} lies outside the capture", file.display()))?.to_owned())
}

/// A folder with all that is in it.
fn copy(from: &Path, to: &Path) -> Result<()> {
    let read = || format!("cannot read {}", from.display());
    let write = |path: &Path| format!("cannot write {}", path.display());
    fs::create_dir_all(to).with_context(|| write(to))?;
    for entry in fs::read_dir(from).with_context(read)? {
        let entry = entry.with_context(read)?.path();
        let target = to.join(entry.file_name().unwrap_or_default());
        if entry.is_dir() {
            copy(&entry, &target)?;
        } else {
            fs::copy(&entry, &target).with_context(|| write(&target))?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn light_changes_all_cameras_and_drift_those_that_are_trained_on() {
        let folder = tempfile::tempdir().unwrap();
        let sample = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/scenes/fairmont-mini");
        let args = ExposeArgs {
            capture: sample.clone(),
            out: folder.path().join("out"),
            drift: 0.3,
            light: -0.2,
            flicker: 0.0,
            seed: 1,
            log: LogArgs::default(),
        };
        run(&args).unwrap();
        let [before, after] = [&sample, &args.out].map(|path| open_capture(path).unwrap());
        // Log odds of the means: nearly the offset.
        let change = |split, view, frame| {
            let at = ViewAt { split, view, frame };
            let odds = |capture: &dyn Capture| {
                let image = capture.image(at).unwrap();
                let mean = image.data().iter().map(|&v| f64::from(v) / 255.0).sum::<f64>()
                    / image.data().len() as f64;
                (mean / (1.0 - mean)).ln()
            };
            odds(&*after) - odds(&*before)
        };
        assert_eq!(change(Split::Train, 0, 0), 0.0);
        let test: Vec<f64> = (0..3).map(|view| change(Split::Test, view, 3)).collect();
        assert!(test.iter().all(|c| (c + 0.6).abs() < 0.15), "{test:?}");
        let train: Vec<f64> = (0..6).map(|view| change(Split::Train, view, 3)).collect();
        let spread =
            train.iter().copied().fold(f64::MIN, f64::max) - train.iter().copied().fold(f64::MAX, f64::min);
        assert!(spread > 0.3, "{train:?}");
        assert!(run(&args).unwrap_err().to_string().contains("not empty"));
    }
}
