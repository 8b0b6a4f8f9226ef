//! Foreground masks by difference from each fixed camera's background, made consistent between the views.

mod background;
mod change;
mod colours;
mod contact_sheet;
mod continuation;
mod cut;
mod difference;
mod regions;

use crate::beside::Beside;
use crate::extraction::file_name;
use crate::hull::hulls;
use crate::pictures::{read_mask, write_mask};
use crate::region::common_region;
use crate::silhouettes::Silhouette;
use crate::{PrepareError, Progress};
use background::Background;
use change::Change;
use colours::Colours;
use ffgs_core::{Camera, ImageRgb8, Mask};
use ffgs_dataset::{Capture, Split};
use rayon::prelude::*;
use regions::{filled, touched_by, without_specks};
use std::fs;
use std::path::{Path, PathBuf};

/// Frames of the capture from which a background is learnt.
const SAMPLES: usize = 20;
/// Fewer frames do not tell what stands still.
const LEAST_FRAMES: usize = 4;
/// From the second round on, the background is learnt without what the one before found, and the colours of that count. There are so many
/// rounds at most, and none after one that changes less than this share of what the masks hold.
const MOST_ROUNDS: usize = 6;
const SETTLED: f64 = 0.02;
/// Voxels that so many views see may add foreground to a mask.
const VIEWS_THAT_ADD: u16 = 4;
/// Smallest region (of the image) that is kept, and largest hole that is filled.
const SPECK: f64 = 2e-4;
const HOLE: f64 = 1e-3;
/// Largest hole that is filled where other views find most of it possible: a dark hub before a dark road is one, what is seen between an
/// arm and a hip is not.
const POSSIBLE_HOLE: f64 = 4e-3;

/// Name of the contact sheet in the capture.
const SHEET: &str = "masks.png";

/// A camera of the capture, for which masks are wanted.
#[derive(Clone, Debug)]
struct View {
    split: Split,
    index: usize,
    name: String,
    fixed: bool,
}

/// Makes the masks of all views; they appear together when all are done. `beside` has more pictures of the cameras than
/// the capture. Returns what was done, or why nothing was.
pub(crate) fn make(
    capture: &Capture,
    beside: &Beside,
    progress: &dyn Progress,
) -> Result<String, PrepareError> {
    let views = views(capture)?;
    let fixed = views.iter().filter(|v| v.fixed).count();
    let plates = views.iter().filter(|v| v.fixed && beside.has_clean_plate(&v.name)).count();
    if capture.frames() < LEAST_FRAMES && plates < 2 {
        return Ok(format!("none: {} frames do not tell what moves; run with --init none", capture.frames()));
    }
    if fixed < 2 {
        return Ok(format!(
            "none: {fixed} of {} cameras stand still, so there is no background to learn",
            views.len()
        ));
    }
    let part = capture.root().join("seg.part");
    let most = if plates == fixed { 1 } else { MOST_ROUNDS };
    let total = most * (fixed + capture.frames());
    let mut done = 0;
    let mut step = |n: usize| {
        done += n;
        progress.advance("masks", done, total);
    };
    for round in 1..=most {
        let change = make_once(capture, &views, beside, &part, round > 1, &mut step)?;
        tracing::info!("masks, round {round}: {:.1} % changed", 100.0 * change);
        if change < SETTLED {
            break;
        }
    }
    progress.advance("masks", total, total);
    let seg = capture.root().join("seg");
    fs::rename(&part, &seg).map_err(|e| PrepareError::io(&seg, e))?;
    contact_sheet::write(capture, &seg)?;
    Ok(format!("{}; look at {SHEET}", made_from(plates, fixed, views.len())))
}

/// One round. Returns by which share the masks in `folder` change, where there are some from the round `before`, else 1.
fn make_once(
    capture: &Capture,
    views: &[View],
    beside: &Beside,
    folder: &Path,
    before: bool,
    step: &mut dyn FnMut(usize),
) -> Result<f64, PrepareError> {
    let known = before.then_some(folder);
    let learnt: Vec<Option<Learnt>> =
        views.par_iter().map(|v| learn(capture, v, known, beside)).collect::<Result<_, _>>()?;
    step(learnt.iter().flatten().count());
    let mut change = Change::default();
    for frame in 0..capture.frames() {
        let masks = masks_of(capture, views, &learnt, frame)?;
        change = change + replace(folder, views, &masks, frame, before)?;
        step(1);
    }
    Ok(if before { change.share() } else { 1.0 })
}

