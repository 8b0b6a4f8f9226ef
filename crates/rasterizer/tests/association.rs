//! Association with every contributor and with the heaviest of each pixel.

use ffgs_core::{Camera, DenseMotion, Gaussians, ImageSize, Intrinsics, Mask};
use ffgs_rasterizer::{Association, AssociationScene, AssociationScratch, Observed};
use glam::{DMat4, DVec2, DVec3};

const SIZE: ImageSize = ImageSize { width: 40, height: 30 };
const FOCAL: f64 = 40.0;
/// Where the optical axis meets the image (px): the centre of a pixel.
const CENTRE: DVec2 = DVec2::new(20.5, 15.5);

fn camera() -> Camera {
    let intrinsics = Intrinsics { fx: FOCAL, fy: FOCAL, cx: CENTRE.x, cy: CENTRE.y };
    Camera::new(intrinsics, DMat4::IDENTITY, SIZE).unwrap()
}

/// Pixels from column 12 on, so that footprints are cut.
fn mask() -> Mask {
    Mask::new(SIZE, (0..SIZE.pixels()).map(|p| u8::from(p % SIZE.width >= 12)).collect()).unwrap()
}

/// A shear: motion (px) at a pixel.
fn flow(pixel: DVec2) -> [f32; 2] {
    [(0.1 * pixel.x) as f32, (2.0 - 0.05 * pixel.y) as f32]
}

fn field() -> DenseMotion {
    let mut field = DenseMotion::unknown(SIZE);
    for p in 0..SIZE.pixels() {
        field.flow[p] = flow(centre_of(p));
        field.confidence[p] = 0.5;
    }
    field
}

fn centre_of(pixel: usize) -> DVec2 {
    DVec2::new((pixel % SIZE.width) as f64 + 0.5, (pixel / SIZE.width) as f64 + 0.5)
}

/// A ball: centre (m), radius (m), opacity.
type Ball = (DVec3, f64, f64);

fn scene(balls: &[Ball]) -> (Gaussians, Vec<DVec3>) {
    let mut gaussians = Gaussians::zeros(balls.len(), 0);
    for (i, &(place, radius, opacity)) in balls.iter().enumerate() {
        gaussians.means[i] = place.as_vec3().to_array();
        gaussians.quats[i] = [1.0, 0.0, 0.0, 0.0];
        gaussians.log_scales[i] = [radius.ln() as f32; 3];
        gaussians.opacity_logits[i] = (opacity / (1.0 - opacity)).ln() as f32;
    }
    (gaussians, balls.iter().map(|b| b.0).collect())
}

/// Targets (px) and weights of the first `moving` balls.
fn observe(balls: &[Ball], moving: usize, contributors: usize) -> (Vec<DVec2>, Vec<f64>) {
    observe_by(balls, moving, contributors, true)
}

/// Likewise, with the mean of the flow or its sum.
fn observe_by(balls: &[Ball], moving: usize, contributors: usize, normalise: bool) -> (Vec<DVec2>, Vec<f64>) {
    let (gaussians, means) = scene(balls);
    let (mut targets, mut weights) = (vec![DVec2::ZERO; moving], vec![0.0; moving]);
    let association = Association {
        camera: &camera(),
        mask: &mask(),
        fields: &[field()],
        flow_floor_px: 0.25,
        min_coverage: 1e-3,
        min_hits: 2,
        min_transmittance: 1e-4,
        contributors,
        normalise,
    };
    let scene = AssociationScene::new(&[&gaussians], &means[..moving]);
    let mut out = [Observed { targets: &mut targets, weights: &mut weights }];
    association.observe(&scene, &mut out, &mut AssociationScratch::default());
    (targets, weights)
}

/// A wide, thin ball in front of a narrow, dense one, both on the optical axis.
const PAIR: [Ball; 2] = [(DVec3::new(0.0, 0.0, 2.0), 0.3, 0.4), (DVec3::new(0.0, 0.0, 4.0), 0.2, 0.9)];

/// `alpha T` of both at a pixel: opacity, falloff, the antialiasing blur of 0.3 px² and its loss of opacity.
fn pair_at(pixel: DVec2) -> [f64; 2] {
    let alpha = |(place, radius, opacity): Ball| {
        let sharp = (FOCAL * radius / place.z).powi(2);
        let alpha = opacity * sharp / (sharp + 0.3)
            * (-0.5 * (pixel - CENTRE).length_squared() / (sharp + 0.3)).exp();
        if alpha < 1.0 / 255.0 { 0.0 } else { alpha }
    };
    let [front, back] = PAIR.map(alpha);
    [front, back * (1.0 - front)]
}

