//! What is known of each fixed camera before its masks are made.

use super::background::Background;
use super::colours::Colours;
use super::enclosed::enclosed;
use super::{LEAST_FRAMES, View, difference, regions};
use crate::PrepareError;
use crate::beside::Beside;
use crate::extraction::file_name;
use crate::pictures::read_mask;
use ffgs_core::{ImageRgb8, ImageSize, Mask};
use ffgs_dataset::Capture;
use std::path::Path;

/// What is known of a fixed camera.
pub(super) struct Learnt {
    pub background: Background,
    /// Grey levels that count in a difference.
    pub levels: f32,
    /// Those of the masks that were made before, and of what is around them.
    pub colours: Option<Colours>,
    /// What something covers in every frame, unless other views deny it.
    pub always_covered: Mask,
    /// Where some picture shows something else than the background, which may then be what stood there for most of the time.
    pub changed: Mask,
}

impl Learnt {
    /// What was `always_covered` before, and is in the masks for that, has to be found again.
    fn new(seen: &Seen, always_covered: Option<&Mask>) -> Self {
        let before = always_covered.cloned().unwrap_or_else(|| Mask::filled(seen.size(), false));
        let mut background = seen.background(&before);
        let masks: Vec<Mask> = seen.masks.iter().map(|mask| without(mask, &before)).collect();
        let always_covered = enclosed(&background, &seen.frames, &masks);
        if always_covered != before {
            background = seen.background(&always_covered);
        }
        let levels = difference::levels(&background, &seen.frames, &seen.masks);
        let colours = Colours::learn(&background, &seen.frames, &seen.masks);
        let changed = seen.changed(&background, levels);
        Self { background, levels, colours, always_covered, changed }
    }
}

/// Largest part of the image that counts as changed because all around it changed: the middle of what hardly moves is always covered.
const ENCLOSED: f64 = 0.05;

/// A pixel that is always covered in a part of the footage counts as covered in the rest of it too, unless the footage is so many times longer.
const TWICE: f64 = 2.0;

/// Pictures of a camera.
struct Seen {
    /// Frames of the capture, with the masks that were made before, or none.
    frames: Vec<ImageRgb8>,
    masks: Vec<Mask>,
    /// Pictures of all of its footage, or of the empty scene.
    footage: Vec<ImageRgb8>,
    /// How many times as long the footage is as the part of it that is the capture.
    longer: f64,
}

impl Seen {
    fn size(&self) -> ImageSize {
        self.frames.first().or(self.footage.first()).expect("a camera has pictures").size()
    }

    /// What they show where no mask covers it and nothing is `always_covered`. Who stands still in a short part of the footage is not its
    /// background, so that the frames of that part do not outnumber the rest by more than the part is longer.
    fn background(&self, always_covered: &Mask) -> Background {
        let chosen = chosen(self.frames.len(), self.footage.len(), self.longer);
        let covered = |mask: &Mask| either(&mask.dilated(regions::radius(mask.size())), always_covered);
        let mut masks: Vec<Mask> = chosen.iter().filter_map(|&i| self.masks.get(i)).map(covered).collect();
        if !masks.is_empty() && self.longer < TWICE {
            masks.extend(self.footage.iter().map(|_| always_covered.clone()));
        }
        let frames = chosen.iter().map(|&i| &self.frames[i]);
        Background::learn(&frames.chain(&self.footage).collect::<Vec<_>>(), &masks)
    }

    /// Where one of the pictures differs from the background.
    fn changed(&self, background: &Background, levels: f32) -> Mask {
        let mut changed = vec![0; background.size.pixels()];
        for image in self.frames.iter().chain(&self.footage) {
            let scores = difference::raw(image, background, levels);
            changed.iter_mut().zip(scores).for_each(|(changed, score)| *changed |= u8::from(score > 1.0));
        }
        let changed = Mask::new(background.size, changed).expect("one value per pixel");
        regions::without_specks(&changed, 0.0, ENCLOSED)
    }
}

/// So many of the `frames`, spread over them, as belong beside `footage` that is so many times longer; half as many as of that at least, and
/// enough of them to tell what stands still.
fn chosen(frames: usize, footage: usize, longer: f64) -> Vec<usize> {
    let fair = footage as f64 / (longer - 1.0).max(0.0);
    let fair = if footage > 0 && fair.is_finite() { fair.ceil() as usize } else { frames };
    let count = fair.max(footage / 2).max(LEAST_FRAMES).min(frames);
    (0..count).map(|i| (2 * i + 1) * frames / (2 * count)).collect()
}

