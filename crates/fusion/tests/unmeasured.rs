//! A frame in which no tracker measured anything.

use ffgs_core::{EstimateStatus, Estimates};
use ffgs_fusion::{FusionConfig, FusionInput, InformationFuser};
use glam::{DMat3, DVec3};

/// Without a measurement the layer goes on as it moved, and is known less well; of a layer without history nothing moves.
#[test]
fn without_a_measurement_the_last_steps_go_on() {
    let means: Vec<DVec3> = (0..200).map(|i| DVec3::new(f64::from(i % 20), f64::from(i / 20), 5.0)).collect();
    let covariances = vec![DMat3::IDENTITY * 1e-4; means.len()];
    let steps: Vec<DVec3> = means.iter().map(|mean| DVec3::new(1.0, 0.01 * mean.x, 0.0)).collect();
    let nothing = Estimates {
        means: means.clone(),
        covariances: covariances.clone(),
        status: vec![EstimateStatus::TooFewViews; means.len()],
    };
    let fused = |previous_steps| {
        let input = FusionInput {
            prior_means: &means,
            prior_covariances: &covariances,
            estimates: std::slice::from_ref(&nothing),
            previous_steps,
            groups: None,
            last_q: 0.2,
            q_floor_m: 0.0,
            observed: None,
            flexibility: None,
        };
        let config = FusionConfig { q_mode: ffgs_fusion::ProcessNoise::Global, ..FusionConfig::default() };
        InformationFuser { config }.fuse(&input).unwrap()
    };
    let moved = fused(Some(&steps[..]));
    for i in 0..means.len() {
        assert!((moved.means[i] - means[i] - steps[i]).length() < 1e-12, "{i}: {}", moved.means[i]);
        assert!(moved.covariances[i].x_axis.x >= 1e-4 + 0.04 - 1e-12 && !moved.measured[i]);
    }
    assert_eq!(fused(None).means, means);
}
