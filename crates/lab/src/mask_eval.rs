//! `ffgs-lab mask-eval`: the masks of a capture, camera by camera, against the true ones.

use anyhow::{Result, bail, ensure};
use clap::Args;
use ffgs_calibration::Media;
use ffgs_core::{ImageSize, Mask, is_present};
use ffgs_dataset::{Capture, DatasetError, Dynamic3dGaussians, Split, read_mask};
use ffgs_method::CaptureFormat;
use ffgs_pipeline::cli::args::LogArgs;
use ffgs_pipeline::cli::terminal::{self, progress};
use ffgs_pipeline::outputs::json::write_json;
use rayon::prelude::*;
use serde::Serialize;
use std::path::{Path, PathBuf};

/// `ffgs-lab mask-eval`.
#[derive(Clone, Debug, Args)]
#[command(
    about = "Score the masks of a capture against the true ones",
    long_about = "Counts the pixels that the masks of a capture have in common with the true ones, of every training camera \
        over all its frames: intersection over union, precision and recall per camera, and their means over cameras. \
        Frame t of the capture is compared with frame t of the truth, or with picture t of a folder in the order of names. \
        The truth must show the capture's own pictures, as large and as undistorted as `ffgs prepare` made them.",
    after_help = "Examples:\n  ffgs-lab mask-eval out/pool-made fixtures/scenes/pool-mini\n  \
        ffgs-lab mask-eval out/dancer out/dome/masks --json masks.json"
)]
pub(crate) struct MaskEvalArgs {
    /// Folder of the capture, made by `ffgs prepare`
    pub capture: PathBuf,
    /// Folder of a capture with the true masks, or one with a folder of mask pictures for each camera
    pub truth: PathBuf,
    /// Writes all figures
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
    /// Messages.
    #[command(flatten)]
    pub log: LogArgs,
}

/// Scores and prints.
///
/// # Errors
/// When a mask cannot be read or has another size than the true one, the capture has no masks or no camera has true
/// ones, or the figures cannot be written.
pub(crate) fn run(args: &MaskEvalArgs) -> Result<()> {
    let report = score(&args.capture, &args.truth, args.log.quiet)?;
    terminal::print(report.text().trim_end());
    args.json.as_ref().map_or(Ok(()), |file| write_json(file, &report))
}

fn score(folder: &Path, truth: &Path, quiet: bool) -> Result<Report> {
    let capture = Capture::open(folder).map_err(|error| error.in_capture(folder))?;
    let files = true_files(&capture, truth)?;
    let bar = progress(quiet, "cameras", files.len());
    let scores = files.par_iter().enumerate().map(|(view, files)| {
        let score = CameraScore::of(&capture, view, files);
        bar.inc(1);
        score
    });
    let cameras: Vec<CameraScore> = scores.collect::<Result<_>>()?;
    bar.finish_and_clear();
    // Single missing masks count as empty; a capture without any was prepared without this step.
    let made = cameras.iter().any(|camera| camera.missing_masks < camera.frames);
    ensure!(made, "{} has no masks; `ffgs prepare --only masks` makes them", folder.display());
    Ok(Report::of(cameras))
}

/// The files of the true masks of every training camera.
fn true_files(capture: &Capture, truth: &Path) -> Result<Vec<TrueFiles>> {
    let (known, frames) = (Truth::open(truth)?, capture.frames());
    let names = capture.names(Split::Train);
    let files: Vec<TrueFiles> = names.iter().map(|name| known.files(name, frames)).collect::<Result<_>>()?;
    ensure!(
        files.iter().flatten().any(Option::is_some),
        "{} has true masks of no training camera of {}; give a capture with masks, or a folder that holds a folder of \
         mask pictures for each camera ({}, …)",
        truth.display(),
        capture.root().display(),
        names[0]
    );
    if let Some(other) = files.iter().map(Vec::len).find(|count| ![0, frames].contains(count)) {
        tracing::warn!(
            "{} has {other} frames, {} has {frames}: frame t is compared with frame t, which is another moment after \
             `ffgs prepare --start` or `--every`",
            truth.display(),
            capture.root().display()
        );
    }
    Ok(files)
}

/// By frame, the file of a camera's true mask; `None` where there is none.
type TrueFiles = Vec<Option<PathBuf>>;

/// Where the true masks are.
enum Truth {
    Capture(Capture),
    /// One folder for each camera.
    Folder(PathBuf, Media),
}

impl Truth {
    fn open(folder: &Path) -> Result<Self> {
        if Dynamic3dGaussians.detect(folder).is_some() {
            return Ok(Self::Capture(Capture::open(folder).map_err(|error| error.in_capture(folder))?));
        }
        Ok(Self::Folder(folder.to_owned(), Media::find(folder)?))
    }

