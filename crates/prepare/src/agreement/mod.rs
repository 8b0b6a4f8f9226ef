//! Whether the pictures agree with the calibration: what two of them show alike lies on epipolar lines if these cameras took them.

mod alone;
mod exchanged;
mod inverted;

use crate::PrepareError;
use crate::stereo::{self, RATIO, between, pixel};
use crate::views::View;
use ffgs_core::Camera;
use ffgs_trackers::{Frame, nearest_two};
use glam::DVec2;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Keypoints of a picture, the strongest, that are compared with those of another, wherever they lie.
const STRONGEST: usize = 1500;
/// A mistake is told when, without it, pictures would agree at so many places for each camera that it concerns, and at so many times as many, beyond
/// what chance gives.
const LEAST: usize = 10;
const TIMES: usize = 4;
/// Wrong cameras have at most one in so many of the places in common, by chance.
const CHANCE: usize = 10;

/// Refuses a calibration that is not that of the pictures, where another would be. `frames` are the pictures of the `views`, which are called
/// `names`. Returns what is to be told of single cameras.
///
/// # Errors
/// When poses are inverted, or pictures exchanged.
pub(crate) fn check(
    views: &[View],
    names: &[String],
    frames: &[Frame],
) -> Result<Option<String>, PrepareError> {
    let cameras: Vec<Camera> = views.iter().map(|view| view.camera).collect();
    let mut alike = Alike { frames, found: BTreeMap::new() };
    let given: Vec<usize> = (0..cameras.len()).collect();
    let agreement = alike.agreement(&cameras, &given);
    inverted::refuse(&mut alike, &cameras, &agreement)?;
    exchanged::refuse(&mut alike, &cameras, names, &agreement)?;
    Ok(alone::told(names, &agreement))
}

/// What a camera has in common with its neighbours.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Agreement {
    /// Places that its picture and those of its neighbours show alike.
    alike: usize,
    /// Those of them that may be the same in space.
    same: usize,
}

impl Agreement {
    /// The same ones as a part of those that are alike; 0 where nothing is.
    fn share(&self) -> f64 {
        self.same as f64 / self.alike.max(1) as f64
    }

    /// Places that are the same in space, beyond what chance gives.
    fn places(&self) -> usize {
        self.same.saturating_sub(self.alike / CHANCE)
    }
}

/// Places that pictures show alike, by pairs of pictures that were compared.
struct Alike<'a> {
    frames: &'a [Frame],
    found: BTreeMap<(usize, usize), Vec<[DVec2; 2]>>,
}

impl Alike<'_> {
    /// Of every camera, if each took the picture that `order` has in its place.
    fn agreement(&mut self, cameras: &[Camera], order: &[usize]) -> Vec<Agreement> {
        let mut all = vec![Agreement::default(); cameras.len()];
        let pairs = stereo::neighbours(cameras);
        self.compare(pairs.iter().map(|&(a, b)| (order[a], order[b])).collect());
        for (a, b) in pairs {
            let alike = &self.found[&(order[a], order[b])];
            let same = same_places(&cameras[a], &cameras[b], alike);
            for camera in [a, b] {
                all[camera].alike += alike.len();
                all[camera].same += same;
            }
        }
        all
    }

    /// Compares those of the pairs of pictures that were not yet.
    fn compare(&mut self, pairs: Vec<(usize, usize)>) {
        let new: Vec<_> = pairs.into_iter().filter(|pair| !self.found.contains_key(pair)).collect();
        let compared = |(a, b): (usize, usize)| ((a, b), alike(&self.frames[a], &self.frames[b]));
        let compared: Vec<_> = new.into_par_iter().map(compared).collect();
        self.found.extend(compared);
    }
}

/// Places of two pictures that are each other's nearest by their descriptors, and distinct.
fn alike(a: &Frame, b: &Frame) -> Vec<[DVec2; 2]> {
    let strongest = |frame: &Frame| 0..frame.keypoints().len().min(STRONGEST);
    let nearest = |from: &Frame, i: usize, to: &Frame| {
        let found = nearest_two(&from.descriptors()[i], to.descriptors(), strongest(to))?;
        found.is_distinct(RATIO).then_some(found.index)
    };
    let place = |i: usize| {
        let j = nearest(a, i, b)?;
        (nearest(b, j, a) == Some(i)).then(|| [a.keypoints()[i], b.keypoints()[j]].map(pixel))
    };
    strongest(a).filter_map(place).collect()
}

/// How many of the places that two pictures show alike may be the same in space, if these cameras took the pictures: they lie on each other's
/// epipolar lines, before both cameras.
fn same_places(first: &Camera, second: &Camera, alike: &[[DVec2; 2]]) -> usize {
    let (fundamental, reach) = (stereo::fundamental(first, second), stereo::reach(second));
    let is_same = |[p, q]: &&[DVec2; 2]| {
        let line = fundamental * p.extend(1.0);
        let is_near = line.dot(q.extend(1.0)).abs() <= reach * line.truncate().length();
        is_near && between(first, *p, second, *q).is_some()
    };
    alike.iter().filter(is_same).count()
}

#[cfg(test)]
mod tests {
    use super::*;
    use ffgs_core::{ImageRgb8, ImageSize, Intrinsics};
    use glam::{DMat3, DMat4, DQuat, DVec3};

