//! Marking, second chance, densification, and the options of the fusion.

use ffgs_core::{Camera, EstimateStatus, Estimates, Gaussians, ImageSize, Intrinsics, Mask, sigmoid};
use ffgs_fusion::{
    DensifyAction, DensifyConfig, FusionConfig, FusionError, FusionInput, InformationFuser, MotionFuser,
    PriorModel, ProcessNoise, Structure, ViewCounts, apply_densification, dynamic_split, initial_covariance,
    plan_densification, second_chance, validate,
};
use glam::{DMat3, DMat4, DVec3};

#[test]
fn validity_needs_all_but_slack_of_the_views_that_see_the_point() {
    let valid = |inside, seen| validate(ViewCounts { inside, seen }, 2);
    assert!(valid(8, 10) && !valid(7, 10) && valid(1, 1) && !valid(0, 1) && !valid(0, 0));
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
    let split = dynamic_split(&means, &[camera, camera], &masks, 2, 0).unwrap();
    assert_eq!(split, [true, true, false]);
    assert!(matches!(dynamic_split(&means, &[camera], &masks, 2, 0), Err(FusionError::Masks { .. })));
}

#[test]
fn a_second_chance_follows_the_neighbours() {
    let previous: Vec<DVec3> = (0..12).map(|i| DVec3::new(1e6 + f64::from(i), 0.0, 0.0)).collect();
    let mut means: Vec<DVec3> = previous.iter().map(|&p| p + DVec3::new(0.0, 2.0, 0.0)).collect();
    means[5] = DVec3::ZERO;
    means[6].y += 50.0;
    let mut valid = [true; 12];
    valid[5] = false;
    second_chance(&previous, &mut means, &valid).unwrap();
    assert_eq!(means[5], previous[5] + DVec3::new(0.0, 2.0, 0.0));
    second_chance(&previous, &mut means, &[false; 12]).unwrap();
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
    let config = DensifyConfig::default();
    assert!(plan_densification(&g, &covariances, &vec![10.0; n], &config).is_empty());
    let plan = plan_densification(&g, &covariances, &vec![0.005; n], &config);
    assert_eq!(
        plan,
        [
            (7, DensifyAction::Split),
            (197, DensifyAction::Clone),
            (198, DensifyAction::Clone),
            (199, DensifyAction::Clone)
        ]
    );
    let full = DensifyConfig { max_dynamic: n + 1, ..config };
    assert_eq!(plan_densification(&g, &covariances, &vec![0.005; n], &full).len(), 1);
    let before = g.clone();
    apply_densification(&mut g, &mut covariances, &plan, 9);
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
    apply_densification(&mut again, &mut vec![DMat3::IDENTITY; n], &plan, 9);
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
    };
    let fused = InformationFuser::default().fuse(&input).unwrap();
    assert_eq!((fused.means[0], fused.q, fused.measured[0]), (DVec3::Y, 0.5, false));
    assert!((fused.covariances[0].x_axis.x - (0.25 + 0.005 * 0.005)).abs() < 1e-12);
}