/// Targets and weights of the pair from the formulas, each pixel counting for the heavier alone or for both.
fn expected(heavier_alone: bool) -> [(DVec2, f64); 2] {
    let (mut coverage, mut moved, mut weight) = ([0.0; 2], [DVec2::ZERO; 2], [0.0; 2]);
    for pixel in (0..SIZE.pixels()).filter(|p| p % SIZE.width >= 12).map(centre_of) {
        let a = pair_at(pixel);
        for i in (0..2).filter(|&i| !heavier_alone || a[i] > a[1 - i]) {
            let motion = DVec2::from_array(flow(pixel).map(f64::from));
            coverage[i] += a[i];
            moved[i] += a[i] * motion;
            weight[i] += a[i] * 0.5 * motion.length().max(0.25);
        }
    }
    [0, 1].map(|i| (CENTRE + moved[i] / coverage[i], weight[i]))
}

#[test]
fn a_sum_of_flow_is_the_mean_times_the_coverage() {
    let (mean, weight) = observe_by(&PAIR, 2, 0, true);
    let (sum, same) = observe_by(&PAIR, 2, 0, false);
    let all = (0..SIZE.pixels()).filter(|p| p % SIZE.width >= 12).map(|p| pair_at(centre_of(p)));
    let coverage = all.fold([0.0; 2], |sum, a| [sum[0] + a[0], sum[1] + a[1]]);
    assert_eq!(weight, same);
    for i in 0..2 {
        let expected = CENTRE + (mean[i] - CENTRE) * coverage[i];
        assert!(sum[i].distance(expected) < 1e-3 * expected.length(), "{i}: {} for {expected} px", sum[i]);
    }
}

fn assert_close(found: &(Vec<DVec2>, Vec<f64>), expected: &[(DVec2, f64)], tolerance: f64) {
    assert_eq!(found.0.len(), expected.len());
    for (i, &(target, weight)) in expected.iter().enumerate() {
        assert!(found.0[i].distance(target) <= 10.0 * tolerance, "{i}: {} for {target} px", found.0[i]);
        assert!((found.1[i] - weight).abs() <= tolerance * weight, "{i}: {} for {weight}", found.1[i]);
    }
}

#[test]
fn a_pair_on_the_axis_gathers_what_the_formulas_say() {
    let [both, heavier] = [false, true].map(expected);
    // The choice matters: the narrow ball takes the middle from the wide one.
    let lost = [0, 1].map(|i| 1.0 - heavier[i].1 / both[i].1);
    assert!(lost[0] > 0.03 && lost[1] > 0.03, "{lost:?} of the weights");
    assert_close(&observe(&PAIR, 2, 0), &both, 1e-4);
    assert_close(&observe(&PAIR, 2, 2), &both, 1e-4);
    assert_close(&observe(&PAIR, 2, 1), &heavier, 1e-4);
}

/// Balls in layers, all over the image.
fn heap() -> Vec<Ball> {
    let place = |i: usize| {
        let depth = 2.0 + 0.05 * i as f64;
        let [x, y] = [i * 7 % 13, i * 5 % 11].map(|v| v as f64 / 12.0 - 0.5);
        (
            DVec3::new(x * depth, 0.7 * y * depth, depth),
            0.1 + 0.02 * (i % 5) as f64,
            0.2 + 0.1 * (i % 6) as f64,
        )
    };
    (0..60).map(place).collect()
}

#[test]
fn as_many_contributors_as_splats_are_all_contributors() {
    let balls = heap();
    // The last twenty only hide what is behind them.
    let all = observe(&balls, 40, 0);
    let rows: Vec<(DVec2, f64)> = all.0.iter().copied().zip(all.1.iter().copied()).collect();
    assert!(rows.iter().filter(|(_, weight)| *weight > 0.0).count() > 30);
    assert_close(&observe(&balls, 40, 60), &rows, 2e-6);
    assert_close(&observe(&balls, 40, 1000), &rows, 2e-6);
    let few = observe(&balls, 40, 2);
    assert!(few.1.iter().sum::<f64>() < 0.95 * all.1.iter().sum::<f64>(), "two a pixel leave something out");
}
