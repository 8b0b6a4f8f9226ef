//! Marking, second chance, densification, and the options of the fusion.

use ffgs_core::{Camera, EstimateStatus, Estimates, Gaussians, ImageSize, Intrinsics, Mask, sigmoid};
use ffgs_fusion::{
    FusionConfig, FusionError, FusionInput, GrowthAction, GrowthConfig, InformationFuser, PriorModel,
    ProcessNoise, Silhouettes, Slack, Structure, ViewCounts, apply_growth, initial_covariance, plan_growth,
    second_chance, validate,
};
use glam::{DMat3, DMat4, DVec3};

#[test]
fn validity_needs_all_but_slack_of_the_views_that_see_the_point() {
    let two = Slack { views: 2, share: 0.0, all_views: false };
    let valid = |inside, seen| validate(ViewCounts { inside, seen }, two);
    assert!(valid(8, 10) && !valid(7, 10) && valid(1, 1) && !valid(0, 1) && !valid(0, 0));
}

#[test]
fn a_share_of_the_views_fits_four_cameras_and_three_hundred() {
    let fifth = Slack { views: 0, share: 0.2, all_views: false };
    let valid = |inside, seen| validate(ViewCounts { inside, seen }, fifth);
    assert!(!valid(3, 4) && valid(4, 4), "four cameras: all of them");
    assert!(valid(8, 10) && !valid(7, 10), "ten: as Algorithm 1");
    assert!(valid(270, 300) && !valid(200, 300), "three hundred: occluders hide it from thirty");
    assert!(!valid(0, 1) && valid(1, 1));
}

/// Cameras on a ring of 4 m about the origin, which they look at; masks show a ball of 0.5 m there.
fn ring(views: usize, shown: impl Fn(usize) -> bool) -> (Vec<Camera>, Vec<Mask>) {
    let size = ImageSize { width: 100, height: 100 };
    let intrinsics = Intrinsics { fx: 100.0, fy: 100.0, cx: 50.0, cy: 50.0 };
    let camera = |v: usize| {
        let turn = DMat4::from_rotation_y(std::f64::consts::TAU * v as f64 / views as f64);
        let pose = DMat4::from_translation(DVec3::new(0.0, 0.0, 4.0)) * turn;
        Camera::new(intrinsics, pose, size).unwrap()
    };
    let inside = |p: usize| {
        let (x, y) = ((p % 100) as f64 + 0.5 - 50.0, (p / 100) as f64 + 0.5 - 50.0);
        u8::from(x.hypot(y) < 12.5)
    };
    let mask = |v: usize| {
        Mask::new(size, (0..10_000).map(|p| if shown(v) { inside(p) } else { u8::from(p < 9) }).collect())
    };
    ((0..views).map(camera).collect(), (0..views).map(|v| mask(v).unwrap()).collect())
}

#[test]
fn background_in_one_mask_cone_of_four_is_not_held() {
    let fifth = Slack { views: 0, share: 0.2, all_views: false };
    let (cameras, masks) = ring(4, |_| true);
    let silhouettes = Silhouettes::new(&cameras, &masks, 2, fifth).unwrap();
    // The last one is narrowly missed by the cameras that see it from the side.
    let means =
        [DVec3::ZERO, DVec3::new(0.0, 0.0, 1.5), DVec3::new(0.0, 0.52, 0.0), DVec3::new(0.0, 0.7, 0.0)];
    assert_eq!(silhouettes.hold(&means).unwrap(), [true, false, true, false]);
}

#[test]
fn views_that_do_not_see_a_gaussian_disagree_when_all_count() {
    let (mut cameras, mut masks) = ring(4, |_| true);
    // A fifth camera looks away, at something of its own.
    let away = DMat4::from_rotation_y(std::f64::consts::PI) * cameras[0].camera_from_world();
    cameras.push(Camera::new(cameras[0].intrinsics(), away, cameras[0].size()).unwrap());
    masks.push(masks[0].clone());
    let hold = |views, all_views| {
        let slack = Slack { views, share: 0.0, all_views };
        Silhouettes::new(&cameras, &masks, 2, slack).unwrap().hold(&[DVec3::ZERO]).unwrap()
    };
    assert_eq!([hold(0, false), hold(0, true), hold(1, true)], [[true], [false], [true]]);
}

