//! The first frame of few cameras: how long it is trained, and how freely, is found with one view left out.
//!
//! A handful of photographs can be fitted to the last pixel by a scene that is wrong everywhere between them; then less
//! training is better (docs/adr/0035-few-cameras-train-as-long-as-a-view-left-out-gains.md).

use crate::devices::Devices;
use anyhow::Result;
use ffgs_core::{Dynamic, Gaussians, Scene, TrainingView};
use ffgs_metrics::psnr;
use ffgs_trainer::{FirstFrame, FirstFrameConfig};

/// Shares of the steps that are tried, until more is no better.
const SHARES: [f64; 3] = [1.0 / 9.0, 1.0 / 3.0, 1.0];
/// Fewest views: of two, one alone says nothing of depth.
const FEWEST: usize = 3;
/// A view left out that is worse than the others by this much (dB) is a warning.
const FAR_BELOW: f64 = 8.0;

/// Trains the first frame of some views.
pub(crate) type Train<'a> = &'a mut dyn FnMut(&FirstFrameConfig, &[TrainingView]) -> Result<FirstFrame>;

/// A training with one view left out.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Trial {
    /// Its settings.
    pub config: FirstFrameConfig,
    /// PSNR of the view left out (dB).
    pub left_out: f64,
    /// Mean PSNR of the others (dB).
    pub trained: f64,
}

impl Trial {
    /// What is to be said in the report, if anything.
    pub(crate) fn warning(&self, cameras: usize) -> Option<String> {
        let Self { left_out, trained, .. } = self;
        (trained - left_out > FAR_BELOW).then(|| {
            format!(
                "few cameras: the first frame fits its photographs to {trained:.1} dB, but one left out of {cameras} \
                 only to {left_out:.1} dB. Between the cameras the scene is not known; more cameras, or some nearer to each \
                 other, would help"
            )
        })
    }
}

/// The settings under which a view left out is best; `None` for views that are not few.
pub(crate) fn best_trial(
    config: &FirstFrameConfig,
    views: &[TrainingView],
    devices: Devices,
    train: Train,
) -> Result<Option<Trial>> {
    if views.len() < FEWEST || views.len() > config.few_views {
        return Ok(None);
    }
    let mut others = views.to_vec();
    let left_out = others.remove(middle(views));
    let mut attempt = |config: FirstFrameConfig| -> Result<Trial> {
        let trained = train(&config, &others)?;
        let of = |views: &[TrainingView]| mean_psnr(&trained, views, devices);
        let trial = Trial { config, left_out: of(std::slice::from_ref(&left_out))?, trained: of(&others)? };
        let (steps, degree) = (config.iterations, config.sh_degree);
        tracing::info!(
            "few cameras: {steps} steps, colours of degree {degree}: {:.2} dB, {:.2} dB in a view left out",
            trial.trained,
            trial.left_out
        );
        Ok(trial)
    };
    let steps = |share: f64| (share * config.iterations as f64).ceil() as usize;
    let mut best = attempt(FirstFrameConfig { iterations: steps(SHARES[0]), ..*config })?;
    for share in &SHARES[1..] {
        let next = attempt(FirstFrameConfig { iterations: steps(*share), ..*config })?;
        if next.left_out <= best.left_out {
            break;
        }
        best = next;
    }
    if config.sh_degree > 0 {
        let flat = attempt(FirstFrameConfig { sh_degree: 0, ..best.config })?;
        best = if flat.left_out > best.left_out { flat } else { best };
    }
    Ok(Some(best))
}

/// The view whose camera is nearest to all others: what is left out should lie between what is kept.
fn middle(views: &[TrainingView]) -> usize {
    let centres: Vec<_> = views.iter().map(|view| view.camera.center()).collect();
    let sum = |i: usize| centres.iter().map(|c| c.distance(centres[i])).sum::<f64>();
    (0..views.len()).min_by(|&a, &b| sum(a).total_cmp(&sum(b))).unwrap_or(0)
}

fn mean_psnr(trained: &FirstFrame, views: &[TrainingView], devices: Devices) -> Result<f64> {
    let cameras: Vec<_> = views.iter().map(|view| view.camera).collect();
    let nothing = Gaussians::empty(trained.gaussians.sh_degree());
    let scene = Scene {
        hidden: Vec::new(),
        static_colours: Vec::new(),
        static_layer: trained.gaussians.clone().into(),
        dynamic: Dynamic { gaussians: nothing, ..Dynamic::default() },
        sky: trained.sky.clone(),
    };
    let rendered = devices.render(&scene, &cameras)?;
    let each = rendered.iter().zip(views).map(|(image, view)| psnr(image, &view.image));
    Ok(each.sum::<Result<f64, _>>()? / views.len() as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use ffgs_core::{Camera, ImageRgb8, ImageSize, Intrinsics, Mask, SkyCube};
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

    /// A training that is best at `at` steps, and better or worse without colours of higher degree.
    fn trial(count: usize, at: usize, flat: f32) -> (Option<Trial>, Vec<(usize, usize, usize)>) {
        let config = FirstFrameConfig { iterations: 900, few_views: 8, ..FirstFrameConfig::default() };
        let mut calls = Vec::new();
        let best = best_trial(&config, &views(count), Devices(&[]), &mut |config, views| {
            calls.push((config.iterations, config.sh_degree, views.len()));
            let error = 0.1 * (config.iterations as f32 / at as f32).ln().abs();
            let error = error + 0.01 + if config.sh_degree == 0 { flat } else { 0.0 };
            let sky = SkyCube::filled(2, [128.0 / 255.0 + error; 3]);
            Ok(FirstFrame { gaussians: Gaussians::empty(config.sh_degree), sky })
        });
        (best.unwrap(), calls)
    }

    #[test]
    fn the_steps_under_which_a_view_left_out_is_best_are_taken() {
        let (best, calls) = trial(5, 300, 0.005);
        assert_eq!(calls, [(100, 3, 4), (300, 3, 4), (900, 3, 4), (300, 0, 4)]);
        assert_eq!(best.unwrap().config.iterations, 300);
        let (best, calls) = trial(5, 100, -0.005);
        assert_eq!(calls, [(100, 3, 4), (300, 3, 4), (100, 0, 4)]);
        let config = best.unwrap().config;
        assert_eq!((config.iterations, config.sh_degree), (100, 0));
    }

    #[test]
    fn many_views_are_trained_as_asked() {
        for count in [2, 9, 20] {
            let (best, calls) = trial(count, 300, 0.0);
            assert!(best.is_none() && calls.is_empty(), "{count}");
        }
    }

    #[test]
    fn a_view_far_below_the_others_is_a_warning() {
        let trial = |left_out| Trial { config: FirstFrameConfig::default(), left_out, trained: 40.0 };
        assert!(trial(35.0).warning(4).is_none());
        let text = trial(13.5).warning(4).unwrap();
        assert!(text.contains("40.0 dB") && text.contains("13.5 dB"), "{text}");
    }

    #[test]
    fn the_view_left_out_lies_between_the_others() {
        assert_eq!(middle(&views(5)), 2);
    }
}
