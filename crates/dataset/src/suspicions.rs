//! Gross mistakes that a capture's cameras, points and masks give away.

use crate::report::{Note, ViewSummary};
use ffgs_core::Camera;
use ffgs_method::{Capture, Fault, Part, Points, Split, ViewAt};
use glam::{DMat4, DVec3};

/// Poses are taken for inverted when fewer than this part of the points is seen,
const FEW_SEEN: f64 = 0.25;
/// and the inverted poses see this many times as many.
const FAR_MORE_SEEN: f64 = 2.0;
/// Masks are taken for inverted when they cover more than this part of the images and of their borders.
const INVERTED: f64 = 0.6;
/// Principal points farther from the image's middle than this part of its side are told.
const OFF_CENTRE: f64 = 0.2;
/// Brightness of the cameras may differ by this factor before it is told.
const EXPOSURE_RATIO: f64 = 1.4;
/// Distances from cameras to points outside of this are told: in metres a desk has more, a stadium less. A run takes any
/// unit (docs/adr/0061-lengths-without-a-unit.md), so it is a note: a unit that was not meant is easily overlooked.
const PLAUSIBLE_METRES: (f64, f64) = (0.1, 1000.0);

/// What is found from the cameras of frame 0, the points and what was counted of every view.
pub(crate) fn find(capture: &dyn Capture, points: &Points, views: &[ViewSummary]) -> (Vec<Fault>, Vec<Note>) {
    let (mut faults, mut notes) = (Vec::new(), Vec::new());
    let train = cameras(capture, Split::Train);
    faults.extend(inverted_poses(capture, &train, points));
    faults.extend(inverted_masks(capture, views));
    for split in Split::ALL {
        let file = capture.part(Part::Cameras(split));
        for (name, camera) in cameras(capture, split) {
            let (found, told) = principal_point(&name, &camera);
            let fix = "write the intrinsics for the size of the images".to_owned();
            faults.extend(found.map(|problem| Fault { file: file.clone(), problem, fix }));
            notes.extend(told.map(|text| Note { file: file.clone(), text }));
        }
    }
    notes.extend(shared_cameras(capture, &train));
    notes.extend(twins(capture, &train));
    notes.extend(distances(capture, &train, points));
    notes.extend(exposure(capture, views));
    (faults, notes)
}

fn cameras(capture: &dyn Capture, split: Split) -> Vec<(String, Camera)> {
    let views = capture.views(split).iter().enumerate();
    let camera = |view| capture.camera(ViewAt { split, view, frame: 0 }).ok();
    views.filter_map(|(v, name)| Some((name.clone(), camera(v)?))).collect()
}

/// Mean part of the points that the cameras see.
fn seen(cameras: &[Camera], points: &Points) -> f64 {
    // A thousand points tell as much as all.
    let step = points.len().div_ceil(1000).max(1);
    let chosen: Vec<DVec3> = points.positions.iter().step_by(step).map(|p| p.map(f64::from).into()).collect();
    let count = |c: &Camera| chosen.iter().filter(|p| c.pixel_of(**p).is_some()).count();
    let all = (chosen.len() * cameras.len()).max(1);
    cameras.iter().map(count).sum::<usize>() as f64 / all as f64
}

fn inverted_poses(capture: &dyn Capture, train: &[(String, Camera)], points: &Points) -> Option<Fault> {
    let as_given: Vec<Camera> = train.iter().map(|(_, c)| *c).collect();
    let turned = |change: &dyn Fn(DMat4) -> DMat4| -> Vec<Camera> {
        let camera = |c: &Camera| Camera::new(c.intrinsics(), change(c.camera_from_world()), c.size()).ok();
        as_given.iter().filter_map(camera).collect()
    };
    let now = seen(&as_given, points);
    if points.is_empty() || now >= FEW_SEEN {
        return None;
    }
    let flip = DMat4::from_diagonal(glam::DVec4::new(1.0, -1.0, -1.0, 1.0));
    let cases: [(&str, &dyn Fn(DMat4) -> DMat4); 3] = [
        ("in OpenGL's axes (y up, z back)", &|m| flip * m),
        ("camera-to-world in OpenGL's axes", &|m| flip * m.inverse()),
        // The last of equals wins, and this is the commonest mistake.
        ("camera-to-world", &|m| m.inverse()),
    ];
    let (name, then) = cases
        .into_iter()
        .map(|(name, change)| (name, seen(&turned(change), points)))
        .max_by(|a, b| a.1.total_cmp(&b.1))?;
    (then > FAR_MORE_SEEN * now && then > FEW_SEEN).then(|| Fault {
        file: capture.part(Part::Cameras(Split::Train)),
        problem: format!(
            "the cameras see {:.0} % of the points; if w2c were {name}, they would see {:.0} %",
            now * 100.0,
            then * 100.0
        ),
        fix: "store w2c as world-to-camera with x right, y down, z forward".into(),
    })
}

