//! Cameras that circle what moves.

use anyhow::{Context, Result, bail};
use ffgs_core::{Camera, Gaussians, ImageSize, RigExtent, Scene, up};
use ffgs_method::{Capture, Split, ViewAt};
use glam::{DMat3, DMat4, DVec3};
use std::f64::consts::TAU;

/// Distance from the circled object, in median distances of its Gaussians from its middle, for a wide lens: near enough that little
/// stands between.
const ORBIT_MARGIN: f64 = 0.9;
/// What stands upright is wholly in the picture: this share of its Gaussians, by their height over its middle or under it.
const TALL: f64 = 0.95;
/// Elevation of an orbit as a share of its radius: what stands around hides less from above. At most as high as the highest camera,
/// which is under a roof if there is one, but at least [`LEAST_ELEVATION`].
const ORBIT_ELEVATION: f64 = 0.8;
const LEAST_ELEVATION: f64 = 0.3;
/// An orbit has at most so many times the pixels per length (focal length over distance) of the training view that shows its object largest.
const MAGNIFIED: f64 = 2.0;
/// What is circled lies in the images of many training views: at least this share of the number that see what is seen best. The rest is a blur from most sides.
const SEEN_SHARE: f64 = 0.5;

/// `views` cameras on a circle around one of the objects that the Gaussians `dynamic` of a frame are, one that many cameras see, with the lens and size of the
/// first test camera.
///
/// # Errors
/// When there is no Gaussian, or the capture's cameras cannot be read.
pub fn orbit(capture: &dyn Capture, dynamic: &Gaussians, frame: usize, views: usize) -> Result<Vec<Camera>> {
    let moving = dynamic.positions();
    if moving.is_empty() {
        bail!("frame {frame} has no moving Gaussian to circle; choose a --camera");
    }
    let [tests, trained] = [Split::Test, Split::Train].map(|split| -> Result<Vec<Camera>> {
        (0..capture.views(split).len())
            .map(|view| Ok(capture.camera(ViewAt { split, view, frame })?))
            .collect()
    });
    let trained = trained?;
    let mut object = one_object(&moving, well_seen(&moving, &trained));
    object.detail = detail(object.middle, &trained);
    let cameras = [tests?, trained].concat();
    let lens = cameras.first().context("the capture has no camera")?;
    circle(&cameras, &object, views)
        .into_iter()
        .map(|pose| Ok(Camera::new(lens.intrinsics(), pose, lens.size())?))
        .collect()
}

/// Static Gaussians nearer to a camera of the circle than this share of its radius are left out: where no camera of the capture stood,
/// some float in the air, and one before the lens hides everything.
const CLEAR: f64 = 0.4;

/// The scene without what is right before the cameras of an orbit.
#[must_use]
pub fn clear_of(scene: &Scene, cameras: &[Camera]) -> Scene {
    let centres: Vec<DVec3> = cameras.iter().map(Camera::center).collect();
    let RigExtent { radius, .. } = RigExtent::of(&centres);
    let layer = &scene.static_layer;
    let is_clear = |i: usize| {
        let place = DVec3::from(layer.means[i].map(f64::from));
        let size = f64::from(layer.log_scales[i].iter().copied().fold(f32::MIN, f32::max).exp());
        centres.iter().all(|centre| centre.distance(place) > CLEAR * radius + size)
    };
    let kept: Vec<usize> = (0..layer.len()).filter(|&i| is_clear(i)).collect();
    // What is known of the others is of no use to a picture.
    Scene::new(layer.select(&kept), scene.dynamic.clone(), scene.sky.clone())
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    quantile(values, 0.5)
}

/// The value that is larger than this share of all; 0 of nothing.
fn quantile(values: impl Iterator<Item = f64>, share: f64) -> f64 {
    let mut sorted: Vec<f64> = values.collect();
    sorted.sort_unstable_by(f64::total_cmp);
    sorted.get((sorted.len() as f64 * share) as usize).copied().unwrap_or(0.0)
}

/// What is circled.
#[derive(Clone, Debug, PartialEq)]
struct Object {
    middle: DVec3,
    /// Median distance of its Gaussians from the middle (m).
    extent: f64,
    points: Vec<DVec3>,
    /// Pixels per metre with which the best training view shows its middle; infinite when none does, or it is not known.
    detail: f64,
}

/// Those of the points that are in the images of many training views, by [`SEEN_SHARE`].
fn well_seen(points: &[DVec3], trained: &[Camera]) -> Vec<DVec3> {
    let seen = |p: &DVec3| trained.iter().filter(|camera| camera.pixel_of(*p).is_some()).count();
    // No maximum: single points may be anywhere.
    let most = quantile(points.iter().map(|p| seen(p) as f64), 0.95);
    points.iter().copied().filter(|p| seen(p) as f64 >= SEEN_SHARE * most).collect()
}

/// See [`Object::detail`].
fn detail(middle: DVec3, trained: &[Camera]) -> f64 {
    let shown = trained.iter().filter(|camera| camera.pixel_of(middle).is_some());
    let best = shown.map(|c| c.intrinsics().focal() / c.center().distance(middle)).fold(0.0, f64::max);
    if best > 0.0 { best } else { f64::INFINITY }
}