    /// The true masks of a camera, for a capture of `frames` frames; none of a camera that is not known here.
    fn files(&self, camera: &str, frames: usize) -> Result<TrueFiles> {
        match self {
            Self::Capture(capture) => masks_of(capture, camera),
            Self::Folder(folder, media) => pictures_of(media, &folder.join(camera), frames),
        }
    }
}

/// Those of a capture, which may hold out other cameras than the one that is scored.
fn masks_of(capture: &Capture, camera: &str) -> Result<TrueFiles> {
    let named = |split| Some((split, capture.names(split).iter().position(|name| name == camera)?));
    let Some((split, view)) = [Split::Train, Split::Test].into_iter().find_map(named) else {
        return Ok(Vec::new());
    };
    let file = |frame| Ok(Some(capture.mask_path(split, view, frame)?).filter(|file| is_present(file)));
    (0..capture.frames_of(split)).map(file).collect()
}

/// Those of a folder. Deeper folders of that name may be of photographs and do not count.
fn pictures_of(media: &Media, folder: &Path, frames: usize) -> Result<TrueFiles> {
    let Some((_, pictures)) = media.folders().find(|(found, _)| *found == folder) else {
        return Ok(Vec::new());
    };
    // Which frames the pictures are of is known only where none is missing.
    ensure!(
        pictures.len() >= frames,
        "{} has {} mask pictures, but the capture has {frames} frames; give one for each frame",
        folder.display(),
        pictures.len()
    );
    Ok(pictures.iter().cloned().map(Some).collect())
}

/// Pixels of a camera's masks and of the true ones.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
struct Counts {
    true_positives: usize,
    false_positives: usize,
    false_negatives: usize,
}

impl Counts {
    /// Of masks of one size.
    fn of(mask: &Mask, truth: &Mask) -> Self {
        let both = mask.data().iter().zip(truth.data()).filter(|(a, b)| **a != 0 && **b != 0).count();
        Self {
            true_positives: both,
            false_positives: mask.count() - both,
            false_negatives: truth.count() - both,
        }
    }

    fn add(&mut self, other: Self) {
        self.true_positives += other.true_positives;
        self.false_positives += other.false_positives;
        self.false_negatives += other.false_negatives;
    }

    fn figures(self) -> Figures {
        let Self { true_positives: both, false_positives, false_negatives } = self;
        let share = |whole: usize| (whole > 0).then(|| both as f64 / whole as f64);
        Figures {
            iou: share(both + false_positives + false_negatives),
            precision: share(both + false_positives),
            recall: share(both + false_negatives),
        }
    }
}

/// Shares from 0 to 1. What would divide by no pixels is absent: IoU where masks and truth are empty, precision where the
/// masks are, recall where the truth is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
struct Figures {
    iou: Option<f64>,
    precision: Option<f64>,
    recall: Option<f64>,
}

impl Figures {
    /// The mean of each figure over those that have it.
    fn mean(all: &[Self]) -> Self {
        let mean = |figure: fn(&Self) -> Option<f64>| {
            let known: Vec<f64> = all.iter().filter_map(figure).collect();
            (!known.is_empty()).then(|| known.iter().sum::<f64>() / known.len() as f64)
        };
        Self { iou: mean(|f| f.iou), precision: mean(|f| f.precision), recall: mean(|f| f.recall) }
    }
}

/// A training camera, over the frames that have a true mask.
#[derive(Clone, Debug, Serialize)]
struct CameraScore {
    camera: String,
    /// Frames with a true mask; 0 of a camera without truth.
    frames: usize,
    /// Those of them in which the capture has no mask, which counts as an empty one, as it does in a run.
    missing_masks: usize,
    #[serde(flatten)]
    counts: Counts,
    #[serde(flatten)]
    figures: Figures,
}

impl CameraScore {
    fn of(capture: &Capture, view: usize, truth: &[Option<PathBuf>]) -> Result<Self> {
        let (mut counts, mut frames, mut missing_masks) = (Counts::default(), 0, 0);
        let known = truth.iter().take(capture.frames()).enumerate();
        for (frame, file) in known.filter_map(|(frame, file)| Some((frame, file.as_ref()?))) {
            let fault = |error: DatasetError| error.in_capture(capture.root());
            let found = capture.load_mask(Split::Train, view, frame).map_err(fault)?;
            let size = capture.camera(Split::Train, view, frame).map_err(fault)?.size();
            let truth = true_mask(file, &capture.mask_path(Split::Train, view, frame)?, size)?;
            frames += 1;
            missing_masks += usize::from(found.is_none());
            counts.add(Counts::of(&found.unwrap_or_else(|| Mask::filled(size, false)), &truth));
        }
        let camera = capture.names(Split::Train)[view].clone();
        Ok(Self { camera, frames, missing_masks, counts, figures: counts.figures() })
    }

