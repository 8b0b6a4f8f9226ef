//! What the command line does: stages, training, whole runs.

use crate::capture::PyCapture;
use crate::failed;
use crate::frame::Frame;
use anyhow::Result;
use clap::{Parser, ValueEnum};
use ffgs_core::Scene;
use ffgs_method::Capture;
use ffgs_pipeline::cli::{Cli, Command};
use ffgs_pipeline::config::Config;
use ffgs_pipeline::device::Device;
use ffgs_pipeline::frame::{all_views, select_views};
use ffgs_pipeline::stage::{Form, Stage, run as run_stage};
use ffgs_reconstruction::Exposures;
use ffgs_reconstruction::initial_points::start;
use ffgs_reconstruction::marking::split;
use ffgs_reconstruction::sky::sky_or_none;
use ffgs_trainer::{CpuBackend, camera_extent};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use std::path::PathBuf;

/// Runs a stage on the arrays of an .npz file and writes its results to another.
#[pyfunction(name = "stage")]
pub(crate) fn stage(
    py: Python<'_>,
    name: &str,
    input: PathBuf,
    output: PathBuf,
    literal: bool,
) -> PyResult<()> {
    let stage = Stage::from_str(name, true).map_err(PyValueError::new_err)?;
    let form = if literal { Form::Literal } else { Form::Run };
    py.detach(|| run_stage(stage, form, &input, &output, &Device::Cpu)).map_err(failed)
}

/// Trains frame 0 of a capture from its initial points on the CPU, as a run does where the exposures of the cameras agree, and splits it
/// into layers. Nothing is written.
#[pyfunction]
#[pyo3(signature = (capture, *, iterations=None, seed=1))]
pub(crate) fn train_first_frame(
    capture: &Bound<'_, PyCapture>,
    iterations: Option<usize>,
    seed: u64,
) -> PyResult<Frame> {
    let from = &*capture.get().0;
    let scene = capture.py().detach(|| trained(from, iterations, seed)).map_err(failed)?;
    Ok(Frame::of(0, scene, Exposures::default()))
}

fn trained(capture: &dyn Capture, iterations: Option<usize>, seed: u64) -> Result<Scene> {
    let mut config = Config::default();
    config.first_frame.iterations = iterations.unwrap_or(config.first_frame.iterations);
    let chosen = select_views(capture, None)?;
    let views = all_views(capture, &chosen, 0)?;
    let own = &views[..chosen.len()];
    let first = config.first_frame.for_views(views.len());
    let points = start(capture, &config.reconstruction(), first.sh_degree, &views)?;
    let extent = camera_extent(&views);
    let trained =
        ffgs_trainer::train_first_frame(&CpuBackend, &first, &views, points, extent, seed, &mut |_| {})?;
    let sky = sky_or_none(trained.sky, &trained.gaussians, own);
    split(&config.marking, &trained.gaussians, sky, own, &views)
}

/// `ffgs run` with the words of its command line; the path of the report.
#[pyfunction]
pub(crate) fn reconstruct(py: Python<'_>, words: Vec<String>) -> PyResult<PathBuf> {
    let words = ["ffgs".to_owned(), "run".to_owned()].into_iter().chain(words);
    let cli = Cli::try_parse_from(words).map_err(|e| PyValueError::new_err(e.to_string()))?;
    let Command::Run(args) = cli.command else { return Err(PyValueError::new_err("not a run")) };
    py.detach(|| args.request().and_then(|request| ffgs_pipeline::run::run(&request))).map_err(failed)
}
