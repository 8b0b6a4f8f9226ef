//! What stays fixed of every view, once per training: the static layer and the sky, cut at the depth of the layer under
//! training (docs/adr/0003).

use crate::backend::{CutLayers, TaskView};
use crate::background::SkyBehind;
use ffgs_core::{Gaussians, ImageSize, Mask, PlanarImage};
use ffgs_rasterizer::{Background, CpuRasterizer, RenderTape, SplitLayers, TileDepths, TileMask, View};
use rayon::prelude::*;
use std::ops::Range;

/// What stays fixed of one view. Columns hold the pixels of the computed tiles only: nothing else of an image is read
/// or written in a step, and memory grows with the foreground as time does.
struct CutView {
    region: Mask,
    /// Pixels of the computed tiles.
    runs: Vec<Range<usize>>,
    /// Static colour in front of the layer, channel by channel.
    front: Vec<f32>,
    /// Transmittance of that.
    transmittance: Vec<f32>,
    /// Static colour and sky behind the layer, channel by channel.
    behind: Vec<f32>,
    /// Weight of the mean alpha outside the mask, divided by the pixels of the mask.
    outside_alpha: f32,
}

/// The cut views, and images in which the one at hand is laid out.
pub(super) struct Cut<'a> {
    maker: Maker<'a>,
    /// Depth of the layer in each view, as it was at the start.
    depths: Vec<TileDepths>,
    /// Those that were at hand so far.
    views: Vec<Option<CutView>>,
    size: Option<ImageSize>,
    /// Of the view at hand, meaningful in its computed tiles.
    behind: PlanarImage,
    image: PlanarImage,
    /// Derivative of the alpha penalty with respect to transmittance, likewise.
    penalty: Vec<f32>,
}

impl<'a> Cut<'a> {
    /// Finds where each view is to be cut; a view is cut when it is first at hand, as a training with fewer steps than views
    /// needs some of them only. Counts in `seen` the views that see each Gaussian of `layer`.
    pub(crate) fn new(
        layers: CutLayers<'a>,
        layer: &Gaussians,
        views: &[TaskView],
        rasterizer: CpuRasterizer,
        seen: &mut [u32],
    ) -> Self {
        let mut maker = Maker {
            layers,
            rasterizer,
            tape: RenderTape::default(),
            sky: SkyBehind::new(),
            split: SplitLayers::default(),
        };
        let depths = views.iter().map(|view| maker.depths(view, layer, seen)).collect();
        let one = ImageSize { width: 1, height: 1 };
        let [behind, image] = [(); 2].map(|()| PlanarImage::zeros(one));
        let views = views.iter().map(|_| None).collect();
        Self { maker, depths, views, size: None, behind, image, penalty: Vec::new() }
    }

    /// Lays what is cut of a view into images of its size.
    pub(crate) fn aim(&mut self, index: usize, task: &TaskView) {
        let Self { maker, depths, views, .. } = self;
        let view = views[index].get_or_insert_with(|| maker.view(task, &depths[index]));
        let size = view.region.size();
        if self.size != Some(size) {
            self.behind.reset(size);
            self.image.reset(size);
            self.penalty.resize(size.pixels(), 0.0);
            self.size = Some(size);
        }
        let pixels = view.transmittance.len();
        for_each_run(&mut self.behind, &view.runs, |channel, _, at, out| {
            out.copy_from_slice(&view.behind[channel * pixels..][at]);
        });
        let weight = view.outside_alpha;
        let mut transmittance = view.transmittance.iter();
        for run in &view.runs {
            let region = &view.region.data()[run.clone()];
            for ((out, &inside), &t) in
                self.penalty[run.clone()].iter_mut().zip(region).zip(&mut transmittance)
            {
                *out = if inside == 0 { -weight * t } else { 0.0 };
            }
        }
    }

    /// What stands behind the layer in the view at hand.
    pub(crate) fn behind(&self) -> &PlanarImage {
        &self.behind
    }

    /// Derivative of the alpha penalty by the layer's transmittance in the view at hand.
    pub(crate) fn penalty(&self) -> &[f32] {
        &self.penalty
    }

