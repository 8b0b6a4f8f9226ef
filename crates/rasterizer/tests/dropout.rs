//! A rendering with dropout is the rendering of those that are kept, with raised opacities, and so are its derivatives.

use ffgs_core::{Camera, Gaussians, ImageSize, Intrinsics, PlanarImage};
use ffgs_rasterizer::{
    Background, CpuRasterizer, Dropout, Gradients, PixelGradients, RenderOptions, RenderTape, View,
};
use ffgs_testkit::largest_difference;
use glam::DMat4;

const SIZE: ImageSize = ImageSize { width: 60, height: 40 };
const DROPOUT: Dropout = Dropout { share: 0.4, draw: 5 };

fn balls(count: usize) -> Gaussians {
    let mut out = Gaussians::zeros(count, 0);
    for i in 0..count {
        let share = |k: usize| ((i * k) % count) as f32 / count as f32;
        let depth = 2.0 + 4.0 * share(7);
        out.means[i] = [(1.2 * share(5) - 0.6) * depth, (0.8 * share(3) - 0.4) * depth, depth];
        out.quats[i] = [1.0, 0.0, 0.0, 0.0];
        out.log_scales[i] = [-2.2 + share(11), -2.0, -2.4];
        out.opacity_logits[i] = 6.0 * share(13) - 4.0;
        out.sh[i] = [share(17), share(19), share(23)].map(|v| 2.0 * v - 1.0);
    }
    out
}

/// Renders with upstream derivatives that vary over the image.
fn both_passes(layer: &Gaussians, dropout: Option<Dropout>) -> (RenderTape, Gradients) {
    let intrinsics = Intrinsics { fx: 40.0, fy: 40.0, cx: 30.0, cy: 20.0 };
    let camera = Camera::new(intrinsics, DMat4::IDENTITY, SIZE).unwrap();
    let view = View { camera: &camera, background: Background::Colour([0.2, 0.5, 0.9]), tiles: None };
    let rasterizer = CpuRasterizer::new(RenderOptions { dropout, ..RenderOptions::default() });
    let mut upstream = PlanarImage::zeros(SIZE);
    upstream.data_mut().iter_mut().enumerate().for_each(|(i, v)| *v = (i as f32 * 0.1).sin());
    let (mut tape, mut gradients) = (RenderTape::default(), Gradients::default());
    rasterizer.render(layer, &view, &mut tape);
    gradients.reset(layer.len(), 0);
    let upstream = PixelGradients { image: &upstream, transmittance: None };
    rasterizer.backward(layer, &view, &mut tape, &upstream, &mut gradients);
    (tape, gradients)
}

fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + (-x).exp())
}

#[test]
fn dropout_is_a_rendering_of_those_that_are_kept() {
    let layer = balls(150);
    let (with, from) = both_passes(&layer, Some(DROPOUT));
    let kept: Vec<usize> = (0..layer.len()).filter(|&i| from.touched[i]).collect();
    assert!((60..120).contains(&kept.len()), "{} are kept", kept.len());

    let mut alone = layer.select(&kept);
    let raised = |logit: f32| (sigmoid(logit) * DROPOUT.gain()).min(1.0);
    for logit in &mut alone.opacity_logits {
        let opacity = f64::from(raised(*logit)).min(1.0 - 1e-7);
        *logit = (opacity / (1.0 - opacity)).ln() as f32;
    }
    let (plain, by_kept) = both_passes(&alone, None);
    let error = largest_difference(with.image().data(), plain.image().data());
    assert!(error < 1e-5, "{error:.1e}");

    let mut at_the_bound = 0;
    for (k, &i) in kept.iter().enumerate() {
        let (bare, opacity) = (sigmoid(layer.opacity_logits[i]), raised(layer.opacity_logits[i]));
        let found = from.gaussians.opacity_logits[i];
        if opacity >= 1.0 {
            at_the_bound += 1;
            assert_eq!(found, 0.0);
            continue;
        }
        // d opacity' / d logit = gain bare (1 - bare); d opacity' / d logit' = opacity' (1 - opacity').
        let chain = DROPOUT.gain() * bare * (1.0 - bare) / (opacity * (1.0 - opacity));
        let expected = by_kept.gaussians.opacity_logits[k] * chain;
        assert!((found - expected).abs() < 1e-3 * expected.abs() + 1e-3, "{i}: {found}, not {expected}");
        let (a, b) = (from.gaussians.means[i], by_kept.gaussians.means[k]);
        assert!((0..3).all(|d| (a[d] - b[d]).abs() < 1e-3 * b[d].abs() + 1e-2), "{i}: {a:?}, not {b:?}");
    }
    assert!(at_the_bound > 5, "{at_the_bound} opacities reach 1");
}

#[test]
fn a_parameter_that_is_not_a_number_is_not_drawn() {
    let mut layer = balls(1);
    layer.opacity_logits[0] = f32::NAN;
    let (tape, gradients) = both_passes(&layer, Some(Dropout { share: 0.0, draw: 0 }));
    assert!(tape.transmittance().iter().all(|&t| t == 1.0) && !gradients.touched[0]);
}
