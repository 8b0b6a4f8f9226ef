//! `cargo xtask bench`: times everything on the CPU and compares it with what the machine can do at best.
//!
//! `--scaling` measures instead how time and peak memory grow.

mod floor;
mod gpu;
mod paper;
mod results;

use crate::{ffgs, workspace};
use anyhow::{Context, Result, ensure};
use clap::Args;
use floor::{Counts, Rates};
use results::{Case, Work};
use serde_json::Value;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::SystemTime;

/// What to time.
#[derive(Args, Clone, Debug, Default)]
pub(crate) struct Options {
    /// A regular expression; only cases whose names match. The table is printed and not saved then.
    filter: Option<String>,
    /// A short pass: fewer and shorter samples.
    #[arg(long)]
    quick: bool,
    /// A finished run whose frames' times are added to the table.
    #[arg(long, value_name = "DIR")]
    run: Option<PathBuf>,
    /// Where: cpu, gpu or gpu:N. On a GPU a pass replaces docs/bench/gpu.csv (docs/bench/gpu.md).
    #[arg(long, default_value = "cpu", conflicts_with_all = ["filter", "run"])]
    device: gpu::Device,
    #[command(flatten)]
    cases: gpu::Cases,
    /// Time nothing: make the whole table from what filtered passes left.
    #[arg(long, conflicts_with = "filter")]
    collect: bool,
    /// How time and peak memory grow with Gaussians, pixels, views and foreground; a word after it selects cases.
    #[arg(long)]
    scaling: bool,
    #[command(flatten)]
    paper: paper::PaperOptions,
}

/// Where the table of a whole pass is kept.
const TABLE: &str = "docs/bench/cpu.csv";
/// That of `--scaling`.
const SCALING: &str = "docs/bench/scaling.csv";
/// The package of all benchmarks.
const PACKAGE: &str = "ffgs-bench";
/// Those of what is timed on the CPU.
const BENCHES: [&str; 2] = ["cpu", "trackers"];
/// Counts of the rendered scenes, written by the benchmark beside criterion's own files.
const COUNTS: &str = "counts.csv";

/// Runs the benchmarks, prints the table and saves it after a whole pass.
pub(crate) fn run(root: &Path, options: &Options) -> Result<()> {
    if let gpu::Device::Gpu(adapter) = options.device {
        let origin = format!("host: {}; commit {}", machine(), commit(root));
        return gpu::run(root, adapter, options.quick, &options.cases, &origin);
    }
    if options.paper.paper || options.paper.upscaled.is_some() {
        let heading = format!("# {}; commit {}", machine(), commit(root));
        return paper::run(root, &options.paper, &heading);
    }
    if options.scaling {
        return scaling(root, options);
    }
    let start = if options.collect { SystemTime::UNIX_EPOCH } else { SystemTime::now() };
    if !options.collect {
        measure(root, options)?;
    }
    let folder = workspace::target(root).join("criterion");
    let cases = results::read(&folder, start)?;
    ensure!(!cases.is_empty(), "no case matches");
    let (rates, counts) = (Rates::of(&cases), floor::read_counts(&folder.join(COUNTS)));
    let mut rows: Vec<Row> = cases.iter().map(|case| Row::new(case, &rates, &counts)).collect();
    rows.extend(frames(&options.run.clone().unwrap_or_else(|| ffgs::default_out(root, ffgs::SAMPLE))));
    println!("\n{}", table(&rows));
    if options.filter.is_none() {
        let path = root.join(TABLE);
        std::fs::create_dir_all(path.parent().context("a folder")?)?;
        std::fs::write(&path, csv(root, options, &rows)).with_context(|| format!("cannot write {TABLE}"))?;
        println!("saved: {TABLE}");
    }
    Ok(())
}

fn measure(root: &Path, options: &Options) -> Result<()> {
    BENCHES.iter().try_for_each(|bench| measure_one(root, options, bench))
}

fn measure_one(root: &Path, options: &Options, bench: &str) -> Result<()> {
    let mut command = workspace::cargo(root);
    command.args(["bench", "-p", PACKAGE, "--bench", bench, "--", "--noplot"]);
    if options.quick {
        command.args(["--warm-up-time", "0.1", "--measurement-time", "0.3", "--sample-size", "10"]);
    }
    if let Some(filter) = &options.filter {
        command.arg(format!("machine|{filter}"));
    }
    command.env("CRITERION_HOME", workspace::target(root).join("criterion"));
    let status = command.status().context("cannot start cargo")?;
    ensure!(status.success(), "the benchmarks failed");
    Ok(())
}

/// Runs the scaling cases, prints their table and saves it when it is whole.
fn scaling(root: &Path, options: &Options) -> Result<()> {
    let mut command = workspace::cargo(root);
    command.args(["bench", "-p", PACKAGE, "--bench", "scaling", "--"]).args(&options.filter);
    let output = command.stderr(Stdio::inherit()).output().context("cannot start cargo")?;
    ensure!(output.status.success(), "the benchmark failed");
    let table = String::from_utf8(output.stdout).context("the table is not text")?;
    print!("{table}");
    if options.filter.is_none() {
        let text = format!("# {}; commit {}\n{table}", machine(), commit(root));
        std::fs::write(root.join(SCALING), text).with_context(|| format!("cannot write {SCALING}"))?;
        println!("saved: {SCALING}");
    }
    Ok(())
}

