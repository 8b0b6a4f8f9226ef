//! `cargo xtask bench --device gpu`: a training step on a GPU, kernel by kernel, beside the adapter's own rates.
//!
//! The share of a case is its least time at the measured rates of the adapter (memory traffic or multiply-adds,
//! whichever takes longer) over the time that it took.

use super::PACKAGE;
use crate::workspace;
use anyhow::{Context, Result, ensure};
use clap::Args;
use std::fmt::Write as _;
use std::path::Path;
use std::str::FromStr;

/// The cases on a GPU.
#[derive(Args, Clone, Debug, Default)]
pub(crate) struct Cases {
    /// With --device gpu: image sizes [default: 320x180,1280x720,1920x1080].
    #[arg(long, value_name = "WxH,WxH")]
    sizes: Option<String>,
    /// With --device gpu: numbers of Gaussians [default: 20000,200000,1000000].
    #[arg(long, value_name = "N,N")]
    counts: Option<String>,
    /// With --device gpu: foreground shares of the dynamic lane in percent [default: 1,5,20,50].
    #[arg(long, value_name = "P,P")]
    shares: Option<String>,
}

/// What to time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Device {
    #[default]
    Cpu,
    /// This adapter, or the best one.
    Gpu(Option<usize>),
}

impl FromStr for Device {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match (text, text.strip_prefix("gpu:").map(str::parse)) {
            ("cpu", _) => Ok(Self::Cpu),
            ("gpu", _) => Ok(Self::Gpu(None)),
            (_, Some(Ok(index))) => Ok(Self::Gpu(Some(index))),
            _ => Err("expected cpu, gpu or gpu:N".to_owned()),
        }
    }
}

/// Where the table is kept.
const TABLE: &str = "docs/bench/gpu.csv";

/// Times the cases, prints the table and saves it with what says where it is from.
pub(crate) fn run(
    root: &Path,
    adapter: Option<usize>,
    quick: bool,
    cases: &Cases,
    origin: &str,
) -> Result<()> {
    let raw = measure(root, adapter, quick, cases)?;
    let rows = parse(&raw)?;
    println!("\n{}", table(&rows));
    let head: Vec<&str> = raw.lines().filter(|line| line.starts_with('#')).collect();
    std::fs::write(root.join(TABLE), csv(&head.join("\n"), origin, &rows))
        .with_context(|| format!("cannot write {TABLE}"))?;
    println!("saved: {TABLE}");
    Ok(())
}

fn measure(root: &Path, adapter: Option<usize>, quick: bool, cases: &Cases) -> Result<String> {
    let out = workspace::target(root).join("bench-gpu.csv");
    let mut command = workspace::cargo(root);
    command.args(["bench", "-p", PACKAGE, "--bench", "gpu", "--", "--out"]).arg(&out);
    let adapter = adapter.map(|index| index.to_string());
    let samples = quick.then(|| "3".to_owned());
    let options = [
        ("--adapter", &adapter),
        ("--samples", &samples),
        ("--sizes", &cases.sizes),
        ("--counts", &cases.counts),
        ("--shares", &cases.shares),
    ];
    for (name, value) in options {
        if let Some(value) = value {
            command.args([name, value]);
        }
    }
    let status = command.status().context("cannot start cargo")?;
    ensure!(status.success(), "the benchmarks failed");
    std::fs::read_to_string(&out).with_context(|| format!("cannot read {}", out.display()))
}

/// One measured case, with its work where it is counted.
#[derive(Clone, Debug, PartialEq)]
struct Row {
    name: String,
    seconds: f64,
    /// Bytes and operations at least.
    work: Option<[f64; 2]>,
    /// Part of the measured ceiling that is reached.
    share: Option<f64>,
    /// Times as fast as the GPU, for cases of the CPU.
    ratio: Option<f64>,
}

