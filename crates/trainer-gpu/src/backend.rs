//! The training backend of a GPU, as the loops of `trainer` use it.

use crate::layer::GpuLayer;
use crate::sky_training::GpuSkyTraining;
use ffgs_gpu::GpuError;
use ffgs_rasterizer_gpu::SceneDevice;
use ffgs_trainer::{LayerTask, SkyTask, TrainBackend};

/// A GPU that trains.
#[derive(Clone, Copy)]
pub struct GpuBackend<'g>(pub &'g SceneDevice);

impl TrainBackend for GpuBackend<'_> {
    type Error = GpuError;
    type Layer<'a>
        = GpuLayer<'a>
    where
        Self: 'a;
    type Sky<'a>
        = GpuSkyTraining<'a>
    where
        Self: 'a;

    fn upload_layer<'a>(&'a self, task: LayerTask<'a>) -> Result<GpuLayer<'a>, GpuError> {
        GpuLayer::new(self.0, task)
    }

    fn upload_sky<'a>(&'a self, task: SkyTask<'a>) -> Result<GpuSkyTraining<'a>, GpuError> {
        GpuSkyTraining::new(self.0, task)
    }
}
