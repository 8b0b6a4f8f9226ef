//! What is known of each fixed camera before its masks are made.

use super::background::Background;
use super::colours::Colours;
use super::{LEAST_FRAMES, View, difference, regions};
use crate::PrepareError;
use crate::beside::Beside;
use crate::extraction::file_name;
use crate::pictures::read_mask;
use ffgs_core::{ImageRgb8, Mask};
use ffgs_dataset::Capture;
use std::path::Path;

/// What is known of a fixed camera.
pub(super) struct Learnt {
    pub background: Background,
    /// Grey levels that count in a difference.
    pub levels: f32,
    /// Those of the masks that were made before, and of what is around them.
    pub colours: Option<Colours>,
}

impl Learnt {
    /// With pictures and the `masks` of the first ones of them that were made before.
    fn new(background: Background, images: &[ImageRgb8], masks: &[Mask]) -> Self {
        let levels = difference::levels(&background, images, masks);
        let colours = Colours::learn(&background, images, masks);
        Self { background, levels, colours }
    }
}

/// The background of a fixed camera: of the empty scene, or from the frames `samples` without what `known` masks of them
/// cover, and from more of its footage; and the colours of these masks.
pub(super) fn learn(
    capture: &Capture,
    view: &View,
    samples: &[usize],
    known: Option<&Path>,
    beside: &Beside,
) -> Result<Option<Learnt>, PrepareError> {
    if !view.fixed {
        return Ok(None);
    }
    if beside.has_clean_plate(&view.name) {
        let empty = beside.clean_plates(&view.name)?;
        return Ok((!empty.is_empty()).then(|| Learnt::new(Background::learn(&empty, &[]), &[], &[])));
    }
    if samples.len() < LEAST_FRAMES {
        return Ok(None);
    }
    let mut images = Vec::new();
    let mut masks = Vec::new();
    for &frame in samples {
        images.push(capture.load_image(view.split, view.index, frame)?);
        if let Some(folder) = known {
            masks.push(read_mask(&folder.join(file_name(&view.name, frame)))?);
        }
    }
    images.extend(beside.footage(&view.name)?);
    let covered: Vec<Mask> = masks.iter().map(|m| m.dilated(regions::radius(m.size()))).collect();
    let background = Background::learn(&images, &covered);
    Ok(Some(Learnt::new(background, &images, &masks)))
}