/// One object: among several, medians over what lies near the present middle, at first over `near`, settle on one. It is whole, though `near` may be
/// a part of it.
fn one_object(points: &[DVec3], mut near: Vec<DVec3>) -> Object {
    let (mut middle, mut extent) = (DVec3::ZERO, 0.0);
    for _ in 0..20 {
        middle = DVec3::from_array([0, 1, 2].map(|a| median(near.iter().map(|p| p[a]))));
        extent = median(near.iter().map(|p| p.distance(middle)));
        let inside = points.iter().copied().filter(|p| p.distance(middle) <= 2.0 * extent);
        let next: Vec<DVec3> = inside.collect();
        if next.is_empty() || next == near {
            break;
        }
        near = next;
    }
    Object { middle, extent, points: near, detail: f64::INFINITY }
}

/// Poses (camera from world) that look at the object's middle.
fn circle(cameras: &[Camera], object: &Object, views: usize) -> Vec<DMat4> {
    let target = object.middle;
    let up = up(cameras);
    // Distance at which a length fills half of a side of the picture, in such lengths.
    let zoom = |side: fn(ImageSize) -> usize| {
        cameras.first().map_or(1.0, |c| 2.0 * c.intrinsics().focal() / side(c.size()) as f64)
    };
    let tall = quantile(object.points.iter().map(|p| (*p - target).dot(up).abs()), TALL);
    let near = ORBIT_MARGIN * object.extent.max(1e-3) * (1.0 + zoom(|size| size.width.max(size.height)));
    let focal = cameras.first().map_or(0.0, |c| c.intrinsics().focal());
    let radius = near.max(tall * (1.0 + zoom(|size| size.height))).max(focal / (MAGNIFIED * object.detail));
    let highest = cameras.iter().map(|c| (c.center() - target).dot(up)).fold(0.0, f64::max);
    let height = highest.clamp(LEAST_ELEVATION * radius, ORBIT_ELEVATION * radius);
    let (east, north) = up.any_orthonormal_pair();
    let pose = |v: usize| {
        let (sin, cos) = (TAU * v as f64 / views as f64).sin_cos();
        let eye = target + radius * (cos * east + sin * north) + height * up;
        let forward = (target - eye).normalize();
        let right = forward.cross(up).normalize();
        let rotation = DMat3::from_cols(right, forward.cross(right), forward).transpose();
        let mut pose = DMat4::from_mat3(rotation);
        pose.w_axis = (-(rotation * eye)).extend(1.0);
        pose
    };
    (0..views).map(pose).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use ffgs_core::Intrinsics;

    #[test]
    fn an_orbit_looks_at_its_target_with_the_cameras_up() {
        let lens = Intrinsics { fx: 50.0, fy: 50.0, cx: 32.0, cy: 24.0 };
        let size = ImageSize { width: 64, height: 48 };
        // At (0, -8, 2), forward +y, up +z.
        let rotation = DMat3::from_cols(DVec3::X, DVec3::NEG_Z, DVec3::Y).transpose();
        let mut pose = DMat4::from_mat3(rotation);
        pose.w_axis = (-(rotation * DVec3::new(0.0, -8.0, 2.0))).extend(1.0);
        let camera = Camera::new(lens, pose, size).unwrap();
        let poses = circle(&[camera], &ball(1.0), 60);
        assert_eq!(poses.len(), 60);
        for pose in poses {
            let camera = Camera::new(lens, pose, size).unwrap();
            let seen = camera.project(DVec3::ZERO).unwrap().pixel;
            assert!((seen - glam::DVec2::new(32.0, 24.0)).length() < 1e-9);
            assert!((1.5..=2.0).contains(&camera.center().z), "above, and no higher than the camera");
            assert!(camera.project(DVec3::Z).unwrap().pixel.y < 24.0);
        }
    }

    fn settled(points: &[DVec3]) -> Object {
        one_object(points, points.to_vec())
    }

    fn ball(extent: f64) -> Object {
        Object { middle: DVec3::ZERO, extent, points: Vec::new(), detail: f64::INFINITY }
    }

    /// A person of 1.8 m, 0.5 m wide, before an upright and a wide picture.
    #[test]
    fn what_stands_upright_is_in_the_picture_from_head_to_foot() {
        let place =
            |i: usize| DVec3::new(0.25 * (i as f64).sin(), 0.15 * (i as f64).cos(), -0.9 + 0.0018 * i as f64);
        let person = settled(&(0..1000).map(place).collect::<Vec<_>>());
        for (width, height) in [(36, 64), (64, 36)] {
            let lens = Intrinsics { fx: 50.0, fy: 50.0, cx: width as f64 / 2.0, cy: height as f64 / 2.0 };
            let rotation = DMat3::from_cols(DVec3::X, DVec3::NEG_Z, DVec3::Y).transpose();
            let size = ImageSize { width, height };
            let level = Camera::new(lens, DMat4::from_mat3(rotation), size).unwrap();
            for pose in circle(&[level], &person, 12) {
                let camera = Camera::new(lens, pose, size).unwrap();
                let rows = [DVec3::Z, DVec3::NEG_Z].map(|end| camera.project(0.85 * end).unwrap().pixel.y);
                assert!(rows.iter().all(|row| (0.0..height as f64).contains(row)), "{rows:?} of {height}");
                assert!(rows[1] - rows[0] > 0.4 * height as f64, "{rows:?} of {height}: too far away");
            }
        }
    }

    #[test]
    fn what_floats_before_a_lens_is_left_out() {
        let lens = Intrinsics { fx: 50.0, fy: 50.0, cx: 32.0, cy: 24.0 };
        let size = ImageSize { width: 64, height: 48 };
        let cameras: Vec<Camera> = circle(&[], &ball(1.0), 8)
            .into_iter()
            .map(|pose| Camera::new(lens, pose, size).unwrap())
            .collect();
        let before_a_lens = cameras[3].center().as_vec3() * 0.9;
        let mut layer = Gaussians::zeros(3, 0);
        layer.means = vec![[0.0; 3], before_a_lens.to_array(), [0.5, 0.0, 0.0]];
        layer.log_scales = vec![[-5.0; 3], [-5.0; 3], [1.0; 3]];
        let scene = Scene::new(layer, ffgs_core::Dynamic::default(), ffgs_core::SkyCube::filled(4, [0.5; 3]));
        // The last one is as large as the circle.
        assert_eq!(clear_of(&scene, &cameras).static_layer.means, [[0.0; 3]]);
    }

    /// A camera at `eye` that looks along +x, z up.
    fn along_x(eye: DVec3) -> Camera {
        let lens = Intrinsics { fx: 100.0, fy: 100.0, cx: 50.0, cy: 50.0 };
        let rotation = DMat3::from_cols(DVec3::NEG_Y, DVec3::NEG_Z, DVec3::X).transpose();
        let mut pose = DMat4::from_mat3(rotation);
        pose.w_axis = (-(rotation * eye)).extend(1.0);
        Camera::new(lens, pose, ImageSize { width: 100, height: 100 }).unwrap()
    }

    #[test]
    fn what_few_cameras_see_is_not_circled() {
        let cameras = [-8.0, -6.0, -4.0].map(|x| along_x(DVec3::new(x, 0.0, 0.0)));
        // The cloud of 900 is in the last camera's image alone, from where it stands behind all others' backs.
        let cloud = |middle: DVec3, n: usize| {
            (0..n).map(move |i| middle + 0.3 * DVec3::new((i as f64).sin(), (i as f64 * 1.7).cos(), 0.0))
        };
        let few = DVec3::new(0.0, 5.0, 0.0);
        let back = along_x(few - 20.0 * DVec3::X);
        let trained = [cameras[0], cameras[1], cameras[2], back];
        let points: Vec<DVec3> = cloud(few, 900).chain(cloud(DVec3::ZERO, 300)).collect();
        assert!(settled(&points).middle.distance(few) < 0.1, "it has the most points");
        let object = one_object(&points, well_seen(&points, &trained));
        assert!(object.middle.length() < 0.1 && object.points.len() == 300, "{object:?}");
        assert_eq!(well_seen(&points, &[]), points, "no camera: all");
        let half: Vec<DVec3> = cloud(DVec3::ZERO, 300).filter(|p| p.x > 0.0).collect();
        assert_eq!(one_object(&points, half), object, "whole, though half of it is well seen");
    }

    #[test]
    fn a_circle_keeps_away_from_what_was_seen_from_afar() {
        let camera = along_x(DVec3::new(-40.0, 0.0, 0.0));
        let radius = |detail| {
            let object = Object { detail, ..ball(1.0) };
            let pose = circle(&[camera], &object, 4)[0];
            Camera::new(camera.intrinsics(), pose, camera.size()).unwrap().center().truncate().length()
        };
        assert!((detail(DVec3::ZERO, &[camera]) - 2.5).abs() < 1e-12);
        assert!((radius(2.5) - 20.0).abs() < 1e-9, "half of the camera's distance");
        assert!(radius(f64::INFINITY) < 5.0);
        let elsewhere = along_x(DVec3::new(1.0, 0.0, 0.0));
        assert!(detail(DVec3::ZERO, &[elsewhere]).is_infinite(), "it looks away");
    }

    #[test]
    fn of_two_objects_one_is_circled() {
        let disc = |center: DVec3| {
            (0..200).map(move |i| center + DVec3::new((i as f64).sin(), (i as f64 * 1.7).cos(), 0.0))
        };
        let points: Vec<DVec3> =
            disc(DVec3::ZERO).chain(disc(DVec3::new(12.0, 0.0, 0.0)).take(150)).collect();
        let found = settled(&points);
        assert!(found.middle.length() < 0.3 && found.extent < 1.5, "{} {}", found.middle, found.extent);
        let single =
            Object { middle: points[0], extent: 0.0, points: vec![points[0]], detail: f64::INFINITY };
        assert_eq!(settled(&points[..1]), single);
    }
}
