//! Cases from an independent float64 implementation (fixtures/reference).

use ffgs_arrays::NpzFile;
use ffgs_core::{Camera, EstimateStatus, Estimates, ImageSize, Intrinsics, Mask};
use ffgs_fusion::{FusionConfig, FusionInput, InformationFuser, MotionFuser, count_views, validate};
use glam::{DMat3, DMat4, DVec3};
use std::path::Path;

fn open_case(stage: &str, name: &str) -> NpzFile {
    let root = concat!(env!("CARGO_MANIFEST_DIR"), "/../../fixtures/reference");
    NpzFile::open(&Path::new(root).join(stage).join(format!("{name}.npz"))).unwrap()
}

fn array(case: &NpzFile, key: &str) -> Vec<f64> {
    case.f64(key).unwrap().data
}

fn points(values: &[f64]) -> Vec<DVec3> {
    values.as_chunks::<3>().0.iter().map(|&p| DVec3::from(p)).collect()
}

fn matrices(values: &[f64]) -> Vec<DMat3> {
    values.as_chunks::<9>().0.iter().map(|m| DMat3::from_cols_array(m).transpose()).collect()
}

fn largest(values: impl Iterator<Item = f64>) -> f64 {
    values.map(f64::abs).fold(0.0, f64::max)
}

#[test]
fn literal_fusion_matches_algorithm_1() {
    for name in ["some_failed", "three_far_from_origin", "two_trackers"] {
        let case = open_case("fuse", name);
        let prior_means = points(&array(&case, "prior_means"));
        let n = prior_means.len();
        let prior_covariances = matrices(&array(&case, "prior_covariances"));
        let (means, covariances) = (points(&array(&case, "means")), matrices(&array(&case, "covariances")));
        let ok = |&v: &f64| if v > 0.0 { EstimateStatus::Ok } else { EstimateStatus::TooFewViews };
        let status: Vec<EstimateStatus> = array(&case, "valid").iter().map(ok).collect();
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
        };
        let fused = InformationFuser { config: FusionConfig::literal() }.fuse(&input).unwrap();
        let expected = points(&array(&case, "expected_means"));
        let size = largest(expected.iter().flat_map(DVec3::to_array)).max(1.0);
        let mean = largest(fused.means.iter().zip(&expected).map(|(a, b)| (*a - *b).length())) / size;
        let expected = matrices(&array(&case, "expected_covariances"));
        let size = largest(expected.iter().flat_map(DMat3::to_cols_array));
        let differences =
            fused.covariances.iter().zip(&expected).flat_map(|(a, b)| (*a - *b).to_cols_array());
        let covariance = largest(differences) / size;
        let q = fused.q / array(&case, "expected_q")[0] - 1.0;
        println!("{name}: mean {mean:.1e}, covariance {covariance:.1e}, q {q:.1e}");
        assert!(mean < 1e-10 && covariance < 1e-10 && q.abs() < 1e-12, "{name}");
    }
}

#[test]
fn validation_counts_match() {
    let case = open_case("validate", "ring");
    let size = ImageSize { width: 160, height: 90 };
    let poses = array(&case, "camera_from_world");
    let intrinsics = array(&case, "intrinsics");
    let cameras: Vec<Camera> = (poses.as_chunks::<16>().0.iter().zip(intrinsics.as_chunks::<4>().0))
        .map(|(pose, &[fx, fy, cx, cy])| {
            let pose = DMat4::from_cols_array(pose).transpose();
            Camera::new(Intrinsics { fx, fy, cx, cy }, pose, size).unwrap()
        })
        .collect();
    let masks: Vec<Mask> = (array(&case, "masks").chunks(size.pixels()))
        .map(|m| Mask::new(size, m.iter().map(|&v| v as u8).collect()).unwrap())
        .collect();
    let counts = count_views(&points(&array(&case, "means")), &cameras, &masks).unwrap();
    let slack = array(&case, "slack")[0] as u32;
    let column = |f: fn(u32, u32, bool) -> f64| {
        counts.iter().map(|c| f(c.inside, c.seen, validate(*c, slack))).collect::<Vec<_>>()
    };
    assert_eq!(column(|inside, _, _| f64::from(inside)), array(&case, "expected_inside"));
    assert_eq!(column(|_, seen, _| f64::from(seen)), array(&case, "expected_seen"));
    assert_eq!(column(|_, _, valid| f64::from(u8::from(valid))), array(&case, "expected_valid"));
}