    fn row(&self) -> [String; 8] {
        let Counts { true_positives, false_positives, false_negatives } = self.counts;
        let counts = [self.frames, true_positives, false_positives, false_negatives].map(|n| n.to_string());
        row(self.camera.clone(), counts, self.figures)
    }
}

/// The true mask in `file`, for the mask `ours` of this size.
fn true_mask(file: &Path, ours: &Path, size: ImageSize) -> Result<Mask> {
    let ImageSize { width, height } = size;
    match read_mask(file, size) {
        Err(DatasetError::ImageSize { found, .. }) => bail!(
            "{} is {} x {}, but {} is {width} x {height}; `ffgs prepare` may undistort and reduce pictures: give true masks \
             of {width} x {height} pixels, of what the capture's own pictures show",
            file.display(),
            found.width,
            found.height,
            ours.display()
        ),
        read => Ok(read?),
    }
}

/// All figures.
#[derive(Debug, Serialize)]
struct Report {
    cameras: Vec<CameraScore>,
    /// Over the cameras with a score, each with equal weight.
    mean: Figures,
    /// Cameras that are skipped, as they have no true masks.
    without_truth: Vec<String>,
    /// Cameras without a score, as all their masks and true masks are empty.
    empty: Vec<String>,
}

impl Report {
    fn of(cameras: Vec<CameraScore>) -> Self {
        let named = |keep: fn(&CameraScore) -> bool| {
            cameras.iter().filter(|camera| keep(camera)).map(|camera| camera.camera.clone()).collect()
        };
        let without_truth = named(|camera| camera.frames == 0);
        let empty = named(|camera| camera.frames > 0 && camera.counts == Counts::default());
        let figures: Vec<Figures> = cameras.iter().map(|camera| camera.figures).collect();
        Self { mean: Figures::mean(&figures), cameras, without_truth, empty }
    }

    /// A row per camera, the means, and what has no score.
    fn text(&self) -> String {
        let scored = self.cameras.len() - self.without_truth.len() - self.empty.len();
        let mean =
            row(format!("mean of {scored} cameras"), std::array::from_fn(|_| String::new()), self.mean);
        let rows: Vec<[String; 8]> = [HEAD.map(str::to_owned)]
            .into_iter()
            .chain(self.cameras.iter().map(CameraScore::row))
            .chain([mean])
            .collect();
        let width = rows.iter().map(|row| row[0].chars().count()).max().unwrap_or(0);
        let line = |[name, cells @ ..]: &[String; 8]| {
            cells.iter().fold(format!("{name:<width$}"), |line, cell| line + &format!("  {cell:>12}")) + "\n"
        };
        rows.iter().map(line).collect::<String>() + &self.notes()
    }

    /// A line for each thing that the means do not tell.
    fn notes(&self) -> String {
        let all = self.cameras.len();
        let list = |names: &[String], what: &str| match names.len() {
            0 => String::new(),
            count => format!("{count} of {all} cameras {what}: {}\n", names.join(", ")),
        };
        let missing: usize = self.cameras.iter().map(|camera| camera.missing_masks).sum();
        let missing = match missing {
            0 => String::new(),
            count => format!("missing masks of the capture, which count as empty: {count}\n"),
        };
        list(&self.without_truth, "skipped, without true masks")
            + &list(&self.empty, "without a score, as their masks and the true ones are empty")
            + &missing
    }
}

const HEAD: [&str; 8] =
    ["camera", "frames", "true pos px", "false pos px", "false neg px", "IoU", "precision", "recall"];

