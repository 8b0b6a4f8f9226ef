//! What a capture of any format holds, and what is wrong with it.

use crate::mask_suspicions::{self, ViewHistory};
use crate::outlines::Outline;
use crate::report::{CheckReport, Note, SplitSummary, ViewSummary};
use crate::suspicions;
use ffgs_core::{ImageRgb8, Mask, is_present};
use ffgs_method::{Capture, Fault, Part, Points, Split, ViewAt};
use rayon::prelude::*;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Below this no motion can be triangulated.
const MIN_TRAIN_VIEWS: usize = 2;

/// Masks of a view that are decoded where images are not.
const MASKS_DECODED: usize = 16;

/// How images are checked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ImageCheck {
    /// Every image is decoded.
    Decode,
    /// Size and completeness only ([`Capture::probe`]), and so of most masks: for a caller that decodes them later anyway.
    Probe,
}

/// Reads every file of the capture, in parallel, and lists what it holds and what is wrong.
pub fn check(capture: &dyn Capture) -> CheckReport {
    check_with_progress(capture, ImageCheck::Decode, &|_, _| ())
}

/// As [`check`]; calls `progress(done, total)` after every image, from any thread.
pub fn check_with_progress(
    capture: &dyn Capture,
    images: ImageCheck,
    progress: &(dyn Fn(usize, usize) + Sync),
) -> CheckReport {
    let mut report = CheckReport { root: capture.root().to_owned(), ..CheckReport::default() };
    let points = check_points(capture, &mut report);
    let views: Vec<_> = Split::ALL
        .iter()
        .flat_map(|&split| (0..capture.views(split).len()).map(move |v| (split, v)))
        .collect();
    let total = views.iter().map(|(split, _)| capture.frames_of(*split)).sum();
    let done = AtomicUsize::new(0);
    let tick = || progress(done.fetch_add(1, Ordering::Relaxed) + 1, total);
    let checker = Checker { capture, images, points: &points, tick: &tick };
    let checked: Vec<_> = views.into_par_iter().map(|(split, view)| checker.view(split, view)).collect();
    let mut histories = Vec::new();
    for (summary, history, faults) in checked {
        if summary.split == Split::Train {
            histories.push(history);
        }
        report.views.push(summary);
        report.faults.extend(faults);
    }
    check_splits(capture, &mut report);
    check_masks(capture, &mut report);
    note_blind_views(capture, &mut report);
    let (faults, notes) = suspicions::find(capture, &points, &report.views);
    report.faults.extend(faults);
    report.notes.extend(notes);
    // A run that only probes the images has been told before, or does not want to know.
    if images == ImageCheck::Decode {
        report.notes.extend(mask_suspicions::find(capture, &points, &histories));
    }
    report
}

fn check_points(capture: &dyn Capture, report: &mut CheckReport) -> Points {
    let file = capture.part(Part::Points);
    let found = capture.points().unwrap_or_else(|fault| {
        report.faults.push(fault);
        None
    });
    let points = found.unwrap_or_default();
    report.points = points.len();
    report.foreground_points = points.foreground_count();
    let mut add = |problem: String, fix: &str| {
        report.faults.push(Fault { file: file.clone(), problem, fix: fix.into() });
    };
    if points.dropped > 0 {
        let all = points.len() + points.dropped;
        add(format!("{} of {all} points are NaN or infinite", points.dropped), "remove these rows");
    }
    if points.is_empty() {
        let fix = "`ffgs prepare CAPTURE --out NEW` makes points, or store some of frame 0, e.g. from structure from motion";
        add("no initial points".into(), fix);
    }
    points
}

/// What the check of a view needs.
struct Checker<'a> {
    capture: &'a dyn Capture,
    images: ImageCheck,
    points: &'a Points,
    tick: &'a (dyn Fn() + Sync),
}