/// Writes the masks of a frame, and tells how they differ from those that were there `before`.
fn replace(
    folder: &Path,
    views: &[View],
    masks: &[Mask],
    frame: usize,
    before: bool,
) -> Result<Change, PrepareError> {
    let one = |(view, mask): (&View, &Mask)| {
        let file = folder.join(file_name(&view.name, frame));
        let change = if before { Change::between(&read_mask(&file)?, mask) } else { Change::default() };
        write_mask(&file, mask)?;
        Ok(change)
    };
    views.par_iter().zip(masks).map(one).try_reduce(Change::default, |a, b| Ok(a + b))
}

/// What the masks of `all` cameras were made from.
fn made_from(plates: usize, fixed: usize, all: usize) -> String {
    let source = match plates {
        0 => format!("made from the background of {fixed} fixed cameras"),
        _ if plates == fixed => format!("made from clean plates of {fixed} fixed cameras"),
        _ => format!("made from clean plates of {plates} of {fixed} fixed cameras, else from the background"),
    };
    match all - fixed {
        0 => source,
        moving => format!("{source}, {moving} moving ones from the visual hull alone"),
    }
}

fn views(capture: &Capture) -> Result<Vec<View>, PrepareError> {
    let mut out = Vec::new();
    for split in [Split::Train, Split::Test] {
        for (index, view) in capture.views(split).iter().enumerate() {
            let first = capture.camera(split, index, 0)?;
            let mut fixed = true;
            for frame in 1..capture.frames() {
                fixed &= capture.camera(split, index, frame)? == first;
            }
            out.push(View { split, index, name: view.name.clone(), fixed });
        }
    }
    Ok(out)
}

/// What is known of a fixed camera.
struct Learnt {
    background: Background,
    /// Grey levels that count in a difference.
    levels: f32,
    /// Those of the masks that were made before, and of what is around them.
    colours: Option<Colours>,
}

impl Learnt {
    /// With pictures and the `masks` of the first ones of them that were made before.
    fn new(background: Background, images: &[ImageRgb8], masks: &[Mask]) -> Self {
        let levels = difference::levels(&background, images, masks);
        let colours = Colours::learn(&background, images, masks);
        Self { background, levels, colours }
    }
}

/// The background of a fixed camera: of the empty scene, or from frames spread over the capture, without what `known` masks
/// cover, and from more of its footage; and the colours of these masks.
fn learn(
    capture: &Capture,
    view: &View,
    known: Option<&Path>,
    beside: &Beside,
) -> Result<Option<Learnt>, PrepareError> {
    if !view.fixed {
        return Ok(None);
    }
    if beside.has_clean_plate(&view.name) {
        let empty = beside.clean_plates(&view.name)?;
        return Ok((!empty.is_empty()).then(|| Learnt::new(Background::learn(&empty, &[]), &[], &[])));
    }
    let frames = capture.frames();
    if frames < LEAST_FRAMES {
        return Ok(None);
    }
    let count = frames.min(SAMPLES);
    let chosen: Vec<usize> = (0..count).map(|i| i * frames / count).collect();
    let mut images = Vec::new();
    let mut masks = Vec::new();
    for frame in chosen {
        images.push(capture.load_image(view.split, view.index, frame)?);
        if let Some(folder) = known {
            masks.push(read_mask(&folder.join(file_name(&view.name, frame)))?);
        }
    }
    images.extend(beside.footage(&view.name)?);
    let covered: Vec<Mask> = masks.iter().map(|m| m.dilated(regions::radius(m.size()))).collect();
    let background = Background::learn(&images, &covered);
    Ok(Some(Learnt::new(background, &images, &masks)))
}

