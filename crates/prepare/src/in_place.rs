//! Footage that is a capture as it lies: pictures of pinhole cameras with a calibration, read where they are.

use crate::names::is_plain;
use crate::rig::{origin, test_cameras};
use crate::{Request, pictures};
use ffgs_calibration::formats::Format;
use ffgs_calibration::{Distortion, Footage, Pictures, SourceCamera};
use ffgs_core::{Camera, ImageRgb8, Mask};
use ffgs_dataset::{DatasetError, probe_image, read_image_with_file, read_mask};
use ffgs_method::{Capture, CaptureFormat, Fault, Part, Plugin, Points, Split, ViewAt};
use glam::{DMat4, DVec3};
use std::path::{Path, PathBuf};

/// A format of calibrations as one of captures. Footage that must be converted first is refused with the command that
/// does it.
pub struct InPlace(pub &'static Format);

impl Plugin for InPlace {
    fn name(&self) -> &'static str {
        self.0.name
    }

    fn summary(&self) -> &'static str {
        self.0.looks_for
    }
}

impl CaptureFormat for InPlace {
    fn detect(&self, folder: &Path) -> Option<String> {
        (self.0.find)(folder).map(|file| file.display().to_string())
    }

    fn open(&self, folder: &Path) -> Result<Box<dyn Capture>, Fault> {
        let file = (self.0.find)(folder).unwrap_or_else(|| folder.to_owned());
        let footage = (self.0.read)(folder, &file).map_err(|error| Fault::new(&file, &error, error.fix()))?;
        Ok(Box::new(FootageCapture::new(folder, file, footage)?))
    }
}

/// Footage whose cameras are pinholes with a picture file for every frame.
#[derive(Debug)]
struct FootageCapture {
    root: PathBuf,
    calibration: PathBuf,
    frames: usize,
    /// Of the splits train and test.
    cameras: [Vec<SourceCamera>; 2],
    names: [Vec<String>; 2],
    metres_per_unit: f64,
    points: Option<Points>,
}

impl FootageCapture {
    fn new(root: &Path, calibration: PathBuf, mut footage: Footage) -> Result<Self, Fault> {
        let fix = format!("make a capture of it: ffgs prepare {} --out CAPTURE", root.display());
        let refuse = |problem: String| Fault::new(&calibration, problem, fix.clone());
        if footage.cameras.len() < 2 {
            let (found, skipped) = (footage.cameras.len(), footage.skipped.join("; "));
            return Err(refuse(format!(
                "two cameras with pictures are needed, {found} can be used. {skipped}"
            )));
        }
        if let Some(reason) = needs_conversion(&footage) {
            return Err(refuse(reason));
        }
        footage.skipped.iter().for_each(|text| tracing::warn!("{}: {text}", root.display()));
        let request = Request::new(root.to_owned(), root.to_owned());
        let test = test_cameras(&footage, &request).map_err(|error| refuse(error.to_string()))?;
        footage.cameras.iter_mut().try_for_each(learn_size)?;
        let metres_per_unit = footage.metres_per_unit.unwrap_or(1.0);
        let frames = picture_count(&footage.cameras[0]);
        let mut cameras = [Vec::new(), Vec::new()];
        for (camera, test) in footage.cameras.into_iter().zip(test) {
            cameras[usize::from(test)].push(camera);
        }
        let names = cameras.each_ref().map(|of| of.iter().map(|camera| camera.name.clone()).collect());
        let mut points = Points::default();
        for point in &footage.points {
            let position = (point.position * metres_per_unit).as_vec3();
            let [r, g, b] = point.colour.map(|c| f32::from(c) / 255.0);
            points.push([position.x, position.y, position.z, r, g, b], false);
        }
        let points = (!points.is_empty()).then_some(points);
        Ok(Self { root: root.to_owned(), calibration, frames, cameras, names, metres_per_unit, points })
    }

    fn source(&self, at: ViewAt) -> Result<&SourceCamera, Fault> {
        let cameras: &[SourceCamera] = match at.split {
            Split::Train => &self.cameras[0],
            Split::Test => &self.cameras[1],
            Split::Init => &[],
        };
        cameras.get(at.view).filter(|_| at.frame < self.frames).ok_or_else(|| {
            let problem = format!("{} has no view {} at frame {}", at.split, at.view, at.frame);
            Fault::new(&self.calibration, problem, "ask for a view and frame that the capture holds")
        })
    }

