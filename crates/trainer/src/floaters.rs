//! Floaters: faint Gaussians in mid-air. Each contributes a little to photographs that show something far behind it; from another viewpoint,
//! together they look like a veil (docs/adr/0087-floaters-are-removed.md).

use ffgs_core::{Camera, Gaussians, PixelFilter, SH_C0, TRANSPARENT, TrainingView, logit, sigmoid};
use ffgs_rasterizer::{Background, CpuRasterizer, FootprintSums, RenderTape, View};
use glam::DVec3;

/// Natural logarithm of how many times farther than a floater lies what its pixels show: 1.65 times.
const FAR_BEHIND: f32 = 0.5;
/// Transmittance from which a pixel shows the sky, whose distance says nothing.
const SKY: f32 = 0.5;
/// Opacity of Gaussians that hide nothing of each other.
const FAINT: f32 = 0.01;
/// Larger views are reduced: distances need no more pixels than these.
const PIXELS: usize = 512 * 512;
/// Nor more views than these, evenly among all.
const VIEWS: usize = 64;

/// Which Gaussians of `layer` float, (N): those less opaque than `opaque` where the views show, on average, something much farther away.
pub(crate) fn floaters(layer: &Gaussians, opaque: f32, views: &[TrainingView]) -> Vec<bool> {
    let cameras: Vec<Camera> = views.iter().map(|view| view.camera).collect();
    let behind = depths_behind(&[layer], &cameras);
    let faint = |i: usize| sigmoid(layer.opacity_logits[i]) < opaque;
    let floats: Vec<bool> = (0..layer.len()).map(|i| faint(i) && behind[i] > FAR_BEHIND).collect();
    tracing::debug!("{} of {} Gaussians float", floats.iter().filter(|&&f| f).count(), layer.len());
    floats
}

/// Natural logarithm of the depth that a pixel shows over the depth of the Gaussian: its mean over the pixels to which the Gaussian contributes,
/// weighted by how much it contributes, (N) of all layers in turn. 0 where no camera shows the Gaussian in front of something else than the sky.
pub fn depths_behind(layers: &[&Gaussians], cameras: &[Camera]) -> Vec<f32> {
    let rasterizer = CpuRasterizer::default();
    let (mut tape, mut sums) = (RenderTape::default(), FootprintSums::default());
    let mut painted = uncoloured(layers);
    let (mut farther, mut weights) = (vec![0.0_f32; painted.len()], vec![0.0_f32; painted.len()]);
    for camera in cameras.iter().step_by(cameras.len().div_ceil(VIEWS).max(1)) {
        let camera = reduced(camera);
        let frame = View { camera: &camera, background: Background::Colour([0.0; 3]), tiles: None };
        let depths = log_depths(&painted.means, &camera);
        painted.sh.iter_mut().zip(&depths).for_each(|(sh, depth)| *sh = [(depth - 0.5) / SH_C0; 3]);
        rasterizer.render(&painted, &frame, &mut tape);
        let [solid, shown] = shown(&tape);
        rasterizer.accumulate(&painted, &frame, &[&solid, &shown], &mut tape, &mut sums);
        for (i, depth) in depths.iter().enumerate() {
            let [weight, shown] = [0, 1].map(|channel| sums.of(i)[channel]);
            farther[i] += shown - weight * depth;
            weights[i] += weight;
        }
    }
    farther.iter().zip(&weights).map(|(sum, weight)| if *weight > 0.0 { sum / weight } else { 0.0 }).collect()
}

