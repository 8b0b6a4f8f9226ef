//! What a format leaves out although a file has it, told in [`Footage::skipped`](crate::Footage): points that are no places, and masks of cameras
//! that have some only.

use crate::{ColouredPoint, Pictures};
use std::path::{Path, PathBuf};

/// The points that single precision can hold, in their order; `skipped` tells how many others the file has.
pub(super) fn usable_points(
    points: Vec<ColouredPoint>,
    file: &Path,
    skipped: &mut Vec<String>,
) -> Vec<ColouredPoint> {
    let all = points.len();
    let usable: Vec<_> = points.into_iter().filter(|p| p.position.as_vec3().is_finite()).collect();
    let bad = all - usable.len();
    if bad > 0 {
        skipped.push(format!("{}: {bad} of {all} points are NaN, infinite or too large", file.display()));
    }
    usable
}

/// A camera's masks, one for each of its pictures; without one for each there are none, which `skipped` tells where some are there. `masks` are
/// files, or what a message calls a mask that is missing.
pub(super) fn complete_masks(
    camera: &str,
    masks: Vec<Result<PathBuf, String>>,
    skipped: &mut Vec<String>,
) -> Option<Pictures> {
    let all = masks.len();
    let missing = masks.iter().filter(|mask| mask.is_err()).count();
    if let Some(first) = masks.iter().find_map(|mask| mask.as_ref().err()).filter(|_| missing < all) {
        skipped.push(format!(
            "masks of camera '{camera}': {missing} of {all} are missing (first: {first}), so none of this camera are used"
        ));
    }
    masks.into_iter().collect::<Result<_, _>>().ok().map(Pictures::Files)
}

/// A file if it is there, else what a message calls it.
pub(super) fn file_or_name(file: PathBuf) -> Result<PathBuf, String> {
    if file.is_file() { Ok(file) } else { Err(file.display().to_string()) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    #[test]
    fn points_that_are_no_places_are_counted() {
        let at = |x: f64| ColouredPoint { position: DVec3::new(x, 2.0, 3.0), colour: [1, 2, 3] };
        let (file, mut skipped) = (Path::new("a.ply"), Vec::new());
        let sound = vec![at(1.0), at(-2e38)];
        assert_eq!(usable_points(sound.clone(), file, &mut skipped), sound);
        assert!(skipped.is_empty(), "{skipped:?}");
        let points = vec![at(f64::NAN), at(1.0), at(f64::INFINITY), at(1e39)];
        assert_eq!(usable_points(points, file, &mut skipped), [at(1.0)]);
        assert_eq!(skipped, ["a.ply: 3 of 4 points are NaN, infinite or too large"]);
    }

    #[test]
    fn masks_are_complete_or_told() {
        let (there, missing) = (|name: &str| Ok(PathBuf::from(name)), |name: &str| Err(name.to_owned()));
        let mut skipped = Vec::new();
        let all = complete_masks("a", vec![there("0"), there("1")], &mut skipped);
        assert_eq!(all, Some(Pictures::Files(vec!["0".into(), "1".into()])));
        assert_eq!(complete_masks("a", vec![missing("0"), missing("1")], &mut skipped), None);
        assert!(skipped.is_empty(), "all or none: {skipped:?}");
        assert_eq!(complete_masks("a", vec![there("0"), missing("x/1"), missing("2")], &mut skipped), None);
        let told = "masks of camera 'a': 2 of 3 are missing (first: x/1), so none of this camera are used";
        assert_eq!(skipped, [told]);
    }
}
