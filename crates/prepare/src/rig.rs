//! The footage's cameras as the capture has them: size, pinhole, units, which are held out.

use crate::names::plain_name;
use crate::pictures::{self, Look};
use crate::schedule::Sequence;
use crate::{PrepareError, Request, TestCameras, moments, video};
use ffgs_calibration::{Distortion, Footage, Lens, Pictures, Role, SourceCamera, Undistortion};
use ffgs_core::{Camera, ImageSize, RigExtent, counted};
use glam::{DMat4, DVec3};
use std::collections::BTreeMap;

/// A camera as the capture will have it.
#[derive(Clone, Debug)]
pub(crate) struct RigCamera {
    pub name: String,
    pub undistortion: Undistortion,
    /// `camera_from_world` in metres, recentred: one, or one per picture.
    pub poses: Vec<DMat4>,
    pub pictures: Pictures,
    pub masks: Option<Pictures>,
    pub test: bool,
    pub sequence: Sequence,
    /// What its first picture tells.
    pub look: Look,
}

/// All cameras and what was decided for them.
#[derive(Clone, Debug, Default)]
pub(crate) struct Rig {
    pub cameras: Vec<RigCamera>,
    /// Metres in a unit of the calibration.
    pub metres_per_unit: f64,
    /// Where the capture's origin lies in the calibration's world (its units).
    pub origin: DVec3,
    pub assumed: Vec<String>,
}

/// From this many cameras on every eighth is held out, as the field does for photographs since LLFF.
const ENOUGH_TO_HOLD_OUT: usize = 16;
const USUAL_STRIDE: usize = 8;

/// Decides size, units, origin and held-out cameras.
pub(crate) fn rig(footage: &Footage, request: &Request) -> Result<Rig, PrepareError> {
    if footage.cameras.len() < 2 {
        let skipped = footage.skipped.join("; ");
        let found = footage.cameras.len();
        return Err(PrepareError::Footage(format!(
            "two cameras with pictures are needed, {found} can be used. {skipped}"
        )));
    }
    if !(request.scale > 0.0 && request.scale <= 1.0) {
        return Err(PrepareError::Footage(format!("--scale {} is not in (0, 1]", request.scale)));
    }
    let test = test_cameras(footage, request)?;
    let metres_per_unit = request.metres_per_unit.or(footage.metres_per_unit).unwrap_or(1.0);
    let mut rig = Rig { metres_per_unit, origin: origin(footage), ..Rig::default() };
    for (source, test) in footage.cameras.iter().zip(&test) {
        let camera = rig.camera(source, *test, request)?;
        if rig.cameras.iter().any(|c| c.name == camera.name) {
            return Err(PrepareError::Footage(format!("two cameras are called {}", camera.name)));
        }
        rig.cameras.push(camera);
    }
    rig.assumed.extend(scaled(footage, &rig.cameras));
    rig.assumed.extend(unexpected(&rig.cameras));
    if request.metres_per_unit.or(footage.metres_per_unit).is_none() {
        rig.assumed.push("lengths of the calibration are metres (--unit names another unit)".to_owned());
    }
    if rig.origin != DVec3::ZERO {
        rig.assumed.push(format!("the world was recentred by {:.1} (its unit)", rig.origin));
    }
    if test.iter().any(|t| *t) && request.test == TestCameras::Usual {
        let names: Vec<&str> = rig.cameras.iter().filter(|c| c.test).map(|c| c.name.as_str()).collect();
        rig.assumed.push(format!("held out for measuring: {} (--test chooses others)", names.join(", ")));
    }
    Ok(rig)
}