impl Checker<'_> {
    fn view(&self, split: Split, view: usize) -> (ViewSummary, ViewHistory, Vec<Fault>) {
        let mut summary = self.empty_summary(split, view);
        let (mut history, mut faults) = (ViewHistory::default(), Vec::new());
        for frame in 0..self.capture.frames_of(split) {
            let at = ViewAt { split, view, frame };
            if let Err(fault) = self.frame(at, &mut summary, &mut history, &mut faults) {
                faults.push(fault);
            }
            (self.tick)();
        }
        summary.coverage /= summary.decoded_masks.max(1) as f64;
        summary.border_coverage /= summary.decoded_masks.max(1) as f64;
        summary.brightness /= summary.images.max(1) as f64;
        (summary, history, faults)
    }

    fn empty_summary(&self, split: Split, view: usize) -> ViewSummary {
        let capture = self.capture;
        let camera = capture.camera(ViewAt { split, view, frame: 0 }).ok();
        let seen =
            |p: &&[f32; 3]| camera.as_ref().is_some_and(|c| c.pixel_of(p.map(f64::from).into()).is_some());
        ViewSummary {
            split,
            name: capture.views(split)[view].clone(),
            frames: capture.frames_of(split),
            size: camera.as_ref().map(ffgs_core::Camera::size),
            images: 0,
            masks: 0,
            decoded_masks: 0,
            missing_masks: Vec::new(),
            empty_masks: 0,
            coverage: 0.0,
            border_coverage: 0.0,
            brightness: 0.0,
            points_seen: self.points.positions.iter().filter(seen).count(),
        }
    }

    /// A caller that decodes images later does so with masks: those of some frames say whether they fit.
    fn decodes_mask(&self, at: ViewAt) -> bool {
        let frames = self.capture.frames_of(at.split);
        self.images == ImageCheck::Decode || at.frame.is_multiple_of(frames.div_ceil(MASKS_DECODED).max(1))
    }

    /// Reads image and mask of a frame; a bad image does not hide a bad mask.
    fn frame(
        &self,
        at: ViewAt,
        summary: &mut ViewSummary,
        history: &mut ViewHistory,
        faults: &mut Vec<Fault>,
    ) -> Result<(), Fault> {
        self.capture.camera(at)?;
        history.areas.push(None);
        let image = match self.images {
            ImageCheck::Decode => self.capture.image(at).map(|i| brightness(&i)),
            ImageCheck::Probe => self.capture.probe(at).map(|()| 0.0),
        };
        match image {
            Ok(brightness) => {
                history.brightness.push(brightness);
                summary.images += 1;
                summary.brightness += brightness;
            }
            Err(fault) => {
                history.brightness.push(0.0);
                faults.push(fault);
            }
        }
        if !self.decodes_mask(at) {
            let there = self.capture.probe_mask(at)?;
            summary.masks += usize::from(there);
            summary.missing_masks.extend((!there).then_some(at.frame));
            return Ok(());
        }
        let Some(mask) = self.capture.mask(at)? else {
            summary.missing_masks.push(at.frame);
            return Ok(());
        };
        summary.masks += 1;
        summary.decoded_masks += 1;
        summary.empty_masks += usize::from(mask.count() == 0);
        summary.coverage += mask.count() as f64 / mask.size().pixels() as f64;
        summary.border_coverage += border(&mask);
        history.areas.pop();
        history.areas.push(Some(mask.count()));
        history.outlines.push(Outline::of(&mask));
        Ok(())
    }
}

/// Mean value of every hundredth byte or so: an exposure needs no more.
fn brightness(image: &ImageRgb8) -> f64 {
    const STEP: usize = 97;
    let sum: f64 = image.data().iter().step_by(STEP).map(|v| f64::from(*v)).sum();
    sum / image.data().len().div_ceil(STEP) as f64
}

/// Foreground fraction of the outermost pixels.
fn border(mask: &Mask) -> f64 {
    let (width, height) = (mask.size().width, mask.size().height);
    let rows = (0..width).flat_map(|x| [(x, 0), (x, height - 1)]);
    let columns = (0..height).flat_map(|y| [(0, y), (width - 1, y)]);
    let inside = rows.chain(columns).filter(|(x, y)| mask.contains(*x, *y)).count();
    inside as f64 / (2 * (width + height)) as f64
}

