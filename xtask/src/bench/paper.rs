//! `--paper`: a capture of the paper's size, or an enlarged one, through the whole program.

use crate::{ffgs, workspace};
use anyhow::{Context, Result, ensure};
use clap::Args;
use serde_json::Value;
use std::collections::BTreeMap;
use std::ffi::{OsStr, OsString};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Where the tables are kept.
const TABLE: &str = "docs/bench/paper.csv";
/// Steps of the first frame that are timed.
const FIRST_STEPS: &str = "20";

/// What to run.
#[derive(Args, Clone, Debug, Default)]
pub(crate) struct PaperOptions {
    /// 60 views of 1920x1080, 1 M static and 200 k dynamic Gaussians: seconds of every stage, memory and bytes read. Needs
    /// 6 GB of disk, 24 GB of memory and about an hour
    #[arg(long)]
    pub(super) paper: bool,
    /// With --paper: factor on views, width and height; its square is that on Gaussians
    #[arg(long, value_name = "S", default_value = "1", requires = "paper")]
    scale: String,
    /// The quick stand-in: this capture enlarged six times
    #[arg(long, value_name = "CAPTURE")]
    pub(super) upscaled: Option<PathBuf>,
    /// With --paper or --upscaled: frames, the first with them
    #[arg(long, value_name = "N", default_value_t = 3)]
    frames: usize,
    /// With --paper or --upscaled: folder of captures and runs; what is there is used again [default: target/bench]
    #[arg(long, value_name = "DIR")]
    place: Option<PathBuf>,
    /// With --paper or --upscaled: options handed on to `ffgs run`, as one word
    #[arg(long, value_name = "OPTIONS", allow_hyphen_values = true)]
    run_options: Option<String>,
}

/// Runs the benchmark, prints the table and, where `saved` is given, keeps it under that heading.
pub(super) fn run(root: &Path, options: &PaperOptions, heading: &str) -> Result<()> {
    let place = options.place.clone().unwrap_or_else(|| workspace::target(root).join("bench"));
    let rows = match &options.upscaled {
        Some(capture) => upscaled(root, &place, capture, options)?,
        None => paper(root, &place, options)?,
    };
    print!("{}", table(&rows));
    if options.paper && options.scale == "1" {
        std::fs::write(root.join(TABLE), csv(heading, &rows))
            .with_context(|| format!("cannot write {TABLE}"))?;
        println!("saved: {TABLE}");
    }
    Ok(())
}

/// A few steps of the first frame in one process, then frames that start from the truth in another.
fn paper(root: &Path, place: &Path, options: &PaperOptions) -> Result<Vec<Row>> {
    let folder = place.join(format!("paper-{}-{}", options.scale, options.frames));
    let capture = folder.join("capture");
    if !folder.join("first/run.json").is_file() {
        let mut lab = Command::new(ffgs::build_lab(root)?);
        lab.args(["synthetic", "--scale", &options.scale, "--frames", &options.frames.to_string(), "--out"]);
        finish(lab.arg(&folder))?;
    }
    let steps = ["--frames", "0..1", "--first-iterations", FIRST_STEPS];
    let first = ffgs_run(root, &capture, &folder.join("few-steps"), &steps, options)?;
    let from_truth = [OsString::from("--first-frame"), folder.join("first").into_os_string()];
    let later = ffgs_run(root, &capture, &folder.join("run"), &from_truth, options)?;
    Ok([rows(&first, &format!("frame 0, {FIRST_STEPS} steps")), rows(&later[1..], "a later frame")].concat())
}

fn upscaled(root: &Path, place: &Path, capture: &Path, options: &PaperOptions) -> Result<Vec<Row>> {
    let name = capture.file_name().context("--upscaled: a folder with a name")?.to_string_lossy();
    let folder = place.join(format!("{name}-x6-{}", options.frames));
    let large = folder.join("capture");
    if !large.join("train_meta.json").is_file() {
        let mut lab = Command::new(ffgs::build_lab(root)?);
        lab.arg("enlarge").arg(capture).args(["--frames", &options.frames.to_string(), "--out"]);
        finish(lab.arg(&large))?;
    }
    let frames = ffgs_run(root, &large, &folder.join("run"), &[] as &[&str], options)?;
    Ok([rows(&frames[..1], "frame 0"), rows(&frames[1..], "a later frame")].concat())
}

