//! Metrics of a test view's video, its frames in time order: VMAF and flicker.

use crate::finished_run::FinishedRun;
use crate::frame::load_view;
use crate::record::FrameRecord;
use crate::vmaf::Vmaf;
use anyhow::{Context, Result, ensure};
use ffgs_core::ImageRgb8;
use ffgs_dataset::read_image;
use ffgs_method::{Split, ViewAt};
use ffgs_metrics::{Seen, flicker};

/// A photograph and the render of it.
type Pair = [ImageRgb8; 2];

fn seen([photograph, render]: &Pair) -> Seen<'_> {
    Seen { photograph, render }
}

/// Measures the rendered test views of a run, and notes the scores in the records, which are those of its frames.
///
/// # Errors
/// When a picture cannot be read, or the program that finds VMAF fails.
pub(crate) fn score_videos(
    run: &FinishedRun,
    vmaf: Option<&Vmaf>,
    records: &mut [FrameRecord],
) -> Result<()> {
    for (view, camera) in run.capture.views(Split::Test).iter().enumerate() {
        score_video(run, vmaf, records, view)
            .with_context(|| format!("the video of test camera {camera}"))?;
    }
    Ok(())
}

fn score_video(
    run: &FinishedRun,
    vmaf: Option<&Vmaf>,
    records: &mut [FrameRecord],
    view: usize,
) -> Result<()> {
    let mut video = None;
    let mut before: Option<(usize, Pair)> = None;
    for record in &mut *records {
        let now = load(run, record.frame, view)?;
        if let (None, Some(vmaf)) = (&video, vmaf) {
            video = Some(vmaf.video(now[0].size(), &run.folder.0)?);
        }
        if let Some(video) = &mut video {
            video.push(&now[0], &now[1])?;
        }
        let before_it = before.as_ref().filter(|(frame, _)| frame + 1 == record.frame);
        record.views[view].flicker =
            before_it.map(|(_, before)| flicker(seen(before), seen(&now))).transpose()?;
        before = Some((record.frame, now));
    }
    let Some(video) = video else { return Ok(()) };
    let scores = video.finish()?;
    ensure!(scores.len() == records.len(), "{} frames, {} scores of VMAF", records.len(), scores.len());
    records.iter_mut().zip(scores).for_each(|(record, score)| record.views[view].vmaf = Some(score));
    Ok(())
}

fn load(run: &FinishedRun, frame: usize, view: usize) -> Result<Pair> {
    let photograph = load_view(&*run.capture, ViewAt { split: Split::Test, view, frame })?.image;
    let camera = &run.capture.views(Split::Test)[view];
    let render = read_image(&run.folder.frame(frame).join(format!("test/{camera}.png")), photograph.size())?;
    Ok([photograph, render])
}
