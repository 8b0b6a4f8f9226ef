//! What the tracks of one view say of every Gaussian: an affine motion of its footprint.

use ffgs_core::{Camera, DenseMotion, Gaussians};
use ffgs_rasterizer::{Background, CpuRasterizer, FootprintSums, RenderOptions, RenderTape, View};
use glam::{DMat2, DVec2};
use rayon::prelude::*;

/// Least determinant of a regression's normal matrix.
const MIN_DETERMINANT: f64 = 1e-12;
/// Least sum of alpha T.
const MIN_WEIGHT: f64 = 1e-3;
/// A Gaussian that does not move goes by less than this (px).
const STILL_PX: f32 = 0.2;

/// Sums over the pixels of a footprint; places x, y are relative to the image's centre (px), d is the displacement.
#[derive(Clone, Copy)]
enum Channel {
    Known,
    X,
    Y,
    XX,
    XY,
    YY,
    Dx,
    Dy,
    XDx,
    YDx,
    XDy,
    YDy,
    Still,
}
/// Of them.
const CHANNELS: usize = Channel::Still as usize + 1;

/// What one view says of one Gaussian.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Footprint {
    /// Sum of alpha T over the pixels whose motion is known.
    pub weight: f64,
    /// These pixels.
    pub hits: u32,
    /// Share of the weight that does not move.
    pub still: f64,
    /// How the footprint moves; `None` where it says too little.
    pub affine: Option<Affine>,
}

/// `p -> matrix p + shift`, in pixels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Affine {
    pub matrix: DMat2,
    pub shift: DVec2,
}

impl Affine {
    pub(super) fn of(&self, pixel: DVec2) -> DVec2 {
        self.matrix * pixel + self.shift
    }
}

/// Affine motions under the footprints of `gaussians` in the image of `camera`, (N).
pub(super) fn footprints(gaussians: &Gaussians, camera: &Camera, motion: &DenseMotion) -> Vec<Footprint> {
    let size = camera.size();
    let centre = DVec2::new(size.width as f64, size.height as f64) / 2.0;
    let planes = planes(motion, centre);
    let channels: Vec<&[f32]> = planes.iter().map(Vec::as_slice).collect();
    let view = View { camera, background: Background::Colour([0.0; 3]), tiles: None };
    let rasterizer = CpuRasterizer::new(RenderOptions { sh_degree: Some(0), ..RenderOptions::default() });
    let (mut tape, mut sums) = (RenderTape::default(), FootprintSums::default());
    rasterizer.accumulate(gaussians, &view, &channels, &mut tape, &mut sums);
    let of = |i: usize| {
        let sums_of: [f64; CHANNELS] = std::array::from_fn(|c| f64::from(sums.of(i)[c]));
        regress(&sums_of, sums.hits(i), centre)
    };
    (0..gaussians.len()).into_par_iter().map(of).collect()
}

/// The channels of every pixel; all are 0 where nothing is known.
fn planes(motion: &DenseMotion, centre: DVec2) -> Vec<Vec<f32>> {
    let width = motion.size.width;
    let mut planes = vec![vec![0.0; motion.size.pixels()]; CHANNELS];
    for (pixel, [dx, dy]) in motion.flow.iter().copied().enumerate() {
        if !(motion.confidence[pixel] > 0.0) {
            continue;
        }
        let x = ((pixel % width) as f64 + 0.5 - centre.x) as f32;
        let y = ((pixel / width) as f64 + 0.5 - centre.y) as f32;
        let still = if dx.hypot(dy) < STILL_PX { 1.0 } else { 0.0 };
        let values = [1.0, x, y, x * x, x * y, y * y, dx, dy, x * dx, y * dx, x * dy, y * dy, still];
        planes.iter_mut().zip(values).for_each(|(plane, value)| plane[pixel] = value);
    }
    planes
}