/// As [`depths_behind`], in one view and in front of what shows without all the Gaussians `of` (indices of all layers in turn), one value for each of these:
/// they do not hide each other, nor what lies behind them.
pub fn depths_without(layers: &[&Gaussians], of: &[usize], camera: &Camera) -> Vec<f32> {
    let rasterizer = CpuRasterizer::default();
    let (mut tape, mut sums) = (RenderTape::default(), FootprintSums::default());
    let mut painted = uncoloured(layers);
    let camera = reduced(camera);
    let frame = View { camera: &camera, background: Background::Colour([0.0; 3]), tiles: None };
    let depths = log_depths(&painted.means, &camera);
    painted.sh.iter_mut().zip(&depths).for_each(|(sh, depth)| *sh = [(depth - 0.5) / SH_C0; 3]);
    let mut faint = painted.select(of);
    faint.opacity_logits.fill(logit(FAINT));
    of.iter().for_each(|&i| painted.opacity_logits[i] = TRANSPARENT);
    rasterizer.render(&painted, &frame, &mut tape);
    let [solid, shown] = shown(&tape);
    rasterizer.render(&faint, &frame, &mut tape);
    rasterizer.accumulate(&faint, &frame, &[&solid, &shown], &mut tape, &mut sums);
    let behind = |(i, &of): (usize, &usize)| {
        let [weight, shown] = [0, 1].map(|channel| sums.of(i)[channel]);
        if weight > 0.0 { shown / weight - depths[of] } else { 0.0 }
    };
    of.iter().enumerate().map(behind).collect()
}

/// Per pixel of a rendered picture of values: whether it shows something else than the sky, and the mean value of that.
fn shown(tape: &RenderTape) -> [Vec<f32>; 2] {
    let through = tape.transmittance();
    let solid = |pixel: usize| f32::from(u8::from(through[pixel] < SKY));
    let value = |pixel: usize| solid(pixel) * tape.image().pixel(pixel)[0] / (1.0 - through[pixel]).max(SKY);
    [(0..through.len()).map(solid).collect(), (0..through.len()).map(value).collect()]
}

/// The shapes and opacities of all layers in turn, with one colour a Gaussian.
fn uncoloured(layers: &[&Gaussians]) -> Gaussians {
    let count = layers.iter().map(|layer| layer.len()).sum();
    let filter = layers.first().map_or_else(PixelFilter::default, |layer| layer.filter);
    let mut out = Gaussians::zeros(count, 0).with_filter(filter);
    let mut start = 0;
    for layer in layers {
        let place = start..start + layer.len();
        start = place.end;
        out.means[place.clone()].copy_from_slice(&layer.means);
        out.quats[place.clone()].copy_from_slice(&layer.quats);
        out.log_scales[place.clone()].copy_from_slice(&layer.log_scales);
        out.opacity_logits[place].copy_from_slice(&layer.opacity_logits);
    }
    out
}

fn reduced(camera: &Camera) -> Camera {
    let share = camera.size().pixels() as f64 / PIXELS as f64;
    camera.reduced(share.sqrt().ceil().max(1.0) as usize)
}

