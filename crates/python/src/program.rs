//! What the command line does: stages, training, whole runs.

use crate::capture::PyCapture;
use crate::failed;
use crate::frame::Frame;
use anyhow::Result;
use clap::{Parser, ValueEnum};
use ffgs_core::StageLog;
use ffgs_method::Capture;
use ffgs_motion::Standstill;
use ffgs_pipeline::cli::{Cli, Command};
use ffgs_pipeline::commands::stage::{Form, Stage, run as run_stage};
use ffgs_pipeline::job::device::Device;
use ffgs_pipeline::job::frame::{first_views, select_views};
use ffgs_pipeline::job::run::run_while;
use ffgs_pipeline::settings::config::Config;
use ffgs_reconstruction::{Devices, Reconstructor, Silent, State};
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

/// Trains frame 0 of a capture from its initial points on the CPU, as a run does, and splits it into layers. Nothing is written.
#[pyfunction]
#[pyo3(signature = (capture, *, iterations=None, seed=1))]
pub(crate) fn train_first_frame(
    capture: &Bound<'_, PyCapture>,
    iterations: Option<usize>,
    seed: u64,
) -> PyResult<Frame> {
    let from = &*capture.get().0;
    let state = capture.py().detach(|| trained(from, iterations, seed)).map_err(failed)?;
    Ok(Frame::of(0, state.scene, state.exposures))
}

fn trained(capture: &dyn Capture, iterations: Option<usize>, seed: u64) -> Result<State> {
    let mut config = Config { seed, ..Config::default() };
    config.first_frame.iterations = iterations.unwrap_or(config.first_frame.iterations);
    let chosen = select_views(capture, None)?;
    let mut reconstructor = Reconstructor {
        config: config.reconstruction(),
        devices: Devices(&[]),
        capture,
        views: &chosen,
        tracks: &[],
        method: Box::new(Standstill),
        method_name: "none".to_owned(),
        monitor: &Silent,
    };
    reconstructor.first_frame(0, first_views(capture, &chosen, 0)?, None, &mut StageLog::default())
}

/// `ffgs run` with the words of its command line; the path of the report. An interrupt from the keyboard ends it after the frame at work.
#[pyfunction]
pub(crate) fn reconstruct(py: Python<'_>, words: Vec<String>) -> PyResult<PathBuf> {
    let words = ["ffgs".to_owned(), "run".to_owned()].into_iter().chain(words);
    let cli = Cli::try_parse_from(words).map_err(|e| PyValueError::new_err(e.to_string()))?;
    let Command::Run(args) = cli.command else { return Err(PyValueError::new_err("not a run")) };
    let result = py.detach(|| args.request().and_then(|request| run_while(&request, &not_interrupted)));
    result.map_err(|error| error.downcast::<PyErr>().unwrap_or_else(failed))
}

/// An interrupt from the keyboard is an error.
fn not_interrupted() -> Result<()> {
    Python::attach(|py| {
        py.check_signals()?;
        Ok(())
    })
}