/// Weighted least squares of the displacement on 1, x and y.
fn regress(sums: &[f64; CHANNELS], hits: u32, centre: DVec2) -> Footprint {
    let of = |channel: Channel| sums[channel as usize];
    let weight = of(Channel::Known);
    if !(weight > MIN_WEIGHT) {
        return Footprint { weight, hits, ..Footprint::default() };
    }
    let mean = |channel| of(channel) / weight;
    let (place, moved) =
        (DVec2::new(mean(Channel::X), mean(Channel::Y)), DVec2::new(mean(Channel::Dx), mean(Channel::Dy)));
    let skew = mean(Channel::XY) - place.x * place.y;
    let spread = DMat2::from_cols(
        DVec2::new(mean(Channel::XX) - place.x * place.x, skew),
        DVec2::new(skew, mean(Channel::YY) - place.y * place.y),
    );
    let with = |c: Channel, d: Channel, at: f64| DVec2::new(mean(c), mean(d)) - moved * at;
    // Columns: how the displacement goes with x and with y.
    let joint = DMat2::from_cols(
        with(Channel::XDx, Channel::XDy, place.x),
        with(Channel::YDx, Channel::YDy, place.y),
    );
    let determinant = weight.powi(3) * spread.determinant();
    let affine = (hits > 1 && determinant > MIN_DETERMINANT).then(|| {
        let slope = joint * spread.inverse();
        let at = place + centre;
        Affine { matrix: DMat2::IDENTITY + slope, shift: moved - slope * at }
    });
    let affine = affine.filter(|a| a.matrix.is_finite() && a.shift.is_finite());
    Footprint { weight, hits, still: mean(Channel::Still), affine }
}

/// Whether a Gaussian is known not to move: more than nine tenths of its footprint stand still in more than two views, in each of
/// more than nine pixels and at least half the weight of the best view (or 1).
pub(super) fn is_fixed(views: &[Footprint]) -> bool {
    let best = views.iter().map(|view| view.weight).fold(0.0, f64::max);
    let still = |v: &&Footprint| v.hits > 9 && v.still > 0.9 && (v.weight >= 0.5 * best || v.weight > 1.0);
    views.iter().filter(still).count() > 2
}

/// Rows of the projection to normalised device coordinates of a point at pixel `seen`, each 0 at (place, 1).
pub(super) fn rays(camera: &Camera, seen: DVec2) -> [[f64; 4]; 2] {
    let (lens, size) = (camera.intrinsics(), camera.size());
    let (rotation, shift) = (camera.rotation().transpose(), camera.translation());
    let row = |a: usize, t: f64| [rotation.col(a).x, rotation.col(a).y, rotation.col(a).z, t];
    let (right, down, ahead) = (row(0, shift.x), row(1, shift.y), row(2, shift.z));
    let equation = |along: [f64; 4], focal: f64, offset: f64, extent: f64| {
        std::array::from_fn(|c| (focal * along[c] + offset * ahead[c]) * 2.0 / extent)
    };
    [
        equation(right, lens.fx, lens.cx - seen.x, size.width as f64),
        equation(down, lens.fy, lens.cy - seen.y, size.height as f64),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::World;

    /// Pixels that all follow one affine map: every footprint finds it.
    #[test]
    fn an_affine_motion_of_the_image_is_found_under_every_footprint() {
        let world = World::new();
        let gaussians = world.gaussians();
        world.with_step(1, |step| {
            let camera = &step.before[0].camera;
            let truth = Affine {
                matrix: DMat2::from_cols(DVec2::new(1.02, -0.03), DVec2::new(0.05, 0.99)),
                shift: DVec2::new(3.0, -1.5),
            };
            let mut motion = DenseMotion::unknown(camera.size());
            let width = camera.size().width;
            for pixel in 0..motion.flow.len() {
                let at = DVec2::new((pixel % width) as f64 + 0.5, (pixel / width) as f64 + 0.5);
                motion.flow[pixel] = (truth.of(at) - at).as_vec2().to_array();
                motion.confidence[pixel] = 1.0;
            }
            let found = footprints(&gaussians, camera, &motion);
            // Of footprints with some weight: sums are in f32.
            let sure: Vec<_> = found.iter().filter(|f| f.weight > 0.5).filter_map(|f| f.affine).collect();
            assert!(sure.len() > 20, "{}", sure.len());
            for affine in sure {
                let far = (affine.matrix - truth.matrix)
                    .to_cols_array()
                    .iter()
                    .fold(0.0, |far: f64, v| far.max(v.abs()));
                assert!(
                    far < 1e-3 && affine.of(DVec2::splat(30.0)).distance(truth.of(DVec2::splat(30.0))) < 0.05,
                    "{affine:?}"
                );
            }
            let nowhere = footprints(&gaussians, camera, &DenseMotion::unknown(camera.size()));
            assert!(nowhere.iter().all(|f| f.affine.is_none() && f.hits == 0));
        });
    }

    #[test]
    fn what_stands_still_in_more_than_two_views_is_fixed() {
        let still = Footprint { weight: 5.0, hits: 20, still: 0.95, affine: None };
        assert!(is_fixed(&[still; 3]));
        assert!(!is_fixed(&[still; 2]));
        for worse in [
            Footprint { hits: 9, ..still },
            Footprint { still: 0.9, ..still },
            Footprint { weight: 0.9, ..still },
        ] {
            assert!(!is_fixed(&[still, still, worse]), "{worse:?}");
        }
    }
}
