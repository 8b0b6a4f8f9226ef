//! The page itself: the template filled in, and the pictures of all frames copied behind it.

use crate::motion_plots::motion_plots;
use crate::plot::{Series, over_frames};
use crate::timing::{Row, mean, rows};
use crate::{FrameReport, ReportError, ReportInput, ViewReport, picture};
use ffgs_core::{read_text, stage, write_atomically};
use minijinja::Environment;
use serde::Serialize;
use std::collections::BTreeSet;
use std::io::Write;
use std::path::Path;

const TEMPLATE: &str = include_str!("../templates/report.html");
pub(crate) const STYLE: &str = include_str!("../templates/style.css");
/// The pictures of a frame are bounded in sum when they are encoded, far below.
const MAX_PICTURES_BYTES: u64 = 1 << 28;
const SCRIPT: &str = include_str!("../templates/script.js");

#[derive(Serialize)]
struct Headline {
    label: String,
    value: String,
    unit: &'static str,
}

#[derive(Serialize)]
struct Page<'a> {
    input: &'a ReportInput,
    style: &'static str,
    script: &'static str,
    headlines: Vec<Headline>,
    /// What the reader should know before the figures.
    foremost: Vec<String>,
    /// Warnings that only the list of all has.
    more_warnings: usize,
    plots: Vec<String>,
    motion_plots: Vec<String>,
    timing: Vec<Row>,
    error_range: f64,
    /// Whether any frame has views to be shown.
    has_views: bool,
    /// Whether any camera is held out.
    has_test_views: bool,
}

/// Where the pictures go: [`write_report`] copies them into the rendered template as they are.
const PICTURES: &str = "<!-- pictures -->";

/// Writes the self-contained `report.html`, atomically. The pictures of each frame are copied from its file, so that a
/// report that is written after every frame encodes none of them again.
///
/// # Errors
/// [`ReportError::Pictures`] names a file that cannot be read, [`ReportError::Io`] is about the report itself.
pub fn write_report(path: &Path, input: &ReportInput) -> Result<(), ReportError> {
    let html = render(input)?;
    let (head, tail) = html.split_once(PICTURES).unwrap_or((&html, ""));
    write_atomically(path, |out| {
        out.write_all(head.as_bytes())?;
        for frame in &input.frames {
            embed(frame.pictures.as_deref(), &format!("pictures-{}", frame.index), out)?;
        }
        embed(input.turntable.as_deref(), "turntable-data", out)?;
        embed(input.cameras.as_deref(), "cameras-data", out)?;
        Ok(out.write_all(tail.as_bytes())?)
    })
}

fn render(input: &ReportInput) -> Result<String, ReportError> {
    let has_views = input.frames.iter().any(|frame| !frame.views.is_empty());
    let page = Page {
        input,
        style: STYLE,
        script: SCRIPT,
        headlines: headlines(input),
        foremost: foremost(input),
        more_warnings: input.warnings.len().saturating_sub(FOREMOST),
        plots: plots(input),
        motion_plots: motion_plots(&input.motion),
        timing: rows(&input.frames),
        error_range: picture::ERROR_RANGE,
        has_views,
        has_test_views: has_views && !input.trained_on,
    };
    let mut environment = Environment::new();
    environment.add_template("report.html", TEMPLATE)?;
    Ok(environment.get_template("report.html")?.render(minijinja::value::Serde(&page))?)
}

/// Warnings above the figures; the first frame's come first, which are of the whole scene.
const FOREMOST: usize = 3;

/// That nothing moves, where that is so, and the first warnings.
fn foremost(input: &ReportInput) -> Vec<String> {
    let still = input.frames.len() > 1 && input.frames.iter().all(|frame| frame.dynamic_gaussians == 0);
    let still = still.then(|| {
        "No Gaussian moves in any frame: the scene was taken for static, as the masks mark nothing, or there are none. If something moves in it, \
         look at the masks with `ffgs check CAPTURE --pictures DIR`, and make others."
            .to_owned()
    });
    still.into_iter().chain(input.warnings.iter().take(FOREMOST).cloned()).collect()
}

/// A file of pictures as a block of data, which the script parses when they are shown.
fn embed(path: Option<&Path>, id: &str, out: &mut impl Write) -> Result<(), ReportError> {
    let Some(path) = path else { return Ok(()) };
    let text = read_text(path, MAX_PICTURES_BYTES)
        .map_err(|source| ReportError::Pictures { path: path.to_owned(), source })?;
    // The folder may come from someone else: a `<` of their text must not end the block. In JSON it stands in strings only.
    let text = text.replace('<', "\\u003c");
    Ok(writeln!(out, "<script type=\"application/json\" id=\"{id}\">{text}</script>")?)
}

type Metric = fn(&ViewReport) -> Option<f64>;

fn mean_of(frame: &FrameReport, metric: Metric) -> Option<f64> {
    mean(&frame.views.iter().filter_map(metric).collect::<Vec<_>>())
}