    fn fault(&self, error: &DatasetError) -> Fault {
        error.in_capture(&self.root)
    }
}

impl Capture for FootageCapture {
    fn root(&self) -> &Path {
        &self.root
    }

    fn frames(&self) -> usize {
        self.frames
    }

    fn views(&self, split: Split) -> &[String] {
        match split {
            Split::Train => &self.names[0],
            Split::Test => &self.names[1],
            Split::Init => &[],
        }
    }

    fn camera(&self, at: ViewAt) -> Result<Camera, Fault> {
        let source = self.source(at)?;
        let mut pose: DMat4 = source.poses[if source.poses.len() == 1 { 0 } else { at.frame }];
        pose.w_axis = (pose.w_axis.truncate() * self.metres_per_unit).extend(1.0);
        let camera = Camera::new(source.lens.intrinsics, pose, source.lens.size);
        camera.and_then(|camera| camera.check_plausible().map(|()| camera)).map_err(|error| {
            let problem = format!("camera '{}', frame {}: {error}", source.name, at.frame);
            Fault::new(&self.calibration, problem, "export the calibration again, or leave the camera out")
        })
    }

    fn image(&self, at: ViewAt) -> Result<ImageRgb8, Fault> {
        self.image_with_file(at).map(|(image, _)| image)
    }

    fn image_with_file(&self, at: ViewAt) -> Result<(ImageRgb8, Option<Vec<u8>>), Fault> {
        let source = self.source(at)?;
        let read = read_image_with_file(file_of(&source.pictures, at.frame), source.lens.size);
        read.map(|(image, bytes)| (image, Some(bytes))).map_err(|error| self.fault(&error))
    }

    fn probe(&self, at: ViewAt) -> Result<(), Fault> {
        let source = self.source(at)?;
        probe_image(file_of(&source.pictures, at.frame), source.lens.size).map_err(|error| self.fault(&error))
    }

    fn image_file(&self, at: ViewAt) -> Option<PathBuf> {
        Some(file_of(&self.source(at).ok()?.pictures, at.frame).to_owned())
    }

    fn probe_mask(&self, at: ViewAt) -> Result<bool, Fault> {
        let source = self.source(at)?;
        let probe = |masks| probe_image(file_of(masks, at.frame), source.lens.size);
        source
            .masks
            .as_ref()
            .map(probe)
            .transpose()
            .map(|found| found.is_some())
            .map_err(|error| self.fault(&error))
    }

    fn mask(&self, at: ViewAt) -> Result<Option<Mask>, Fault> {
        let source = self.source(at)?;
        let read = |masks| read_mask(file_of(masks, at.frame), source.lens.size);
        source.masks.as_ref().map(read).transpose().map_err(|error| self.fault(&error))
    }

    fn points(&self) -> Result<Option<Points>, Fault> {
        Ok(self.points.clone())
    }

    fn part(&self, part: Part) -> PathBuf {
        match part {
            Part::Cameras(_) | Part::Points => self.calibration.clone(),
            Part::Images => self.root.clone(),
            Part::Masks => self.root.join("masks"),
        }
    }
}

/// The file of a frame; [`needs_conversion`] refused everything else.
fn file_of(pictures: &Pictures, frame: usize) -> &Path {
    match pictures {
        Pictures::Files(files) => &files[frame],
        Pictures::Video(file) => file,
    }
}

fn picture_count(camera: &SourceCamera) -> usize {
    match &camera.pictures {
        Pictures::Files(files) => files.len(),
        Pictures::Video(_) => 0,
    }
}

/// The size of the pictures, where the calibration does not say it.
fn learn_size(camera: &mut SourceCamera) -> Result<(), Fault> {
    if camera.lens.size.pixels() == 0 {
        let file = file_of(&camera.pictures, 0);
        let first = pictures::read_rgb(file).map_err(|error| Fault::new(file, &error, error.fix()))?;
        camera.lens.size = first.size();
    }
    Ok(())
}

