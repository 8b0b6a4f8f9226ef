//! Training on the CPU. Equal bytes for any number of threads.

mod around;
mod cut;
mod layer;
mod sky;

use crate::backend::{LayerTask, SkyTask, TrainBackend};
use std::convert::Infallible;

pub use layer::CpuLayer;
pub use sky::CpuSky;

/// All cores of this machine.
#[derive(Clone, Copy, Debug, Default)]
pub struct CpuBackend;

impl TrainBackend for CpuBackend {
    type Error = Infallible;
    type Layer<'a> = CpuLayer<'a>;
    type Sky<'a> = CpuSky<'a>;

    fn upload_layer<'a>(&'a self, task: LayerTask<'a>) -> Result<CpuLayer<'a>, Infallible> {
        Ok(CpuLayer::new(task))
    }

    fn upload_sky<'a>(&'a self, task: SkyTask<'a>) -> Result<CpuSky<'a>, Infallible> {
        Ok(CpuSky::new(task))
    }
}