/// Starts a program and waits.
fn finish(command: &mut Command) -> Result<()> {
    let status = command.status().with_context(|| format!("cannot start {command:?}"))?;
    ensure!(status.success(), "{command:?} failed");
    Ok(())
}

/// Runs the program on a capture into a new folder; the records of its frames.
fn ffgs_run(
    root: &Path,
    capture: &Path,
    out: &Path,
    words: &[impl AsRef<OsStr>],
    options: &PaperOptions,
) -> Result<Vec<Value>> {
    if out.exists() {
        std::fs::remove_dir_all(out).with_context(|| format!("cannot remove {}", out.display()))?;
    }
    let mut command = Command::new(ffgs::build(root)?);
    command.arg("run").arg(capture).arg("--out").arg(out).args(words).args(["--device", "cpu"]);
    command.args(options.run_options.iter().flat_map(|all| all.split_whitespace()));
    finish(&mut command)?;
    let text = std::fs::read_to_string(out.join("metrics.json"))?;
    let metrics: Value = serde_json::from_str(&text)?;
    let frames = metrics["frames"].as_array().cloned().unwrap_or_default();
    ensure!(!frames.is_empty(), "{} has no frames", out.display());
    Ok(frames)
}

/// A figure of one part.
#[derive(Clone, Debug, PartialEq)]
struct Row {
    part: String,
    what: String,
    value: f64,
    unit: &'static str,
}

/// Means over frames of seconds, and what the process had used after the last of them.
fn rows(frames: &[Value], part: &str) -> Vec<Row> {
    let mut seconds: BTreeMap<&str, Vec<f64>> = BTreeMap::new();
    for (stage, value) in frames.iter().flat_map(|f| f["seconds"].as_object().into_iter().flatten()) {
        seconds.entry(stage.as_str()).or_default().extend(value.as_f64());
    }
    let row = |what: &str, value, unit| Row { part: part.to_owned(), what: what.to_owned(), value, unit };
    let mut rows: Vec<Row> = seconds
        .iter()
        .map(|(stage, values)| row(stage, values.iter().sum::<f64>() / values.len() as f64, "s"))
        .collect();
    rows.sort_by(|a, b| b.value.total_cmp(&a.value));
    let last = frames.last();
    let figures = [
        ("PSNR", "psnr", "dB"),
        ("process: peak memory", "peak_memory_mib", "MiB"),
        ("process: read", "read_mib", "MiB"),
        ("process: processors", "processor_seconds", "s"),
        ("static Gaussians", "static_gaussians", ""),
        ("dynamic Gaussians", "dynamic_gaussians", ""),
    ];
    for (what, key, unit) in figures {
        let value = last.and_then(|frame| match key {
            "psnr" => mean_of_views(frame, key),
            _ => frame[key].as_f64(),
        });
        rows.extend(value.map(|value| row(what, value, unit)));
    }
    rows
}

fn mean_of_views(frame: &Value, key: &str) -> Option<f64> {
    let views = frame["views"].as_array()?;
    let values: Vec<f64> = views.iter().filter_map(|view| view[key].as_f64()).collect();
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

fn table(rows: &[Row]) -> String {
    let mut out = String::new();
    for Row { part, what, value, unit } in rows {
        let _ = writeln!(out, "{part:<20} {what:<24} {value:>14.3} {unit}");
    }
    out
}

fn csv(heading: &str, rows: &[Row]) -> String {
    let mut out = format!("{heading}\npart,what,value,unit\n");
    for Row { part, what, value, unit } in rows {
        let _ = writeln!(out, "\"{part}\",{what},{value:.6e},{unit}");
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn seconds_are_means_and_what_was_used_is_the_last_frames() {
        let frame = |wall: f64, peak: f64| {
            json!({"seconds": {"wall": wall, "load": 1.0}, "peak_memory_mib": peak,
            "views": [{"psnr": 20.0}, {"psnr": 30.0}]})
        };
        let rows = rows(&[frame(4.0, 100.0), frame(8.0, 300.0)], "later");
        let found: Vec<_> = rows.iter().map(|r| (r.what.as_str(), r.value, r.unit)).collect();
        let expected = [
            ("wall", 6.0, "s"),
            ("load", 1.0, "s"),
            ("PSNR", 25.0, "dB"),
            ("process: peak memory", 300.0, "MiB"),
        ];
        assert_eq!(found, expected);
        assert!(
            csv("# here", &rows).starts_with("# here\npart,what,value,unit\n\"later\",wall,6.000000e0,s\n")
        );
    }
}