fn check_splits(capture: &dyn Capture, report: &mut CheckReport) {
    for split in Split::ALL {
        let views = capture.views(split).len();
        if views > 0 {
            report.splits.push(SplitSummary { split, views, frames: capture.frames_of(split) });
        }
    }
    let train = capture.views(Split::Train).len();
    if train < MIN_TRAIN_VIEWS {
        let problem =
            format!("{train} training view: motion is triangulated from at least {MIN_TRAIN_VIEWS}");
        let file = capture.part(Part::Cameras(Split::Train));
        report.faults.push(Fault { file, problem, fix: "add calibrated cameras of the same scene".into() });
    }
    if capture.views(Split::Test).is_empty() {
        let file = capture.part(Part::Cameras(Split::Test));
        let text = "no test views: quality is measured on views that are trained on, which look better than new places";
        report.notes.push(Note { file, text: text.into() });
    }
}

fn check_masks(capture: &dyn Capture, report: &mut CheckReport) {
    let train = || report.views.iter().filter(|v| v.split == Split::Train);
    let masks: usize = train().map(|v| v.masks).sum();
    let empty: usize = train().map(|v| v.empty_masks).sum();
    let decoded: usize = train().map(|v| v.decoded_masks).sum();
    let file = capture.part(Part::Masks);
    // A run looks at those of some frames before it starts.
    let looked_at = if decoded < masks { "that was looked at " } else { "" };
    if decoded == empty && report.faults.is_empty() {
        let (what, fix) = match masks {
            0 => ("no masks".to_owned(), "; `ffgs prepare CAPTURE --out NEW` makes some"),
            _ => (format!("every training mask {looked_at}is empty"), ""),
        };
        let others = if looked_at.is_empty() { "" } else { ", if the others are empty too" };
        let text = format!("{what}: nothing is marked as moving, the scene is taken for static{others}{fix}");
        report.notes.push(Note { file, text });
    }
    if masks == 0 && !is_present(&capture.part(Part::Masks)) {
        return;
    }
    // A segmenter may write nothing where it finds nothing.
    let missing: usize = train().map(|v| v.missing_masks.len()).sum();
    let most = missing > masks;
    for view in &report.views {
        let file = capture.part(Part::Masks).join(&view.name);
        // Unreadable masks have their own fault; here only those that are not there.
        if let Some(&first) = view.missing_masks.first() {
            let (count, first) = (view.missing_masks.len(), mask_name(capture, view, first));
            let text = format!("{count} of {} masks are missing, the first is {first}", view.frames);
            if view.split == Split::Train && most {
                let fix = "add a PNG per image, 0 = background".into();
                report.faults.push(Fault { file, problem: text, fix });
            } else {
                let text = format!("{text}; they count as empty");
                report.notes.push(Note { file, text });
            }
        } else if view.empty_masks > 0 {
            let of = if view.decoded_masks < view.masks { " that were looked at" } else { "" };
            let text = format!("{} of {} masks{of} are empty", view.empty_masks, view.decoded_masks);
            report.notes.push(Note { file, text });
        }
    }
}

/// Masks are named after their images.
fn mask_name(capture: &dyn Capture, summary: &ViewSummary, frame: usize) -> String {
    let view = capture.views(summary.split).iter().position(|name| *name == summary.name);
    let image = view.and_then(|view| capture.image_file(ViewAt { split: summary.split, view, frame }));
    let name = image.as_deref().and_then(|image| image.file_stem());
    name.map_or_else(|| format!("of frame {frame}"), |name| format!("{}.png", name.display()))
}

fn note_blind_views(capture: &dyn Capture, report: &mut CheckReport) {
    let blind = report.views.iter().filter(|v| v.points_seen == 0 && v.size.is_some() && report.points > 0);
    let text = "sees no initial point at frame 0 (is its pose world-to-camera, in metres, OpenCV axes?)";
    let note = |v: &ViewSummary| Note {
        file: capture.part(Part::Cameras(v.split)),
        text: format!("camera '{}' {text}", v.name),
    };
    report.notes.extend(blind.map(note).collect::<Vec<_>>());
}
