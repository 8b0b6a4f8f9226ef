//! How much errors of each Gaussian show in the views of a capture.

use anyhow::Result;
use ffgs_core::{Camera, Gaussians, Scene};
use ffgs_method::{Capture, Split, ViewAt};
use ffgs_rasterizer::{Background, CpuRasterizer, Information, RenderOptions, RenderTape, View};
use std::collections::BTreeMap;

/// Squared blending weights, summed over the pixels of the training views of one frame. Rendering them costs as much as writing some
/// frames, so they serve for several.
pub(crate) struct Importance {
    still: Vec<f32>,
    /// By persistent id.
    moving: BTreeMap<u32, f32>,
    /// Of the dynamic Gaussians.
    mean: f32,
}

impl Importance {
    /// Of the Gaussians of a frame.
    pub(crate) fn new(scene: &Scene, capture: &dyn Capture, frame: usize) -> Result<Self> {
        let cameras = (0..capture.views(Split::Train).len())
            .map(|view| capture.camera(ViewAt { split: Split::Train, view, frame }))
            .collect::<Result<Vec<_>, _>>()?;
        let mut still = squared_weights(&scene.joint(), &cameras);
        let moving = still.split_off(scene.static_layer.len());
        let mean = moving.iter().sum::<f32>() / moving.len().max(1) as f32;
        Ok(Self { still, moving: scene.dynamic.ids.iter().copied().zip(moving).collect(), mean })
    }

    /// Whether it still tells something of the static Gaussians of a scene.
    pub(crate) fn fits(&self, scene: &Scene) -> bool {
        self.still.len() == scene.static_layer.len()
    }

    /// Of the static and the dynamic Gaussians of a scene; of those born since, the mean.
    pub(crate) fn of(&self, scene: &Scene) -> (&[f32], Vec<f32>) {
        let own = |id: &u32| self.moving.get(id).copied().unwrap_or(self.mean);
        (&self.still, scene.dynamic.ids.iter().map(own).collect())
    }
}

/// The information on constant colours when pixels have unit variance, up to a factor that is the same for all.
fn squared_weights(gaussians: &Gaussians, cameras: &[Camera]) -> Vec<f32> {
    let rasterizer = CpuRasterizer::new(RenderOptions { sh_degree: Some(0), ..RenderOptions::default() });
    let mut tape = RenderTape::default();
    let mut out = Information::none(gaussians.len(), gaussians.sh_degree());
    for camera in cameras {
        let view = View { camera, background: Background::Colour([0.0; 3]), tiles: None };
        rasterizer.render_layers(&[gaussians], &view, &mut tape);
        let ones = vec![1.0; camera.size().pixels()];
        rasterizer.add_information(&[gaussians], &view, &tape, &ones, &mut out);
    }
    (0..gaussians.len()).map(|i| out.others.sh_of(i)[0][0]).collect()
}
