//! Metrics of a test view's video, its frames in time order: VMAF and flicker.

use crate::commands::eval::vmaf::{Video, Vmaf};
use crate::job::frame::load_view;
use crate::outputs::finished_run::FinishedRun;
use crate::outputs::record::FrameRecord;
use anyhow::{Context, Result, ensure};
use ffgs_core::{ImageRgb8, Mask};
use ffgs_dataset::read_image;
use ffgs_method::{Split, ViewAt};
use ffgs_metrics::{Seen, flicker, masked_flicker};

/// A photograph, the render of it, and the foreground.
struct Shot {
    photograph: ImageRgb8,
    render: ImageRgb8,
    mask: Mask,
}

impl Shot {
    fn load(run: &FinishedRun, frame: usize, view: usize) -> Result<Self> {
        let truth = load_view(&*run.capture, ViewAt { split: Split::Test, view, frame })?;
        let camera = &run.capture.views(Split::Test)[view];
        let file = run.folder.frame(frame).join(format!("test/{camera}.png"));
        let render = read_image(&file, truth.image.size())?;
        Ok(Self { photograph: truth.image, render, mask: truth.mask })
    }

    fn seen(&self) -> Seen<'_> {
        Seen { photograph: &self.photograph, render: &self.render }
    }

    /// The render before the photograph's own background, so that only the foreground can differ.
    fn foreground(&self) -> Result<ImageRgb8> {
        let mut data = self.photograph.data().to_vec();
        let pixels = data.chunks_exact_mut(3).zip(self.render.data().chunks_exact(3)).zip(self.mask.data());
        pixels.filter(|(_, inside)| **inside != 0).for_each(|((out, render), _)| out.copy_from_slice(render));
        ImageRgb8::new(self.photograph.size(), data).context("a picture of the photograph's size")
    }
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
    let mut videos: Option<[Video; 2]> = None;
    let mut masked = false;
    let mut before: Option<(usize, Shot)> = None;
    for record in &mut *records {
        let now = Shot::load(run, record.frame, view)?;
        if let (None, Some(vmaf)) = (&videos, vmaf) {
            let video = |name| vmaf.video(name, now.photograph.size(), &run.folder.0);
            videos = Some([video("whole")?, video("foreground")?]);
        }
        if let Some([whole, foreground]) = &mut videos {
            whole.push(&now.photograph, &now.render)?;
            foreground.push(&now.photograph, &now.foreground()?)?;
        }
        masked |= now.mask.count() > 0;
        let last =
            before.as_ref().filter(|(frame, _)| frame + 1 == record.frame).map(|(_, shot)| shot.seen());
        let metrics = &mut record.views[view];
        metrics.flicker = last.map(|last| flicker(last, now.seen())).transpose()?;
        metrics.mflicker =
            last.map(|last| masked_flicker(last, now.seen(), &now.mask)).transpose()?.flatten();
        before = Some((record.frame, now));
    }
    let Some([whole, foreground]) = videos else { return Ok(()) };
    let (whole, foreground) = (whole.finish()?, foreground.finish()?);
    for scores in [&whole, &foreground] {
        ensure!(scores.len() == records.len(), "{} frames, {} scores of VMAF", records.len(), scores.len());
    }
    for (record, (whole, foreground)) in records.iter_mut().zip(whole.into_iter().zip(foreground)) {
        record.views[view].vmaf = Some(whole);
        record.views[view].mvmaf = masked.then_some(foreground);
    }
    Ok(())
}
