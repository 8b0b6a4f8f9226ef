//! Chunks of Gaussians that a view cannot show are not projected.

use crate::constants::PIXEL_FILTER;
use crate::elementary::exp;
use crate::pinhole::PinholeF32;
use crate::projection::MAX_REACH;
use crate::tiles::{TileGrid, TileMask, tile_range};
use ffgs_core::Gaussians;
use glam::DVec3;
use rayon::prelude::*;
use std::ops::Range;

/// Gaussians projected as one unit of parallel work.
pub(crate) const CHUNK: usize = 1024;

/// Consecutive Gaussians of one layer.
#[derive(Clone, Debug)]
pub(crate) struct Chunk<'a> {
    pub(crate) layer: &'a Gaussians,
    /// Indices in the layer.
    pub(crate) range: Range<usize>,
    /// Number of Gaussians in the layers before.
    pub(crate) before: usize,
}

/// All chunks of some layers, in the order of the Gaussians.
pub(crate) fn chunks_of<'a>(layers: &[&'a Gaussians]) -> Vec<Chunk<'a>> {
    let mut before = 0;
    let mut chunks = Vec::new();
    for &layer in layers {
        let starts = (0..layer.len()).step_by(CHUNK);
        chunks.extend(starts.map(|s| Chunk { layer, range: s..(s + CHUNK).min(layer.len()), before }));
        before += layer.len();
    }
    chunks
}

/// Rounding of a place in the camera in f32, as a share of its distance.
const ROUNDING: f32 = 1e-6;

/// Where chunks of consecutive Gaussians lie. Worth making once for many views, where neighbours in memory are neighbours
/// in space.
#[derive(Clone, Debug)]
pub(crate) struct ChunkBounds(Vec<Sphere>);

/// Around the means of a chunk. A bound that is NaN rules nothing out.
#[derive(Clone, Copy, Debug)]
struct Sphere {
    centre: DVec3,
    /// (m).
    radius: f32,
    /// Largest standard deviation of its Gaussians (m).
    sigma: f32,
}

impl ChunkBounds {
    /// Of all chunks.
    pub(crate) fn new(layers: &[&Gaussians]) -> Self {
        let around = |Chunk { layer, range, .. }: &Chunk| {
            Sphere::around(&layer.means[range.clone()], &layer.log_scales[range.clone()])
        };
        Self(chunks_of(layers).par_iter().map(around).collect())
    }

    /// Numbers of the chunks that may reach a computed tile, ascending. `size` is that of the image (px).
    pub(crate) fn in_sight(
        &self,
        camera: &PinholeF32,
        size: [f32; 2],
        grid: TileGrid,
        tiles: Option<&TileMask>,
    ) -> impl Iterator<Item = usize> {
        let chunks = self.0.iter().enumerate();
        chunks.filter(move |(_, s)| s.may_show(camera, size, grid, tiles)).map(|(number, _)| number)
    }
}

impl Sphere {
    fn around(means: &[[f32; 3]], log_scales: &[[f32; 3]]) -> Self {
        // What is not finite is never shown.
        let places = || means.iter().map(|p| DVec3::from(p.map(f64::from))).filter(|p| p.is_finite());
        let low = places().fold(DVec3::INFINITY, DVec3::min);
        let high = places().fold(DVec3::NEG_INFINITY, DVec3::max);
        let centre = 0.5 * (low + high);
        let radius = 0.5 * (high - low).length();
        let scale = log_scales.iter().flatten().copied().fold(f32::NEG_INFINITY, f32::max);
        // Rounded up: the projection works in f32.
        Self { centre, radius: radius as f32 * 1.001, sigma: exp(scale) * 1.001 }
    }

    /// Whether a splat of the chunk may touch a computed tile.
    fn may_show(
        &self,
        camera: &PinholeF32,
        size: [f32; 2],
        grid: TileGrid,
        tiles: Option<&TileMask>,
    ) -> bool {
        let at = camera.rotation * (self.centre - camera.center).as_vec3();
        let radius = self.radius + ROUNDING * at.length();
        if at.z + radius < 0.0 {
            return false;
        }
        if !(at.z - radius > 0.0) {
            return true;
        }
        let extent = |axis: usize| camera.extent(axis, [at[axis], at.z], radius, self.sigma);
        let ([left, right], [top, bottom]) = (extent(0), extent(1));
        let outside = right < 0.0 || left > size[0] || bottom < 0.0 || top > size[1];
        let columns = tile_range(left, right, grid.columns);
        let rows = tile_range(top, bottom, grid.rows);
        !outside && tiles.is_none_or(|t| t.any_in(rows.0..=rows.1, &(columns.0..=columns.1)))
    }
}

