//! The parts as one run, and the jump at each seam.

use super::ids::{Counts, Ids};
use super::plan::Plan;
use crate::job::lock::FolderLock;
use crate::job::manifest::Manifest;
use crate::outputs::exposure_files::{read_usual, write_usual};
use crate::outputs::folder::{RunFolder, STATE};
use crate::outputs::json::{read_json, write_json};
use crate::outputs::publish::publish;
use crate::outputs::record::{FrameRecord, Metrics, mean};
use crate::outputs::scene_files::write_dynamic;
use crate::outputs::state;
use crate::outputs::turntable::write_turntable;
use crate::plugins::registry::open_capture;
use anyhow::{Context, Result, ensure};
use ffgs_core::{Scene, open_input, write_atomically};
use ffgs_method::Capture;
use ffgs_reconstruction::Devices;
use serde::{Deserialize, Serialize};
use std::path::Path;
use std::{fs, io};

/// A jump of the quality that is told in the report (dB).
const TOLD: f64 = 0.3;

/// A seam: its frame is the last of one part and the key frame of the next.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Seam {
    frame: usize,
    /// Mean over the test views, or else the training views that measure the frame (dB): as the part before ends with the frame, and as the next begins with it.
    psnr: [Option<f64>; 2],
    mpsnr: [Option<f64>; 2],
    /// Gaussians of the moving layer that keep an id from the first frame, take one of a neighbour, or get a new one.
    ids_kept: usize,
    ids_matched: usize,
    ids_new: usize,
}

impl Seam {
    fn of(frame: usize, ends: [&FrameRecord; 2], Counts { kept, matched, new }: Counts) -> Self {
        Self {
            frame,
            psnr: ends.map(|record| mean(record.measured().map(|v| v.psnr))),
            mpsnr: ends.map(|record| mean(record.measured().filter_map(|v| v.mpsnr))),
            ids_kept: kept,
            ids_matched: matched,
            ids_new: new,
        }
    }

    /// What the quality gains over the seam (dB): the whole picture's, and the foreground's.
    fn jumps(&self) -> [Option<f64>; 2] {
        [self.psnr, self.mpsnr].map(|[before, after]| Some(after? - before?))
    }

    fn warning(&self) -> Option<String> {
        let jumps = self.jumps().map(|jump| jump.unwrap_or(0.0));
        let large = jumps.iter().any(|jump| jump.abs() > TOLD);
        large.then(|| {
            format!(
                "frame {}: the quality jumps by {:+.2} dB PSNR, {:+.2} dB MPSNR where two parts meet; longer parts \
                 have fewer seams, and other --key-iterations, more or fewer, can make this one smaller",
                self.frame, jumps[0], jumps[1]
            )
        })
    }
}

/// Makes `joined`; returns the table of the seams.
///
/// # Errors
/// When a part is not finished, or a file cannot be read or written.
pub(super) fn join(plan: &Plan) -> Result<String> {
    let parts = plan.parts();
    for (number, part) in parts.iter().enumerate() {
        ensure!(
            plan.part(number).state(part.end - 1).exists(),
            "part {number} is not finished; run `ffgs segment run {} --only {number}`",
            plan.folder.display()
        );
    }
    let (capture, joined) = (open_capture(&plan.capture)?, plan.joined());
    let _lock = FolderLock::take(&joined.0)?;
    joined.remove_half_written()?;
    let mut manifest: Manifest = read_json(&plan.part(0).manifest())?;
    manifest.frames = plan.frames.clone();
    (manifest.first_frame, manifest.segment_length) = (None, Some(plan.length));
    write_json(&joined.manifest(), &manifest)?;
    write_usual(&read_usual(&plan.part(0))?, &joined)?;
    let (drawn, target) = (plan.part(0).cameras(), joined.cameras());
    if drawn.is_file() {
        copy(&drawn, &target)?;
    }
    let first = state::load(&plan.first().state(plan.frames.start), plan.frames.start)?.dynamic.next_id;
    let (mut seams, mut records, mut last) = (Vec::new(), Vec::new(), None::<Scene>);
    for (number, part) in parts.iter().enumerate() {
        let folder = plan.part(number);
        let mut ids = None;
        if let Some(before) = &last {
            let key = state::load(&folder.state(part.start), part.start)?;
            let (map, counts) = Ids::at_seam(&before.dynamic, &key.dynamic, first);
            let ends =
                [&plan.part(number - 1), &folder].map(|run| FrameRecord::read(run, part.start, &*capture));
            let [before, after] = ends;
            seams.push(Seam::of(part.start, [&before?, &after?], counts));
            ids = Some(map);
        }
        for frame in part.clone().skip(usize::from(number > 0)) {
            let mut record = FrameRecord::read(&folder, frame, &*capture)?;
            if frame == part.start + 1 {
                record.log.warnings.extend(seams.last().and_then(Seam::warning));
            }
            last =
                Some(take_frame((&folder, &joined), frame, &record, ids.as_mut().map(|map| (map, first)))?);
            records.push(record);
        }
    }
    finish(&joined, &*capture, &manifest, last.as_ref(), records)?;
    write_json(&joined.0.join("seams.json"), &seams)?;
    Ok(table(&seams) + &joined.0.display().to_string())
}

