//! `ffgs eval`: measures a finished run again.

pub(crate) mod video;
pub(crate) mod vmaf;

use crate::cli::args::EvalArgs;
use crate::cli::terminal::{self, progress};
use crate::commands::eval::video::score_videos;
use crate::commands::eval::vmaf::Vmaf;
use crate::job::lock::FolderLock;
use crate::outputs::finished_run::FinishedRun;
use crate::outputs::json::{read_json, write_json};
use crate::outputs::publish::publish;
use crate::outputs::record::{FrameRecord, Mean, Metrics, ViewMetrics, after_first};
use crate::outputs::scoring::{load_tests, score};
use anyhow::{Result, anyhow, bail};
use ffgs_core::counted;
use ffgs_method::Split;
use ffgs_reconstruction::Devices;
use ffgs_report::FramePictures;

/// Renders and measures the test views of every finished frame and the videos that they make, and writes metrics and report
/// again.
///
/// # Errors
/// When the run or its capture cannot be read, a result cannot be written, or ffmpeg fails.
pub(crate) fn eval(args: &EvalArgs) -> Result<()> {
    if FinishedRun::open(&args.run)?.capture.views(Split::Test).is_empty() {
        terminal::print(
            "the capture has no test views to measure: mean_training_views in metrics.json is of views that were trained on",
        );
        return Ok(());
    }
    let (metrics, no_vmaf) = measure(args)?;
    let reason = no_vmaf.map(|reason| format!("no VMAF: {reason}\n")).unwrap_or_default();
    terminal::print((table(&metrics.frames) + &costs(&metrics.mean) + &reason).trim_end());
    Ok(())
}

/// Whether VMAF can be found here.
pub fn has_vmaf() -> bool {
    Vmaf::find().is_ok()
}

/// Renders and measures as `ffgs eval`, and prints nothing: the metrics, and why there is no VMAF where there is none.
///
/// # Errors
/// When the run or its capture cannot be read, a result cannot be written, or ffmpeg fails.
pub fn measure(args: &EvalArgs) -> Result<(Metrics, Option<String>)> {
    let run = FinishedRun::open(&args.run)?;
    let (capture, folder) = (&*run.capture, &run.folder);
    if capture.views(Split::Test).is_empty() {
        bail!(
            "{} has no test views to measure; training_views in metrics.json are figures of views that were trained on",
            capture.root().display()
        );
    }
    let _lock = FolderLock::take(&args.run)?;
    let bar = progress(args.log.quiet, "frames", run.frames.len());
    let gpus = args.device.open()?;
    let vmaf = match () {
        () if args.no_vmaf => Err(anyhow!("left out by --no-vmaf")),
        () if !run.thinned.is_empty() => {
            let frames = counted(run.thinned.len(), "frame");
            Err(anyhow!("the pictures of {frames} were not kept (--keep of the run)"))
        }
        () => Vmaf::find(),
    };
    let mut records = Vec::new();
    for &frame in &run.frames {
        let mut record = run.record(frame)?;
        let (tests, _) = load_tests(capture, &run.exposures(frame)?, frame)?;
        let scene = run.scene(frame)?;
        let file = folder.pictures(frame);
        let mut pictures = if file.exists() { read_json(&file)? } else { FramePictures::default() };
        (record.views, pictures.views) = score(
            capture,
            &scene,
            (&tests, &run.trained_cameras(frame)?),
            &folder.frame(frame),
            Devices(&gpus),
        )?;
        write_json(&file, &pictures)?;
        records.push(record);
        bar.inc(1);
    }
    if run.thinned.is_empty() {
        score_videos(&run, vmaf.as_ref().ok(), &mut records)?;
    }
    for record in &records {
        write_json(&folder.record(record.frame), record)?;
    }
    bar.finish_and_clear();
    for &frame in &run.thinned {
        records.push(run.record(frame)?);
    }
    records.sort_by_key(|record| record.frame);
    let metrics = Metrics::of(records);
    publish(folder, &run.manifest, &metrics)?;
    Ok((metrics, vmaf.err().map(|reason| reason.to_string())))
}

