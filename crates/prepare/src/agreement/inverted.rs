//! Poses that take a camera to the world, where those that take the world to the camera are meant.

use super::{Agreement, Alike, LEAST, TIMES};
use crate::PrepareError;
use ffgs_core::Camera;

/// Refuses poses whose inverses agree with far more of the pictures than they.
///
/// # Errors
/// When the poses are inverted.
pub(super) fn refuse(
    alike: &mut Alike,
    cameras: &[Camera],
    agreement: &[Agreement],
) -> Result<(), PrepareError> {
    let places = |agreement: &[Agreement]| agreement.iter().map(Agreement::places).sum::<usize>();
    let now = places(agreement);
    if now >= LEAST * cameras.len() {
        return Ok(());
    }
    let inverse = |camera: &Camera| {
        Camera::new(camera.intrinsics(), camera.camera_from_world().inverse(), camera.size()).ok()
    };
    let Some(inverses) = cameras.iter().map(inverse).collect::<Option<Vec<_>>>() else { return Ok(()) };
    let given: Vec<usize> = (0..cameras.len()).collect();
    let then = places(&alike.agreement(&inverses, &given));
    if then < LEAST * cameras.len() || then < TIMES * now {
        return Ok(());
    }
    Err(PrepareError::Footage(format!(
        "the pictures agree with those of neighbouring cameras at {now} places as the cameras are calibrated, and at {then} with the inverse of each \
         pose: the calibration holds camera-to-world; write world-to-camera into it, the inverse of each"
    )))
}
