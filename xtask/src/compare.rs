//! `cargo xtask compare`: what the motion initialisation is worth, as one table.

use crate::ffgs;
use anyhow::{Context, Result, ensure};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Capture, folder and iterations of the comparison.
#[derive(clap::Args)]
pub(crate) struct Options {
    /// Folder of the capture.
    #[arg(default_value = ffgs::SAMPLE)]
    capture: PathBuf,
    /// Where the runs are written; finished ones are kept.
    #[arg(long, value_name = "DIR", default_value = "out/compare")]
    out: PathBuf,
    /// Iterations of the dynamic lane to compare at.
    #[arg(long, value_name = "N,N", value_delimiter = ',', default_values_t = [100, 300])]
    iterations: Vec<usize>,
}

const HEAD: &str = "\
| initialisation | iterations | trackside PSNR | MPSNR | SSIM | all views PSNR | MPSNR | SSIM | s per frame |
|---|---|---|---|---|---|---|---|---|";

/// Trains one first frame, runs every initialisation from it and prints a row for each.
pub(crate) fn run(root: &Path, options: &Options) -> Result<()> {
    let program = ffgs::build(root)?;
    let first = options.out.join("first");
    let methods = methods(&options.capture)?;
    finish(&program, options, &first, &["--frames", "0..1"])?;
    println!("{HEAD}");
    for iterations in &options.iterations {
        for method in &methods {
            let folder = options.out.join(format!("{}_{iterations}", method.replace(':', "_")));
            let (n, first) = (iterations.to_string(), first.to_string_lossy());
            finish(
                &program,
                options,
                &folder,
                &["--method", method, "--iterations", &n, "--first-frame", &first],
            )?;
            println!("{}", row(method, *iterations, &read(&folder.join("metrics.json"))?));
        }
    }
    Ok(())
}

/// `trackers`, `none`, and each tracker that the capture names.
fn methods(capture: &Path) -> Result<Vec<String>> {
    let trackers = read(&capture.join("tracks/tracks.json"))?;
    let named = trackers["trackers"].as_array().into_iter().flatten().filter_map(|t| t["name"].as_str());
    let mut methods = vec!["trackers".to_owned(), "none".to_owned()];
    methods.extend(named.map(|name| format!("tracker:{name}")));
    Ok(methods)
}

/// Runs, or goes on with a run that was interrupted.
fn finish(program: &Path, options: &Options, out: &Path, args: &[&str]) -> Result<()> {
    let mut command = Command::new(program);
    command.arg("run").arg(&options.capture).arg("--out").arg(out).args(args).arg("--resume");
    let status = command.stdout(std::process::Stdio::null()).status().context("cannot start ffgs")?;
    ensure!(status.success(), "the run into {} failed", out.display());
    Ok(())
}

fn row(method: &str, iterations: usize, metrics: &Value) -> String {
    let of = |group: &str, key: &str, digits: usize| {
        metrics[group][key].as_f64().map_or_else(|| "-".to_owned(), |v| format!("{v:.digits$}"))
    };
    let views = |group: &str| {
        format!("{} | {} | {}", of(group, "psnr", 2), of(group, "mpsnr", 2), of(group, "ssim", 4))
    };
    let (fixed, all) = (views("mean_trackside"), views("mean"));
    format!("| `{method}` | {iterations} | {fixed} | {all} | {} |", of("mean", "seconds_per_frame", 1))
}

fn read(file: &Path) -> Result<Value> {
    let text = std::fs::read_to_string(file).with_context(|| format!("cannot read {}", file.display()))?;
    serde_json::from_str(&text).with_context(|| format!("{} is not JSON", file.display()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::workspace;

    #[test]
    fn the_sample_is_compared_with_every_tracker_alone() {
        let root = workspace::root().unwrap();
        let methods = methods(&root.join(ffgs::SAMPLE)).unwrap();
        let expected =
            ["trackers", "none", "tracker:sparse_xfeat", "tracker:points_raft", "tracker:dense_gmflow"];
        assert_eq!(methods, expected);
    }

    #[test]
    fn a_row_shows_both_groups_of_views_and_a_dash_for_what_is_absent() {
        let metrics = serde_json::json!({
            "mean": {"psnr": 20.0, "mpsnr": null, "ssim": 0.5, "seconds_per_frame": 3.04},
            "mean_trackside": {"psnr": 25.449, "mpsnr": 22.1, "ssim": 0.85791},
        });
        let expected = "| `none` | 100 | 25.45 | 22.10 | 0.8579 | 20.00 | - | 0.5000 | 3.0 |";
        assert_eq!(row("none", 100, &metrics), expected);
    }
}