/// What one of two masks covers, or both.
fn either(a: &Mask, b: &Mask) -> Mask {
    let data = a.data().iter().zip(b.data()).map(|(a, b)| a | b);
    Mask::new(a.size(), data.collect()).expect("masks of one camera have one size")
}

/// What a mask covers and another one does not.
fn without(mask: &Mask, other: &Mask) -> Mask {
    let data = mask.data().iter().zip(other.data()).map(|(a, b)| a & (1 - b));
    Mask::new(mask.size(), data.collect()).expect("masks of one camera have one size")
}

/// What the round before has left: the folder of its masks, and what it knew of the camera.
#[derive(Clone, Copy)]
pub(super) struct Before<'a> {
    pub folder: &'a Path,
    pub learnt: Option<&'a Learnt>,
}

/// The background of a fixed camera: of the empty scene, or from the frames `samples` without what the masks of them from the round `before`
/// cover, and from more of its footage; and the colours of these masks.
pub(super) fn learn(
    capture: &Capture,
    view: &View,
    samples: &[usize],
    before: Option<Before>,
    beside: &Beside,
) -> Result<Option<Learnt>, PrepareError> {
    if !view.fixed {
        return Ok(None);
    }
    if beside.has_clean_plate(&view.name) {
        let empty = beside.clean_plates(&view.name)?;
        let seen = Seen { frames: Vec::new(), masks: Vec::new(), footage: empty, longer: 1.0 };
        return Ok((!seen.footage.is_empty()).then(|| Learnt::new(&seen, None)));
    }
    if samples.len() < LEAST_FRAMES {
        return Ok(None);
    }
    let (mut frames, mut masks) = (Vec::new(), Vec::new());
    for &frame in samples {
        frames.push(capture.load_image(view.split, view.index, frame)?);
        if let Some(before) = before {
            masks.push(read_mask(&before.folder.join(file_name(&view.name, frame)))?);
        }
    }
    let longer = beside.times_longer(&view.name, capture.frames());
    let seen = Seen { frames, masks, footage: beside.footage(&view.name)?, longer };
    let always_covered = before.and_then(|before| before.learnt).map(|learnt| &learnt.always_covered);
    Ok(Some(Learnt::new(&seen, always_covered)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_of_a_short_part_do_not_outnumber_the_footage() {
        assert_eq!(chosen(20, 16, 1.0).len(), 20, "the capture is all of its footage");
        assert_eq!(chosen(20, 16, 2.0).len(), 16, "half of it: as many as of the rest");
        assert_eq!(chosen(20, 16, 8.0).len(), 8, "an eighth");
        assert_eq!(
            [chosen(20, 0, 1.0).len(), chosen(20, 0, 8.0).len()],
            [20; 2],
            "no footage that can be read"
        );
        assert_eq!(chosen(20, 1, 20.0).len(), LEAST_FRAMES, "hardly any");
        assert_eq!(chosen(8, 8, 1e3), [1, 3, 5, 7]);
    }

    /// Someone stands in a corner in all frames of a part, and nowhere else in the footage.
    #[test]
    fn who_stands_still_in_a_part_is_not_the_background() {
        let size = ImageSize { width: 40, height: 30 };
        let picture = |stands: bool| {
            let grey = |i: usize| if stands && i % 40 < 8 && i / 40 < 10 { 200 } else { 60 + (i % 40) as u8 };
            ImageRgb8::new(size, (0..size.pixels()).flat_map(|i| [grey(i); 3]).collect()).unwrap()
        };
        let seen = |longer: f64| Seen {
            frames: vec![picture(true); 20],
            masks: Vec::new(),
            footage: (0..16).map(|i| picture(i == 7)).collect(),
            longer,
        };
        let corner = |longer: f64| seen(longer).background(&Mask::filled(size, false)).colour[0][0];
        assert!((corner(20.0) - 60.0).abs() < 2.0, "{}", corner(20.0));
        assert!((corner(1.0) - 200.0).abs() < 2.0, "of all frames most: {}", corner(1.0));
        let seen = seen(20.0);
        let changed = seen.changed(&seen.background(&Mask::filled(size, false)), 9.0);
        let [corner, beside, below] = [0, 8, 10 * 40].map(|i| changed.data()[i]);
        assert_eq!([corner, beside, below], [1, 0, 0], "the corner alone showed something else");
    }
}
