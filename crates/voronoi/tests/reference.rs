//! Cases from an independent float64 implementation (fixtures/reference).

use ffgs_arrays::NpzFile;
use ffgs_core::{DenseMotion, ImageSize};
use ffgs_voronoi::{AgreementConfig, GaussianKnn, IntegerCentredTracks, MotionInterpolator, agreement};
use std::path::Path;

fn open_case(stage: &str, name: &str) -> NpzFile {
    let root = concat!(env!("CARGO_MANIFEST_DIR"), "/../../fixtures/reference");
    NpzFile::open(&Path::new(root).join(stage).join(format!("{name}.npz"))).unwrap()
}

fn array(case: &NpzFile, key: &str) -> Vec<f64> {
    case.f64(key).unwrap().data
}

fn pairs(values: &[f64]) -> Vec<[f64; 2]> {
    values.as_chunks().0.to_vec()
}

fn largest_difference(found: &[f32], expected: &[f64]) -> f64 {
    assert_eq!(found.len(), expected.len());
    found.iter().zip(expected).map(|(&a, b)| (f64::from(a) - b).abs()).fold(0.0, f64::max)
}

#[test]
fn gaussian_knn_matches_algorithm_2() {
    for name in ["dense", "far_underflow", "few_tracks", "one_track", "typical"] {
        let case = open_case("voronoi", name);
        let tracks = IntegerCentredTracks {
            src: pairs(&array(&case, "src")),
            tgt: pairs(&array(&case, "tgt")),
            visibility: array(&case, "visibility"),
        };
        let size = array(&case, "size");
        let size = ImageSize { width: size[1] as usize, height: size[0] as usize };
        let knn = GaussianKnn { k: array(&case, "k")[0] as usize, sigma: array(&case, "sigma")[0] };
        let out = knn.densify_integer_centred(&tracks, size, None).unwrap();
        let flow = largest_difference(out.flow.as_flattened(), &array(&case, "expected_flow"));
        let visibility = largest_difference(&out.visibility, &array(&case, "expected_visibility"));
        let confidence = largest_difference(&out.confidence, &array(&case, "expected_confidence"));
        println!("{name}: flow {flow:.1e} px, visibility {visibility:.1e}, confidence {confidence:.1e}");
        assert!(flow < 1e-5 && visibility < 1e-6 && confidence < 1e-6, "{name}");
    }
}

#[test]
fn agreement_matches_algorithm_1() {
    for name in ["one", "two", "three"] {
        let case = open_case("agreement", name);
        let (flow, confidence) = (array(&case, "flow"), array(&case, "confidence"));
        let size = ImageSize { width: 50, height: 30 };
        let n = size.pixels();
        let mut flows: Vec<DenseMotion> = (confidence.chunks(n).zip(flow.chunks(2 * n)))
            .map(|(c, f)| DenseMotion {
                size,
                flow: pairs(f).into_iter().map(|p| p.map(|v| v as f32)).collect(),
                visibility: vec![1.0; n],
                confidence: c.iter().map(|&v| v as f32).collect(),
            })
            .collect();
        let floor = array(&case, "magnitude_floor")[0] as f32;
        let config = AgreementConfig { magnitude_floor_px: floor, ..AgreementConfig::default() };
        agreement(&mut flows, None, &config).unwrap();
        let found: Vec<f32> = flows.iter().flat_map(|f| f.confidence.clone()).collect();
        let error = largest_difference(&found, &array(&case, "expected_confidence"));
        assert!(error < 1e-6, "{name}: {error:.1e}");
    }
}
