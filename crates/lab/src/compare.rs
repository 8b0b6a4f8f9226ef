//! `ffgs-lab compare`: what the motion initialisation is worth, as one table.

use anyhow::{Result, anyhow};
use clap::Args;
use ffgs_pipeline::args::LogArgs;
use ffgs_pipeline::config::Config;
use ffgs_pipeline::device::Device;
use ffgs_pipeline::json::read_json;
use ffgs_pipeline::record::{Mean, Metrics};
use ffgs_pipeline::registry::open_capture;
use ffgs_pipeline::request::{FrameRange, RunRequest};
use ffgs_pipeline::{run, terminal};
use std::path::{Path, PathBuf};

/// `ffgs-lab compare`.
#[derive(Clone, Debug, Args)]
pub(crate) struct CompareArgs {
    /// Folder of the capture
    #[arg(default_value = "fixtures/scenes/fairmont-mini")]
    capture: PathBuf,
    /// Where the runs are written; finished ones are kept
    #[arg(long, value_name = "DIR", default_value = "out/compare")]
    out: PathBuf,
    /// Iterations of the dynamic lane to compare at
    #[arg(long, value_name = "N,N", value_delimiter = ',', default_values_t = [100, 300])]
    iterations: Vec<usize>,
    /// Where to compute; auto = a hardware GPU where there is one, else the CPU
    #[arg(long, value_name = "auto|cpu|gpu[:N,N]", default_value = "auto")]
    device: Device,
    /// Messages.
    #[command(flatten)]
    pub log: LogArgs,
}

const HEAD: &str = "\
| initialisation | iterations | trackside PSNR | MPSNR | SSIM | all views PSNR | MPSNR | SSIM | s per frame |
|---|---|---|---|---|---|---|---|---|";

/// Trains one first frame, runs every initialisation from it and prints a row for each. Goes on with runs that were
/// interrupted.
///
/// # Errors
/// When a run fails.
pub(crate) fn run(args: &CompareArgs) -> Result<()> {
    let first = args.out.join("first");
    let only_first = FrameRange { start: 0, end: Some(1) };
    run::run(&RunRequest { frames: Some(only_first), ..args.request(&first) })?;
    terminal::print(HEAD);
    for &iterations in &args.iterations {
        for method in methods(&args.capture)? {
            let folder = args.out.join(format!("{}_{iterations}", method.replace(':', "_")));
            let mut request = args.request(&folder);
            request.method = Some(method.parse().map_err(|e| anyhow!("{e}"))?);
            request.first_frame = Some(first.clone());
            request.config.dynamic.iterations = iterations;
            run::run(&request)?;
            terminal::print(row(&method, iterations, &read_json(&folder.join("metrics.json"))?));
        }
    }
    Ok(())
}

impl CompareArgs {
    /// A run with the default settings into `out`.
    fn request(&self, out: &Path) -> RunRequest {
        RunRequest {
            capture: self.capture.clone(),
            out: out.to_owned(),
            resume: true,
            method: None,
            frames: None,
            train_views: None,
            first_frame: None,
            device: self.device.clone(),
            quiet: self.log.quiet,
            config: Config::default(),
        }
    }
}

/// `trackers`, `none`, and each tracker that the capture names.
fn methods(capture: &Path) -> Result<Vec<String>> {
    let sources = ffgs_tracks::sources(&*open_capture(capture)?)?;
    let alone = sources.iter().map(|source| format!("tracker:{}", source.name()));
    Ok(["trackers".to_owned(), "none".to_owned()].into_iter().chain(alone).collect())
}

fn row(method: &str, iterations: usize, metrics: &Metrics) -> String {
    let number = |value: Option<f64>, digits: usize| {
        value.map_or_else(|| "-".to_owned(), |value| format!("{value:.digits$}"))
    };
    let views = |mean: &Mean| {
        format!("{} | {} | {}", number(mean.psnr, 2), number(mean.mpsnr, 2), number(mean.ssim, 4))
    };
    let (fixed, all) = (views(&metrics.mean_trackside), views(&metrics.mean));
    format!("| `{method}` | {iterations} | {fixed} | {all} | {} |", number(metrics.mean.seconds_per_frame, 1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sample_is_compared_with_every_tracker_alone() {
        let sample = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/scenes/fairmont-mini");
        let expected =
            ["trackers", "none", "tracker:sparse_xfeat", "tracker:points_raft", "tracker:dense_gmflow"];
        assert_eq!(methods(&sample).unwrap(), expected);
    }

    #[test]
    fn a_row_shows_both_groups_of_views_and_a_dash_for_what_is_absent() {
        let mut metrics = Metrics::default();
        let all = &mut metrics.mean;
        (all.psnr, all.ssim, all.seconds_per_frame) = (Some(20.0), Some(0.5), Some(3.04));
        let fixed = &mut metrics.mean_trackside;
        (fixed.psnr, fixed.mpsnr, fixed.ssim) = (Some(25.449), Some(22.1), Some(0.85791));
        let expected = "| `none` | 100 | 25.45 | 22.10 | 0.8579 | 20.00 | - | 0.5000 | 3.0 |";
        assert_eq!(row("none", 100, &metrics), expected);
    }
}
