//! Captures for Python: cameras, images, masks and points as numpy arrays.

use crate::arrays::array;
use crate::failed;
use ffgs_core::{Camera, ImageSize, Intrinsics};
use ffgs_method::{Capture, Split, ViewAt};
use ffgs_pipeline::plugins::registry::open_capture;
use glam::DMat4;
use pyo3::exceptions::{PyIndexError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::path::PathBuf;

/// A capture on disk: calibrated cameras with images and masks. Images are decoded when asked for.
#[pyclass(name = "Capture", frozen, module = "fastflowgs")]
pub(crate) struct PyCapture(pub(crate) Box<dyn Capture>);

impl PyCapture {
    fn at(&self, view: &str, frame: usize) -> PyResult<ViewAt> {
        let inside =
            |split: &Split| self.0.views(*split).iter().position(|name| name == view).map(|at| (*split, at));
        let found = Split::ALL.iter().find_map(inside);
        let (split, at) =
            found.ok_or_else(|| PyValueError::new_err(format!("the capture has no view {view}")))?;
        if frame >= self.0.frames_of(split) {
            return Err(PyIndexError::new_err(format!("view {view} has {} frames", self.0.frames_of(split))));
        }
        Ok(ViewAt { split, view: at, frame })
    }
}

#[pymethods]
impl PyCapture {
    /// Opens the capture in a folder.
    #[new]
    fn new(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        py.detach(|| open_capture(&path)).map(Self).map_err(failed)
    }

    /// Number of frames.
    #[getter]
    fn frames(&self) -> usize {
        self.0.frames()
    }

    /// Names of the views of a split: "train", "test" or "init".
    fn views(&self, split: &str) -> PyResult<Vec<String>> {
        let found = Split::ALL.into_iter().find(|s| s.to_string() == split);
        let split =
            found.ok_or_else(|| PyValueError::new_err(format!("no split {split}: train, test or init")))?;
        Ok(self.0.views(split).to_vec())
    }

    /// The camera of a view at a frame: width, height, intrinsics (fx, fy, cx, cy), camera_from_world (4, 4).
    fn camera<'py>(&self, py: Python<'py>, view: &str, frame: usize) -> PyResult<Bound<'py, PyDict>> {
        camera_dict(py, &self.0.camera(self.at(view, frame)?).map_err(failed)?)
    }

    /// The photograph of a view at a frame: (H, W, 3) uint8, sRGB.
    fn image<'py>(&self, py: Python<'py>, view: &str, frame: usize) -> PyResult<Bound<'py, PyAny>> {
        let at = self.at(view, frame)?;
        let image = py.detach(|| self.0.image(at)).map_err(failed)?;
        array(py, image.data(), &[image.size().height, image.size().width, 3])
    }

    /// The foreground mask of a view at a frame: (H, W) uint8, 1 is foreground; None where there is none.
    fn mask<'py>(&self, py: Python<'py>, view: &str, frame: usize) -> PyResult<Option<Bound<'py, PyAny>>> {
        let at = self.at(view, frame)?;
        let mask = py.detach(|| self.0.mask(at)).map_err(failed)?;
        mask.map(|mask| array(py, mask.data(), &[mask.size().height, mask.size().width])).transpose()
    }

    /// The initial points: positions (N, 3) in metres, colours (N, 3) in 0..1, foreground (N) uint8; None where there are none.
    fn points<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyDict>>> {
        let Some(points) = py.detach(|| self.0.points()).map_err(failed)? else { return Ok(None) };
        let (out, n) = (PyDict::new(py), points.positions.len());
        let foreground: Vec<u8> = points.foreground.iter().map(|&f| u8::from(f)).collect();
        out.set_item("positions", array(py, points.positions.as_flattened(), &[n, 3])?)?;
        out.set_item("colours", array(py, points.colours.as_flattened(), &[n, 3])?)?;
        out.set_item("foreground", array(py, &foreground, &[n])?)?;
        Ok(Some(out))
    }
}

pub(crate) fn camera_dict<'py>(py: Python<'py>, camera: &Camera) -> PyResult<Bound<'py, PyDict>> {
    let (out, lens) = (PyDict::new(py), camera.intrinsics());
    out.set_item("width", camera.size().width)?;
    out.set_item("height", camera.size().height)?;
    out.set_item("intrinsics", array(py, &[lens.fx, lens.fy, lens.cx, lens.cy], &[4])?)?;
    out.set_item(
        "camera_from_world",
        array(py, &camera.camera_from_world().transpose().to_cols_array(), &[4, 4])?,
    )?;
    Ok(out)
}

/// The camera that a dict as of [`camera_dict`] describes.
pub(crate) fn camera_of(camera: &Bound<'_, PyAny>) -> PyResult<Camera> {
    let [width, height] =
        [camera.get_item("width")?.extract::<usize>()?, camera.get_item("height")?.extract::<usize>()?];
    if !(1..=ImageSize::MAX_PIXELS).contains(&width.saturating_mul(height)) {
        return Err(PyValueError::new_err(format!("{width} x {height} pixels is not an image size")));
    }
    let [fx, fy, cx, cy]: [f64; 4] = camera.get_item("intrinsics")?.extract()?;
    let pose: [[f64; 4]; 4] = camera.get_item("camera_from_world")?.extract()?;
    let pose = DMat4::from_cols_array_2d(&pose).transpose();
    Camera::new(Intrinsics { fx, fy, cx, cy }, pose, ImageSize { width, height })
        .map_err(|e| PyValueError::new_err(e.to_string()))
}
