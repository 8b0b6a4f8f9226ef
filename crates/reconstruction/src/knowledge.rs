//! Information on the moving layer from one frame to the next: predicted, used as the prior of the finetuning, and
//! increased by that of the frame's photographs (docs/adr/0019-information-is-the-prior-of-the-next-frame.md).

use crate::reduced::Reduced;
use ffgs_core::{Gaussians, Knowledge, Scene, SkyCube, StageLog, stage};
use ffgs_fusion::symmetric_inverse;
use ffgs_rasterizer::Information;
use ffgs_trainer::{Drift, DynamicLaneConfig, Gain, PixelNoise, Prior, information_gain};
use glam::DMat3;
use std::time::Instant;

/// The prediction before a frame's photographs.
pub(crate) struct Predicted {
    information: Information,
    noise: PixelNoise,
    /// Where the finetuning starts.
    start: Gaussians,
    /// What was known before the drift.
    known: Gaussians,
    drift: Drift,
    config: DynamicLaneConfig,
}

fn least(config: &DynamicLaneConfig) -> Drift {
    Drift::from_array(config.drift.map(|deviation| deviation * deviation))
}

impl Predicted {
    /// After the motion; `None` when nothing is known or asked for.
    pub(crate) fn new(scene: &Scene, config: &DynamicLaneConfig) -> Option<Self> {
        let Knowledge { information, drift, noise: [sigma, correlated] } = &scene.dynamic.knowledge;
        if information.is_empty() || (config.prior_weight == 0.0 && config.natural_step == 0.0) {
            return None;
        }
        let positions = scene.dynamic.covariances.iter().map(|&c| symmetric_inverse(c));
        let positions = positions.map(|p| if p.is_finite() { p } else { DMat3::ZERO }).collect();
        let least = least(config).to_array();
        let drift = Drift::from_array([0, 1, 2, 3, 4].map(|k| drift[k].max(least[k])));
        let others = drift.fade(information);
        Some(Self {
            information: Information { positions, others },
            noise: PixelNoise { sigma: *sigma, correlated: *correlated },
            start: scene.dynamic.gaussians.clone(),
            known: information.clone(),
            drift,
            config: *config,
        })
    }

    /// As the finetuning takes it.
    pub(crate) fn prior(&self) -> Prior<'_> {
        let information = &self.information;
        Prior { information, noise: self.noise, weight: self.config.prior_weight, curvature: information }
    }
}

/// What is known of the last of the `layers`, and what `views` tell of it where it is now: the curvature that the loss has at the start of a training, in
/// units of the prior's noise.
pub(crate) fn curvature(layers: &[&Gaussians], sky: &SkyCube, views: &Reduced, prior: Prior) -> Information {
    let Gain { mut information, noise } = information_gain(layers, sky, &views.views);
    let correlated = noise.correlated * (views.factor * views.factor) as f64;
    tracing::debug!("pixels before the training: {noise:?}, after the last one: {:?}", prior.noise);
    // What a nat of information is in the loss at the noise of these photographs, over what it is at the prior's.
    let unit = noise.sigma * correlated / (prior.noise.sigma * prior.noise.correlated);
    let unit = if unit.is_finite() { unit } else { 1.0 };
    let known = prior.information;
    for (sum, known) in information.positions.iter_mut().zip(&known.positions) {
        *sum = *sum * unit + *known;
    }
    let in_units = |values: &mut [f32]| values.iter_mut().for_each(|v| *v *= unit as f32);
    let Gaussians { quats, log_scales, opacity_logits, sh, .. } = &mut information.others;
    in_units(quats.as_flattened_mut());
    in_units(log_scales.as_flattened_mut());
    in_units(opacity_logits);
    in_units(sh.as_flattened_mut());
    add(&mut information.others, &known.others);
    information
}

