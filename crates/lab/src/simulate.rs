//! `ffgs-lab simulate`: the figures of `motion-eval` on simulated scenes, beside the literal Algorithm 1.

use crate::evaluation::configuration;
use anyhow::Result;
use clap::Args;
use ffgs_core::Estimates;
use ffgs_fusion::{FusionConfig, FusionInput, InformationFuser, ViewObservations};
use ffgs_motion_eval::{Row, Sample, summarise, table};
use ffgs_pipeline::cli::args::LogArgs;
use ffgs_pipeline::settings::config::Config;
use ffgs_simulator::{Recipe, Rig, Scenario, Simulation, simulate};
use ffgs_triangulation::WeightedRays;
use glam::{DMat3, DVec3};
use std::path::PathBuf;

/// `ffgs-lab simulate`.
#[derive(Clone, Debug, Args)]
pub(crate) struct SimulateArgs {
    /// Settings, as for `ffgs run`
    #[arg(long, value_name = "FILE.toml")]
    pub config: Option<PathBuf>,
    /// Standard deviation of a tracker's error (px)
    #[arg(long, value_name = "PX", default_value_t = Recipe::default().noise_px)]
    pub noise: f64,
    /// Share of the error's variance that is smooth over the surface
    #[arg(long, value_name = "SHARE", default_value_t = Recipe::default().smooth)]
    pub smooth: f64,
    /// Factor on the covariances that the trackers claim: below 1 they are too sure of themselves
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0)]
    pub claims: f64,
    /// Messages.
    #[command(flatten)]
    pub log: LogArgs,
}

/// Scores and prints.
///
/// # Errors
/// When the configuration cannot be read.
pub(crate) fn run(args: &SimulateArgs) -> Result<()> {
    let rows = rows(args, &configuration(args.config.as_deref())?)?;
    ffgs_pipeline::cli::terminal::print(table(&rows).trim_end());
    Ok(())
}

/// Errors of the fusion as configured over all scenarios, rigs and seeds.
pub(crate) fn all_samples(config: &Config) -> Result<Vec<Sample>> {
    let mut samples = Vec::new();
    for scenario in Scenario::ALL {
        for (rig, seed) in RIGS.into_iter().flat_map(|r| SEEDS.map(move |s| (r, s))) {
            let scene = simulate(&Recipe { scenario, rig, seed, ..Recipe::default() });
            samples.extend(score(&scene, &estimate(&scene, config)?, config.fusion)?);
        }
    }
    Ok(samples)
}

/// Rigs of every scenario.
const RIGS: [Rig; 3] = [Rig::Trackside, Rig::Ring, Rig::Dome];
/// Seeds of every combination.
const SEEDS: std::ops::RangeInclusive<u64> = 1..=3;

/// Rows of every scenario and rig: the fusion as configured, and our most literal reading of Algorithm 1.
fn rows(args: &SimulateArgs, config: &Config) -> Result<Vec<Row>> {
    let mut rows = Vec::new();
    let recipe = Recipe { noise_px: args.noise, smooth: args.smooth, ..Recipe::default() };
    for scenario in Scenario::ALL {
        for rig in RIGS {
            let mut samples = [Vec::new(), Vec::new()];
            for seed in SEEDS {
                let scene = simulate(&Recipe { scenario, rig, seed, ..recipe });
                let mut estimates = estimate(&scene, config)?;
                let claimed = estimates.iter_mut().flat_map(|e| &mut e.covariances);
                claimed.for_each(|c| *c *= args.claims);
                let fusions = [config.fusion, FusionConfig::literal()];
                for (out, fusion) in samples.iter_mut().zip(fusions) {
                    out.extend(score(&scene, &estimates, fusion)?);
                }
            }
            for (name, samples) in ["fused", "literal"].iter().zip(&samples) {
                let name = format!("{scenario:?}, {rig:?}: {name}");
                rows.push(Row { name, candidates: samples.len(), summary: summarise(samples) });
            }
        }
    }
    Ok(rows)
}

fn estimate(scene: &Simulation, config: &Config) -> Result<Vec<Estimates>> {
    let solver = WeightedRays { config: config.triangulation };
    let one = |observations| {
        let mut out = Estimates::default();
        solver.triangulate(&scene.previous, &scene.cameras, observations, &mut out)?;
        Ok(out)
    };
    scene.observations.iter().map(one).collect()
}

/// Errors of the fusion; places at t-1 are exact, so the posterior is that of the motion.
fn score(scene: &Simulation, estimates: &[Estimates], config: FusionConfig) -> Result<Vec<Sample>> {
    let standing = vec![DVec3::ZERO; scene.previous.len()];
    let fused = InformationFuser { config }.fuse(&FusionInput {
        prior_means: &scene.previous,
        prior_covariances: &vec![DMat3::ZERO; scene.previous.len()],
        estimates,
        previous_steps: Some(&standing),
        groups: Some(&scene.parts),
        last_q: 0.0,
        q_floor_m: 0.01,
        observed: Some(ViewObservations { cameras: &scene.cameras, observations: &scene.observations }),
        flexibility: None,
    })?;
    let sample =
        |i: usize| Sample { error: fused.means[i] - scene.truth[i], covariance: fused.covariances[i] };
    Ok((0..scene.truth.len()).map(sample).collect())
}
