//! The visual hull: the voxels that nearly all masks contain.

use ffgs_core::{Camera, Mask};
use glam::{DVec3, IVec3};
use rayon::prelude::*;

/// Voxels along the longest side of the box.
const SIDE: usize = 128;
/// One view in so many may deny a voxel: masks have holes.
const DENIALS_PER_VIEW: usize = 6;

/// An axis-aligned box in the world (m).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Region {
    pub low: DVec3,
    pub high: DVec3,
}

impl Region {
    /// Multiple of `ray` (m) after which a line from `eye` has left the sphere of `radii` half sides about the middle, or is nearest to it.
    pub(crate) fn exit(self, eye: DVec3, ray: DVec3, radii: f64) -> f64 {
        let to_middle = (self.low + self.high) / 2.0 - eye;
        let radius = radii * (self.high - self.low).x / 2.0;
        let (along, square) = (to_middle.dot(ray), ray.length_squared());
        let inside = along * along - square * (to_middle.length_squared() - radius * radius);
        (along + inside.max(0.0).sqrt()) / square
    }
}

/// A camera with what it saw.
#[derive(Clone, Debug)]
pub(crate) struct Silhouette {
    pub camera: Camera,
    pub mask: Mask,
}

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

/// Voxels of the region that at least `least_views` cameras see and nearly all of those hold for foreground. The
/// region is cut down to what is occupied and divided anew once, so that a small thing in a large room gets all voxels.
pub(crate) fn hull(silhouettes: &[Silhouette], region: Region, least_views: usize) -> Hull {
    let coarse = carve(silhouettes, region, least_views);
    match bounds(&coarse) {
        Some(inner) => carve(silhouettes, inner, least_views),
        None => coarse,
    }
}

fn carve(silhouettes: &[Silhouette], Region { low, high }: Region, least_views: usize) -> Hull {
    let extent = high - low;
    let side = extent.max_element() / SIDE as f64;
    let counts = (extent / side).ceil().as_uvec3().max(glam::UVec3::ONE);
    // A voxel counts for a view when any of the pixels that it covers does.
    let grown: Vec<Silhouette> = silhouettes.par_iter().map(|s| grown(s, side, (low + high) / 2.0)).collect();
    let slab = |z: u32| {
        let voxels =
            (0..counts.y).flat_map(|y| (0..counts.x).map(move |x| DVec3::new(x.into(), y.into(), z.into())));
        let centres = voxels.map(|v| low + (v + 0.5) * side);
        centres.filter_map(|c| Some((c, occupied(&grown, c, least_views)?))).collect::<Vec<_>>()
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

/// How many views see an occupied voxel; `None` for one that is not.
fn occupied(silhouettes: &[Silhouette], centre: DVec3, least_views: usize) -> Option<u16> {
    let (seen, inside) = views_of(silhouettes, centre);
    (seen >= least_views && inside + seen / DENIALS_PER_VIEW >= seen).then_some(seen as u16)
}

/// How many views see a place, and how many of them have it in their mask.
pub(crate) fn views_of(silhouettes: &[Silhouette], place: DVec3) -> (usize, usize) {
    let seen = silhouettes.iter().filter_map(|s| Some((s, s.camera.pixel_of(place)?)));
    seen.fold((0, 0), |(seen, inside), (s, (x, y))| (seen + 1, inside + usize::from(s.mask.contains(x, y))))
}

fn bounds(hull: &Hull) -> Option<Region> {
    let low = hull.centres.iter().copied().reduce(DVec3::min)?;
    let high = hull.centres.iter().copied().reduce(DVec3::max)?;
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
        Mask::new(size, data).expect("one value a pixel")
    }
}

/// The part of the world that the cameras look at: around the point nearest to all optical axes, as far as the
/// cameras are from it. Parallel cameras have no such point; then it is as far ahead as ten times their distances
/// from each other.
pub(crate) fn common_region(cameras: &[Camera]) -> Region {
    let centres: Vec<DVec3> = cameras.iter().map(Camera::center).collect();
    let axes: Vec<DVec3> = cameras.iter().map(|c| c.rotation().transpose() * DVec3::Z).collect();
    let mean = centres.iter().sum::<DVec3>() / centres.len() as f64;
    let spread = centres.iter().map(|c| c.distance(mean)).fold(0.0, f64::max);
    let middle = nearest_to_axes(&centres, &axes).filter(|m| {
        let ahead = centres.iter().zip(&axes).filter(|(c, a)| (*m - **c).dot(**a) > 0.0).count();
        ahead * 2 > cameras.len() && m.distance(mean) < 10.0 * spread
    });
    let ahead = axes.iter().sum::<DVec3>().normalize_or(DVec3::Z);
    let middle = middle.unwrap_or(mean + ahead * 5.0 * spread);
    let mut distances: Vec<f64> = centres.iter().map(|c| c.distance(middle)).collect();
    distances.sort_by(f64::total_cmp);
    let radius = distances[distances.len() / 2];
    Region { low: middle - radius, high: middle + radius }
}

/// Least squares: the sum of I - a aᵀ over the axes, solved; `None` for axes that are nearly parallel.
fn nearest_to_axes(centres: &[DVec3], axes: &[DVec3]) -> Option<DVec3> {
    let (mut sum, mut right) = (glam::DMat3::ZERO, DVec3::ZERO);
    for (c, a) in centres.iter().zip(axes) {
        let across = glam::DMat3::IDENTITY - glam::DMat3::from_cols(*a * a.x, *a * a.y, *a * a.z);
        sum += across;
        right += across * *c;
    }
    let n = centres.len() as f64;
    // The determinant of the mean is sin² of the axes' angles, about.
    ((sum * (1.0 / n)).determinant() > 1e-3).then(|| sum.inverse() * right)
}

#[cfg(test)]
mod tests {
    use super::*;
    use ffgs_core::{ImageSize, Intrinsics};
    use glam::DMat4;

    fn ring(count: usize) -> Vec<Camera> {
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

    fn ball(camera: &Camera, centre: DVec3, radius: f64) -> Mask {
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
        let hull = hull(&silhouettes, region, 2);
        let farthest = hull.centres.iter().map(|c| c.distance(centre)).fold(0.0, f64::max);
        let mean = hull.centres.iter().sum::<DVec3>() / hull.centres.len() as f64;
        assert!(mean.distance(centre) < 0.02 && farthest > 0.28 && farthest < 0.5, "{mean} {farthest}");
        for (camera, s) in cameras.iter().zip(&silhouettes) {
            let seen = hull.seen_by(camera, 2);
            let both = (0..seen.data().len()).filter(|&i| seen.data()[i] * s.mask.data()[i] == 1).count();
            assert!(both as f64 > 0.95 * s.mask.count() as f64 && both as f64 > 0.5 * seen.count() as f64);
        }
    }

    #[test]
    fn parallel_cameras_have_a_region_ahead_of_them() {
        let size = ImageSize { width: 160, height: 120 };
        let intrinsics = Intrinsics { fx: 150.0, fy: 150.0, cx: 80.0, cy: 60.0 };
        let at = |x: f64| {
            Camera::new(intrinsics, DMat4::from_translation(DVec3::new(-x, 0.0, 0.0)), size).unwrap()
        };
        let region = common_region(&[at(-0.5), at(0.0), at(0.5)]);
        let middle = (region.low + region.high) / 2.0;
        assert!(middle.x.abs() < 1e-9 && (middle.z - 2.5).abs() < 1e-9);
    }
}
