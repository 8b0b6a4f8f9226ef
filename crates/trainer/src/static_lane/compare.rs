//! What the photographs say about the renders: the residuals of all views, and what these send back to the Gaussians.

use super::trace::ViewTrace;
use crate::background::{BackgroundConfig, SkyBehind, outside};
use ffgs_core::{Gaussians, PlanarImage, SkyCube, TrainingView};
use ffgs_rasterizer::{Background, CpuRasterizer, RenderTape, View};
use glam::Vec3;
use rayon::prelude::*;

/// Photograph minus render of one view.
pub(super) struct Residual {
    /// (pixels) zero at and around the foreground.
    pub(super) values: Vec<Vec3>,
    /// (pixels) the others. An error of exactly zero counts too: the sky at night fits to the bit.
    counted: Vec<bool>,
}

impl Residual {
    /// `A^T` of it as far as one view goes: over (seen).
    fn sent_back(&self, trace: &ViewTrace) -> Vec<Vec3> {
        let mut back = vec![Vec3::ZERO; trace.seen.len()];
        for (pixel, &value) in self.values.iter().enumerate().filter(|(_, value)| **value != Vec3::ZERO) {
            trace.of(pixel).iter().for_each(|&(at, w)| back[at as usize] += w * value);
        }
        back
    }

    fn squares(&self) -> f64 {
        self.values.iter().map(|r| f64::from(r.length_squared())).sum()
    }
}

/// What the photographs say about the renders.
pub(super) struct Compared {
    /// Over (view, seen): what the residuals send back.
    pub(super) back: Vec<Vec3>,
    /// Sum of the squared residuals.
    pub(super) squares: f64,
    /// (views, pixels) those outside the masks.
    pub(super) counted: Vec<Vec<bool>>,
}

/// Renders all views, a few at a time, and keeps of their residuals what the solve needs.
pub(super) fn compare(
    config: &BackgroundConfig,
    traces: &[ViewTrace],
    views: &[TrainingView],
    sky: &SkyCube,
    layer: &Gaussians,
) -> Compared {
    let (mut tape, mut behind) = (RenderTape::default(), SkyBehind::new());
    let mut out = Compared { back: Vec::new(), squares: 0.0, counted: Vec::with_capacity(views.len()) };
    out.back.reserve_exact(traces.iter().map(|t| t.seen.len()).sum());
    let together = rayon::current_num_threads();
    for (views, traces) in views.chunks(together).zip(traces.chunks(together)) {
        let render = |(view, trace): (&TrainingView, &ViewTrace)| {
            let background = behind.render(sky, &view.camera);
            let counts = outside(view, config.mask_dilation);
            let on_lattice = trace.on_lattice();
            let counted =
                counts.data().par_iter().enumerate().map(|(p, &counts)| counts != 0 && on_lattice(p));
            residual(view, layer, background, counted.collect(), &mut tape)
        };
        let residuals: Vec<Residual> = views.iter().zip(traces).map(render).collect();
        let sent =
            |(residual, trace): (&Residual, &ViewTrace)| (residual.sent_back(trace), residual.squares());
        let parts: Vec<(Vec<Vec3>, f64)> = residuals.par_iter().zip(traces).map(sent).collect();
        for ((back, squares), residual) in parts.into_iter().zip(residuals) {
            out.back.extend(back);
            out.squares += squares;
            out.counted.push(residual.counted);
        }
    }
    out
}

/// Photograph minus render where `counted` says so.
pub(super) fn residual(
    view: &TrainingView,
    layer: &Gaussians,
    behind: &PlanarImage,
    counted: Vec<bool>,
    tape: &mut RenderTape,
) -> Residual {
    let frame = View { camera: &view.camera, background: Background::Image(behind), tiles: None };
    CpuRasterizer::default().render(layer, &frame, tape);
    let difference = |p: usize| Vec3::from(view.image.pixel(p)) - Vec3::from(tape.image().pixel(p));
    let value = |(p, &counts): (usize, &bool)| if counts { difference(p) } else { Vec3::ZERO };
    Residual { values: counted.par_iter().enumerate().map(value).collect(), counted }
}
