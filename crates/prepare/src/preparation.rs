//! The steps in their order.

use crate::beside::{Beside, refuse_plates_among_footage};
use crate::journal::{self, Journal};
use crate::networks::Networks;
use crate::removal::remove;
use crate::rig::{self, Rig, rig};
use crate::stereo::StereoPoint;
use crate::timing::schedule;
use crate::{PrepareError, Progress, Request, Step, camera_lists, extraction, masks, points, tracking};
use ffgs_calibration::{ColouredPoint, Footage, Pictures, detect};
use ffgs_dataset::Capture;
use glam::DVec3;
use std::path::Path;

/// What was read, made and assumed; prints as a table.
#[derive(Clone, Debug, Default)]
pub struct Summary {
    /// Label and text of every row.
    pub rows: Vec<(String, String)>,
    /// Steps that an older version of this program finished, whose results may be better today.
    pub older: Vec<Step>,
}

/// Makes a capture of footage, or goes on with one.
///
/// # Errors
/// When the footage, its calibration or a picture cannot be used; nothing half-written is left under a final name.
pub fn prepare(request: &Request, progress: &dyn Progress) -> Result<Summary, PrepareError> {
    prepared(request, progress).map_err(|error| error.of(&request.source))
}

fn prepared(request: &Request, progress: &dyn Progress) -> Result<Summary, PrepareError> {
    // A network that cannot be loaded is told before anything is made.
    let mut networks = Networks::load(if request.wants(Step::Tracks) { &request.networks } else { &[] })?;
    refuse_plates_among_footage(request)?;
    let mut journal = Journal::open(request)?;
    let (format, calibration) = detect(&request.source, request.format.as_deref())?;
    let mut footage = (format.read)(&request.source, &calibration)?;
    journal.refuse_other_calibration(&footage, request)?;
    if !journal.to_clear.is_empty() {
        refuse_useless(&footage, request)?;
        clear(&mut journal, &request.out)?;
    }
    if networks.announce(&request.out)? {
        journal.steps.remove(&Step::Tracks);
    }
    let mut summary = Summary::default();
    summary.row("footage", format!("{} ({})", request.source.display(), format.name));
    summary.row("calibration", calibration.display().to_string());
    for step in Step::ALL {
        if request.wants(step) && !journal.steps.contains_key(&step) {
            let done = take(step, &mut footage, request, &mut networks, &mut journal, progress)?;
            journal.finish(step, done, &request.out)?;
        }
    }
    summary.add(&journal);
    Ok(summary)
}

impl Summary {
    /// Name of the file of a capture that tells how it was prepared.
    pub const FILE: &str = journal::FILE;

    /// What such a file tells.
    ///
    /// # Errors
    /// When the file cannot be read or is none of `prepare`.
    pub fn read(file: &Path) -> Result<Self, PrepareError> {
        let mut summary = Self::default();
        summary.add(&Journal::read(file)?);
        Ok(summary)
    }

    fn add(&mut self, journal: &Journal) {
        for step in Step::ALL {
            self.row(&step.to_string(), journal.account(step).unwrap_or_else(|| "not made".to_owned()));
        }
        self.older.extend(Step::ALL.into_iter().filter(|step| journal.is_older(*step)));
        journal.assumed.iter().for_each(|text| self.row("assumed", text));
        journal.skipped.iter().for_each(|text| self.row("skipped", text));
    }

    fn row(&mut self, label: &str, text: impl Into<String>) {
        self.rows.push((label.to_owned(), text.into()));
    }
}

impl std::fmt::Display for Summary {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.rows.iter().try_for_each(|(label, text)| writeln!(f, "{label:12} {text}"))
    }
}

fn take(
    step: Step,
    footage: &mut Footage,
    request: &Request,
    networks: &mut Networks,
    journal: &mut Journal,
    progress: &dyn Progress,
) -> Result<String, PrepareError> {
    if step == Step::Pictures {
        return make_pictures(footage, request, journal, progress);
    }
    if !journal.steps.contains_key(&Step::Pictures) {
        let reason = format!(
            "it has no pictures yet, of which {step} are made; take that step first, or leave --only out"
        );
        return Err(PrepareError::Output { folder: request.out.clone(), reason });
    }
    let capture = Capture::open(&request.out)?;
    if step == Step::Masks {
        journal.clean_plates = request.clean_plates.as_deref().map(journal::absolute);
    }
    match step {
        Step::Masks if request.out.join("seg").is_dir() => Ok(match &request.clean_plates {
            None => "those of the footage".to_owned(),
            Some(_) => {
                "those of the footage; the clean plates were not needed (--force masks uses them)".to_owned()
            }
        }),
        Step::Masks => {
            let rig = rig(footage, request)?;
            let beside = Beside::new(&rig, request)?;
            let made = masks::make(&capture, &beside, progress)?;
            beside.discard()?;
            Ok(made)
        }
        Step::Points => {
            let known = known_points(footage, journal);
            if footage.points_are_complete {
                return points::keep(&capture, &known);
            }
            points::make(&capture, &known, progress)
        }
        _ => tracking::make_all(&capture, networks, progress),
    }
}

