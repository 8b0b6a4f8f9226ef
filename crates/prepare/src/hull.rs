//! The visual hull: the voxels that nearly all masks contain.

use crate::blocks::Blocks;
use crate::region::Region;
use crate::silhouettes::Silhouette;
use ffgs_core::{Camera, Mask};
use glam::{DVec3, IVec3, UVec3};
use rayon::prelude::*;

/// Voxels along the longest side of the box.
const SIDE: usize = 128;

/// Occupied voxels.
#[derive(Clone, Debug)]
pub(crate) struct Hull {
    /// Centres (m).
    pub centres: Vec<DVec3>,
    /// Views that see each of them.
    pub views: Vec<u16>,
    /// Side of a voxel (m).
    pub side: f64,
    /// Centre of voxel (0, 0, 0).
    origin: DVec3,
}

/// For each of `least_views`, the voxels of the region that at least so many cameras see and nearly all of those hold for foreground. The
/// region is cut down to what is occupied and divided anew once, so that a small thing in a large room gets all voxels.
pub(crate) fn hulls<const N: usize>(
    silhouettes: &[Silhouette],
    region: Region,
    least_views: [usize; N],
) -> [Hull; N] {
    let coarse = carve(silhouettes, region, least_views.into_iter().min().unwrap_or(0));
    least_views.map(|least| carve(silhouettes, bounds(&coarse, least).unwrap_or(region), least))
}

fn carve(silhouettes: &[Silhouette], Region { low, high }: Region, least_views: usize) -> Hull {
    let extent = high - low;
    let side = extent.max_element() / SIDE as f64;
    let counts = (extent / side).ceil().as_uvec3().max(UVec3::ONE);
    // A voxel counts for a view when any of the pixels that it covers does.
    let grown: Vec<Silhouette> = silhouettes.par_iter().map(|s| grown(s, side, (low + high) / 2.0)).collect();
    let centre = |voxel: UVec3| low + (voxel.as_dvec3() + 0.5) * side;
    let blocks = Blocks::new(&grown, counts, centre);
    let slab = |z: u32| {
        let voxels = (0..counts.y).flat_map(|y| (0..counts.x).map(move |x| UVec3::new(x, y, z)));
        let occupied = |voxel: UVec3| {
            let views = blocks.views_of(voxel, centre(voxel)).filter(|views| *views >= least_views)?;
            Some((centre(voxel), views as u16))
        };
        voxels.filter_map(occupied).collect::<Vec<_>>()
    };
    let slabs: Vec<Vec<(DVec3, u16)>> = (0..counts.z).into_par_iter().map(slab).collect();
    let (centres, views) = slabs.into_iter().flatten().unzip();
    Hull { centres, views, side, origin: low + 0.5 * side }
}

fn grown(s: &Silhouette, side: f64, middle: DVec3) -> Silhouette {
    let radius =
        s.camera.project(middle).map_or(0.0, |p| 0.5 * side * s.camera.intrinsics().focal() / p.depth);
    Silhouette { camera: s.camera, mask: s.mask.dilated(radius.ceil().clamp(0.0, 64.0) as usize) }
}

/// Of the voxels that at least `least_views` see.
fn bounds(hull: &Hull, least_views: usize) -> Option<Region> {
    let seen = |i: &usize| usize::from(hull.views[*i]) >= least_views;
    let centres = || (0..hull.centres.len()).filter(seen).map(|i| hull.centres[i]);
    let (low, high) = (centres().reduce(DVec3::min)?, centres().reduce(DVec3::max)?);
    Some(Region { low: low - hull.side, high: high + hull.side })
}

impl Hull {
    /// The voxel of a point, occupied or not.
    pub(crate) fn voxel(&self, point: DVec3) -> IVec3 {
        ((point - self.origin) / self.side).round().as_ivec3()
    }