/// Rows of the benchmark, with the shares of what the adapter can do and the CPU's ratios.
fn parse(text: &str) -> Result<Vec<Row>> {
    let lines = text.lines().filter(|line| !line.starts_with('#')).skip(1);
    let mut rows: Vec<Row> = lines.map(row).collect::<Result<_>>()?;
    let rate = |name: &str, which: usize| {
        rows.iter().find(|r| r.name == name).and_then(|r| Some(r.work?[which] / r.seconds))
    };
    let (copy, fma) = (rate("machine/copy", 0), rate("machine/fma", 1));
    let seconds = |name: &str| rows.iter().find(|r| r.name == name).map(|r| r.seconds);
    let ratios: Vec<Option<f64>> = rows
        .iter()
        .map(|r| Some(seconds(&format!("gpu/{}", r.name.strip_prefix("cpu/")?))? / r.seconds))
        .collect();
    for (row, ratio) in rows.iter_mut().zip(ratios) {
        row.ratio = ratio;
        if let (Some([bytes, operations]), Some(copy), Some(fma)) = (row.work, copy, fma) {
            row.share = Some((bytes / copy).max(operations / fma) / row.seconds);
        }
    }
    Ok(rows)
}

fn row(line: &str) -> Result<Row> {
    let fields: Vec<&str> = line.split(',').collect();
    let [name, seconds, bytes, operations] = fields[..] else { anyhow::bail!("not a row: {line}") };
    let work = match (bytes.parse(), operations.parse()) {
        (Ok(bytes), Ok(operations)) => Some([bytes, operations]),
        _ => None,
    };
    let seconds = seconds.parse().with_context(|| format!("no time: {line}"))?;
    Ok(Row { name: name.to_owned(), seconds, work, share: None, ratio: None })
}

fn table(rows: &[Row]) -> String {
    let mut out = format!("{:<48} {:>12} {:>11} {:>11} {:>8}", "case", "time", "MB", "M operations", "share");
    for row in rows {
        let [bytes, operations] =
            [0, 1].map(|k| row.work.map_or_else(String::new, |w| format!("{:.2}", w[k] / 1e6)));
        let share = row.share.map_or_else(String::new, |s| format!("{:.1} %", s * 100.0));
        let share = row.ratio.map_or(share, |r| format!("{r:.1} times as fast as the GPU"));
        let time = format!("{:.3} ms", row.seconds * 1e3);
        let _ = write!(out, "\n{:<48} {time:>12} {bytes:>11} {operations:>12} {share:>8}", row.name);
    }
    out
}

fn csv(head: &str, origin: &str, rows: &[Row]) -> String {
    let mut out = format!("{head}\n# {origin}\nname,seconds,bytes,operations,share,cpu_times_as_fast\n");
    for row in rows {
        let number = |value: Option<f64>| value.map_or_else(String::new, |v| format!("{v:.4}"));
        let [bytes, operations] =
            [0, 1].map(|k| row.work.map_or_else(String::new, |w| format!("{:.0}", w[k])));
        let (share, ratio) = (number(row.share), number(row.ratio));
        let _ = writeln!(out, "{},{:.6e},{bytes},{operations},{share},{ratio}", row.name, row.seconds);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    const RAW: &str = "# adapter\nname,seconds,bytes,operations\n\
        machine/copy,1.0,1000,0\nmachine/fma,2.0,0,4000\n\
        cpu/forward/a,0.5,,\ngpu/forward/a,2.0,1000,1000\nkernel/blend/a,1.0,100,1000\n";

    #[test]
    fn a_share_is_the_longer_of_both_floors_and_a_ratio_compares_with_the_cpu() {
        let rows = parse(RAW).unwrap();
        let shares: Vec<_> = rows.iter().map(|r| r.share).collect();
        assert_eq!(shares, [Some(1.0), Some(1.0), None, Some(0.5), Some(0.5)]);
        let ratios: Vec<_> = rows.iter().filter_map(|r| r.ratio).collect();
        assert_eq!(ratios, [4.0]);
        assert!(table(&rows).contains("4.0 times as fast as the GPU"));
        assert!(csv("# adapter", "commit 1", &rows).starts_with("# adapter\n# commit 1\nname,"));
    }

    #[test]
    fn lines_that_are_no_rows_are_refused() {
        assert!(parse("# a\nname\nb,1\n").is_err());
        assert!(parse("# a\nname\nb,x,1,2\n").is_err());
    }

    #[test]
    fn devices() {
        assert_eq!("gpu:1".parse(), Ok(Device::Gpu(Some(1))));
        assert_eq!("cpu".parse(), Ok(Device::Cpu));
        assert!("gpu:x".parse::<Device>().is_err());
    }
}
