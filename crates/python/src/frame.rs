//! Reconstructed frames for Python: their columns, renders, and a short training.

use crate::arrays::{array, rows};
use crate::capture::{PyCapture, camera_dict, camera_of};
use crate::failed;
use anyhow::{Context, Result, bail};
use ffgs_core::{Camera, Gaussians, PlanarImage, Scene, SkyCube};
use ffgs_pipeline::job::frame::select_views;
use ffgs_pipeline::outputs::exposure_files::load_training;
use ffgs_pipeline::outputs::orbit::orbit;
use ffgs_pipeline::outputs::picture::{draw, panorama_picture};
use ffgs_pipeline::settings::config::Config;
use ffgs_reconstruction::Exposures;
use ffgs_splats::Panorama;
use ffgs_trainer::{CpuBackend, Surroundings, sky_picture, train_dynamic};
use glam::Vec3;
use pyo3::exceptions::{PyIndexError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::sync::Arc;

/// What stands behind the Gaussians.
pub(crate) enum Sky {
    /// That of a run.
    Cube(SkyCube),
    /// That of a stream, decoded when it is drawn: an equirectangular picture, and what its top row and its middle column show.
    Encoded { picture: Vec<u8>, up: Vec3, forward: Vec3 },
}

impl Sky {
    fn seen_by(&self, camera: &Camera) -> Result<PlanarImage> {
        Ok(match self {
            Self::Cube(sky) => sky_picture(sky, camera),
            Self::Encoded { picture, up, forward } => {
                let sky = Panorama::decode(picture, *up, *forward).context("the sky of the stream")?;
                panorama_picture(&sky, camera)
            }
        })
    }
}

/// A reconstructed frame: its static and its dynamic Gaussians before a sky.
#[pyclass(frozen, module = "fastflowgs")]
pub(crate) struct Frame {
    pub(crate) index: usize,
    pub(crate) still: Arc<Gaussians>,
    pub(crate) moving: Gaussians,
    /// Empty for a stream.
    pub(crate) ids: Vec<u32>,
    /// (N, 3, 3), flat; empty for a stream.
    pub(crate) covariances: Vec<f64>,
    pub(crate) sky: Arc<Sky>,
    /// Of the run's cameras in this frame; neutral for a stream.
    pub(crate) exposures: Exposures,
}

impl Frame {
    /// A frame of a run.
    pub(crate) fn of(index: usize, scene: Scene, exposures: Exposures) -> Self {
        Self {
            index,
            still: scene.static_layer,
            moving: scene.dynamic.gaussians,
            ids: scene.dynamic.ids,
            covariances: scene.dynamic.covariances.iter().flat_map(glam::DMat3::to_cols_array).collect(),
            sky: Arc::new(Sky::Cube(scene.sky)),
            exposures,
        }
    }

    /// Colours and opacity of every pixel.
    fn picture(&self, camera: &Camera, background: Option<[f32; 3]>) -> Result<(Vec<f32>, Vec<f32>)> {
        let behind = match background {
            None => self.sky.seen_by(camera)?,
            Some(colour) => {
                let mut plain = PlanarImage::zeros(camera.size());
                (0..camera.size().pixels()).for_each(|pixel| plain.set_pixel(pixel, colour));
                plain
            }
        };
        let (image, transmittance) = draw(&[&self.still, &self.moving], camera, &behind);
        let colours = (0..camera.size().pixels()).flat_map(|pixel| image.pixel(pixel)).collect();
        Ok((colours, transmittance.iter().map(|t| 1.0 - t).collect()))
    }

    /// The dynamic layer trained on the photographs of a frame.
    fn trained(&self, capture: &PyCapture, frame: usize, task: &Finetuning) -> Result<Gaussians> {
        let Sky::Cube(sky) = &*self.sky else {
            bail!("a frame of a stream cannot be finetuned; take it from the run")
        };
        let mut config = Config::default().dynamic;
        config.iterations = task.iterations.unwrap_or(config.iterations);
        // What another frame changed is not known here.
        let exposures = if frame == self.index { self.exposures.clone() } else { self.exposures.usual() };
        let views = load_training(&*capture.0, &exposures, &select_views(&*capture.0, None)?, frame)?;
        let around = Surroundings { static_layer: &self.still, sky, prior: None };
        let mut layer = self.moving.clone();
        if let Some(means) = &task.means {
            layer.means.clone_from(means);
        }
        train_dynamic(&CpuBackend, &config, &views, around, &mut layer, task.seed, &mut |_| {})?;
        Ok(layer)
    }
}

struct Finetuning {
    iterations: Option<usize>,
    means: Option<Vec<[f32; 3]>>,
    seed: u64,
}

#[pymethods]
impl Frame {
    /// Frame of the capture.
    #[getter]
    fn index(&self) -> usize {
        self.index
    }

    /// The static Gaussians: means (N, 3) m, quats (N, 4) w x y z, log_scales (N, 3), opacity_logits (N), sh (N, K, 3); float32.
    #[getter(r#static)]
    fn static_layer<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        columns(py, &self.still)
    }

    /// The dynamic Gaussians, as the static ones; of a run also ids (N) and covariances (N, 3, 3) of the positions, m^2.
    #[getter]
    fn dynamic<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let (out, n) = (columns(py, &self.moving)?, self.moving.len());
        if self.ids.len() == n && self.covariances.len() == 9 * n {
            out.set_item("ids", array(py, &self.ids, &[n])?)?;
            out.set_item("covariances", array(py, &self.covariances, &[n, 3, 3])?)?;
        }
        Ok(out)
    }

    /// Draws the frame as `ffgs render` does, but with what veils the picture, and in the exposure that all cameras share: colours (H, W, 3) float32, sRGB in 0..1, and opacity (H, W) float32.
    ///
    /// `camera` is a dict as `Capture.camera` returns. Behind the Gaussians is the sky, or one colour where `background` is given.
    #[pyo3(signature = (camera, background=None))]
    fn render<'py>(
        &self,
        py: Python<'py>,
        camera: &Bound<'py, PyAny>,
        background: Option<[f32; 3]>,
    ) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyAny>)> {
        let camera = camera_of(camera)?;
        let (colours, opacity) = py.detach(|| self.picture(&camera, background)).map_err(failed)?;
        let (width, height) = (camera.size().width, camera.size().height);
        Ok((array(py, &colours, &[height, width, 3])?, array(py, &opacity, &[height, width])?))
    }

    /// `views` cameras on a circle around one of the moving objects, as `ffgs render --orbit` has them.
    fn orbit<'py>(
        &self,
        py: Python<'py>,
        capture: &Bound<'py, PyCapture>,
        views: usize,
    ) -> PyResult<Vec<Bound<'py, PyDict>>> {
        let capture = &*capture.get().0;
        let cameras = py.detach(|| orbit(capture, &self.moving, self.index, views)).map_err(failed)?;
        cameras.iter().map(|camera| camera_dict(py, camera)).collect()
    }

    /// Trains the dynamic layer on the photographs of frame `frame`, starting at this frame's Gaussians or, where `means` (N, 3) in
    /// metres is given, at those positions. The static layer and the sky stay, and what a run knows of the Gaussians
    /// from earlier frames is not used: `reconstruct` does all that.
    #[pyo3(signature = (capture, frame, *, means=None, iterations=None, seed=1))]
    fn finetune(
        &self,
        py: Python<'_>,
        capture: &Bound<'_, PyCapture>,
        frame: usize,
        means: Option<&Bound<'_, PyAny>>,
        iterations: Option<usize>,
        seed: u64,
    ) -> PyResult<Self> {
        let capture = capture.get();
        if frame >= capture.0.frames() {
            return Err(PyIndexError::new_err(format!("the capture has {} frames", capture.0.frames())));
        }
        let means = means.map(|means| rows(means, self.moving.len())).transpose()?;
        if means.iter().flatten().flatten().any(|value| !value.is_finite()) {
            return Err(PyValueError::new_err("means: not finite"));
        }
        let task = Finetuning { iterations, means, seed };
        let moving = py.detach(|| self.trained(capture, frame, &task)).map_err(failed)?;
        Ok(Self {
            index: frame,
            still: Arc::clone(&self.still),
            moving,
            ids: self.ids.clone(),
            covariances: self.covariances.clone(),
            sky: Arc::clone(&self.sky),
            exposures: if frame == self.index { self.exposures.clone() } else { self.exposures.usual() },
        })
    }
}

fn columns<'py>(py: Python<'py>, g: &Gaussians) -> PyResult<Bound<'py, PyDict>> {
    let (out, n) = (PyDict::new(py), g.len());
    out.set_item("means", array(py, g.means.as_flattened(), &[n, 3])?)?;
    out.set_item("quats", array(py, g.quats.as_flattened(), &[n, 4])?)?;
    out.set_item("log_scales", array(py, g.log_scales.as_flattened(), &[n, 3])?)?;
    out.set_item("opacity_logits", array(py, &g.opacity_logits, &[n])?)?;
    out.set_item("sh", array(py, g.sh.as_flattened(), &[n, g.sh_stride(), 3])?)?;
    Ok(out)
}
