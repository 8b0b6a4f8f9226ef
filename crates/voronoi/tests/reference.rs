//! Cases from an independent float64 implementation (fixtures/reference).

use ffgs_core::{DenseMotion, ImageSize};
use ffgs_testkit::{case, largest_difference};
use ffgs_voronoi::{AgreementConfig, GaussianKnn, IntegerCentredTracks, MotionInterpolator, agreement};

#[test]
fn gaussian_knn_matches_algorithm_2() {
    for name in ["dense", "far_underflow", "few_tracks", "one_track", "typical"] {
        let case = case("voronoi", name);
        let tracks = IntegerCentredTracks {
            src: case.rows("src"),
            tgt: case.rows("tgt"),
            visibility: case.array("visibility"),
        };
        let size = case.array("size");
        let size = ImageSize { width: size[1] as usize, height: size[0] as usize };
        let knn = GaussianKnn { k: case.scalar("k") as usize, sigma: case.scalar("sigma") };
        let out = knn.densify_integer_centred(&tracks, size, None).unwrap();
        let flow = largest_difference(out.flow.as_flattened(), &case.array("expected_flow"));
        let visibility = largest_difference(&out.visibility, &case.array("expected_visibility"));
        let confidence = largest_difference(&out.confidence, &case.array("expected_confidence"));
        println!("{name}: flow {flow:.1e} px, visibility {visibility:.1e}, confidence {confidence:.1e}");
        assert!(flow < 1e-5 && visibility < 1e-6 && confidence < 1e-6, "{name}");
    }
}

#[test]
fn agreement_matches_algorithm_1() {
    for name in ["one", "two", "three"] {
        let case = case("agreement", name);
        let (flow, confidence) = (case.array("flow"), case.array("confidence"));
        let size = ImageSize { width: 50, height: 30 };
        let n = size.pixels();
        let mut flows: Vec<DenseMotion> = (confidence.chunks(n).zip(flow.chunks(2 * n)))
            .map(|(c, f)| DenseMotion {
                size,
                flow: f.as_chunks::<2>().0.iter().map(|p| p.map(|v| v as f32)).collect(),
                visibility: vec![1.0; n],
                confidence: c.iter().map(|&v| v as f32).collect(),
            })
            .collect();
        let floor = case.scalar("magnitude_floor") as f32;
        let config = AgreementConfig { magnitude_floor_px: floor, ..AgreementConfig::default() };
        agreement(&mut flows, None, &config).unwrap();
        let found: Vec<f32> = flows.iter().flat_map(|f| f.confidence.clone()).collect();
        let error = largest_difference(&found, &case.array("expected_confidence"));
        assert!(error < 1e-6, "{name}: {error:.1e}");
    }
}
