//! The exposures of the cameras: removed from photographs, given back to renders (docs/adr/0055-exposures.md). What single frames change is found in
//! `light.rs`.

use anyhow::Result;
use ffgs_core::{Camera, Exposure, Gaussians, TrainingView, upper_median};
use ffgs_method::{Capture, Split, ViewAt};
use ffgs_trainer::estimate_exposures;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Root mean square of the offsets of the training views (log odds) from which cameras differ. Surfaces that reflect differ between views,
/// too: 0.02 to 0.13 in five rendered captures of one exposure, 0.21 in two filmed ones.
const DIFFERENT: f64 = 0.16;
/// Offset from the median (log odds) from which one camera differs though all together do not,
const STANDS_OUT: f64 = 0.3;
/// and in units of the cameras' median distance from it.
const UNUSUAL: f64 = 4.0;
/// Standard errors that a likeness of neighbours must have: 34 in a filmed walk, up to 2.2 where each camera has an exposure of its own.
const NO_CHANCE: f64 = 3.0;
/// Least squared distance of two cameras, as a share of the rig's.
const NEAREST: f64 = 1e-6;

/// Offsets of the log odds (red, green, blue) by camera; empty where cameras agree.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Exposures {
    /// Training views.
    train: BTreeMap<String, [f64; 3]>,
    /// Views of the first frame alone.
    init: BTreeMap<String, [f64; 3]>,
    /// By how much training views differ from these in one frame, where any does.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    change: BTreeMap<String, [f64; 3]>,
}

impl Exposures {
    /// Of the photographs `views`, taken at `shots`, on the surfaces of a first frame that was trained on them.
    pub(crate) fn estimate(
        capture: &dyn Capture,
        shots: &[ViewAt],
        views: &[TrainingView],
        trained: &Gaussians,
    ) -> Self {
        let estimated = estimate_exposures(trained, views);
        let of_training = || shots.iter().zip(&estimated).filter(|(at, _)| at.split == Split::Train);
        let mean = |c: usize| {
            of_training().map(|(_, exposure)| exposure.offsets[c]).sum::<f64>()
                / of_training().count().max(1) as f64
        };
        let means = [0, 1, 2].map(mean);
        let mut all = Self::default();
        for (at, exposure) in shots.iter().zip(&estimated) {
            let offsets = [0, 1, 2].map(|c| ((exposure.offsets[c] - means[c]) * 1e4).round() / 1e4);
            all.split_mut(at.split).insert(capture.views(at.split)[at.view].clone(), offsets);
        }
        tracing::debug!("exposures: {:.3} (log odds, root mean square), {:?}", all.deviation(), all.train);
        if all.deviation() > DIFFERENT { all } else { all.standing_out() }
    }

    /// With the offsets of the cameras that stand out from all others, about the median; neutral where none does.
    fn standing_out(&self) -> Self {
        let column = |c: usize| self.train.values().map(|offsets| offsets[c]).collect::<Vec<f64>>();
        let middle = [0, 1, 2].map(|c| upper_median(column(c)).unwrap_or(0.0));
        let away = |offsets: &[f64; 3]| {
            let from_middle: [f64; 3] = std::array::from_fn(|c| offsets[c] - middle[c]);
            (from_middle, from_middle.iter().fold(0.0, |most: f64, offset| most.max(offset.abs())))
        };
        let usual = upper_median(self.train.values().map(|offsets| away(offsets).1)).unwrap_or(0.0);
        let stands_out = |offsets: &[f64; 3]| away(offsets).1 > STANDS_OUT.max(UNUSUAL * usual);
        if !self.train.values().any(stands_out) {
            return Self::default();
        }
        let kept = |all: &BTreeMap<String, [f64; 3]>| {
            let offsets = |offsets: &[f64; 3]| if stands_out(offsets) { away(offsets).0 } else { [0.0; 3] };
            all.iter().map(|(name, of_camera)| (name.clone(), offsets(of_camera))).collect()
        };
        Self { train: kept(&self.train), init: kept(&self.init), change: BTreeMap::new() }
    }

    fn split_mut(&mut self, split: Split) -> &mut BTreeMap<String, [f64; 3]> {
        if split == Split::Init { &mut self.init } else { &mut self.train }
    }