/// One line of the table.
#[derive(Debug, PartialEq)]
struct Row {
    name: String,
    seconds: f64,
    work: Option<Work>,
    floor: Option<f64>,
}

impl Row {
    fn new(case: &Case, rates: &Rates, counts: &BTreeMap<String, Counts>) -> Self {
        let floor = floor::seconds(case, rates, counts);
        Self { name: case.name.clone(), seconds: case.seconds, work: Some(case.work), floor }
    }

    /// Time over floor.
    fn ratio(&self) -> Option<f64> {
        self.floor.map(|floor| self.seconds / floor)
    }
}

/// Wall clock of frame 0 and means over streamed frames of a finished run, where there is one.
fn frames(run: &Path) -> Vec<Row> {
    let Ok(text) = std::fs::read_to_string(run.join("metrics.json")) else { return Vec::new() };
    let metrics: Value = serde_json::from_str(&text).unwrap_or_default();
    let all = metrics["frames"].as_array().map_or(&[][..], Vec::as_slice);
    let Some((first, later)) = all.split_first() else { return Vec::new() };
    let row =
        |name: &str, seconds: f64| Row { name: format!("frame/{name}"), seconds, work: None, floor: None };
    let mut rows: Vec<Row> = first["seconds"]["wall"].as_f64().map(|s| row("first", s)).into_iter().collect();
    for (name, key) in [("streamed", "wall"), ("streamed/dynamic", "dynamic"), ("streamed/static", "static")]
    {
        let seconds: Vec<f64> = later.iter().filter_map(|f| f["seconds"][key].as_f64()).collect();
        if !seconds.is_empty() {
            rows.push(row(name, seconds.iter().sum::<f64>() / seconds.len() as f64));
        }
    }
    rows
}

fn table(rows: &[Row]) -> String {
    let mut out = format!("{:<34} {:>12} {:>16} {:>12} {:>8}", "case", "time", "work", "floor", "ratio");
    for row in rows {
        let time = |seconds: f64| format!("{:.3} ms", seconds * 1e3);
        let work = row.work.map_or_else(String::new, |w| w.to_string());
        let ratio = row.ratio().map_or_else(String::new, |r| format!("{r:.1}"));
        let floor = row.floor.map_or_else(String::new, time);
        let _ = write!(out, "\n{:<34} {:>12} {work:>16} {floor:>12} {ratio:>8}", row.name, time(row.seconds));
    }
    out
}

fn csv(root: &Path, options: &Options, rows: &[Row]) -> String {
    let pass = if options.quick { "quick" } else { "whole" };
    let mut out = format!("# {}; commit {}; {pass} pass\n", machine(), commit(root));
    out.push_str("name,seconds,work,unit,floor_seconds,ratio\n");
    for row in rows {
        let number = |value: Option<f64>| value.map_or_else(String::new, |v| format!("{v:.6e}"));
        let (amount, unit) = (row.work.map(Work::amount), row.work.map_or("", Work::unit));
        let ratio = row.ratio().map_or_else(String::new, |r| format!("{r:.2}"));
        let (amount, floor) = (number(amount), number(row.floor));
        let _ = writeln!(out, "{},{:.6e},{amount},{unit},{floor},{ratio}", row.name, row.seconds);
    }
    out
}

/// Processor and its threads.
fn machine() -> String {
    let info = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let model = info.lines().find(|l| l.starts_with("model name")).and_then(|l| l.split(": ").nth(1));
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    format!("{}, {threads} threads, {}", model.unwrap_or(std::env::consts::ARCH), std::env::consts::OS)
}

/// Short hash, with a plus where files differ from it.
fn commit(root: &Path) -> String {
    let git = |args: &[&str]| Command::new("git").args(args).current_dir(root).output().ok();
    let text = |output: std::process::Output| String::from_utf8_lossy(&output.stdout).trim().to_owned();
    let hash = git(&["rev-parse", "--short", "HEAD"]).map(text).unwrap_or_default();
    let changed = git(&["status", "--porcelain", "--untracked-files=no"]).map(text).unwrap_or_default();
    if changed.is_empty() { hash } else { hash + "+" }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_come_from_the_metrics_of_a_run() {
        let folder = tempfile::tempdir().unwrap();
        let text = r#"{"frames": [{"seconds": {"wall": 40.0}}, {"seconds": {"wall": 3.0, "dynamic": 2.0}},
            {"seconds": {"wall": 5.0, "dynamic": null}}]}"#;
        std::fs::write(folder.path().join("metrics.json"), text).unwrap();
        let rows = frames(folder.path());
        let found: Vec<_> = rows.iter().map(|r| (r.name.as_str(), r.seconds)).collect();
        assert_eq!(found, [("frame/first", 40.0), ("frame/streamed", 4.0), ("frame/streamed/dynamic", 2.0)]);
        assert!(frames(&folder.path().join("none")).is_empty());
    }
}