/// Points of the calibration in the capture's world.
fn known_points(footage: &Footage, journal: &Journal) -> Vec<StereoPoint> {
    let to_capture = |p: &ColouredPoint| StereoPoint {
        position: (p.position - DVec3::from(journal.origin)) * journal.metres_per_unit,
        colour: p.colour.map(|c| f32::from(c) / 255.0),
    };
    let is_usable = |point: &StereoPoint| point.position.as_vec3().is_finite();
    footage.points.iter().map(to_capture).filter(is_usable).collect()
}

fn make_pictures(
    footage: &mut Footage,
    request: &Request,
    journal: &mut Journal,
    progress: &dyn Progress,
) -> Result<String, PrepareError> {
    let rig = rig(footage, request)?;
    let sequences: Vec<_> = rig.cameras.iter().map(|c| c.sequence.clone()).collect();
    let schedule = schedule(&sequences, footage.timestamps.as_deref(), request)?;
    journal.calibration = journal::checksums(footage);
    (journal.origin, journal.metres_per_unit) = (rig.origin.to_array(), rig.metres_per_unit);
    journal.assume(&footage.assumed);
    journal.assume(&rig.assumed);
    journal.assume(&schedule.assumed);
    journal.skip(&footage.skipped);
    journal.skip(&schedule.skipped);
    journal.save(&request.out)?;
    extraction::extract(&rig, &schedule, &request.out, progress)?;
    camera_lists::write(&rig, &schedule, &request.out)?;
    Ok(describe(&rig, footage, schedule.frames.len(), schedule.spread))
}

fn describe(rig: &Rig, footage: &Footage, frames: usize, spread: Option<f64>) -> String {
    let videos = rig.cameras.iter().filter(|c| matches!(c.pictures, Pictures::Video(_))).count();
    let test = rig.cameras.iter().filter(|c| c.test).count();
    let size = rig.cameras[0].undistortion.size();
    let apart = spread.map_or(String::new(), |s| format!(", at most {:.0} ms apart", s * 1e3));
    format!(
        "{} cameras ({videos} videos), {test} held out, {frames} frames, {} x {}, {} undistorted{apart}",
        rig.cameras.len(),
        size.width,
        size.height,
        rig::distorted(footage)
    )
}

/// What would stop a step that is to be made again must not cost the result that is there.
fn refuse_useless(footage: &Footage, request: &Request) -> Result<(), PrepareError> {
    let rig = rig(footage, request)?;
    let sequences: Vec<_> = rig.cameras.iter().map(|c| c.sequence.clone()).collect();
    schedule(&sequences, footage.timestamps.as_deref(), request)?;
    let beside = Beside::new(&rig, request)?;
    rig.cameras.iter().try_for_each(|camera| beside.clean_plates(&camera.name).map(|_| ()))?;
    beside.discard()
}

/// Removes what is to be made again. The journal tells so before the first file goes: a preparation that is killed in between goes on with it.
fn clear(journal: &mut Journal, out: &Path) -> Result<(), PrepareError> {
    let results = |step: &Step| match step {
        // Masks, points and tracks belong to their pictures.
        Step::Pictures => {
            ["train_meta.json", "test_meta.json", "ims", "seg", "seg.part", "init_pt_cld.npz", "tracks"]
                .as_slice()
        }
        Step::Masks => &["seg", "seg.part"],
        Step::Points => &["init_pt_cld.npz"],
        Step::Tracks => &[],
    };
    journal.save(out)?;
    let steps = std::mem::take(&mut journal.to_clear);
    steps.iter().flat_map(results).try_for_each(|name| remove(&out.join(name)))?;
    if steps.contains(&Step::Tracks) {
        tracking::discard(out)?;
    }
    journal.save(out)
}