    /// Without what one frame changes.
    #[must_use]
    pub fn usual(&self) -> Self {
        Self { change: BTreeMap::new(), ..self.clone() }
    }

    /// With a frame's changes (log odds) of training views, by their names: of every view, as those that do not change speak for the views between
    /// them, too.
    pub(crate) fn changed(&self, changes: impl Iterator<Item = (String, [f64; 3])>) -> Self {
        let mut change: BTreeMap<_, _> = changes.collect();
        if change.values().all(|offsets| *offsets == [0.0; 3]) {
            change.clear();
        }
        Self { change, ..self.clone() }
    }

    /// How many training views this frame changes.
    pub fn changes(&self) -> usize {
        self.change.values().filter(|offsets| **offsets != [0.0; 3]).count()
    }

    /// Of a training view that was trained on.
    fn of_training(&self, name: &str) -> Option<[f64; 3]> {
        let (usual, change) = (self.train.get(name), self.change.get(name));
        let [usual, more] = [usual, change].map(|offsets| offsets.copied().unwrap_or_default());
        (self.train.contains_key(name) || change.is_some())
            .then(|| std::array::from_fn(|c| usual[c] + more[c]))
    }

    /// Root mean square of the training views' offsets (log odds), without what one frame changes.
    pub fn deviation(&self) -> f64 {
        let offsets: Vec<f64> = self.train.values().flatten().copied().collect();
        (offsets.iter().map(|o| o * o).sum::<f64>() / offsets.len().max(1) as f64).sqrt()
    }

    /// Whether all cameras agree.
    pub fn are_neutral(&self) -> bool {
        self.train.is_empty() && self.change.is_empty()
    }

    /// Whether every offset is a number between -20 and 20.
    pub fn are_sound(&self) -> bool {
        let all = self.train.values().chain(self.init.values()).chain(self.change.values()).flatten();
        all.copied().all(|offset| offset.is_finite() && offset.abs() < 20.0)
    }

    /// Of one view. A camera that was not trained on has the mean of the training cameras, the nearest of which count most, as
    /// far as neighbours resemble each other: in a walk with one camera they do, in a rig of several they may not.
    ///
    /// # Errors
    /// When a camera cannot be read.
    pub fn of(&self, capture: &dyn Capture, at: ViewAt) -> Result<Exposure> {
        if self.are_neutral() {
            return Ok(Exposure::NEUTRAL);
        }
        let name = &capture.views(at.split)[at.view];
        let known = match at.split {
            Split::Train => self.of_training(name),
            Split::Init => self.init.get(name).copied(),
            Split::Test => None,
        };
        if let Some(offsets) = known {
            return Ok(Exposure { offsets });
        }
        let known = self.known_cameras(capture, at.frame)?;
        let (likeness, neighbours) = (likeness(&known), from_neighbours(&known, &capture.camera(at)?));
        Ok(Exposure { offsets: neighbours.map(|offset| likeness * offset) })
    }

    /// Training cameras at a frame, and their offsets.
    fn known_cameras(&self, capture: &dyn Capture, frame: usize) -> Result<Vec<(Camera, [f64; 3])>> {
        let names = capture.views(Split::Train).iter().enumerate();
        let known = names.filter_map(|(view, name)| Some((view, self.of_training(name)?)));
        known
            .map(|(view, offsets)| {
                Ok((capture.camera(ViewAt { split: Split::Train, view, frame })?, offsets))
            })
            .collect()
    }

    /// Turns photographs taken at `shots` into those that cameras of one exposure would have taken.
    ///
    /// # Errors
    /// When a camera cannot be read.
    pub fn remove(&self, capture: &dyn Capture, shots: &[ViewAt], views: &mut [TrainingView]) -> Result<()> {
        for (&at, view) in shots.iter().zip(views).filter(|_| !self.are_neutral()) {
            view.image = self.of(capture, at)?.removed(&view.image);
        }
        Ok(())
    }

    /// The training view whose exposure differs most, and by how much (log odds); `None` where all cameras agree.
    pub fn furthest(&self) -> Option<(&str, f64)> {
        let largest = |offsets: &[f64; 3]| {
            offsets.iter().copied().fold(0.0, |a: f64, b| if b.abs() > a.abs() { b } else { a })
        };
        let offsets = self.train.iter().map(|(name, offsets)| (name.as_str(), largest(offsets)));
        offsets.max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()))
    }
}