impl Rig {
    fn camera(
        &self,
        source: &SourceCamera,
        test: bool,
        request: &Request,
    ) -> Result<RigCamera, PrepareError> {
        let look = first_look(&source.pictures)?;
        let (found, lens) = (look.size, lens_for(source, look)?);
        let reduced = |length: usize| ((length as f64 * request.scale).round() as usize).max(1);
        let size = ImageSize { width: reduced(found.width), height: reduced(found.height) };
        let undistortion = Undistortion::new(lens, size)
            .map_err(|reason| PrepareError::Footage(format!("camera '{}': {reason}", source.name)))?;
        let move_origin = DMat4::from_translation(self.origin);
        let to_metres = |pose: &DMat4| {
            let mut pose = *pose * move_origin;
            pose.w_axis = (pose.w_axis.truncate() * self.metres_per_unit).extend(1.0);
            pose
        };
        let (pictures, rate, moments) = match &source.pictures {
            Pictures::Video(file) => {
                let facts = video::probe(file)?;
                (facts.frames, Some(facts.rate), facts.times)
            }
            Pictures::Files(files) => (files.len(), None, moments::numbers(files)),
        };
        let name = plain_name(&source.name);
        Ok(RigCamera {
            sequence: Sequence { name: name.clone(), pictures, rate, moments },
            name,
            undistortion,
            poses: source.poses.iter().map(to_metres).collect(),
            pictures: source.pictures.clone(),
            masks: source.masks.clone(),
            test,
            look,
        })
    }
}

/// The lens for the pictures.
fn lens_for(source: &SourceCamera, look: Look) -> Result<Lens, PrepareError> {
    let (lens, found) = (source.lens, look.size);
    if lens.size.pixels() == 0 {
        let pinhole = Camera::new(lens.intrinsics, DMat4::IDENTITY, found);
        let fault = pinhole.map_or_else(|e| Some(e.to_string()), |pinhole| pinhole.stray_principal_point());
        let told = |fault| PrepareError::Footage(format!("camera '{}': {fault}", source.name));
        return fault.map_or(Ok(Lens { size: found, ..lens }), |fault| Err(told(fault)));
    }
    let (x, y) = (found.width as f64 / lens.size.width as f64, found.height as f64 / lens.size.height as f64);
    // A video encoder may pad or crop by a pixel or two.
    if (x / y - 1.0).abs() > 0.02 {
        let is_turned = found.width == lens.size.height && found.height == lens.size.width;
        let turned = match (is_turned, look.turned) {
            (true, true) => {
                "; their EXIF data say that they are to be turned, which is not done here: save them turned (mogrify -auto-orient)"
            }
            (true, false) => "; a video may say that it is to be turned, which ffmpeg does",
            (false, _) => "",
        };
        let reason = format!(
            "camera '{}' was calibrated at {} x {}, but its pictures are {} x {}{turned}",
            source.name, lens.size.width, lens.size.height, found.width, found.height
        );
        return Err(PrepareError::Footage(reason));
    }
    Ok(lens.resized(found))
}

/// Of which cameras the intrinsics were scaled: a sentence for all of the same sizes.
fn scaled(footage: &Footage, cameras: &[RigCamera]) -> Vec<String> {
    let mut groups: BTreeMap<(usize, usize), Vec<&str>> = BTreeMap::new();
    for (source, camera) in footage.cameras.iter().zip(cameras) {
        let (calibrated, found) = (source.lens.size, camera.undistortion.source_size());
        if calibrated.pixels() > 0 && calibrated != found {
            groups.entry((calibrated.width, found.width)).or_default().push(&camera.name);
        }
    }
    let told = |((calibrated, found), names): ((usize, usize), Vec<&str>)| {
        format!(
            "the calibration is for {calibrated} columns, the pictures of {} have {found}: intrinsics were scaled",
            some_of(&names)
        )
    };
    groups.into_iter().map(told).collect()
}

