//! Few cameras: the first frame is first trained without one of them, to say how far the scene can be trusted between them
//! (docs/adr/0035-few-cameras.md).

use crate::devices::Devices;
use anyhow::Result;
use ffgs_core::{Dynamic, Scene, TrainingView};
use ffgs_metrics::psnr;
use ffgs_trainer::FirstFrame;

/// Fewest views: of two, one alone says nothing of depth.
const FEWEST: usize = 3;
/// Share of the first frame's steps after which the trial tells: with more of them the views that it is trained on only get closer.
pub(crate) const STEPS: f32 = 0.43;
/// A view left out that is worse than the others by this much (dB) is a warning: rendered rigs of 8 to 12 cameras have 1.2 to 5.3, filmed
/// ones of 3 to 7, between which nothing can be seen, 7.2 to 13.
const FAR_BELOW: f64 = 6.0;

/// Trains the first frame of some views.
pub(crate) type Train<'a> = &'a mut dyn FnMut(&[TrainingView]) -> Result<FirstFrame>;

/// A training with one view left out.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Trial {
    /// Which view was left out.
    pub view: usize,
    /// PSNR of the view left out (dB).
    pub left_out: f64,
    /// Mean PSNR of the others (dB).
    pub trained: f64,
}

impl Trial {
    /// What is to be said in the report, if anything, of the camera that was left out.
    pub(crate) fn warning(&self, camera: &str) -> Option<String> {
        let Self { left_out, trained, .. } = self;
        (trained - left_out > FAR_BELOW).then(|| {
            format!(
                "few cameras: trained without camera '{camera}', the first frame has a PSNR of {trained:.1} dB on the others, but of \
                 {left_out:.1} dB on that one. Between the cameras the scene is not known; more cameras, or some nearer to each other, \
                 would help. If points do not lie on what they show in `ffgs check --pictures`, the calibration does not fit"
            )
        })
    }
}

/// Trains without the view in the middle; `None` for views that are not few.
pub(crate) fn trial(
    few: usize,
    views: &[TrainingView],
    devices: Devices,
    train: Train,
) -> Result<Option<Trial>> {
    if views.len() < FEWEST || views.len() > few {
        return Ok(None);
    }
    let mut others = views.to_vec();
    let view = middle(views);
    let left_out = others.remove(view);
    let trained = train(&others)?;
    let of = |views: &[TrainingView]| mean_psnr(&trained, views, devices);
    let trial = Trial { view, left_out: of(std::slice::from_ref(&left_out))?, trained: of(&others)? };
    tracing::info!("few cameras: {:.2} dB, {:.2} dB in a view left out", trial.trained, trial.left_out);
    Ok(Some(trial))
}

/// The view whose camera is nearest to all others: what is left out should lie between what is kept.
fn middle(views: &[TrainingView]) -> usize {
    let centres: Vec<_> = views.iter().map(|view| view.camera.center()).collect();
    let sum = |i: usize| centres.iter().map(|c| c.distance(centres[i])).sum::<f64>();
    (0..views.len()).min_by(|&a, &b| sum(a).total_cmp(&sum(b))).unwrap_or(0)
}

fn mean_psnr(trained: &FirstFrame, views: &[TrainingView], devices: Devices) -> Result<f64> {
    let cameras: Vec<_> = views.iter().map(|view| view.camera).collect();
    let nothing = trained.gaussians.select(&[]);
    let dynamic = Dynamic { gaussians: nothing, ..Dynamic::default() };
    let scene = Scene::new(trained.gaussians.clone(), dynamic, trained.sky.clone());
    let rendered = devices.render(&scene, &cameras)?;
    let each = rendered.iter().zip(views).map(|(image, view)| psnr(image, &view.image));
    Ok(each.sum::<Result<f64, _>>()? / views.len() as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use ffgs_core::{Camera, Gaussians, ImageRgb8, ImageSize, Intrinsics, Mask, SkyCube};
    use glam::{DMat4, DVec3};

    /// Cameras in a row that photograph a grey sky.
    fn views(count: usize) -> Vec<TrainingView> {
        let size = ImageSize { width: 16, height: 8 };
        let intrinsics = Intrinsics { fx: 16.0, fy: 16.0, cx: 8.0, cy: 4.0 };
        let view = |i: usize| TrainingView {
            camera: Camera::new(intrinsics, DMat4::from_translation(DVec3::X * i as f64), size).unwrap(),
            image: ImageRgb8::new(size, vec![128; 3 * size.pixels()]).unwrap(),
            mask: Mask::filled(size, false),
        };
        (0..count).map(view).collect()
    }

    #[test]
    fn few_views_are_tried_without_the_middle_one() {
        for (count, tried) in [(2, false), (3, true), (5, true), (8, true), (9, false)] {
            let mut trained = Vec::new();
            let found = trial(8, &views(count), Devices(&[]), &mut |views| {
                trained.push(views.len());
                // A grey that is wrong by a tenth: 20 dB in every view.
                let sky = SkyCube::filled(2, [128.0 / 255.0 + 0.1; 3]);
                Ok(FirstFrame { gaussians: Gaussians::empty(0), sky })
            });
            let found = found.unwrap();
            assert_eq!((found.is_some(), trained), (tried, if tried { vec![count - 1] } else { vec![] }));
            assert!(found.is_none_or(|t| (t.left_out - 20.0).abs() < 0.1 && (t.trained - 20.0).abs() < 0.1));
        }
    }

    #[test]
    fn a_view_far_below_the_others_is_a_warning() {
        let trial = |left_out| Trial { view: 0, left_out, trained: 40.0 };
        assert!(trial(35.0).warning("cam_2").is_none());
        let text = trial(13.5).warning("cam_2").unwrap();
        assert!(text.contains("40.0 dB") && text.contains("13.5 dB"), "{text}");
    }

    #[test]
    fn the_view_left_out_lies_between_the_others() {
        assert_eq!(middle(&views(5)), 2);
    }
}
