//! Cases from an independent float64 implementation (fixtures/reference).

use ffgs_core::{EstimateStatus, Estimates, ImageSize, Mask};
use ffgs_fusion::{FusionConfig, FusionInput, InformationFuser, Slack, count_views, validate};
use ffgs_testkit::{case, largest, largest_difference, relative_difference};
use glam::{DMat3, DVec3};

fn flat(points: &[DVec3]) -> Vec<f64> {
    points.iter().flat_map(DVec3::to_array).collect()
}

#[test]
fn literal_fusion_matches_algorithm_1() {
    for name in ["some_failed", "three_far_from_origin", "two_trackers"] {
        let case = case("fuse", name);
        let prior_means = case.points("prior_means");
        let n = prior_means.len();
        let prior_covariances = case.matrices("prior_covariances");
        let (means, covariances) = (case.points("means"), case.matrices("covariances"));
        let ok = |&v: &f64| if v > 0.0 { EstimateStatus::Ok } else { EstimateStatus::TooFewViews };
        let status: Vec<EstimateStatus> = case.array("valid").iter().map(ok).collect();
        let estimates: Vec<Estimates> = (0..means.len() / n)
            .map(|l| Estimates {
                means: means[l * n..(l + 1) * n].to_vec(),
                covariances: covariances[l * n..(l + 1) * n].to_vec(),
                status: status[l * n..(l + 1) * n].to_vec(),
            })
            .collect();
        let input = FusionInput {
            prior_means: &prior_means,
            prior_covariances: &prior_covariances,
            estimates: &estimates,
            previous_steps: None,
            groups: None,
            last_q: 0.0,
            q_floor_m: 0.0,
            observed: None,
            flexibility: None,
        };
        let fused = InformationFuser { config: FusionConfig::literal() }.fuse(&input).unwrap();
        let expected = case.points("expected_means");
        let size = largest(expected.iter().flat_map(DVec3::to_array)).max(1.0);
        let mean = largest_difference(&flat(&fused.means), &flat(&expected)) / size;
        let covariances = |all: &[DMat3]| all.iter().flat_map(DMat3::to_cols_array).collect::<Vec<_>>();
        let expected = case.matrices("expected_covariances");
        let covariance = relative_difference(&covariances(&fused.covariances), &covariances(&expected));
        let q = fused.q / case.scalar("expected_q") - 1.0;
        println!("{name}: mean {mean:.1e}, covariance {covariance:.1e}, q {q:.1e}");
        assert!(mean < 1e-10 && covariance < 1e-10 && q.abs() < 1e-12, "{name}");
    }
}

#[test]
fn validation_counts_match() {
    let case = case("validate", "ring");
    let size = ImageSize { width: 160, height: 90 };
    let cameras = case.cameras(size);
    let masks: Vec<Mask> = (case.array("masks").chunks(size.pixels()))
        .map(|m| Mask::new(size, m.iter().map(|&v| v as u8).collect()).unwrap())
        .collect();
    let counts = count_views(&case.points("means"), &cameras, &masks).unwrap();
    let slack = Slack { views: case.scalar("slack") as u32, share: 0.0, all_views: false };
    let column = |f: fn(u32, u32, bool) -> f64| {
        counts.iter().map(|c| f(c.inside, c.seen, validate(*c, slack))).collect::<Vec<_>>()
    };
    assert_eq!(column(|inside, _, _| f64::from(inside)), case.array("expected_inside"));
    assert_eq!(column(|_, seen, _| f64::from(seen)), case.array("expected_seen"));
    assert_eq!(column(|_, _, valid| f64::from(u8::from(valid))), case.array("expected_valid"));
}
