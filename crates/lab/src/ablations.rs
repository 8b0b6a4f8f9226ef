//! `ffgs-lab ablations`: each departure from Algorithm 1 taken back alone, and each option tried alone.

use crate::cells::Cell;
use crate::evaluation::{Evaluation, SourceArgs, configuration};
use crate::simulate;
use anyhow::{Result, ensure};
use clap::Args;
use ffgs_fusion::{FusionConfig, PriorModel, ProcessNoise, Structure};
use ffgs_motion_eval::{Row, summarise, table};
use ffgs_pipeline::cli::terminal::progress;
use ffgs_pipeline::settings::config::Config;
use ffgs_triangulation::TriangulationConfig;
use ffgs_voronoi::{Method, SourceFilter};
use std::path::PathBuf;

/// `ffgs-lab ablations`.
#[derive(Clone, Debug, Args)]
#[command(
    after_help = "Examples:\n  ffgs-lab ablations fixtures/scenes/fairmont-mini --run out/mini\n  ffgs-lab ablations"
)]
pub struct AblationArgs {
    /// Folder of the capture, with truth/ [default: simulated scenes]
    pub capture: Option<PathBuf>,
    /// What is moved.
    #[command(flatten)]
    pub source: SourceArgs,
}

/// A name and what it changes in the configuration.
pub type Ablation = (&'static str, fn(&mut Config));

/// In the order of the stages.
pub(crate) const ABLATIONS: [Ablation; 26] = [
    ("as configured", |_| {}),
    ("literal: Algorithms 1 and 2", |c| *c = Config::literal()),
    ("literal fusion", |c| c.fusion = FusionConfig::literal()),
    ("rigid neighbourhoods for groups", |c| c.fusion.structure = Structure::RigidNeighbours),
    ("tracks of the whole image", |c| c.voronoi.source_filter = SourceFilter::All),
    ("visibility not in the confidence", |c| c.voronoi.use_visibility = false),
    ("kernel twice as wide", |c| c.voronoi.sigma *= 2.0),
    ("kernel half as wide", |c| c.voronoi.sigma *= 0.5),
    ("natural neighbours", |c| c.voronoi.method = Method::NaturalNeighbour),
    ("no agreement floor", |c| c.agreement.magnitude_floor_px = 0.0),
    ("unknown counts as disagreement", |c| c.agreement.ignore_unknown = false),
    ("no flow floor", |c| c.association.flow_floor_px = 0.0),
    ("the hidden is observed", |c| c.association.min_transmittance = 1e-4),
    ("sixteen contributors per pixel", |c| c.association.contributors = 16),
    ("what left the image counts", |c| c.association.withdraw_unseen = false),
    ("no depth weighting, no refinement", |c| {
        c.triangulation.depth_weighting = false;
        c.triangulation.refine = false;
    }),
    ("no refinement", |c| c.triangulation.refine = false),
    ("own residuals only", |c| c.triangulation.pooled_degrees = 0.0),
    ("25-degree rule", |c| c.triangulation.collinear_degrees = 25.0),
    ("no robust weights", |c| c.triangulation.robust = false),
    ("literal triangulation", |c| c.triangulation = TriangulationConfig::literal()),
    ("literal fusion, q per object", |c| {
        c.fusion = FusionConfig { q_mode: ProcessNoise::PerObject, ..FusionConfig::literal() };
    }),
    ("literal fusion, constant velocity", |c| {
        c.fusion = FusionConfig { prior: PriorModel::ConstantVelocity, ..FusionConfig::literal() };
    }),
    ("literal fusion, gate 16.3", |c| c.fusion = FusionConfig { gate: 16.3, ..FusionConfig::literal() }),
    ("literal fusion, covariances x 10", |c| {
        c.fusion = FusionConfig { correlation_inflation: 10.0, ..FusionConfig::literal() };
    }),
    ("cells of 128", |c| c.fusion.groups.cell = 128),
];

/// Prints one line per change: the fused estimate of the bodies, or that of all simulated scenes.
///
/// # Errors
/// When the capture, its truth or the configuration cannot be read.
pub fn run(args: &AblationArgs) -> Result<()> {
    let source = &args.source;
    let simulated = args.capture.is_none();
    ensure!(
        !(simulated && (source.run.is_some() || source.frames.is_some())),
        "--run and --frames need a capture"
    );
    let mut eval = args.capture.as_deref().map(|capture| Evaluation::open(capture, source)).transpose()?;
    let bar = progress(source.log.quiet, "changes", ABLATIONS.len());
    let mut rows = Vec::new();
    for (name, change) in ABLATIONS {
        let mut config = configuration(source.config.as_deref())?;
        change(&mut config);
        let cell = score(&config, eval.as_mut())?;
        rows.push(Row { name: name.into(), candidates: cell.candidates, summary: summarise(&cell.samples) });
        bar.inc(1);
    }
    bar.finish_and_clear();
    ffgs_pipeline::cli::terminal::print(table(&rows).trim_end());
    Ok(())
}

fn score(config: &Config, eval: Option<&mut Evaluation>) -> Result<Cell> {
    if let Some(eval) = eval {
        eval.config = *config;
        return eval.bodies();
    }
    let samples = simulate::all_samples(config)?;
    Ok(Cell { candidates: samples.len(), samples, ..Cell::default() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_ablation_but_the_first_changes_something_of_its_own() {
        let of = |(name, change): &Ablation| {
            let mut config = Config::default();
            change(&mut config);
            (*name, config)
        };
        let all: Vec<(&str, Config)> = ABLATIONS.iter().map(of).collect();
        for (i, (name, config)) in all.iter().enumerate() {
            for (other, before) in &all[..i] {
                assert!(config != before, "{name} and {other} are the same");
            }
        }
    }
}
