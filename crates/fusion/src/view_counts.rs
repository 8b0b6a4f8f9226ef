//! Counts the views, and the masks, that points lie in. Blocks of points are tested view by view, so that a mask stays in the
//! cache; the points of a block run in SIMD lanes.

use crate::error::FusionError;
use ffgs_core::{Camera, Intrinsics, Mask, instructions};
use glam::DVec3;
use pulp::{Simd, WithSimd};
use rayon::prelude::*;

/// In how many views a point falls in the image, and of those in the mask.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ViewCounts {
    /// Views with the point in the mask.
    pub inside: u32,
    /// Views with the point in front of the camera and in the image.
    pub seen: u32,
}

/// Counts for every mean (m) over the V cameras and masks of one time.
///
/// # Errors
/// [`FusionError::Masks`] when their numbers or sizes differ.
pub fn count_views(
    means: &[DVec3],
    cameras: &[Camera],
    masks: &[Mask],
) -> Result<Vec<ViewCounts>, FusionError> {
    let views: Vec<(&Camera, &Mask)> = cameras.iter().zip(masks).collect();
    if cameras.len() != masks.len() || views.iter().any(|(c, m)| c.size() != m.size()) {
        return Err(FusionError::Masks { cameras: cameras.len(), masks: masks.len() });
    }
    let mut counts = vec![ViewCounts::default(); means.len()];
    counts.par_chunks_mut(BLOCK).zip(means.par_chunks(BLOCK)).for_each(|(counts, means)| {
        instructions().dispatch(Block { means, views: &views, counts });
    });
    Ok(counts)
}

/// Points a task counts.
const BLOCK: usize = 1 << 13;
/// Points projected side by side. Plain loops over them become vectors of the dispatched instruction set.
const LANES: usize = 64;

struct Block<'a> {
    means: &'a [DVec3],
    views: &'a [(&'a Camera, &'a Mask)],
    counts: &'a mut [ViewCounts],
}

impl WithSimd for Block<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let parts: Vec<Part> = self.means.chunks(LANES).map(Part::new).collect();
        for (camera, mask) in self.views {
            for (part, counts) in parts.iter().zip(self.counts.chunks_mut(LANES)) {
                let (shown, pixels) = part.pixels(camera);
                for ((count, shown), pixel) in counts.iter_mut().zip(shown).zip(pixels) {
                    count.seen += shown;
                    count.inside += shown & u32::from(mask.data()[pixel as usize]);
                }
            }
        }
    }
}

/// Points column by column; the last part ends with the world's origin.
struct Part {
    columns: [[f64; LANES]; 3],
}

impl Part {
    fn new(means: &[DVec3]) -> Self {
        let mut columns = [[0.0; LANES]; 3];
        for (k, mean) in means.iter().enumerate() {
            for (axis, column) in columns.iter_mut().enumerate() {
                column[k] = mean[axis];
            }
        }
        Self { columns }
    }

    /// Whether each point is shown (1 or 0), and the index of its pixel or 0: [`Camera::pixel_of`] to the last bit.
    #[inline(always)]
    fn pixels(&self, camera: &Camera) -> ([u32; LANES], [u32; LANES]) {
        let ([x, y, z], r, t) = (&self.columns, camera.rotation(), camera.translation());
        let Intrinsics { fx, fy, cx, cy } = camera.intrinsics();
        let (width, height) = (camera.size().width as f64, camera.size().height as f64);
        let (mut shown, mut pixels) = ([0; LANES], [0; LANES]);
        for k in 0..LANES {
            let along =
                |axis: usize| r.x_axis[axis] * x[k] + r.y_axis[axis] * y[k] + r.z_axis[axis] * z[k] + t[axis];
            let depth = along(2);
            let (column, row) = (fx * along(0) / depth + cx, fy * along(1) / depth + cy);
            let inside = column >= 0.0 && row >= 0.0 && column < width && row < height && depth > 0.0;
            let pixel = row.trunc() * width + column.trunc();
            shown[k] = u32::from(inside);
            pixels[k] = if inside { pixel } else { 0.0 } as u32;
        }
        (shown, pixels)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ffgs_core::ImageSize;
    use ffgs_testkit::vectorised;
    use glam::DMat4;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn counts_are_those_of_one_point_after_another() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let size = ImageSize { width: 40, height: 30 };
        let intrinsics = Intrinsics { fx: 30.0, fy: 35.0, cx: 18.0, cy: 16.5 };
        let camera = |turn: f64| {
            let pose = DMat4::from_translation(DVec3::new(0.1, -0.2, 1.0)) * DMat4::from_rotation_y(turn);
            Camera::new(intrinsics, pose, size).unwrap()
        };
        let cameras: Vec<Camera> = (0..5).map(|v| camera(f64::from(v))).collect();
        let mut mask =
            || Mask::new(size, (0..size.pixels()).map(|_| rng.random_range(0..2)).collect()).unwrap();
        let masks: Vec<Mask> = cameras.iter().map(|_| mask()).collect();
        let mut point = || DVec3::from_array(std::array::from_fn(|_| rng.random_range(-3.0..3.0)));
        let mut means: Vec<DVec3> = (0..BLOCK + 70).map(|_| point()).collect();
        means[3] = DVec3::NAN;
        let counts = count_views(&means, &cameras, &masks).unwrap();
        assert!(counts.iter().any(|c| c.inside > 0 && c.inside < c.seen));
        for (&mean, &found) in means.iter().zip(&counts) {
            let seen = cameras.iter().zip(&masks).filter_map(|(c, m)| Some((c.pixel_of(mean)?, m)));
            let inside = seen.clone().filter(|((x, y), m)| m.contains(*x, *y)).count() as u32;
            assert_eq!(found, ViewCounts { inside, seen: seen.count() as u32 });
        }
        let views: Vec<(&Camera, &Mask)> = cameras.iter().zip(&masks).collect();
        let count = |set| {
            let mut out = vec![ViewCounts::default(); means.len()];
            vectorised(set, Block { means: &means, views: &views, counts: &mut out })?;
            Some(out)
        };
        assert!((0..3).filter_map(count).all(|found| found == counts), "an instruction set differs");
    }
}