/// Why the footage is no capture yet.
fn needs_conversion(footage: &Footage) -> Option<String> {
    let frames = picture_count(&footage.cameras[0]);
    let counts = |masks: &Pictures| matches!(masks, Pictures::Files(files) if files.len() == frames);
    let of_camera = |camera: &SourceCamera| {
        let reasons = [
            (matches!(camera.pictures, Pictures::Video(_)), "is a video"),
            (camera.lens.distortion != Distortion::None, "has a lens that bends"),
            (frames == 0 || !counts(&camera.pictures), "has another number of pictures"),
            (![1, frames].contains(&camera.poses.len()), "has no pose for every frame"),
            (!camera.masks.as_ref().is_none_or(counts), "has no mask for every frame"),
            (!camera.name.chars().all(is_plain), "has a name that is no plain file name"),
        ];
        let found = reasons.into_iter().find(|(is_so, _)| *is_so);
        found.map(|(_, why)| format!("camera '{}' {why}", camera.name))
    };
    let of_all = if footage.timestamps.is_some() {
        Some("its frames are matched by timestamps".to_owned())
    } else {
        (origin(footage) != DVec3::ZERO).then(|| "the scene is far from the world's origin".to_owned())
    };
    let twice = || {
        let names = || footage.cameras.iter().map(|camera| &camera.name);
        let found = names().enumerate().find(|(i, name)| names().take(*i).any(|other| other == *name));
        found.map(|(_, name)| format!("two cameras are called '{name}'"))
    };
    footage.cameras.iter().find_map(of_camera).or(of_all).or_else(twice)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Layout, convert};
    use ffgs_calibration::formats::{COLMAP, TRANSFORMS};

    fn sample() -> PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/scenes/fairmont-mini")
    }

    fn train(view: usize) -> ViewAt {
        ViewAt { split: Split::Train, view, frame: 0 }
    }

    /// A frame of the sample in the layouts of other tools is the same capture: cameras, pictures, points.
    #[test]
    fn other_layouts_of_the_sample_are_read_where_they_are() {
        let original = ffgs_dataset::Capture::open(&sample()).unwrap();
        for (layout, format) in [(Layout::Colmap, &COLMAP), (Layout::Nerfstudio, &TRANSFORMS)] {
            let folder = tempfile::tempdir().unwrap();
            convert(&original, layout, 2, folder.path()).unwrap();
            let format = InPlace(format);
            assert!(format.detect(folder.path()).is_some() && format.detect(&sample()).is_none());
            let capture = format.open(folder.path()).unwrap();
            assert_eq!(capture.frames(), 1);
            let views = original.views(Split::Train).iter().enumerate();
            for (v, view) in views.filter(|(_, view)| capture.views(Split::Train).contains(&view.name)) {
                let found = capture.views(Split::Train).iter().position(|name| *name == view.name).unwrap();
                let (a, b) =
                    (original.camera(Split::Train, v, 2).unwrap(), capture.camera(train(found)).unwrap());
                assert!(a.camera_from_world().abs_diff_eq(b.camera_from_world(), 1e-6), "{}", view.name);
                assert_eq!(
                    original.load_image(Split::Train, v, 2).unwrap(),
                    capture.image(train(found)).unwrap()
                );
                capture.probe(train(found)).unwrap();
            }
            let points = capture.points().unwrap().expect("both layouts hold the points");
            assert_eq!(points.len(), original.initial_points().unwrap().len(), "{layout:?}");
            assert!(capture.camera(ViewAt { frame: 1, ..train(0) }).is_err());
        }
    }

    #[test]
    fn footage_that_must_be_converted_is_refused_with_the_command() {
        let folder = tempfile::tempdir().unwrap();
        let original = ffgs_dataset::Capture::open(&sample()).unwrap();
        convert(&original, Layout::Nerfstudio, 0, folder.path()).unwrap();
        let file = folder.path().join("transforms.json");
        let text = std::fs::read_to_string(&file).unwrap();
        std::fs::write(&file, text.replacen("\"fl_x\"", "\"k1\": 0.1, \"fl_x\"", 1)).unwrap();
        let refused = InPlace(&TRANSFORMS).open(folder.path()).unwrap_err().to_string();
        assert!(refused.contains("has a lens that bends") && refused.contains("ffgs prepare"), "{refused}");
    }
}