/// Adds the information of `views`, reduced or not, on the trained scene; `predicted` is the information before, and the start of the training.
pub(crate) fn learn(scene: &mut Scene, predicted: Option<&Predicted>, views: &Reduced, log: &mut StageLog) {
    let start = Instant::now();
    if scene.dynamic.gaussians.is_empty() {
        return;
    }
    let Gain { information: gained, noise } = information_gain(&scene.layers(), &scene.sky, &views.views);
    let dynamic = &mut scene.dynamic;
    for (covariance, gained) in dynamic.covariances.iter_mut().zip(&gained.positions) {
        let joint = symmetric_inverse(symmetric_inverse(*covariance) + *gained);
        *covariance = if joint.is_finite() { joint } else { *covariance };
    }
    let mut drift = dynamic.knowledge.drift;
    let mut known = gained.others;
    if let Some(predicted) = predicted {
        let mut learnt = predicted.drift;
        let ends = (&predicted.start, &dynamic.gaussians);
        learnt.learn(least(&predicted.config), &predicted.known, &known, ends);
        drift = learnt.to_array();
        add(&mut known, &predicted.information.others);
    }
    tracing::debug!("pixels: {noise:?}; {drift:?}");
    // Of whole pixels, as the next frame may be reduced otherwise.
    let correlated = noise.correlated * (views.factor * views.factor) as f64;
    dynamic.knowledge = Knowledge { information: known, drift, noise: [noise.sigma, correlated] };
    log.since(stage::INFORMATION, start);
}

fn add(sum: &mut Gaussians, more: &Gaussians) {
    let add = |sum: &mut [f32], more: &[f32]| sum.iter_mut().zip(more).for_each(|(s, m)| *s += m);
    add(sum.quats.as_flattened_mut(), more.quats.as_flattened());
    add(sum.log_scales.as_flattened_mut(), more.log_scales.as_flattened());
    add(&mut sum.opacity_logits, &more.opacity_logits);
    add(sum.sh.as_flattened_mut(), more.sh.as_flattened());
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_scene::{ball, photographs, scene};
    use ffgs_core::TrainingView;
    use ffgs_rasterizer::{Background, CpuRasterizer, RenderTape, View};
    use ffgs_trainer::{CpuBackend, Surroundings, train_dynamic};
    use glam::Vec3;

    /// Mean absolute difference (grey levels) of what `views` show inside their masks and the layer before their grey.
    fn error(layer: &Gaussians, views: &[TrainingView]) -> f32 {
        let (mut sum, mut count, mut tape) = (0.0, 0.0, RenderTape::default());
        for view in views {
            let frame = View { camera: &view.camera, background: Background::Colour([0.3; 3]), tiles: None };
            CpuRasterizer::default().render(layer, &frame, &mut tape);
            for pixel in (0..view.mask.data().len()).filter(|&pixel| view.mask.data()[pixel] != 0) {
                let difference = Vec3::from(tape.image().pixel(pixel)) - Vec3::from(view.image.pixel(pixel));
                sum += difference.abs().element_sum() * 255.0;
                count += 3.0;
            }
        }
        sum / count
    }

    #[test]
    fn what_fits_already_is_not_spoilt_by_steps_that_are_too_long() {
        let views = photographs(&ball(Vec3::ZERO));
        let mut scene = scene(&ball(Vec3::ZERO));
        let whole = Reduced::new(&views, 1);
        learn(&mut scene, None, &whole, &mut StageLog::default());
        let config = DynamicLaneConfig::default();
        let predicted = Predicted::new(&scene, &config).unwrap();
        let known = predicted.prior();
        let expected = curvature(&scene.layers(), &scene.sky, &whole, known);
        let pairs = expected.others.sh.iter().zip(&known.information.others.sh);
        assert!(pairs.clone().all(|(sum, known)| (0..3).all(|c| sum[c] >= known[c])), "they are added");
        let trained = |prior| {
            let mut layer = scene.dynamic.gaussians.clone();
            let around =
                Surroundings { static_layer: &scene.static_layer, sky: &scene.sky, prior: Some(prior) };
            train_dynamic(&CpuBackend, &config, &views, around, &mut layer, 1, &mut |_| {}).unwrap();
            error(&layer, &views)
        };
        let (alone, together) = (trained(known), trained(Prior { curvature: &expected, ..known }));
        let start = error(&scene.dynamic.gaussians, &views);
        assert!(start < 0.3, "the layer is what was photographed: {start}");
        assert!(together < 0.5 * alone, "{together} grey levels, {alone} with what is known alone");
    }
}
