//! Single cameras whose pose or lens is not that of their pictures.

use super::Agreement;
use ffgs_core::upper_median;

/// Fewer places tell nothing of a camera.
const LEAST: usize = 40;
/// A camera is told of that agrees at less than this part of the share of places at which most cameras do.
const PART: f64 = 0.25;

/// Cameras that agree far less with their neighbours than most do.
pub(super) fn told(names: &[String], agreement: &[Agreement]) -> Option<String> {
    let judged = || agreement.iter().zip(names).filter(|(a, _)| a.alike >= LEAST);
    let usual = upper_median(judged().map(|(a, _)| a.share()))?;
    let text = |(a, name): (&Agreement, &String)| {
        format!("camera '{name}' agrees with its neighbours at {} of {} places", a.same, a.alike)
    };
    let all: Vec<String> = judged().filter(|(a, _)| a.share() < PART * usual).map(text).collect();
    (!all.is_empty()).then(|| {
        format!(
            "{}; most cameras do at {:.0} %: is its calibration that of these pictures, and did it stand where it was calibrated?",
            all.join(", "),
            100.0 * usual
        )
    })
}