/// Natural logarithms of the depths in units of the least, so that none is negative, (N); 0 behind the camera.
fn log_depths(means: &[[f32; 3]], camera: &Camera) -> Vec<f32> {
    let depth = |mean: &[f32; 3]| camera.project(DVec3::from(mean.map(f64::from))).map_or(0.0, |p| p.depth);
    let depths: Vec<f64> = means.iter().map(depth).collect();
    let least = depths.iter().copied().filter(|&d| d > 0.0).fold(f64::INFINITY, f64::min);
    depths.iter().map(|&d| if d > 0.0 { (d / least).ln() as f32 } else { 0.0 }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{CpuBackend, FirstFrame, FirstFrameConfig, FirstFrameTask, train_first_frame};
    use ffgs_core::{ImageRgb8, ImageSize, Intrinsics, Mask, SkyCube, StageLog, logit};
    use glam::DMat4;

    const OPAQUE: f32 = 0.5;

    /// At the origin, along z, with that focal length (px): 48 x 32 pixels at 40, the same field of view at others.
    fn view(focal: usize) -> TrainingView {
        let size = ImageSize { width: 48 * focal / 40, height: 32 * focal / 40 };
        let [fx, cx, cy] = [focal, size.width / 2, size.height / 2].map(|v| v as f64);
        let camera = Camera::new(Intrinsics { fx, fy: fx, cx, cy }, DMat4::IDENTITY, size).unwrap();
        let image = ImageRgb8::new(size, vec![0; 3 * size.pixels()]).unwrap();
        TrainingView { camera, image, mask: Mask::filled(size, false) }
    }

    /// An opaque wall 4 m away left of the axis and the sky right of it; before them single Gaussians at `(x, z)` of an opacity each.
    fn scene(before: &[([f32; 2], f32)]) -> Gaussians {
        let wall = |i: usize| [-0.1 * (i % 30) as f32, 0.1 * (i / 30) as f32 - 1.5, 4.0];
        let places = before.iter().map(|([x, z], _)| [*x, 0.0, *z]).chain((0..900).map(wall));
        let places: Vec<[f32; 3]> = places.collect();
        let mut out = crate::from_points(&places, &vec![[0.2; 3]; places.len()], 0, 0.98);
        out.log_scales.fill([0.06_f32.ln(); 3]);
        before.iter().zip(&mut out.opacity_logits).for_each(|((_, opacity), at)| *at = logit(*opacity));
        out
    }

    fn float(before: &[([f32; 2], f32)], views: &[TrainingView]) -> Vec<bool> {
        let found = floaters(&scene(before), OPAQUE, views);
        assert!(!found[before.len()..].contains(&true), "the wall floats");
        found[..before.len()].to_vec()
    }

    #[test]
    fn faint_and_far_before_a_wall_floats() {
        let before = [
            ([-0.4, 1.0], 0.2),
            ([-0.2, 1.8], 0.2),
            ([-1.0, 3.5], 0.2),
            ([-0.8, 1.5], 0.9),
            ([0.4, 1.0], 0.2),
        ];
        // The last two: opaque, and before the sky.
        let expected = [true, true, false, false, false];
        assert_eq!(float(&before, &[view(40)]), expected);
        assert_eq!(float(&before, &[view(40), view(60)]), expected);
        assert_eq!(float(&before, &[view(1280)]), expected, "a large view, reduced");
    }

    #[test]
    fn what_no_view_shows_stays() {
        let before = [([-0.3, 1.0], 0.2), ([-0.3, -1.0], 0.2), ([-0.8, 5.0], 0.2)];
        assert_eq!(float(&before, &[]), [false; 3]);
        assert_eq!(float(&before, &[view(40)]), [true, false, false], "behind the camera, behind the wall");
        assert_eq!(floaters(&Gaussians::empty(0), OPAQUE, &[view(40)]), [false; 0]);
    }

    #[test]
    fn the_first_frame_loses_them_or_keeps_all() {
        let before = [([-0.4, 1.0], 0.2), ([0.4, 1.0], 0.2)];
        let count = |floater_opacity: f32| {
            let (iterations, densify_every, grow_gradient) = (10, 2, f32::INFINITY);
            let config = FirstFrameConfig {
                iterations,
                densify_every,
                grow_gradient,
                floater_opacity,
                ..Default::default()
            };
            let start = FirstFrame { gaussians: scene(&before), sky: SkyCube::filled(4, [0.2; 3]) };
            let points = start.gaussians.len();
            let task = FirstFrameTask { views: &[view(40), view(60)], start, extent: 1.0, seed: 1 };
            let mut log = StageLog::default();
            let Ok(trained) =
                train_first_frame(&CpuBackend, &config, task, &mut |_| None, &mut log, &mut |_| {});
            let told = log.changes.get("removed: in mid-air").copied().unwrap_or_default();
            assert_eq!(told as usize, points - trained.gaussians.len());
            trained.gaussians.len()
        };
        assert_eq!([count(0.0), count(OPAQUE)], [scene(&before).len(), scene(&before).len() - 1]);
    }

    #[test]
    fn depths_of_zero_infinity_and_nan_are_no_panic() {
        let mut layer = scene(&[([-0.3, 1.0], 0.2), ([0.0, 0.0], 0.2), ([0.0, 1.0], 0.2)]);
        layer.means[1] = [f32::NAN; 3];
        layer.means[2] = [0.0, 0.0, f32::INFINITY];
        assert_eq!(floaters(&layer, OPAQUE, &[view(40)])[..2], [true, false]);
    }
}
