//! 4D streams for Python.

use crate::failed;
use crate::frame::{Frame, Sky};
use anyhow::Result;
use ffgs_reconstruction::Exposures;
use ffgs_stream::Reader;
use glam::Vec3;
use pyo3::prelude::*;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// A 4D stream (docs/STREAM.md). Reading frames in order costs one file each.
#[pyclass(frozen)]
pub(crate) struct Stream(Mutex<Reader>);

impl Stream {
    /// After a panic the reader begins at a key frame again.
    fn reader(&self) -> MutexGuard<'_, Reader> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn frame(&self, frame: u64) -> Result<Frame> {
        let mut reader = self.reader();
        let found = reader.read(frame)?;
        let [up, forward] = [reader.manifest().up, reader.manifest().forward].map(Vec3::from_array);
        Ok(Frame {
            index: frame as usize,
            still: Arc::new(found.static_layer),
            moving: found.dynamic_layer,
            ids: Vec::new(),
            covariances: Vec::new(),
            sky: Arc::new(Sky::Encoded { picture: found.sky, up, forward }),
            exposures: Exposures::default(),
        })
    }
}

#[pymethods]
impl Stream {
    /// Opens the stream in a folder.
    #[new]
    fn new(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        py.detach(|| Reader::open(&path)).map(|reader| Self(Mutex::new(reader))).map_err(failed)
    }

    /// The frames, ascending; of a stream that grows those so far.
    #[getter]
    fn frames(&self, py: Python<'_>) -> PyResult<Vec<u64>> {
        py.detach(|| {
            let mut reader = self.reader();
            reader.refresh()?;
            Ok(reader.entries().iter().map(|entry| entry.frame).collect())
        })
        .map_err(|error: ffgs_stream::StreamError| failed(error))
    }

    /// Frames per second at which it plays.
    #[getter]
    fn frames_per_second(&self, py: Python<'_>) -> f64 {
        py.detach(|| self.reader().manifest().frames_per_second)
    }

    /// Reads a frame.
    fn read(&self, py: Python<'_>, frame: u64) -> PyResult<Frame> {
        py.detach(|| self.frame(frame)).map_err(failed)
    }
}