impl PinholeF32 {
    /// Least and greatest pixel coordinate along an axis of what splats with means in a sphere around `[x or y, z]` in the
    /// camera (m), in front of it, can touch.
    fn extent(&self, axis: usize, [x, z]: [f32; 2], radius: f32, sigma: f32) -> [f32; 2] {
        let (near, far) = (z - radius, z + radius);
        let low = (x - radius) / if x < radius { near } else { far };
        let high = (x + radius) / if x > -radius { near } else { far };
        // The Jacobian's row is f/z (1, -slope), its slope no steeper than the widened frustum.
        let steep = self.low[axis].abs().max(self.high[axis].abs());
        let sigma_px = self.focal[axis] / near * (1.0 + steep * steep).sqrt() * sigma;
        let reach = MAX_REACH * (sigma_px * sigma_px + PIXEL_FILTER).sqrt() + 1.0;
        let pixel = |slope: f32| self.focal[axis] * slope + self.principal[axis];
        [pixel(low) - reach, pixel(high) + reach]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cpu::CpuRasterizer;
    use crate::tape::RenderTape;
    use crate::view::{Background, RenderOptions, View};
    use ffgs_core::{Camera, ImageSize, Intrinsics, Mask};
    use glam::DMat4;

    /// Chunks in a ring around the camera, some beside the frustum, some behind, some with huge or broken Gaussians.
    fn ring() -> Gaussians {
        let mut g = Gaussians::zeros(24 * CHUNK, 0);
        for i in 0..g.len() {
            let (chunk, k) = (i / CHUNK, (i % CHUNK) as f32);
            let (sin, cos) = (chunk as f32 * std::f32::consts::TAU / 24.0 + 1e-4 * k).sin_cos();
            g.means[i] = [4.0 * sin, (0.01 * k).sin(), 4.0 * cos + 0.2 * (0.1 * k).cos()];
            g.quats[i] = [1.0, 0.3 * sin, 0.2, 0.1 * k.sin()];
            g.log_scales[i] = [-4.0 + (0.7 * k).sin(), -3.0, -4.0];
            g.opacity_logits[i] = 3.0;
        }
        g.log_scales[7 * CHUNK] = [1.5, 1.0, 0.0];
        g.means[CHUNK] = [f32::NAN; 3];
        g.means[2 * CHUNK] = [f32::INFINITY, 0.0, 0.0];
        g.log_scales[3 * CHUNK + 1] = [f32::NAN; 3];
        g.log_scales[13 * CHUNK + 1] = [80.0; 3];
        g
    }

    #[test]
    fn nothing_in_sight_is_ruled_out() {
        let gaussians = ring();
        let bounds = ChunkBounds::new(&[&gaussians]);
        let size = ImageSize { width: 100, height: 60 };
        let mut spot = vec![0; size.pixels()];
        spot[31 * size.width + 70..31 * size.width + 78].fill(1);
        let tiles = [None, Some(TileMask::covering(&Mask::new(size, spot).unwrap()))];
        let intrinsics = Intrinsics { fx: 60.0, fy: 60.0, cx: 55.0, cy: 30.0 };
        let (mut all, mut some) = (RenderTape::default(), RenderTape::default());
        let mut passed_over = 0;
        for (step, tiles) in (0..40).flat_map(|step| tiles.iter().map(move |t| (step, t.as_ref()))) {
            let turn = DMat4::from_rotation_y(0.2 * f64::from(step)) * DMat4::from_rotation_x(0.3);
            let pose = turn * DMat4::from_translation(DVec3::new(0.0, 0.0, 0.1 * f64::from(step)));
            let camera = Camera::new(intrinsics, pose, size).unwrap();
            let view = View { camera: &camera, background: Background::Colour([0.0; 3]), tiles };
            let rasterizer =
                CpuRasterizer::new(RenderOptions { sh_degree: Some(0), ..RenderOptions::default() });
            rasterizer.prepare(&[&gaussians], &view, &mut all);
            rasterizer.prepare_within(&[&gaussians], Some(&bounds), &view, &mut some);
            assert!(all.visible() > 0);
            assert!(all.visible_indices().eq(some.visible_indices()), "step {step}");
            let (size, grid) = ([100.0, 60.0], TileGrid::new(size));
            passed_over += 24 - bounds.in_sight(&PinholeF32::from(&camera), size, grid, tiles).count();
        }
        // A third of the ring is in the frustum, one chunk spans everything.
        assert!(passed_over > 80 * 10, "{passed_over}");
    }
}