/// Means over the frames after the first, as in `metrics.json`. What was not measured is left out: without test views there is no quality,
/// and that of videos comes with `ffgs eval`. Efficiencies are of test views alone.
fn headlines(input: &ReportInput) -> Vec<Headline> {
    let frames = &input.frames[..];
    let later = frames.get(1..).filter(|f| !f.is_empty()).unwrap_or(frames);
    let over =
        |f: &dyn Fn(&FrameReport) -> Option<f64>| mean(&later.iter().filter_map(f).collect::<Vec<_>>());
    let metric = |m: Metric| mean(&later.iter().flat_map(|f| &f.views).filter_map(m).collect::<Vec<_>>());
    let gaussians = over(&|f| Some((f.static_gaussians + f.dynamic_gaussians) as f64 / 1000.0));
    let megabytes = over(&|f| Some(f.bytes as f64 / 1e6));
    let seconds = over(&|f| f.seconds.get(stage::WALL).copied()).filter(|seconds| *seconds > 0.0);
    let (psnr, vmaf) = (metric(|v| v.psnr), metric(|v| v.vmaf));
    let seconds_of_quality = seconds.filter(|_| !input.trained_on);
    let per_second = |quality: Option<f64>| Some(quality? / seconds_of_quality?);
    let of_views = |name: &str| format!("{name}{}", of_views(input));
    let cost = str::to_owned;
    let values = [
        (of_views("PSNR"), psnr, 2, "dB"),
        (of_views("MPSNR (foreground)"), metric(|v| v.mpsnr), 2, "dB"),
        (of_views("SSIM"), metric(|v| v.ssim), 4, ""),
        (cost("Time per frame"), over(&|f| f.seconds.get(stage::WALL).copied()), 2, "s"),
        (cost("PSNR per second (PE)"), per_second(psnr), 2, "dB/s"),
        (cost("Gaussians"), gaussians, 1, "thousand"),
        (cost("On disk per frame"), megabytes, 2, "MB"),
        (cost("VMAF"), vmaf, 2, ""),
        (cost("VMAF per second (VE)"), per_second(vmaf), 2, "1/s"),
        (cost("Flicker"), metric(|v| v.flicker), 3, "levels"),
        (of_views("MSSIM (foreground)"), metric(|v| v.mssim), 4, ""),
        (cost("MVMAF (foreground)"), metric(|v| v.mvmaf), 2, ""),
        (cost("Flicker of the foreground"), metric(|v| v.mflicker), 3, "levels"),
    ];
    let headline = |(label, value, decimals, unit): (_, Option<f64>, usize, _)| {
        Some(Headline { label, value: format!("{:.decimals$}", value?), unit })
    };
    values.into_iter().filter_map(headline).collect()
}

/// Of which views a curve or a figure is, where that is not plain.
fn of_views(input: &ReportInput) -> &'static str {
    if input.trained_on { ", training views" } else { "" }
}

fn plots(input: &ReportInput) -> Vec<String> {
    let frames = &input.frames[..];
    let metrics: [(&str, Metric); 5] = [
        ("PSNR (dB)", |v| v.psnr),
        ("MPSNR (dB)", |v| v.mpsnr),
        ("SSIM", |v| v.ssim),
        ("VMAF", |v| v.vmaf),
        ("flicker (levels)", |v| v.flicker),
    ];
    let measured = |metric: Metric| frames.iter().flat_map(|f| &f.views).any(|view| metric(view).is_some());
    let mut out: Vec<String> = metrics
        .into_iter()
        .filter(|(_, metric)| measured(*metric))
        .map(|(label, metric)| {
            over_frames(&format!("{label}{}", of_views(input)), &metric_series(frames, metric))
        })
        .collect();
    let count = |name: &str, of: fn(&FrameReport) -> usize| {
        let points = frames.iter().map(|f| (f.index as f64, Some(of(f) as f64))).collect();
        Series { name: name.to_owned(), bold: false, points }
    };
    let counts = [count("static", |f| f.static_gaussians), count("dynamic", |f| f.dynamic_gaussians)];
    out.push(over_frames("Gaussians", &counts));
    out.extend(changes(frames));
    let grade = |name: &str, of: &dyn Fn(&FrameReport) -> Option<f64>| {
        let points = frames.iter().map(|f| (f.index as f64, of(f))).collect();
        Series { name: name.to_owned(), bold: false, points }
    };
    if frames.iter().any(|f| f.initial_mpsnr.is_some()) {
        let series = [
            grade("finetuned", &|f| mean_of(f, |v| v.mpsnr)),
            grade("initialisation alone", &|f| f.initial_mpsnr),
        ];
        out.push(over_frames("mean MPSNR (dB)", &series));
    }
    out
}

/// Gaussians that come, go or change their layer in each frame, by the reason; `None` where there are none.
fn changes(frames: &[FrameReport]) -> Option<String> {
    let reasons: BTreeSet<&String> = frames.iter().flat_map(|f| f.changes.keys()).collect();
    let count = |f: &FrameReport, reason: &String| f.changes.get(reason).copied().unwrap_or_default() as f64;
    let of_reason = |reason: &&String| Series {
        name: (*reason).clone(),
        bold: false,
        points: frames.iter().map(|f| (f.index as f64, Some(count(f, reason)))).collect(),
    };
    let series: Vec<Series> = reasons.iter().map(of_reason).collect();
    (!series.is_empty()).then(|| over_frames("Gaussians that change", &series))
}

/// The mean over views first, then each view (of all frames, in order of appearance).
fn metric_series(frames: &[FrameReport], metric: Metric) -> Vec<Series> {
    let points = |value: &dyn Fn(&FrameReport) -> Option<f64>| {
        frames.iter().map(|f| (f.index as f64, value(f))).collect::<Vec<_>>()
    };
    let mut names: Vec<&str> = Vec::new();
    for view in frames.iter().flat_map(|f| &f.views) {
        if !names.contains(&view.name.as_str()) {
            names.push(&view.name);
        }
    }
    let mean = Series { name: "mean".to_owned(), bold: true, points: points(&|f| mean_of(f, metric)) };
    let of_view = |name: &&str| Series {
        name: (*name).to_owned(),
        bold: false,
        points: points(&|f| f.views.iter().find(|v| v.name == *name).and_then(metric)),
    };
    std::iter::once(mean).chain(names.iter().map(of_view)).collect()
}
