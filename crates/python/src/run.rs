//! Finished runs for Python.

use crate::failed;
use crate::frame::Frame;
use ffgs_pipeline::outputs::finished_run::FinishedRun;
use pyo3::exceptions::PyKeyError;
use pyo3::prelude::*;
use std::path::PathBuf;

/// The finished frames of a run.
#[pyclass(frozen)]
pub(crate) struct Run(FinishedRun);

#[pymethods]
impl Run {
    /// Opens a run by its output folder.
    #[new]
    fn new(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        py.detach(|| FinishedRun::open(&path)).map(Self).map_err(failed)
    }

    /// The finished frames, ascending.
    #[getter]
    fn frames(&self) -> Vec<usize> {
        self.0.frames.clone()
    }

    /// Folder of the capture.
    #[getter]
    fn capture(&self) -> PathBuf {
        self.0.manifest.capture_path.clone()
    }

    /// Reads a frame.
    fn read(&self, py: Python<'_>, frame: usize) -> PyResult<Frame> {
        if !self.0.frames.contains(&frame) {
            return Err(PyKeyError::new_err(format!("frame {frame} is not finished")));
        }
        let read = || anyhow::Ok((self.0.scene(frame)?, self.0.exposures(frame)?));
        let (scene, exposures) = py.detach(read).map_err(failed)?;
        Ok(Frame::of(frame, scene, exposures))
    }
}