fn inverted_masks(capture: &dyn Capture, views: &[ViewSummary]) -> Option<Fault> {
    let with_masks: Vec<_> = views.iter().filter(|v| v.split == Split::Train && v.masks > 0).collect();
    let inverted =
        with_masks.iter().filter(|v| v.coverage > INVERTED && v.border_coverage > INVERTED).count();
    (2 * inverted > with_masks.len()).then(|| Fault {
        file: capture.part(Part::Masks),
        problem: format!(
            "{inverted} of {} cameras have masks that cover most of the image and of its border",
            with_masks.len()
        ),
        fix: "write the moving objects as not 0, the rest as 0 (are the masks inverted?)".into(),
    })
}

/// A principal point outside of the image is a fault, one far from its middle is told.
fn principal_point(name: &str, camera: &Camera) -> (Option<String>, Option<String>) {
    if let Some(stray) = camera.stray_principal_point() {
        return (Some(format!("camera '{name}': {stray}")), None);
    }
    let (k, size) = (camera.intrinsics(), camera.size());
    let (width, height) = (size.width as f64, size.height as f64);
    let off = ((k.cx / width - 0.5).abs()).max((k.cy / height - 0.5).abs()) > OFF_CENTRE;
    let text = format!(
        "camera '{name}': the principal point ({:.0}, {:.0}) of its {} x {} image is far from the middle: do the intrinsics belong to \
         this size?",
        k.cx, k.cy, size.width, size.height
    );
    (None, off.then_some(text))
}

/// Test cameras that are trained on measure nothing.
fn shared_cameras(capture: &dyn Capture, train: &[(String, Camera)]) -> Option<Note> {
    let trained = |c: &Camera| train.iter().any(|(_, t)| same_pose(t, c));
    let names: Vec<String> =
        cameras(capture, Split::Test).into_iter().filter(|(_, c)| trained(c)).map(|(name, _)| name).collect();
    (!names.is_empty()).then(|| Note {
        file: capture.part(Part::Cameras(Split::Test)),
        text: format!("{} also trained on: their figures say nothing of new views", names.join(", ")),
    })
}

/// One camera's calibration that was written for another, too.
fn twins(capture: &dyn Capture, train: &[(String, Camera)]) -> Option<Note> {
    let mut pairs = train.iter().enumerate().flat_map(|(i, a)| train[i + 1..].iter().map(move |b| (a, b)));
    let ((a, _), (b, _)) = pairs.find(|((_, a), (_, b))| same_pose(a, b))?;
    Some(Note {
        file: capture.part(Part::Cameras(Split::Train)),
        text: format!(
            "cameras '{a}' and '{b}' stand in the same place and look the same way: is the pose of one that of the other?"
        ),
    })
}

fn same_pose(a: &Camera, b: &Camera) -> bool {
    a.center().distance(b.center()) < 1e-9 && a.rotation().abs_diff_eq(b.rotation(), 1e-9)
}

fn distances(capture: &dyn Capture, train: &[(String, Camera)], points: &Points) -> Option<Note> {
    let step = points.len().div_ceil(1000).max(1);
    let sample = || points.positions.iter().step_by(step);
    let mut all: Vec<f64> = train
        .iter()
        .flat_map(|(_, c)| sample().filter_map(|p| Some(c.project(p.map(f64::from).into())?.depth)))
        .collect();
    all.sort_by(f64::total_cmp);
    let median = *all.get(all.len() / 2)?;
    let plausible = median > PLAUSIBLE_METRES.0 && median < PLAUSIBLE_METRES.1;
    (!plausible).then(|| Note {
        file: capture.part(Part::Cameras(Split::Train)),
        text: format!(
            "half of the points are nearer to the cameras than {median:.3}: are the lengths metres? A run takes any unit"
        ),
    })
}

fn exposure(capture: &dyn Capture, views: &[ViewSummary]) -> Option<Note> {
    let train = || views.iter().filter(|v| v.split == Split::Train && v.brightness > 0.0);
    let darkest = train().min_by(|a, b| a.brightness.total_cmp(&b.brightness))?;
    let brightest = train().max_by(|a, b| a.brightness.total_cmp(&b.brightness))?;
    (brightest.brightness > EXPOSURE_RATIO * darkest.brightness).then(|| Note {
        file: capture.part(Part::Images),
        text: format!(
            "exposure differs: camera '{}' has a mean of {:.0}, '{}' of {:.0}; ffgs run removes it",
            darkest.name, darkest.brightness, brightest.name, brightest.brightness
        ),
    })
}
