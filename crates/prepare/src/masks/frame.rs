//! The masks of one frame: what differs in each view, what the others say of it, and the cheapest outline around it.

use super::learnt::Learnt;
use super::regions::{filled, touched_by, without_specks};
use super::{View, cut, difference, regions};
use crate::PrepareError;
use crate::blocks::DENIALS_PER_VIEW;
use crate::hull::hulls;
use crate::region::common_region;
use crate::silhouettes::Silhouette;
use ffgs_core::{Camera, ImageRgb8, Mask};
use ffgs_dataset::Capture;
use rayon::prelude::*;
use std::ops::Range;

/// Voxels that so many views see may add foreground to a mask.
const VIEWS_THAT_ADD: usize = 4;
/// Of so few views none may deny a voxel. With its own silhouette in the hull a view would deny what its mask misses, so each asks the others
/// alone. With fewer than four, two others would confirm too much.
const FEW_VIEWS: Range<usize> = VIEWS_THAT_ADD..DENIALS_PER_VIEW;
/// Smallest region (of the image) that is kept, and largest hole that is filled.
const SPECK: f64 = 2e-4;
const HOLE: f64 = 1e-3;
/// Largest hole that is filled where other views find most of it possible: a dark hub before a dark road is one, what is seen between an
/// arm and a hip is not.
const POSSIBLE_HOLE: f64 = 4e-3;

/// The masks of one frame, in the order of the views.
pub(super) fn masks_of(
    capture: &Capture,
    views: &[View],
    learnt: &[Option<Learnt>],
    frame: usize,
) -> Result<Vec<Mask>, PrepareError> {
    let load = |view: &View| -> Result<(Camera, ImageRgb8), PrepareError> {
        Ok((
            capture.camera(view.split, view.index, frame)?,
            capture.load_image(view.split, view.index, frame)?,
        ))
    };
    let loaded: Vec<_> = views.par_iter().map(load).collect::<Result<_, _>>()?;
    let raw: Vec<Option<Vec<f32>>> = loaded
        .par_iter()
        .zip(learnt)
        .map(|((_, image), learnt)| learnt.as_ref().map(|l| difference::raw(image, &l.background, l.levels)))
        .collect();
    let scores: Vec<Option<Vec<f32>>> = (raw.par_iter().zip(learnt))
        .map(|(raw, learnt)| Some(difference::scores(raw.as_ref()?, &learnt.as_ref()?.always_covered)))
        .collect();
    let silhouettes: Vec<Silhouette> = loaded
        .iter()
        .zip(&scores)
        .filter_map(|((camera, _), s)| {
            let mask = difference::foreground(s.as_ref()?, camera.size());
            Some(Silhouette { camera: *camera, mask })
        })
        .collect();
    let cameras: Vec<Camera> = loaded.iter().map(|l| l.0).collect();
    let refined = |(v, agreed): (usize, &Agreed)| {
        let (Some(raw), Some(Learnt { background, colours, always_covered, changed, .. })) =
            (&raw[v], &learnt[v])
        else {
            return agreed.mask.clone();
        };
        let image = &loaded[v].1;
        let mut votes = cut::votes(raw, image.size());
        if let Some(colours) = colours {
            colours.weigh(&mut votes, image, background, changed, &agreed.mask);
        }
        cut::add_other_views(&mut votes, &agreed.possible, &agreed.confirmed);
        cut::cover(&mut votes, always_covered, &agreed.possible);
        let cut = cut::cheapest(&votes, image, background, &agreed.mask);
        // What colours alone have found is another thing of the same colour.
        let found = touched_by(&cut, |i| agreed.mask.data()[i] == 1);
        filled(&without_specks(&found, SPECK, HOLE), POSSIBLE_HOLE, &agreed.possible)
    };
    Ok(agreed(&cameras, &scores, &silhouettes).par_iter().enumerate().map(refined).collect())
}