/// One row per frame, then the mean over all views of all frames, and over those of the frames after the run's first, as in metrics.json.
fn table(records: &[FrameRecord]) -> String {
    let titles = ["PSNR", "MPSNR", "SSIM", "VMAF", "flicker", "MSSIM", "MVMAF", "mflicker"];
    let titles = titles.map(|title| format!("  {title:>8}")).concat();
    let mut text = format!("{:>10}{titles}\n", "frame");
    for record in records {
        text += &row(&record.frame.to_string(), &record.views.iter().collect::<Vec<_>>());
    }
    text += &row("mean", &records.iter().flat_map(|r| &r.views).collect::<Vec<_>>());
    let later = after_first(records);
    if !later.is_empty() {
        text += &row("mean later", &later.iter().flat_map(|r| &r.views).collect::<Vec<_>>());
    }
    text
}

fn row(name: &str, views: &[&ViewMetrics]) -> String {
    let mean = |of: fn(&ViewMetrics) -> Option<f64>, digits: usize| {
        let values: Vec<f64> = views.iter().filter_map(|v| of(v)).collect();
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        if values.is_empty() { "-".to_owned() } else { format!("{mean:.digits$}") }
    };
    let cells = [
        mean(|v| Some(v.psnr), 2),
        mean(|v| v.mpsnr, 2),
        mean(|v| Some(v.ssim), 4),
        mean(|v| v.vmaf, 2),
        mean(|v| v.flicker, 3),
        mean(|v| v.mssim, 4),
        mean(|v| v.mvmaf, 2),
        mean(|v| v.mflicker, 3),
    ];
    format!("{name:>10}{}\n", cells.map(|cell| format!("  {cell:>8}")).concat())
}

/// What the frames after the first cost, and the paper's efficiencies.
fn costs(mean: &Mean) -> String {
    let text =
        |value: Option<f64>, scale: f64| value.map_or("-".into(), |value| format!("{:.2}", value * scale));
    format!(
        "{} s per frame; PSNR / s (PE) {}, VMAF / s (VE) {}; {} MB per frame, {} with the first\n",
        text(mean.seconds_per_frame, 1.0),
        text(mean.psnr_per_second, 1.0),
        text(mean.vmaf_per_second, 1.0),
        text(mean.bytes_per_frame, 1e-6),
        text(mean.bytes_per_frame_with_first, 1e-6),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_has_frames_and_means() {
        let view = |psnr, mpsnr| ViewMetrics { psnr, mpsnr, ssim: 0.5, ..ViewMetrics::default() };
        let whole = ViewMetrics { vmaf: Some(80.0), flicker: Some(1.5), ..view(30.0, Some(10.0)) };
        let later = ViewMetrics { mssim: Some(0.25), mvmaf: Some(60.0), mflicker: Some(4.5), ..whole };
        let of = |frame, views| FrameRecord { frame, views, ..FrameRecord::default() };
        let text = table(&[of(0, vec![view(20.0, None)]), of(1, vec![later.clone()])]);
        let begun_later = table(&[of(5, vec![view(20.0, None)]), of(6, vec![later])]);
        assert_eq!(
            begun_later.lines().last(),
            text.lines().last(),
            "the run's first frame, whatever its number"
        );
        let words: Vec<Vec<&str>> = text.lines().map(|l| l.split_whitespace().collect()).collect();
        assert_eq!(words[1], ["0", "20.00", "-", "0.5000", "-", "-", "-", "-", "-"]);
        let masked = ["0.2500", "60.00", "4.500"];
        assert_eq!(words[3][..6], ["mean", "25.00", "10.00", "0.5000", "80.00", "1.500"]);
        assert_eq!(words[4][..7], ["mean", "later", "30.00", "10.00", "0.5000", "80.00", "1.500"]);
        assert_eq!((&words[3][6..], &words[4][7..]), (&masked[..], &masked[..]));
    }
}
