//! A device that keeps the layers it was given, so that a static layer is uploaded once per frame at most.

use crate::scene::GpuScene;
use ffgs_core::Gaussians;
use ffgs_gpu::{Gpu, GpuError};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};

/// Where the photographs of a training are between the steps that use them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// All in the memory of the device.
    Device,
    /// In the machine's memory; that of each step crosses to the device.
    Host,
}

/// A GPU that keeps the layers it was told of: one that stands still crosses to the device once, however many stages
/// use it.
pub struct SceneDevice {
    /// The GPU.
    pub gpu: Gpu,
    /// A `Weak` keeps the address from being used for another layer, and the layer from being changed in place.
    kept: Mutex<Vec<(Weak<Gaussians>, GpuScene)>>,
    uploads: AtomicUsize,
    photographs_stay: AtomicBool,
}

impl SceneDevice {
    /// Nothing is kept yet.
    pub fn new(gpu: Gpu) -> Self {
        Self {
            gpu,
            kept: Mutex::default(),
            uploads: AtomicUsize::new(0),
            photographs_stay: AtomicBool::new(false),
        }
    }

    /// `layer` on the device, for reading. Layers that nobody holds any more are let go.
    ///
    /// # Errors
    /// When the device fails or has too little memory.
    pub fn layer(&self, layer: &Arc<Gaussians>) -> Result<GpuScene, GpuError> {
        let mut kept = self.living();
        if let Some((_, scene)) = kept.iter().find(|(known, _)| known.as_ptr() == Arc::as_ptr(layer)) {
            return Ok(scene.clone());
        }
        let scene = GpuScene::upload(&self.gpu, layer)?;
        self.uploads.fetch_add(1, Ordering::Relaxed);
        kept.push((Arc::downgrade(layer), scene.clone()));
        Ok(scene)
    }

    /// Keeps what is on the device already; `scene` must not change any more.
    pub fn keep(&self, layer: &Arc<Gaussians>, scene: GpuScene) {
        self.living().push((Arc::downgrade(layer), scene));
    }

    /// Lets go of everything.
    pub fn forget(&self) {
        self.kept().clear();
        self.gpu.release_unused();
    }

    /// Where the photographs of a training begin.
    pub fn place_of_photographs(&self) -> Place {
        if self.photographs_stay.load(Ordering::Relaxed) { Place::Host } else { Place::Device }
    }

    /// Leaves photographs on the host from now on, as the memory of the device was too small for all of them.
    pub fn leave_photographs(&self) {
        if !self.photographs_stay.swap(true, Ordering::Relaxed) {
            let name = &self.gpu.report().name;
            tracing::info!("the memory of {name} is short: photographs cross to it one by one, step by step");
        }
        self.gpu.release_unused();
    }

    /// Layers that were brought to the device by [`SceneDevice::layer`].
    pub fn uploads(&self) -> usize {
        self.uploads.load(Ordering::Relaxed)
    }

    fn living(&self) -> MutexGuard<'_, Vec<(Weak<Gaussians>, GpuScene)>> {
        let mut kept = self.kept();
        kept.retain(|(layer, _)| layer.strong_count() > 0);
        kept
    }

    fn kept(&self) -> MutexGuard<'_, Vec<(Weak<Gaussians>, GpuScene)>> {
        self.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn layer(x: f32) -> Gaussians {
        let mut out = Gaussians::zeros(3, 1);
        out.means.fill([x, 0.0, 2.0]);
        out.sh.fill([0.5 * x; 3]);
        out
    }

    #[test]
    #[ignore = "needs a GPU"]
    fn a_layer_crosses_once_until_it_changes() {
        let device = SceneDevice::new(Gpu::for_test());
        let mut first = Arc::new(layer(1.0));
        for _ in 0..3 {
            assert_eq!(device.layer(&first).unwrap().download(&device.gpu).unwrap(), *first);
        }
        assert_eq!(device.uploads(), 1);
        // In place, as nobody else holds it; and again at once, where another one could come to lie.
        Arc::make_mut(&mut first).means[0][0] = 7.0;
        assert_eq!(device.layer(&first).unwrap().download(&device.gpu).unwrap(), *first);
        drop(first);
        let second = Arc::new(layer(2.0));
        assert_eq!(device.layer(&second).unwrap().download(&device.gpu).unwrap(), *second);
        assert_eq!(device.uploads(), 3);
        assert_eq!(device.living().len(), 1, "what nobody holds is let go");
    }

    #[test]
    #[ignore = "needs a GPU"]
    fn scenes_are_joined_on_the_device() {
        let gpu = Gpu::for_test();
        let (mut joint, second) = (layer(1.0), layer(2.0));
        let parts = [&joint, &second, &Gaussians::zeros(0, 1)].map(|g| GpuScene::upload(&gpu, g).unwrap());
        joint.extend(&second);
        let found = GpuScene::joined(&gpu, &parts.each_ref()).unwrap();
        assert_eq!(found.download(&gpu).unwrap(), joint);
    }
}