fn row(name: String, [a, b, c, d]: [String; 4], figures: Figures) -> [String; 8] {
    let cell = |figure: Option<f64>| figure.map_or_else(|| "-".to_owned(), |figure| format!("{figure:.3}"));
    let [iou, precision, recall] = [figures.iou, figures.precision, figures.recall].map(cell);
    [name, a, b, c, d, iou, precision, recall]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::capture_writer::CaptureWriter;
    use ffgs_core::{Camera, ImageRgb8, Intrinsics};
    use glam::DMat4;
    use image::GrayImage;

    const SIZE: ImageSize = ImageSize { width: 4, height: 3 };

    /// The first row of pixels, the others empty.
    fn mask(row: [u8; 4]) -> Mask {
        let data = row.into_iter().chain([0; 8]).collect();
        Mask::new(SIZE, data).unwrap()
    }

    /// A capture of the training cameras `names` whose masks are `masks[view][frame]`.
    fn capture(folder: &Path, names: &[&str], masks: &[[Mask; 2]]) {
        let writer = CaptureWriter::new(folder.to_owned()).unwrap();
        let names: Vec<String> = names.iter().map(ToString::to_string).collect();
        let intrinsics = Intrinsics { fx: 4.0, fy: 4.0, cx: 2.0, cy: 1.5 };
        let camera = Camera::new(intrinsics, DMat4::IDENTITY, SIZE).unwrap();
        writer.cameras(Split::Train, &names, &vec![vec![camera; names.len()]; 2]).unwrap();
        let image = ImageRgb8::new(SIZE, vec![0; SIZE.pixels() * 3]).unwrap();
        for (name, masks) in names.iter().zip(masks) {
            masks.iter().enumerate().for_each(|(t, mask)| writer.view(name, t, &image, mask).unwrap());
        }
    }

    fn picture(file: &Path, (width, height): (u32, u32), row: [u8; 4]) {
        std::fs::create_dir_all(file.parent().unwrap()).unwrap();
        let level = |x: u32, y: u32| 255 * row.get(x as usize).filter(|_| y == 0).copied().unwrap_or(0);
        GrayImage::from_fn(width, height, |x, y| image::Luma([level(x, y)])).save(file).unwrap();
    }

    fn counts(true_positives: usize, false_positives: usize, false_negatives: usize) -> Counts {
        Counts { true_positives, false_positives, false_negatives }
    }

    const NONE: Figures = Figures { iou: None, precision: None, recall: None };

    #[test]
    fn figures_follow_from_the_counts_and_change_places_with_mask_and_truth() {
        let (ours, truth) = (mask([1, 1, 1, 0]), mask([0, 1, 1, 1]));
        assert_eq!(Counts::of(&ours, &truth), counts(2, 1, 1));
        let found = counts(3, 1, 2).figures();
        let expected = Figures { iou: Some(0.5), precision: Some(0.75), recall: Some(0.6) };
        assert_eq!(found, expected);
        let swapped = counts(3, 2, 1).figures();
        assert_eq!(swapped, Figures { iou: Some(0.5), precision: Some(0.6), recall: Some(0.75) });
        assert_eq!(Figures::mean(&[found, swapped]).precision, Some(0.675));
    }

    #[test]
    fn what_has_no_pixels_has_no_figure() {
        let (none, some) = (mask([0; 4]), mask([1, 1, 0, 0]));
        let of = |ours: &Mask, truth: &Mask| Counts::of(ours, truth).figures();
        assert_eq!(of(&none, &none), NONE);
        assert_eq!(of(&none, &some), Figures { iou: Some(0.0), precision: None, recall: Some(0.0) });
        assert_eq!(of(&some, &none), Figures { iou: Some(0.0), precision: Some(0.0), recall: None });
        assert_eq!(of(&some, &mask([0, 0, 1, 1])).iou, Some(0.0));
        assert_eq!(Figures::mean(&[NONE, of(&some, &some), of(&none, &some)]).iou, Some(0.5));
        assert_eq!(Figures::mean(&[NONE]), NONE);
    }

    /// Masks of four cameras; the truth knows nothing of the last, and the third sees nothing.
    fn four_cameras(folder: &Path) -> (PathBuf, PathBuf) {
        let (ours, truth) = (folder.join("ours"), folder.join("truth"));
        let (some, none) = (mask([1, 1, 0, 0]), mask([0; 4]));
        let masks = [
            [some.clone(), some.clone()],
            [some.clone(), none.clone()],
            [none.clone(), none],
            [some.clone(), some],
        ];
        capture(&ours, &["cam2", "cam10", "blind", "new"], &masks);
        let rows = [
            ("cam2", [[1, 1, 0, 0], [0, 1, 1, 1]]),
            ("cam10", [[1, 1, 0, 0], [0; 4]]),
            ("blind", [[0; 4]; 2]),
        ];
        for (name, rows) in rows {
            rows.iter()
                .enumerate()
                .for_each(|(t, row)| picture(&truth.join(format!("{name}/{t}.png")), (4, 3), *row));
        }
        (ours, truth)
    }

    #[test]
    fn cameras_are_scored_over_their_frames_and_those_without_truth_are_skipped() {
        let folder = tempfile::tempdir().unwrap();
        let (ours, truth) = four_cameras(folder.path());
        let report = score(&ours, &truth, true).unwrap();
        let found: Vec<_> = report.cameras.iter().map(|c| (c.camera.as_str(), c.frames, c.counts)).collect();
        let expected = [
            ("cam2", 2, counts(3, 1, 2)),
            ("cam10", 2, counts(2, 0, 0)),
            ("blind", 2, counts(0, 0, 0)),
            ("new", 0, counts(0, 0, 0)),
        ];
        assert_eq!(found, expected);
        assert_eq!(report.mean, Figures { iou: Some(0.75), precision: Some(0.875), recall: Some(0.8) });
        assert_eq!((report.without_truth.join(","), report.empty.join(",")), ("new".into(), "blind".into()));
        let text = report.text();
        let words: Vec<Vec<&str>> = text.lines().map(|line| line.split_whitespace().collect()).collect();
        assert_eq!(words[1], ["cam2", "2", "3", "1", "2", "0.500", "0.750", "0.600"]);
        assert_eq!(words[3], ["blind", "2", "0", "0", "0", "-", "-", "-"]);
        assert_eq!(words[5], ["mean", "of", "2", "cameras", "0.750", "0.875", "0.800"]);
        assert!(text.contains("1 of 4 cameras skipped, without true masks: new\n"), "{text}");
        assert!(text.contains("1 of 4 cameras without a score") && text.contains("empty: blind\n"), "{text}");
        let json = serde_json::to_value(&report).unwrap();
        assert_eq!((&json["cameras"][0]["iou"], &json["cameras"][2]["iou"]), (&0.5.into(), &().into()));
        assert_eq!(
            (&json["cameras"][0]["false_negatives"], &json["mean"]["recall"]),
            (&2.into(), &0.8.into())
        );
    }

    #[test]
    fn a_missing_mask_counts_as_an_empty_one_and_a_missing_true_mask_does_not_count() {
        let folder = tempfile::tempdir().unwrap();
        let (ours, truth) = (folder.path().join("ours"), folder.path().join("truth"));
        let (some, both) = (mask([1, 1, 0, 0]), |mask: &Mask| [mask.clone(), mask.clone()]);
        capture(&ours, &["a", "b"], &[both(&some), both(&some)]);
        capture(&truth, &["b", "a"], &[both(&some), both(&mask([1; 4]))]);
        std::fs::remove_file(ours.join("seg/a/000000.png")).unwrap();
        std::fs::remove_file(truth.join("seg/b/000001.png")).unwrap();
        let report = score(&ours, &truth, true).unwrap();
        let found: Vec<_> = report.cameras.iter().map(|c| (c.frames, c.missing_masks, c.counts)).collect();
        assert_eq!(found, [(2, 1, counts(2, 0, 6)), (1, 0, counts(2, 0, 0))]);
        assert!(report.text().ends_with("missing masks of the capture, which count as empty: 1\n"));
        std::fs::remove_dir_all(ours.join("seg")).unwrap();
        assert!(score(&ours, &truth, true).unwrap_err().to_string().contains("ours has no masks"));
    }

    #[test]
    fn what_cannot_be_compared_is_refused_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let (ours, truth) = four_cameras(folder.path());
        let error = |truth: &Path| score(&ours, truth, true).unwrap_err().to_string();
        let file = truth.join("cam10/1.png");
        picture(&file, (8, 6), [1; 4]);
        let text = error(&truth);
        let named =
            [file, ours.join("seg/cam10/000001.png")].map(|file| text.contains(&file.display().to_string()));
        assert!(named == [true; 2] && text.contains("is 8 x 6") && text.contains("is 4 x 3"), "{text}");
        std::fs::remove_file(truth.join("cam10/1.png")).unwrap();
        let text = error(&truth);
        assert!(text.contains("cam10 has 1 mask pictures, but the capture has 2 frames"), "{text}");
        // Photographs somewhere below are no masks.
        let text = error(folder.path());
        assert!(text.contains("true masks of no training camera") && text.contains("(cam2, …)"), "{text}");
        assert!(error(&folder.path().join("nowhere")).contains("nowhere"));
    }

    #[test]
    fn the_made_masks_of_the_second_sample_have_their_known_score_and_the_exact_ones_a_full_one() {
        let sample = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/scenes/pool-mini");
        let made = score(&sample, &sample.join("made/seg"), true).unwrap().mean.iou.unwrap();
        assert!((made - 0.8127).abs() < 1e-4, "{made}");
        let exact = Figures { iou: Some(1.0), precision: Some(1.0), recall: Some(1.0) };
        assert_eq!(score(&sample, &sample.join("seg"), true).unwrap().mean, exact);
        assert_eq!(score(&sample, &sample, true).unwrap().mean, exact);
    }
}