    /// The silhouette, in a camera, of the voxels that at least `least_views` see.
    pub(crate) fn seen_by(&self, camera: &Camera, least_views: u16) -> Mask {
        let size = camera.size();
        let mut data = vec![0_u8; size.pixels()];
        for (centre, _) in self.centres.iter().zip(&self.views).filter(|(_, v)| **v >= least_views) {
            let Some(p) = camera.project(*centre) else { continue };
            let half = 0.5 * self.side * camera.intrinsics().focal() / p.depth;
            let span = |at: f64, n: usize| {
                let low = (at - half).floor().clamp(0.0, n as f64) as usize;
                low..((at + half).ceil().clamp(0.0, n as f64) as usize)
            };
            for y in span(p.pixel.y, size.height) {
                data[y * size.width..][span(p.pixel.x, size.width)].fill(1);
            }
        }
        Mask::new(size, data).expect("one value per pixel")
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::region::common_region;
    use ffgs_core::{ImageSize, Intrinsics};
    use glam::DMat4;

    /// Cameras around (1, 0, 0.3) m.
    pub(crate) fn ring(count: usize) -> Vec<Camera> {
        let size = ImageSize { width: 160, height: 120 };
        let intrinsics = Intrinsics { fx: 150.0, fy: 150.0, cx: 80.0, cy: 60.0 };
        let pose = |i: usize| {
            let angle = std::f64::consts::TAU * i as f64 / count as f64;
            let eye = DVec3::new(4.0 * angle.cos() + 1.0, 4.0 * angle.sin(), 1.5);
            let forward = (DVec3::new(1.0, 0.0, 0.3) - eye).normalize();
            let right = forward.cross(DVec3::Z).normalize();
            let rotation = glam::DMat3::from_cols(right, forward.cross(right), forward).transpose();
            let mut pose = DMat4::from_mat3(rotation);
            pose.w_axis = (-(rotation * eye)).extend(1.0);
            pose
        };
        (0..count).map(|i| Camera::new(intrinsics, pose(i), size).unwrap()).collect()
    }

    /// The silhouette of a ball.
    pub(crate) fn ball(camera: &Camera, centre: DVec3, radius: f64) -> Mask {
        let size = camera.size();
        let inside = |i: usize| {
            let pixel = glam::DVec2::new((i % size.width) as f64 + 0.5, (i / size.width) as f64 + 0.5);
            let to = centre - camera.center();
            let across = to - camera.ray(pixel) * to.dot(camera.ray(pixel));
            u8::from(across.length() < radius)
        };
        Mask::new(size, (0..size.pixels()).map(inside).collect()).unwrap()
    }

    #[test]
    fn a_ball_is_carved_and_seen_where_it_is() {
        let cameras = ring(8);
        let (centre, radius) = (DVec3::new(1.2, -0.1, 0.4), 0.3);
        let silhouettes: Vec<_> =
            cameras.iter().map(|c| Silhouette { camera: *c, mask: ball(c, centre, radius) }).collect();
        let region = common_region(&cameras);
        assert!(((region.low + region.high) / 2.0 - DVec3::new(1.0, 0.0, 0.3)).length() < 1e-6);
        let [hull] = hulls(&silhouettes, region, [2]);
        let farthest = hull.centres.iter().map(|c| c.distance(centre)).fold(0.0, f64::max);
        let mean = hull.centres.iter().sum::<DVec3>() / hull.centres.len() as f64;
        assert!(mean.distance(centre) < 0.02 && farthest > 0.28 && farthest < 0.5, "{mean} {farthest}");
        for (camera, s) in cameras.iter().zip(&silhouettes) {
            let seen = hull.seen_by(camera, 2);
            let both = (0..seen.data().len()).filter(|&i| seen.data()[i] * s.mask.data()[i] == 1).count();
            assert!(both as f64 > 0.95 * s.mask.count() as f64 && both as f64 > 0.5 * seen.count() as f64);
        }
    }
}