#[test]
fn a_mask_that_flickers_has_no_say() {
    let fifth = Slack { views: 0, share: 0.2, all_views: false };
    let (cameras, masks) = ring(6, |v| v != 2 && v != 3);
    let means: Vec<DVec3> = (0..60).map(|i| DVec3::new(0.0, 0.01 * f64::from(i % 20), 0.0)).collect();
    let mut silhouettes = Silhouettes::new(&cameras, &masks, 2, Slack { share: 0.4, ..fifth }).unwrap();
    assert_eq!(silhouettes.drop_flickering(&means).unwrap(), 2);
    assert!(silhouettes.hold(&means).unwrap().iter().all(|held| *held));
    let (cameras, masks) = ring(6, |_| true);
    let mut silhouettes = Silhouettes::new(&cameras, &masks, 2, fifth).unwrap();
    assert_eq!(silhouettes.drop_flickering(&means).unwrap(), 0);
}

#[test]
fn empty_masks_have_no_say_in_the_split() {
    let size = ImageSize { width: 20, height: 20 };
    let intrinsics = Intrinsics { fx: 20.0, fy: 20.0, cx: 10.0, cy: 10.0 };
    let camera = Camera::new(intrinsics, DMat4::IDENTITY, size).unwrap();
    let mut centre = vec![0; 400];
    centre[10 * 20 + 10] = 1;
    let masks = [Mask::new(size, centre).unwrap(), Mask::filled(size, false)];
    let means = [DVec3::new(0.0, 0.0, 4.0), DVec3::new(0.5, 0.0, 4.0), DVec3::new(1.5, 0.0, 4.0)];
    let none = Slack { views: 0, share: 0.0, all_views: false };
    let split = Silhouettes::new(&[camera, camera], &masks, 2, none).unwrap().hold(&means).unwrap();
    assert_eq!(split, [true, true, false]);
    assert!(matches!(Silhouettes::new(&[camera], &masks, 2, none), Err(FusionError::Masks { .. })));
}

#[test]
fn a_second_chance_follows_the_neighbours() {
    let previous: Vec<DVec3> = (0..12).map(|i| DVec3::new(1e6 + f64::from(i), 0.0, 0.0)).collect();
    let mut means: Vec<DVec3> = previous.iter().map(|&p| p + DVec3::new(0.0, 2.0, 0.0)).collect();
    means[5] = DVec3::ZERO;
    means[6].y += 50.0;
    let mut valid = [true; 12];
    valid[5] = false;
    let mut covariances = vec![DMat3::IDENTITY * 1e-4; 12];
    covariances[5] = DMat3::IDENTITY * 1e-9;
    second_chance(&previous, &mut means, &mut covariances, &valid).unwrap();
    assert_eq!(means[5], previous[5] + DVec3::new(0.0, 2.0, 0.0));
    // One of the eight neighbours went 50 m another way: its scatter belongs to the covariance.
    let scatter = 50.0 * 50.0 / 24.0;
    assert!((covariances[5].y_axis.y - (1e-4 + scatter)).abs() < 1e-9, "{}", covariances[5]);
    second_chance(&previous, &mut means, &mut covariances, &[false; 12]).unwrap();
}

fn gaussians(n: usize) -> Gaussians {
    let mut g = Gaussians::zeros(n, 0);
    g.quats.fill([1.0, 0.0, 0.0, 0.0]);
    g.log_scales.fill([-5.0, -6.0, -6.0]);
    g.log_scales[7] = [0.0, -3.0, -3.0];
    g
}