/// Mean of the offsets of cameras; weights fall with the fourth power of the distance and of the angle between the views.
fn from_neighbours(known: &[(Camera, [f64; 3])], camera: &Camera) -> [f64; 3] {
    let distances: Vec<f64> =
        known.iter().map(|(other, _)| other.center().distance_squared(camera.center())).collect();
    // Lengths in units of the rig, to be added to angles.
    let rig = (distances.iter().sum::<f64>() / distances.len().max(1) as f64).max(f64::MIN_POSITIVE);
    let weight = |((other, _), distance): (&(Camera, [f64; 3]), &f64)| {
        let angle = other.rotation().row(2).angle_between(camera.rotation().row(2));
        (distance / rig + angle * angle + NEAREST).powi(-2)
    };
    let weights: Vec<f64> = known.iter().zip(&distances).map(weight).collect();
    let sum: f64 = weights.iter().sum();
    [0, 1, 2].map(|c| {
        let weighted = known.iter().zip(&weights).map(|((_, offsets), w)| w * offsets[c]);
        if known.is_empty() { 0.0 } else { weighted.sum::<f64>() / sum }
    })
}

/// How far cameras resemble their neighbours, 0 to 1: the slope of their offsets over those that the others predict, where it is not chance.
fn likeness(known: &[(Camera, [f64; 3])]) -> f64 {
    let pairs: Vec<([f64; 3], [f64; 3])> = (0..known.len())
        .map(|left_out| {
            let mut others = known.to_vec();
            let (camera, offsets) = others.remove(left_out);
            (from_neighbours(&others, &camera), offsets)
        })
        .collect();
    let product = |a: &[f64; 3], b: &[f64; 3]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let square = pairs.iter().map(|(p, _)| product(p, p)).sum::<f64>().max(f64::MIN_POSITIVE);
    let slope = pairs.iter().map(|(p, offsets)| product(p, offsets)).sum::<f64>() / square;
    // The channels of a camera change together: it counts once.
    let of_camera = |(p, offsets): &([f64; 3], [f64; 3])| product(p, offsets) - slope * product(p, p);
    let error = pairs.iter().map(|pair| of_camera(pair).powi(2)).sum::<f64>().sqrt() / square;
    if slope > NO_CHANCE * error { slope.clamp(0.0, 1.0) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ffgs_core::{ImageSize, Intrinsics};
    use ffgs_dataset::Dynamic3dGaussians;
    use ffgs_method::CaptureFormat;
    use glam::{DMat4, DVec3};
    use std::path::Path;

    fn sample() -> Box<dyn Capture> {
        let sample = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fixtures/scenes/fairmont-mini");
        Dynamic3dGaussians.open(&sample).unwrap()
    }

    /// Training view `bright` by +1, the others by nothing.
    fn one_bright(capture: &dyn Capture, bright: usize) -> Exposures {
        let names = capture.views(Split::Train).iter().enumerate();
        let offsets = |view| [if view == bright { 1.0 } else { 0.0 }; 3];
        Exposures {
            train: names.map(|(view, name)| (name.clone(), offsets(view))).collect(),
            ..Exposures::default()
        }
    }

    /// Cameras in a row that look along z, one per offset.
    fn row(offsets: &[f64]) -> Vec<(Camera, [f64; 3])> {
        offsets.iter().enumerate().map(|(i, offset)| (at(i as f64), [*offset; 3])).collect()
    }

    fn at(x: f64) -> Camera {
        let size = ImageSize { width: 16, height: 8 };
        let intrinsics = Intrinsics { fx: 16.0, fy: 16.0, cx: 8.0, cy: 4.0 };
        Camera::new(intrinsics, DMat4::from_translation(DVec3::new(-x, 0.0, 0.0)), size).unwrap()
    }

    #[test]
    fn neighbours_predict_an_exposure_as_far_as_they_resemble_each_other() {
        let walk = row(&[-0.6, -0.5, -0.3, -0.1, 0.0, 0.2, 0.3, 0.4, 0.6]);
        let between = from_neighbours(&walk, &at(6.5))[0];
        assert!((between - 0.35).abs() < 0.05, "{between}");
        assert!(likeness(&walk) > 0.8, "{}", likeness(&walk));
        let alternating = row(&[0.5, -0.5, 0.5, -0.5, 0.5, -0.5]);
        assert_eq!(likeness(&alternating), 0.0);
        let by_chance = row(&[-0.1, 0.3, 0.3, 0.0, -0.1, -0.3, -0.2, -0.4]);
        assert_eq!(likeness(&by_chance), 0.0, "a slope of 0.8, two standard errors");
        assert_eq!((from_neighbours(&[], &at(0.0)), likeness(&[])), ([0.0; 3], 0.0));
        assert_eq!(from_neighbours(&walk[..1], &at(0.0)), [-0.6; 3]);
    }

    #[test]
    fn a_training_view_has_its_own_exposure_and_no_view_has_one_where_cameras_agree() {
        let capture = sample();
        let view = |split, view| ViewAt { split, view, frame: 0 };
        let exposures = one_bright(&*capture, 2);
        let of = |at| exposures.of(&*capture, at).unwrap().offsets;
        assert_eq!((of(view(Split::Train, 2)), of(view(Split::Train, 0))), ([1.0; 3], [0.0; 3]));
        assert!(of(view(Split::Test, 0)).iter().all(|offset| (0.0..1.0).contains(offset)));
        let neutral = Exposures::default().of(&*capture, view(Split::Test, 0)).unwrap();
        assert_eq!(neutral, Exposure::NEUTRAL);
    }

    #[test]
    fn a_frame_changes_some_cameras_and_those_between_them() {
        let capture = sample();
        let names = capture.views(Split::Train);
        let of = |exposures: &Exposures, view| {
            exposures.of(&*capture, ViewAt { split: Split::Train, view, frame: 0 }).unwrap().offsets[0]
        };
        let changes = |view: usize| if view == 2 { [0.3; 3] } else { [0.0; 3] };
        let changes = names.iter().enumerate().map(|(view, name)| (name.clone(), changes(view)));
        let usual = one_bright(&*capture, 2);
        for (before, sum) in [(Exposures::default(), 0.3), (usual.clone(), 1.3)] {
            let changed = before.changed(changes.clone());
            assert!(!changed.are_neutral() && changed.are_sound());
            assert_eq!((of(&changed, 2), of(&changed, 0), changed.changes()), (sum, 0.0, 1));
            assert_eq!(changed.usual(), before);
        }
    }

    #[test]
    fn the_camera_that_differs_most_is_named_and_offsets_have_bounds() {
        let capture = sample();
        let mut exposures = one_bright(&*capture, 2);
        let names = capture.views(Split::Train);
        assert_eq!(exposures.furthest(), Some((names[2].as_str(), 1.0)));
        assert!(exposures.are_sound() && !exposures.are_neutral());
        assert_eq!(Exposures::default().furthest(), None);
        for wrong in [f64::NAN, 1e9] {
            exposures.init.insert("other".to_owned(), [0.0, wrong, 0.0]);
            assert!(!exposures.are_sound(), "{wrong}");
        }
    }

    #[test]
    fn one_wrong_camera_among_many_is_seen_and_the_others_stay_as_they_are() {
        let named = |offsets: &dyn Fn(usize) -> f64| Exposures {
            train: (0..40).map(|view| (format!("{view:02}"), [offsets(view); 3])).collect(),
            ..Exposures::default()
        };
        let usual = |view: usize| 0.08 * (view as f64).sin();
        let wrong = named(&|view| if view == 7 { 0.6 } else { usual(view) });
        assert!(wrong.deviation() < DIFFERENT, "all together do not differ: {}", wrong.deviation());
        let found = wrong.standing_out();
        assert!((found.train["07"][0] - 0.6).abs() < 0.05, "{:?}", found.train["07"]);
        assert_eq!(found.train.values().filter(|offsets| **offsets != [0.0; 3]).count(), 1);
        assert!(named(&usual).standing_out().are_neutral());
        let wide = named(&|view| 0.25 * (view as f64).sin());
        assert!(wide.standing_out().are_neutral(), "reflections");
    }
}
