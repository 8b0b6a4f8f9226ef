//! Exposures of cameras, from surface points that several of them see (docs/adr/0055-exposures.md).

use ffgs_core::{Camera, Exposure, Gaussians, TrainingView, median};
use ffgs_rasterizer::{Background, CpuRasterizer, RenderOptions, RenderTape, View};
use glam::{DVec2, DVec3};
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

/// Surface points, over all views.
const POINTS: usize = 20_000;
/// Views of a point at most.
const MOST_VIEWS: usize = 16;
/// Pixels of a view beyond which it is reduced: more of them would not make more points.
const MOST_PIXELS: usize = 640 * 360;
/// Contributions of a pixel that its depth is the mean of.
const CONTRIBUTIONS: usize = 8;
/// Alpha from which a pixel shows a surface.
const OPAQUE: f32 = 0.7;
/// Largest difference of two depths of one point, as a share of the depth.
const SAME_DEPTH: f64 = 0.02;
/// Values nearer than this to black or white are clipped: they say nothing of the exposure.
pub(crate) const CLIPPED: f64 = 0.02;
/// Standard deviation of an offset before anything is known (log odds).
const USUAL: f64 = 0.5;
/// Least scale of the residuals (log odds): views of one surface never agree better.
const LEAST_SCALE: f64 = 0.05;
/// Residual at which the weight is halved, in units of the median residual.
const SOFT: f64 = 1.5;
/// Fewest points that a view shares with others: less is chance, and the view is neutral.
const FEWEST: usize = 50;
/// Rounds of reweighting.
const ROUNDS: usize = 12;

/// What one view shows at a surface point, in one channel.
#[derive(Clone, Copy, Debug)]
struct Sight {
    view: usize,
    /// Log odds of the value.
    odds: f64,
    /// Inverse variance of the log odds at constant noise of the value; 1 at mid-grey, 0 where it is clipped.
    weight: f64,
}

/// Exposures in which the views agree best on the surfaces of `gaussians`; their mean is neutral.
///
/// A surface point is the mean depth of a pixel; the other views that have that depth there see the same point. Each point has an unknown
/// colour, each view one offset per channel, and the robust squared difference is least: a surface that reflects, or a depth that is wrong,
/// is outvoted. A view that shares next to nothing with others is neutral.
pub fn estimate_exposures(gaussians: &Gaussians, views: &[TrainingView]) -> Vec<Exposure> {
    let views: Vec<TrainingView> =
        views.par_iter().map(|view| view.reduced(factor(view, MOST_PIXELS))).collect();
    let views = views.as_slice();
    let depths: Vec<Vec<f32>> = views.iter().map(|view| depths(gaussians, &view.camera)).collect();
    let points: Vec<Vec<(usize, usize)>> =
        (0..views.len()).into_par_iter().flat_map_iter(|view| points(view, views, &depths)).collect();
    let channels: Vec<Vec<f64>> = (0..3)
        .into_par_iter()
        .map(|channel| {
            let sight = |&(view, pixel): &(usize, usize)| {
                Sight::new(view, f64::from(views[view].image.pixel(pixel)[channel]))
            };
            let seen: Vec<Vec<Sight>> =
                points.iter().map(|point| point.iter().filter_map(sight).collect()).collect();
            offsets(&seen, views.len())
        })
        .collect();
    (0..views.len()).map(|view| Exposure { offsets: [0, 1, 2].map(|c| channels[c][view]) }).collect()
}

/// How far a view is reduced, to have at most so many pixels.
pub(crate) fn factor(view: &TrainingView, most_pixels: usize) -> usize {
    (view.camera.size().pixels() as f64 / most_pixels as f64).sqrt().ceil() as usize
}

impl Sight {
    fn new(view: usize, value: f64) -> Option<Self> {
        (value > CLIPPED && value < 1.0 - CLIPPED).then(|| Self {
            view,
            odds: (value / (1.0 - value)).ln(),
            weight: (4.0 * value * (1.0 - value)).powi(2),
        })
    }
}