#[test]
fn densification_keeps_transmittance_covariance_and_the_growth_cap() {
    let n = 200;
    let mut g = gaussians(n);
    let mut covariances: Vec<DMat3> =
        (0..n).map(|i| DMat3::from_diagonal(DVec3::splat(1e-6 * i as f64))).collect();
    covariances[7] = DMat3::IDENTITY;
    let config = GrowthConfig::default();
    assert!(plan_growth(&g, &covariances, &vec![10.0; n], &config).is_empty());
    let plan = plan_growth(&g, &covariances, &vec![0.005; n], &config);
    assert_eq!(
        plan,
        [
            (7, GrowthAction::Split),
            (197, GrowthAction::Clone),
            (198, GrowthAction::Clone),
            (199, GrowthAction::Clone)
        ]
    );
    let full = GrowthConfig { max_dynamic: n + 1, ..config };
    assert_eq!(plan_growth(&g, &covariances, &vec![0.005; n], &full).len(), 1);
    let before = g.clone();
    apply_growth(&mut g, &mut covariances, &plan, 9);
    g.validate().unwrap();
    assert_eq!((g.len(), covariances.len()), (n + 4, n + 4));
    assert_eq!(covariances[n], DMat3::IDENTITY);
    for (child, &(i, _)) in plan.iter().enumerate() {
        let through = |j: usize| 1.0 - sigmoid(g.opacity_logits[j]);
        let parent = 1.0 - sigmoid(before.opacity_logits[i]);
        assert!((through(i) * through(n + child) - parent).abs() < 1e-6);
    }
    assert!(g.means[7][0] > 0.4 && (g.means[7][0] + g.means[n][0]).abs() < 1e-6);
    let mut again = before.clone();
    apply_growth(&mut again, &mut vec![DMat3::IDENTITY; n], &plan, 9);
    assert_eq!(again, g);
}

fn estimates(means: Vec<DVec3>, ok: &[bool]) -> Estimates {
    let n = means.len();
    let status =
        ok.iter().map(|&ok| if ok { EstimateStatus::Ok } else { EstimateStatus::Degenerate }).collect();
    Estimates { means, covariances: vec![DMat3::IDENTITY * 1e-4; n], status }
}

#[test]
fn options_change_what_they_say() {
    let zero = [DVec3::ZERO; 2];
    let prior = [DMat3::IDENTITY * 1e-4; 2];
    let good = estimates(vec![DVec3::X, DVec3::Y * 4.0], &[true, true]);
    let far = estimates(vec![DVec3::X * 1.01, DVec3::Y * 9.0], &[true, true]);
    let all = [good.clone(), good, far];
    let steps = [DVec3::X, DVec3::Y * 4.0];
    let input = FusionInput {
        prior_means: &zero,
        prior_covariances: &prior,
        estimates: &all,
        previous_steps: Some(&steps),
        groups: Some(&[0, 1]),
        last_q: 0.5,
        q_floor_m: 0.0,
        observed: None,
        flexibility: None,
    };
    let fuse = |config: FusionConfig| InformationFuser { config }.fuse(&input).unwrap();
    let literal = FusionConfig::literal();
    assert!(fuse(literal).means[1].y > 5.0);
    assert!((fuse(FusionConfig { gate: 16.3, ..literal }).means[1].y - 4.0).abs() < 0.1);
    assert!(fuse(FusionConfig { prior: PriorModel::ConstantVelocity, ..literal }).q < 0.1);
    let inflated = fuse(FusionConfig { correlation_inflation: 3.0, ..literal });
    assert!(inflated.covariances[0].x_axis.x > 2.9 * fuse(literal).covariances[0].x_axis.x);
    let grouped = fuse(FusionConfig { q_mode: ProcessNoise::PerObject, ..literal });
    assert!(grouped.means[1].y > fuse(literal).means[1].y);
    let missing = FusionInput { groups: None, ..input };
    let config = FusionConfig { q_mode: ProcessNoise::PerObject, ..literal };
    assert!(matches!(InformationFuser { config }.fuse(&missing), Err(FusionError::MissingInput { .. })));
    // Two Gaussians are no neighbourhood: the structure falls back to the literal update.
    assert_eq!(
        fuse(FusionConfig { structure: Structure::RigidNeighbours, ..literal }).means,
        fuse(literal).means
    );
}

#[test]
fn without_estimates_the_prior_grows_by_the_last_q() {
    let none = [estimates(vec![DVec3::X], &[false])];
    let input = FusionInput {
        prior_means: &[DVec3::Y],
        prior_covariances: &[initial_covariance(0.0, 0.02)],
        estimates: &none,
        previous_steps: None,
        groups: None,
        last_q: 0.5,
        q_floor_m: 0.0,
        observed: None,
        flexibility: None,
    };
    let fused = InformationFuser::default().fuse(&input).unwrap();
    assert_eq!((fused.means[0], fused.q, fused.measured[0]), (DVec3::Y, 0.5, false));
    assert!((fused.covariances[0].x_axis.x - (0.25 + 0.005 * 0.005)).abs() < 1e-12);
}