    /// `front + T_front * drawn`, drawn = the layer over what is behind it, in the view at hand.
    pub(crate) fn compose(&mut self, index: usize, drawn: &PlanarImage) -> &PlanarImage {
        let Some(view) = &self.views[index] else { return &self.image };
        let pixels = view.transmittance.len();
        for_each_run(&mut self.image, &view.runs, |channel, run, at, out| {
            let front = &view.front[channel * pixels..][at.clone()];
            let drawn = &drawn.plane(channel)[run];
            let through = &view.transmittance[at];
            for (((out, &front), &drawn), &t) in out.iter_mut().zip(front).zip(drawn).zip(through) {
                *out = front + t * drawn;
            }
        });
        &self.image
    }

    /// From the derivative by the composed image to that by the layer's own.
    pub(crate) fn through_front(&self, index: usize, gradient: &mut PlanarImage) {
        let Some(view) = &self.views[index] else { return };
        for_each_run(gradient, &view.runs, |_, _, at, gradient| {
            gradient.iter_mut().zip(&view.transmittance[at]).for_each(|(g, &t)| *g *= t);
        });
    }
}

/// Makes cut views, one after another in the same memory.
struct Maker<'a> {
    layers: CutLayers<'a>,
    rasterizer: CpuRasterizer,
    tape: RenderTape,
    sky: SkyBehind,
    split: SplitLayers,
}

impl Maker<'_> {
    /// Where a view is to be cut. Counts the Gaussians of `layer` that it sees.
    fn depths(&mut self, task: &TaskView, layer: &Gaussians, seen: &mut [u32]) -> TileDepths {
        let camera = &task.view.camera;
        let frame = View { camera, background: Background::Colour([0.0; 3]), tiles: task.tiles.as_ref() };
        self.rasterizer.prepare(&[layer], &frame, &mut self.tape);
        self.tape.visible_indices().for_each(|i| seen[i] += 1);
        TileDepths::nearest(&self.tape)
    }

    fn view(&mut self, task: &TaskView, depths: &TileDepths) -> CutView {
        let TaskView { view, region, tiles } = task;
        let (camera, split) = (&view.camera, &mut self.split);
        let background = Background::Image(self.sky.render(self.layers.sky, camera));
        let frame = View { camera, background, tiles: tiles.as_ref() };
        self.rasterizer.render_split(self.layers.static_layer, &frame, depths, &mut self.tape, split);
        let runs = pixel_runs(tiles.as_ref(), camera.size());
        let region = region.clone().unwrap_or_else(|| Mask::filled(camera.size(), true));
        let outside_alpha = self.layers.outside_alpha / view.mask.count() as f32;
        let (front, behind) = (cut_image(&split.front, &runs), cut_image(&split.behind, &runs));
        let transmittance = cut(&split.transmittance, &runs);
        CutView { region, runs, front, transmittance, behind, outside_alpha }
    }
}

fn pixel_runs(tiles: Option<&TileMask>, size: ImageSize) -> Vec<Range<usize>> {
    tiles.map_or_else(|| std::iter::once(0..size.pixels()).collect(), |tiles| tiles.pixel_runs(size))
}

/// The values of some runs of a plane, in exactly the memory they need.
fn cut(plane: &[f32], runs: &[Range<usize>]) -> Vec<f32> {
    let mut out = Vec::with_capacity(runs.iter().map(Range::len).sum());
    runs.iter().for_each(|run| out.extend_from_slice(&plane[run.clone()]));
    out
}

fn cut_image(image: &PlanarImage, runs: &[Range<usize>]) -> Vec<f32> {
    [0, 1, 2].map(|c| cut(image.plane(c), runs)).concat()
}

/// Calls `visit(channel, run, place in the cut columns, values)` for every channel of the pixels in `runs`.
fn for_each_run(
    image: &mut PlanarImage,
    runs: &[Range<usize>],
    visit: impl Fn(usize, Range<usize>, Range<usize>, &mut [f32]) + Sync,
) {
    let pixels = image.size().pixels();
    image.data_mut().par_chunks_exact_mut(pixels).enumerate().for_each(|(channel, plane)| {
        let mut start = 0;
        for run in runs {
            let at = start..start + run.len();
            start = at.end;
            visit(channel, run.clone(), at, &mut plane[run.clone()]);
        }
    });
}