/// Depth of the surface in every pixel (m); 0 where there is none.
fn depths(gaussians: &Gaussians, camera: &Camera) -> Vec<f32> {
    let rasterizer = CpuRasterizer::new(RenderOptions { sh_degree: Some(0), ..RenderOptions::default() });
    let view = View { camera, background: Background::Colour([0.0; 3]), tiles: None };
    let top = rasterizer.top_contributors(gaussians, &view, CONTRIBUTIONS, &mut RenderTape::default());
    let of_gaussian = |mean: &[f32; 3]| {
        camera.project(DVec3::from(mean.map(f64::from))).map(|projection| projection.depth as f32)
    };
    let depths: Vec<Option<f32>> = gaussians.means.par_iter().map(of_gaussian).collect();
    let pixels = top.indices.par_chunks(CONTRIBUTIONS).zip(top.weights.par_chunks(CONTRIBUTIONS));
    let depth = |(indices, weights): (&[i32], &[f32])| {
        let depth_of = |index: i32| depths[usize::try_from(index).ok()?];
        let seen = indices.iter().zip(weights).filter_map(|(index, w)| Some((depth_of(*index)?, w)));
        let (sum, alpha) = seen.fold((0.0, 0.0), |(sum, alpha), (depth, w)| (sum + depth * w, alpha + w));
        if alpha > OPAQUE { sum / alpha } else { 0.0 }
    };
    pixels.map(depth).collect()
}

/// Surface points of a view that other views see: each as (view, pixel), this view first.
fn points(view: usize, views: &[TrainingView], depths: &[Vec<f32>]) -> Vec<Vec<(usize, usize)>> {
    let size = views[view].camera.size();
    let stride = ((size.pixels() * views.len()) as f64 / POINTS as f64).sqrt().ceil().max(1.0) as usize;
    let at = |x: usize, y: usize| {
        let pixel = y * size.width + x;
        let depth = f64::from(depths[view][pixel]);
        let point = (depth > 0.0).then(|| point(&views[view].camera, [x, y], depth))?;
        let others: Vec<_> = (0..views.len())
            .filter(|other| *other != view)
            .filter_map(|v| sees(v, point, views, depths))
            .collect();
        let every = others.len().div_ceil(MOST_VIEWS - 1).max(1);
        let seen: Vec<_> = std::iter::once((view, pixel)).chain(others.into_iter().step_by(every)).collect();
        (seen.len() > 1).then_some(seen)
    };
    let grid =
        (0..size.height).step_by(stride).flat_map(|y| (0..size.width).step_by(stride).map(move |x| (x, y)));
    grid.filter_map(|(x, y)| at(x, y)).collect()
}

/// The point at a depth (m) behind the centre of a pixel.
fn point(camera: &Camera, [x, y]: [usize; 2], depth: f64) -> DVec3 {
    let ray = camera.ray(DVec2::new(x as f64 + 0.5, y as f64 + 0.5));
    camera.center() + ray * (depth / camera.rotation().row(2).dot(ray))
}

/// The view and its pixel that shows a point.
fn sees(view: usize, point: DVec3, views: &[TrainingView], depths: &[Vec<f32>]) -> Option<(usize, usize)> {
    let camera = &views[view].camera;
    let projection = camera.project(point)?;
    let (x, y) = (projection.pixel.x.floor(), projection.pixel.y.floor());
    let size = camera.size();
    let inside = x >= 0.0 && y >= 0.0 && x < size.width as f64 && y < size.height as f64;
    let pixel = inside.then(|| y as usize * size.width + x as usize)?;
    let difference = (f64::from(depths[view][pixel]) - projection.depth).abs();
    (difference < SAME_DEPTH * projection.depth).then_some((view, pixel))
}