/// What first pictures tell that a user may not expect.
fn unexpected(cameras: &[RigCamera]) -> Vec<String> {
    let of = |is: &dyn Fn(&Look) -> bool| -> Option<String> {
        let names: Vec<&str> = cameras.iter().filter(|c| is(&c.look)).map(|c| c.name.as_str()).collect();
        (!names.is_empty()).then(|| some_of(&names))
    };
    let transparent = of(&|look| look.transparent).map(|cameras| {
        format!(
            "pictures of {cameras} are transparent in parts, which count as what their colours show: cut them off, or fill them"
        )
    });
    let turned = of(&|look| look.turned).map(|cameras| {
        format!(
            "pictures of {cameras} say by EXIF data that they are to be turned; they are taken as they are stored, as COLMAP takes them (where the \
             calibration is of turned ones, as OpenCV reads them, save them turned: mogrify -auto-orient)"
        )
    });
    transparent.into_iter().chain(turned).collect()
}

/// Cameras in words, the first of many.
fn some_of(names: &[&str]) -> String {
    const SHOWN: usize = 4;
    let shown = names[..names.len().min(SHOWN)].join(", ");
    match names.len().saturating_sub(SHOWN) {
        0 => format!("camera {shown}"),
        more => format!("camera {shown} and {}", counted(more, "other")),
    }
}

/// Cameras whose lens bends.
pub(crate) fn distorted(footage: &Footage) -> usize {
    footage.cameras.iter().filter(|c| c.lens.distortion != Distortion::None).count()
}

/// What the first picture tells. Of a video that is to be turned ffmpeg turns the frames.
fn first_look(of: &Pictures) -> Result<Look, PrepareError> {
    match of {
        Pictures::Video(file) => {
            let first = video::Frames::open(file)?.next()?;
            first
                .map(|i| Look { size: i.size(), transparent: false, turned: false })
                .ok_or_else(|| PrepareError::picture(file, "ffmpeg decodes no frame of it"))
        }
        Pictures::Files(files) => {
            let first =
                files.first().ok_or_else(|| PrepareError::Footage("a camera has no picture".to_owned()))?;
            pictures::look_at(first)
        }
    }
}

/// Whether each camera is held out.
pub(crate) fn test_cameras(footage: &Footage, request: &Request) -> Result<Vec<bool>, PrepareError> {
    let cameras = &footage.cameras;
    let said = cameras.iter().any(|c| c.role != Role::Unsaid);
    let test: Vec<bool> = match &request.test {
        TestCameras::Every(n) => (0..cameras.len()).map(|i| i % n == 0).collect(),
        TestCameras::Named(names) => {
            let names: Vec<String> = names.iter().map(|name| plain_name(name)).collect();
            let spelt: Vec<String> = cameras.iter().map(|camera| plain_name(&camera.name)).collect();
            if let Some(unknown) = names.iter().find(|name| !spelt.contains(name)) {
                let known = cameras.iter().map(|c| c.name.as_str()).collect::<Vec<_>>().join(", ");
                return Err(PrepareError::Footage(format!(
                    "--test names camera {unknown}; the cameras are {known}"
                )));
            }
            spelt.iter().map(|name| names.contains(name)).collect()
        }
        TestCameras::Usual if said => cameras.iter().map(|c| c.role == Role::Test).collect(),
        TestCameras::Usual if cameras.len() >= ENOUGH_TO_HOLD_OUT => {
            (0..cameras.len()).map(|i| i % USUAL_STRIDE == 0).collect()
        }
        TestCameras::Usual | TestCameras::None => vec![false; cameras.len()],
    };
    let train = test.iter().filter(|t| !**t).count();
    if train < 2 {
        return Err(PrepareError::Footage(format!(
            "--test leaves {} to reconstruct from, two are needed",
            counted(train, "camera")
        )));
    }
    Ok(test)
}

/// The middle of the cameras when they are far from the world's origin, else the origin.
pub(crate) fn origin(footage: &Footage) -> DVec3 {
    let centres: Vec<DVec3> =
        footage.cameras.iter().flat_map(|c| &c.poses).map(|p| p.inverse().w_axis.truncate()).collect();
    let rig = RigExtent::of(&centres);
    if rig.is_far_from_zero() { rig.middle } else { DVec3::ZERO }
}
