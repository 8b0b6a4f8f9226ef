//! Sums over the footprint of every Gaussian, and the strongest contributors of every pixel, on the device.

use crate::kernels;
use crate::rasterize::GpuRasterizer;
use crate::scene::GpuScene;
use crate::view::GpuView;
use ffgs_core::Gaussians;
use ffgs_gpu::{Buffer, GpuError, Groups};
use ffgs_rasterizer::constants::ENTRY;
use ffgs_rasterizer::{TopContributors, View};

/// Channels that one pass over the pixels sums.
pub(crate) const CHANNELS: usize = ENTRY - 1;
/// Contributors kept per pixel at most.
pub(crate) const MOST_CONTRIBUTORS: usize = 16;

/// Sums per Gaussian of `alpha T` times per-pixel channels; see [`ffgs_rasterizer::FootprintSums`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Footprints {
    channels: usize,
    sums: Vec<f32>,
    hits: Vec<u32>,
}

impl Footprints {
    /// (channels) sums of Gaussian `i`.
    pub fn of(&self, i: usize) -> &[f32] {
        &self.sums[i * self.channels..(i + 1) * self.channels]
    }

    /// Pixels where Gaussian `i` contributes and the first channel is not zero.
    pub fn hits(&self, i: usize) -> u32 {
        self.hits[i]
    }
}

/// Row-major planes of the view's size, one after the other, on the device.
#[derive(Clone, Copy, Debug)]
pub struct Planes<'a> {
    /// (count, H, W) f32.
    pub values: &'a Buffer,
    /// Number of planes, at least one.
    pub count: usize,
    /// Transmittance at which a pixel is finished, if that is sooner than in the image.
    pub finished: f32,
}

impl GpuRasterizer<'_> {
    /// Renders `gaussians` and sums `alpha T * channel` per Gaussian over the pixels, for each row-major channel; at
    /// least one channel of the view's size.
    ///
    /// # Errors
    /// When the device fails or has too little memory.
    pub fn accumulate(
        &mut self,
        gaussians: &Gaussians,
        view: &View,
        channels: &[&[f32]],
    ) -> Result<Footprints, GpuError> {
        let scene = GpuScene::upload(self.gpu, gaussians)?;
        let planes = self.gpu.upload("channels", &channels.concat())?;
        self.accumulate_planes(
            &scene,
            view,
            &Planes { values: &planes, count: channels.len(), finished: 0.0 },
            scene.count,
        )
    }

    /// The same for a scene and planes that are on the device; sums of the first `rows` Gaussians only.
    ///
    /// # Errors
    /// When the device fails or has too little memory.
    pub fn accumulate_planes(
        &mut self,
        scene: &GpuScene,
        view: &View,
        planes: &Planes,
        rows: usize,
    ) -> Result<Footprints, GpuError> {
        let gpu = self.gpu;
        let view = GpuView::new(gpu, view.camera, view.background, view.tiles)?;
        self.render_on_device(scene, &view)?;
        let totals = gpu.buffer("footprints", (scene.count * ENTRY * 4) as u64)?;
        let channels = planes.count;
        let mut out = Footprints { channels, sums: vec![0.0; rows * channels], hits: vec![0; rows] };
        for first in (0..channels).step_by(CHANNELS) {
            let span = [first, CHANNELS.min(channels - first)];
            self.sum(scene, &view, planes, span, &totals)?;
            let sums: Vec<[f32; ENTRY]> = gpu.download(&totals, rows)?;
            for (i, row) in sums.iter().enumerate() {
                let at = i * channels + first;
                out.sums[at..at + span[1]].copy_from_slice(&row[..span[1]]);
                out.hits[i] = row[CHANNELS] as u32;
            }
        }
        Ok(out)
    }

    /// Sums of `count` planes from `first` on, into `totals`.
    fn sum(
        &self,
        scene: &GpuScene,
        view: &GpuView,
        planes: &Planes,
        [first, count]: [usize; 2],
        totals: &Buffer,
    ) -> Result<(), GpuError> {
        let (gpu, s) = (self.gpu, &self.scratch);
        let span = gpu.uniform("channels", &[first as u32, count as u32, planes.finished.to_bits(), 0])?;
        let sum = [&view.uniform, &span, &s.splats, &s.list, &view.slots, &s.last, planes.values, &s.entries];
        let mut commands = gpu.commands();
        let kernel = commands.pick(&kernels::FOOTPRINT, &kernels::FOOTPRINT_SUBGROUPS);
        commands.run(kernel, &sum, Groups::of(view.parts(), 1));
        let total = [&view.uniform, &s.extents, &s.entries, totals];
        commands.run(&kernels::FOOTPRINT_TOTALS, &total, Groups::Items(scene.count));
        gpu.submit(commands)
    }

    /// Renders `gaussians` and lists the `count` (at most 16) largest contributions of each pixel.
    ///
    /// # Errors
    /// When the device fails or has too little memory.
    pub fn top_contributors(
        &mut self,
        gaussians: &Gaussians,
        view: &View,
        count: usize,
    ) -> Result<TopContributors, GpuError> {
        let gpu = self.gpu;
        let count = count.clamp(1, MOST_CONTRIBUTORS);
        let scene = GpuScene::upload(gpu, gaussians)?;
        let on_device = GpuView::new(gpu, view.camera, view.background, view.tiles)?;
        self.render_uploaded(&scene, &on_device)?;
        let entries = on_device.size().pixels() * count;
        let empty = vec![[-1_i32, 0]; entries];
        let top = gpu.upload("top contributors", &empty)?;
        let kept = gpu.uniform("kept", &[count as u32, 0, 0, 0])?;
        let s = &self.scratch;
        let buffers = [&on_device.uniform, &kept, &s.splats, &s.list, &on_device.slots, &s.last, &top];
        let mut commands = gpu.commands();
        commands.run(&kernels::TOP_CONTRIBUTORS, &buffers, Groups::of(4 * on_device.slots(), 1));
        gpu.submit(commands)?;
        let rows: Vec<[u32; 2]> = gpu.download(&top, entries)?;
        Ok(TopContributors {
            count,
            indices: rows.iter().map(|row| row[0] as i32).collect(),
            weights: rows.iter().map(|row| f32::from_bits(row[1])).collect(),
        })
    }
}