/// The mask of a view, by what all views say.
struct Agreed {
    mask: Mask,
    /// What no other view denies.
    possible: Mask,
    /// What the others see.
    confirmed: Mask,
}

/// What a view found itself, and what the others see though the difference is weak here.
fn agreed(cameras: &[Camera], scores: &[Option<Vec<f32>>], silhouettes: &[Silhouette]) -> Vec<Agreed> {
    let fixed: Vec<Camera> = silhouettes.iter().map(|s| s.camera).collect();
    let region = common_region(&fixed);
    let all = hulls(silhouettes, region, [1, VIEWS_THAT_ADD.min(silhouettes.len())]);
    let mut own = 0..silhouettes.len();
    let mut mask_of = |camera: &Camera, score: &Option<Vec<f32>>| {
        let Some(score) = score else {
            let add = all[1].seen_by(camera, 0);
            return Agreed { mask: add.clone(), possible: add.clone(), confirmed: add };
        };
        let own = own.next().expect("a silhouette per score");
        let others = FEW_VIEWS
            .contains(&silhouettes.len())
            .then(|| hulls(&without(silhouettes, own), region, [1, VIEWS_THAT_ADD - 1]));
        let [possible, seen] = others.as_ref().unwrap_or(&all);
        let (own, add) = (&silhouettes[own].mask, seen.seen_by(camera, 0));
        let allowed = possible.seen_by(camera, 1).dilated(regions::radius(camera.size()));
        let data = (0..own.data().len())
            .map(|i| own.data()[i] | (add.data()[i] & u8::from(score[i] > difference::WITH_OTHERS)));
        let mask = Mask::new(camera.size(), data.collect()).expect("one value per pixel");
        Agreed { mask: without_specks(&mask, SPECK, HOLE), possible: allowed, confirmed: add }
    };
    cameras.iter().zip(scores).map(|(c, s)| mask_of(c, s)).collect()
}

/// All but one.
fn without(silhouettes: &[Silhouette], one: usize) -> Vec<Silhouette> {
    [&silhouettes[..one], &silhouettes[one + 1..]].concat()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hull::tests::{ball, ring};
    use glam::DVec3;

    /// Shares of the left half of a ball that each view finds possible, and that the others confirm: the first view of so many misses it.
    fn left_half(views: usize) -> Vec<[f64; 2]> {
        let cameras = ring(views);
        let whole: Vec<Mask> = cameras.iter().map(|c| ball(c, DVec3::new(1.0, 0.0, 0.3), 0.3)).collect();
        let left = |mask: &Mask, i: usize| mask.data()[i] == 1 && i % mask.size().width < 80;
        let found = |(v, mask): (usize, &Mask)| {
            let data = (0..mask.data().len()).map(|i| mask.data()[i] * u8::from(v > 0 || !left(mask, i)));
            Silhouette { camera: cameras[v], mask: Mask::new(mask.size(), data.collect()).unwrap() }
        };
        let silhouettes: Vec<Silhouette> = whole.iter().enumerate().map(found).collect();
        let scores: Vec<_> = whole.iter().map(|mask| Some(vec![0.0; mask.data().len()])).collect();
        let share = |(agreed, whole): (&Agreed, &Mask)| {
            let half: Vec<usize> = (0..whole.data().len()).filter(|&i| left(whole, i)).collect();
            [&agreed.possible, &agreed.confirmed]
                .map(|m| half.iter().filter(|&&i| m.data()[i] == 1).count() as f64 / half.len() as f64)
        };
        agreed(&cameras, &scores, &silhouettes).iter().zip(&whole).map(share).collect()
    }

    #[test]
    fn what_one_view_of_four_misses_the_three_others_confirm() {
        for views in [4, 5, 6] {
            let [possible, confirmed] = left_half(views)[0];
            assert!(possible > 0.95 && confirmed > 0.95, "{views} views: {possible}, {confirmed}");
        }
        let [_, confirmed] = left_half(3)[0];
        assert!(confirmed < 0.5, "two others confirm little: {confirmed}");
    }
}