    const SIZE: ImageSize = ImageSize { width: 240, height: 180 };

    fn posed(pose: DMat4) -> Camera {
        Camera::new(Intrinsics { fx: 220.0, fy: 220.0, cx: 120.0, cy: 90.0 }, pose, SIZE).unwrap()
    }

    /// In an arc before the wall, at heights of all kinds: cameras in a line have the same epipolar lines in another order.
    fn camera(i: usize) -> Camera {
        let angle = 0.25 * i as f64 - 0.4;
        let height = [0.5, -0.4, 0.1, -0.6, 0.4, -0.2, 0.6][i];
        let eye = DVec3::new(3.0 * angle.sin(), height, -3.0 * angle.cos());
        let forward = (DVec3::new(0.2, 0.5, 0.0) - eye).normalize();
        let right = forward.cross(DVec3::NEG_Y).normalize();
        let rotation = DMat3::from_cols(right, forward.cross(right), forward).transpose();
        let mut pose = DMat4::from_mat3(rotation);
        pose.w_axis = (-(rotation * eye)).extend(1.0);
        posed(pose)
    }

    /// Of a wall and a floor of squares, each of a grey of its own. Cameras that all look at the same place of one plane may be exchanged.
    fn picture(camera: &Camera) -> ImageRgb8 {
        let grey = |p: usize| {
            let at = DVec2::new((p % SIZE.width) as f64 + 0.5, (p / SIZE.width) as f64 + 0.5);
            let ray = camera.ray(at);
            let [wall, floor] = [-camera.center().z / ray.z, (0.7 - camera.center().y) / ray.y];
            let is_floor = floor > 0.0 && floor < wall;
            let place = camera.center() + ray * if is_floor { floor } else { wall };
            let [x, y] = [place.x, if is_floor { 10.0 + place.z } else { place.y }]
                .map(|v| (v / 0.09).floor() as i64 as u64);
            (x.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ y.wrapping_mul(0xC2B2_AE3D_27D4_EB4F))
                .wrapping_mul(0xD6E8_FEB8_6659_FD93)
                >> 56
        };
        ImageRgb8::new(SIZE, (0..SIZE.pixels()).flat_map(|p| [grey(p) as u8; 3]).collect()).unwrap()
    }

    /// What is said of cameras that take these pictures, each an index, or of grey ones.
    fn said(cameras: &[Camera], pictures: &[usize], is_grey: bool) -> Result<Option<String>, String> {
        let view = |(camera, &picture): (&Camera, &usize)| {
            let grey = || ImageRgb8::new(SIZE, vec![90; 3 * SIZE.pixels()]).unwrap();
            let image = if is_grey { grey() } else { self::picture(&self::camera(picture)) };
            View { camera: *camera, image, mask: None }
        };
        let views: Vec<View> = cameras.iter().zip(pictures).map(view).collect();
        let names: Vec<String> = (0..views.len()).map(|i| format!("cam_{i}")).collect();
        check(&views, &names, &stereo::described(&views)).map_err(|error| error.to_string())
    }

    fn rig(count: usize) -> (Vec<Camera>, Vec<usize>) {
        ((0..count).map(camera).collect(), (0..count).collect())
    }

    #[test]
    fn right_cameras_are_not_doubted_nor_those_of_pictures_without_anything() {
        for count in [1, 2, 4, 7] {
            let (cameras, order) = rig(count);
            assert_eq!(said(&cameras, &order, false), Ok(None), "{count}");
            assert_eq!(said(&cameras, &order, true), Ok(None), "{count}");
        }
    }

    #[test]
    fn inverted_poses_are_refused() {
        let (right, order) = rig(4);
        let wrong: Vec<Camera> = right.iter().map(|c| posed(c.camera_from_world().inverse())).collect();
        let told = said(&wrong, &order, false).unwrap_err();
        assert!(told.contains("the calibration holds camera-to-world"), "{told}");
    }

    #[test]
    fn exchanged_pictures_are_refused_with_what_belongs_to_what() {
        let orders: [&[usize]; 4] =
            [&[0, 2, 1, 3], &[3, 0, 1, 2], &[0, 1, 2, 5, 4, 3, 6], &[4, 1, 2, 3, 6, 5, 0]];
        for order in orders {
            let (cameras, _) = rig(order.len());
            let told = said(&cameras, order, false).unwrap_err();
            for (camera, picture) in order.iter().enumerate().filter(|(camera, picture)| camera != *picture) {
                // The camera `camera` has the picture that `picture` took.
                assert!(
                    told.contains(&format!("those of 'cam_{camera}' fit 'cam_{picture}'")),
                    "{order:?}: {told}"
                );
            }
        }
    }

    #[test]
    fn a_camera_that_was_turned_after_its_calibration_is_told() {
        let (mut cameras, order) = rig(5);
        let turned = DMat4::from_quat(DQuat::from_rotation_x(0.05));
        cameras[3] = posed(turned * cameras[3].camera_from_world());
        let told = said(&cameras, &order, false).unwrap().expect("a doubt");
        assert!(
            told.starts_with("camera 'cam_3' agrees with its neighbours at ") && !told.contains("cam_2"),
            "{told}"
        );
    }
}