/// Offsets of one channel: iteratively reweighted least squares (Geman and McClure's weights) of `odds - offset - point`.
fn offsets(points: &[Vec<Sight>], views: usize) -> Vec<f64> {
    let mut shared = vec![0; views];
    points.iter().filter(|p| p.len() > 1).flatten().for_each(|sight| shared[sight.view] += 1);
    let points: Vec<Vec<Sight>> =
        points.iter().map(|p| p.iter().filter(|s| shared[s.view] >= FEWEST).copied().collect()).collect();
    let mut offsets = DVector::zeros(views);
    let mut scale = USUAL;
    for _ in 0..ROUNDS {
        let mut normal = DMatrix::from_diagonal_element(views, views, USUAL.powi(-2));
        let mut right = DVector::zeros(views);
        let mut residuals = Vec::new();
        for point in points.iter().filter(|point| point.len() > 1) {
            let middle = median(point.iter().map(|sight| sight.odds - offsets[sight.view])).unwrap_or(0.0);
            let weights: Vec<f64> = point
                .iter()
                .map(|sight| {
                    let residual: f64 = sight.odds - offsets[sight.view] - middle;
                    residuals.push(residual.abs());
                    sight.weight / (scale * scale + residual * residual)
                })
                .collect();
            add_point(point, &weights, &mut normal, &mut right);
        }
        scale = (SOFT * median(residuals).unwrap_or(0.0)).max(LEAST_SCALE);
        if let Some(factors) = normal.cholesky() {
            offsets = factors.solve(&right);
        }
        offsets.add_scalar_mut(-offsets.mean());
    }
    offsets.iter().copied().collect()
}