/// The masks of one frame, in the order of the views.
fn masks_of(
    capture: &Capture,
    views: &[View],
    learnt: &[Option<Learnt>],
    frame: usize,
) -> Result<Vec<Mask>, PrepareError> {
    let load = |view: &View| -> Result<(Camera, ImageRgb8), PrepareError> {
        Ok((
            capture.camera(view.split, view.index, frame)?,
            capture.load_image(view.split, view.index, frame)?,
        ))
    };
    let loaded: Vec<_> = views.par_iter().map(load).collect::<Result<_, _>>()?;
    let raw: Vec<Option<Vec<f32>>> = loaded
        .par_iter()
        .zip(learnt)
        .map(|((_, image), learnt)| learnt.as_ref().map(|l| difference::raw(image, &l.background, l.levels)))
        .collect();
    let scores: Vec<Option<Vec<f32>>> = (raw.par_iter().zip(&loaded))
        .map(|(raw, (camera, _))| raw.as_ref().map(|raw| difference::scores(raw, camera.size())))
        .collect();
    let silhouettes: Vec<Silhouette> = loaded
        .iter()
        .zip(&scores)
        .filter_map(|((camera, _), s)| {
            let mask = difference::foreground(s.as_ref()?, camera.size());
            Some(Silhouette { camera: *camera, mask })
        })
        .collect();
    let cameras: Vec<Camera> = loaded.iter().map(|l| l.0).collect();
    let refined = |(v, agreed): (usize, &Agreed)| {
        let (Some(raw), Some(Learnt { background, colours, .. })) = (&raw[v], &learnt[v]) else {
            return agreed.mask.clone();
        };
        let image = &loaded[v].1;
        let mut votes = cut::votes(raw, image.size());
        if let Some(colours) = colours {
            colours.weigh(&mut votes, image, background, &agreed.mask);
        }
        cut::add_other_views(&mut votes, &agreed.possible, &agreed.confirmed);
        let cut = cut::cheapest(&votes, image, background, &agreed.mask);
        // What colours alone have found is another thing of the same colour.
        let found = touched_by(&cut, |i| agreed.mask.data()[i] == 1);
        filled(&without_specks(&found, SPECK, HOLE), POSSIBLE_HOLE, &agreed.possible)
    };
    Ok(agreed(&cameras, &scores, &silhouettes).par_iter().enumerate().map(refined).collect())
}

/// The mask of a view, by what all views say.
struct Agreed {
    mask: Mask,
    /// What no other view denies.
    possible: Mask,
    /// What the others see.
    confirmed: Mask,
}

/// What a view found itself, and what the others see though the difference is weak here.
fn agreed(cameras: &[Camera], scores: &[Option<Vec<f32>>], silhouettes: &[Silhouette]) -> Vec<Agreed> {
    let fixed: Vec<Camera> = silhouettes.iter().map(|s| s.camera).collect();
    let region = common_region(&fixed);
    let [possible, seen] = hulls(silhouettes, region, [1, usize::from(VIEWS_THAT_ADD).min(fixed.len())]);
    let mut own = silhouettes.iter();
    let mut mask_of = |camera: &Camera, score: &Option<Vec<f32>>| {
        let add = seen.seen_by(camera, 0);
        let Some(score) = score else {
            return Agreed { mask: add.clone(), possible: add.clone(), confirmed: add };
        };
        let own = &own.next().expect("a silhouette per score").mask;
        let allowed = possible.seen_by(camera, 1).dilated(regions::radius(camera.size()));
        let data = (0..own.data().len())
            .map(|i| own.data()[i] | (add.data()[i] & u8::from(score[i] > difference::WITH_OTHERS)));
        let mask = Mask::new(camera.size(), data.collect()).expect("one value a pixel");
        Agreed { mask: without_specks(&mask, SPECK, HOLE), possible: allowed, confirmed: add }
    };
    cameras.iter().zip(scores).map(|(c, s)| mask_of(c, s)).collect()
}

/// Where the contact sheet lies.
pub(crate) fn sheet_path(root: &Path) -> PathBuf {
    root.join(SHEET)
}