/// Puts a frame into the joined run, with other ids where they change; its state comes last.
fn take_frame(
    (from, to): (&RunFolder, &RunFolder),
    frame: usize,
    record: &FrameRecord,
    ids: Option<(&mut Ids, u32)>,
) -> Result<Scene> {
    let mut scene = state::load(&from.state(frame), frame)?;
    let folder = to.frame(frame);
    // An earlier join may have been cut short, or be of parts that were made again since.
    remove(&to.state(frame))?;
    remove(&folder)?;
    take_files(&from.frame(frame), &folder)?;
    take_files(&from.frame(frame).join("test"), &folder.join("test"))?;
    if let Some((ids, first)) = ids {
        ids.apply(&mut scene.dynamic, first);
        write_dynamic(&folder, &scene.dynamic)?;
    }
    write_json(&to.record(frame), record)?;
    state::save(&to.state(frame), frame, &scene)?;
    Ok(scene)
}

/// The files of a folder but the state, which marks a frame as finished. They are linked where the disk can: nothing
/// changes a file of a run, each is replaced as a whole.
fn take_files(from: &Path, to: &Path) -> Result<()> {
    fs::create_dir_all(to).with_context(|| format!("cannot write {}", to.display()))?;
    for entry in fs::read_dir(from).into_iter().flatten().flatten() {
        let (file, target) = (entry.path(), to.join(entry.file_name()));
        if !file.is_file() || entry.file_name() == STATE {
            continue;
        }
        fs::hard_link(&file, &target).or_else(|_| copy(&file, &target))?;
    }
    Ok(())
}

/// Copies a file, whole or not at all.
fn copy(from: &Path, to: &Path) -> Result<()> {
    let mut source = open_input(from).with_context(|| format!("cannot read {}", from.display()))?;
    write_atomically(to, |out| io::copy(&mut source, out).map(|_| ()))
        .map_err(|error: io::Error| anyhow::Error::new(error))
        .with_context(|| format!("cannot write {}", to.display()))
}

/// Removes a file or folder that may be missing.
fn remove(path: &Path) -> Result<()> {
    let removed = if path.is_dir() { fs::remove_dir_all(path) } else { fs::remove_file(path) };
    match removed {
        Err(error) if error.kind() != io::ErrorKind::NotFound => {
            Err(error).with_context(|| format!("cannot remove {}", path.display()))
        }
        _ => Ok(()),
    }
}

/// What belongs to no single frame.
fn finish(
    joined: &RunFolder,
    capture: &dyn Capture,
    manifest: &Manifest,
    last: Option<&Scene>,
    records: Vec<FrameRecord>,
) -> Result<()> {
    let frame = records.last().map_or(0, |record| record.frame);
    if let Some(scene) = last {
        write_turntable(joined, capture, frame, scene, Devices(&[]))?;
    }
    publish(joined, manifest, &Metrics::of(records))
}

fn table(seams: &[Seam]) -> String {
    let head = format!(
        "{:>6}  {:>8} {:>7}  {:>8} {:>7}  {:>9} {:>7} {:>7}\n",
        "seam", "PSNR", "jump", "MPSNR", "jump", "ids kept", "matched", "new"
    );
    let number = |value: Option<f64>| value.map_or("-".to_owned(), |v| format!("{v:.2}"));
    let jump = |value: Option<f64>| value.map_or("-".to_owned(), |v| format!("{v:+.2}"));
    let row = |seam: &Seam| {
        let [psnr, mpsnr] = seam.jumps();
        format!(
            "{:>6}  {:>8} {:>7}  {:>8} {:>7}  {:>9} {:>7} {:>7}\n",
            seam.frame,
            number(seam.psnr[0]),
            jump(psnr),
            number(seam.mpsnr[0]),
            jump(mpsnr),
            seam.ids_kept,
            seam.ids_matched,
            seam.ids_new
        )
    };
    head + &seams.iter().map(row).collect::<String>()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::outputs::record::ViewMetrics;

    #[test]
    fn a_seam_says_how_the_quality_jumps() {
        let of = |psnr, mpsnr| FrameRecord {
            views: vec![ViewMetrics { psnr, mpsnr, ..ViewMetrics::default() }],
            ..FrameRecord::default()
        };
        let (before, after) = (of(24.0, Some(20.0)), of(24.1, Some(19.5)));
        let seam = Seam::of(7, [&before, &after], Counts { kept: 3, matched: 2, new: 1 });
        assert!(seam.warning().unwrap().contains("+0.10 dB PSNR, -0.50 dB MPSNR"));
        let words: Vec<String> = table(&[seam]).split_whitespace().map(str::to_owned).collect();
        assert_eq!(words[words.len() - 8..], ["7", "24.00", "+0.10", "20.00", "-0.50", "3", "2", "1"]);
        assert_eq!(Seam::of(7, [&before, &of(24.1, None)], Counts::default()).warning(), None);
    }
}