/// Adds a point, whose own value is eliminated, to the normal equations of the offsets.
fn add_point(point: &[Sight], weights: &[f64], normal: &mut DMatrix<f64>, right: &mut DVector<f64>) {
    let sum: f64 = weights.iter().sum();
    let mean = point.iter().zip(weights).map(|(sight, w)| sight.odds * w).sum::<f64>() / sum;
    for (a, w) in point.iter().zip(weights) {
        right[a.view] += w * (a.odds - mean);
        normal[(a.view, a.view)] += w;
        for (b, v) in point.iter().zip(weights) {
            normal[(a.view, b.view)] -= w * v / sum;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::from_points;
    use ffgs_core::{ImageRgb8, ImageSize, Intrinsics, Mask, PlanarImage};
    use glam::DMat4;

    const SIZE: ImageSize = ImageSize { width: 96, height: 64 };

    /// A wall of many colours at z = 2.
    fn wall() -> Gaussians {
        let points: Vec<[f32; 3]> =
            (0..6000).map(|i| [(i % 100) as f32 * 0.04 - 2.0, (i / 100) as f32 * 0.04 - 1.2, 2.0]).collect();
        let colours: Vec<[f32; 3]> =
            (0..6000).map(|i| [11, 17, 29].map(|k| 0.2 + 0.6 * ((i / 7 * k) % 97) as f32 / 97.0)).collect();
        from_points(&points, &colours, 0, 0.95)
    }

    /// Cameras in a row before it.
    fn camera(i: usize) -> Camera {
        let intrinsics = Intrinsics { fx: 80.0, fy: 80.0, cx: 48.0, cy: 32.0 };
        Camera::new(intrinsics, DMat4::from_translation(DVec3::X * (0.5 - 0.25 * i as f64)), SIZE).unwrap()
    }

    fn photographs(wall: &Gaussians, exposures: &[Exposure]) -> Vec<TrainingView> {
        taken_by(camera, wall, exposures)
    }

    fn taken_by(
        camera: impl Fn(usize) -> Camera,
        wall: &Gaussians,
        exposures: &[Exposure],
    ) -> Vec<TrainingView> {
        let rasterizer = CpuRasterizer::new(RenderOptions::default());
        let mut tape = RenderTape::default();
        let mut photograph = |(i, exposure): (usize, &Exposure)| {
            let camera = camera(i);
            let view = View { camera: &camera, background: Background::Colour([0.0; 3]), tiles: None };
            rasterizer.render(wall, &view, &mut tape);
            let mut image: PlanarImage = tape.image().clone();
            exposure.apply(&mut image);
            TrainingView { camera, image: ImageRgb8::from(&image), mask: Mask::filled(camera.size(), false) }
        };
        exposures.iter().enumerate().map(&mut photograph).collect()
    }

    fn furthest(found: &[Exposure], expected: &[Exposure]) -> f64 {
        let pairs = found.iter().zip(expected);
        let differences = pairs.flat_map(|(a, b)| [0, 1, 2].map(|c| (a.offsets[c] - b.offsets[c]).abs()));
        differences.fold(0.0, |most, d| if d.is_nan() { f64::NAN } else { most.max(d) })
    }

    /// Their means are zero.
    const EXPOSURES: [Exposure; 4] = [
        Exposure { offsets: [0.6, 0.4, 0.1] },
        Exposure { offsets: [-0.8, -0.3, 0.0] },
        Exposure { offsets: [0.1, 0.1, 0.3] },
        Exposure { offsets: [0.1, -0.2, -0.4] },
    ];

    #[test]
    fn exposures_are_found_and_equal_ones_are_neutral() {
        let wall = wall();
        let found = estimate_exposures(&wall, &photographs(&wall, &EXPOSURES));
        assert!(furthest(&found, &EXPOSURES) < 0.03, "{found:?}");
        let neutral = [Exposure::NEUTRAL; 4];
        let found = estimate_exposures(&wall, &photographs(&wall, &neutral));
        assert!(furthest(&found, &neutral) < 0.01, "{found:?}");
    }

    /// Larger than what is compared: reduced to half, with a column and a row that no block holds.
    #[test]
    fn exposures_of_large_photographs_are_found() {
        let (wall, size) = (wall(), ImageSize { width: 769, height: 513 });
        let large = |i: usize| {
            let intrinsics = Intrinsics { fx: 640.0, fy: 640.0, cx: 384.0, cy: 256.0 };
            let pose = DMat4::from_translation(DVec3::X * (0.5 - 0.25 * i as f64));
            Camera::new(intrinsics, pose, size).unwrap()
        };
        let views = taken_by(large, &wall, &EXPOSURES);
        assert_eq!(factor(&views[0], MOST_PIXELS), 2);
        let found = estimate_exposures(&wall, &views);
        assert!(furthest(&found, &EXPOSURES) < 0.03, "{found:?}");
    }

    #[test]
    fn a_photograph_that_is_half_hidden_is_outvoted() {
        let wall = wall();
        let mut views = photographs(&wall, &EXPOSURES);
        let mut data = views[2].image.data().to_vec();
        data[..SIZE.pixels()].fill(230);
        views[2].image = ImageRgb8::new(SIZE, data).unwrap();
        assert!(furthest(&estimate_exposures(&wall, &views), &EXPOSURES) < 0.05);
    }

    #[test]
    fn a_few_shared_points_are_chance() {
        let point = |view_b: f64| vec![Sight::new(0, 0.5).unwrap(), Sight::new(1, view_b).unwrap()];
        assert_eq!(offsets(&vec![point(0.7); FEWEST - 1], 2), [0.0; 2]);
        let found = offsets(&vec![point(0.7); FEWEST], 2);
        let expected = (0.7_f64 / 0.3).ln();
        assert!((found[1] - found[0] - expected).abs() < 0.05 * expected, "{found:?}");
    }

    #[test]
    fn a_view_that_shares_nothing_is_neutral() {
        let wall = wall();
        let mut views = photographs(&wall, &EXPOSURES[..3]);
        let away = DMat4::from_rotation_y(std::f64::consts::PI) * camera(0).camera_from_world();
        views[2].camera = Camera::new(camera(0).intrinsics(), away, SIZE).unwrap();
        let found = estimate_exposures(&wall, &views);
        assert!(found[2].offsets.iter().all(|o| o.abs() < 1e-6), "{found:?}");
        let difference = found[0].offsets[0] - found[1].offsets[0];
        assert!((difference - 1.4).abs() < 0.05, "{difference}");
        assert!(estimate_exposures(&Gaussians::empty(0), &views).iter().all(|e| *e == Exposure::NEUTRAL));
        assert!(estimate_exposures(&wall, &[]).is_empty());
    }
}
