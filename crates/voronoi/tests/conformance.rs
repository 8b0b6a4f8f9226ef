//! The contract of `MotionInterpolator`, run by every implementation, and the stage around it.

use ffgs_core::{DenseMotion, ImageSize, Mask, TrackSet};
use ffgs_voronoi::{
    AgreementConfig, GaussianKnn, Method, MotionError, MotionInterpolator, NaturalNeighbour, SourceFilter,
    VoronoiConfig, agreement, densify_view,
};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

const SIZE: ImageSize = ImageSize { width: 33, height: 21 };

fn random_tracks(n: usize) -> TrackSet {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let mut tracks = TrackSet::default();
    for _ in 0..n {
        let src = [rng.random_range(-2.0..35.0), rng.random_range(-2.0..23.0)];
        tracks.src.push(src);
        tracks.tgt.push([src[0] + rng.random_range(-5.0..5.0), src[1] + rng.random_range(-5.0..5.0)]);
        tracks.visibility.push(rng.random());
    }
    tracks
}

fn field(interpolator: &dyn MotionInterpolator, tracks: &TrackSet, size: ImageSize) -> DenseMotion {
    let out = interpolator.densify(tracks, size, None).unwrap();
    assert_eq!((out.size, out.flow.len(), out.confidence.len()), (size, size.pixels(), size.pixels()));
    assert!(out.flow.as_flattened().iter().all(|v| v.is_finite()));
    assert!(out.visibility.iter().chain(&out.confidence).all(|v| (0.0..=1.0).contains(v)));
    out
}

fn conforms(interpolator: &dyn MotionInterpolator) {
    no_tracks_is_unknown(interpolator);
    one_track_is_constant(interpolator);
    duplicates_and_collinear_tracks_are_no_special_case(interpolator);
    values_at_a_track_and_inside_the_range(interpolator);
    only_the_region_is_computed(interpolator);
    bad_batches_are_errors(interpolator);
}

fn no_tracks_is_unknown(interpolator: &dyn MotionInterpolator) {
    let out = field(interpolator, &TrackSet::default(), SIZE);
    assert_eq!(out, DenseMotion::unknown(SIZE));
}

fn one_track_is_constant(interpolator: &dyn MotionInterpolator) {
    let tracks = TrackSet { src: vec![[-900.0, 4.0]], tgt: vec![[-897.0, 2.0]], visibility: vec![0.25] };
    for size in [SIZE, ImageSize { width: 1, height: 1 }, ImageSize { width: 1, height: 9 }] {
        let out = field(interpolator, &tracks, size);
        assert!(out.flow.iter().all(|&f| f == [3.0, -2.0]) && out.visibility.iter().all(|&v| v == 0.25));
    }
}

fn duplicates_and_collinear_tracks_are_no_special_case(interpolator: &dyn MotionInterpolator) {
    let equal = TrackSet {
        src: vec![[10.5, 10.5]; 1000],
        tgt: vec![[11.5, 10.5]; 1000],
        visibility: vec![1.0; 1000],
    };
    let out = field(interpolator, &equal, SIZE);
    assert!(out.flow.iter().all(|f| (f[0] - 1.0).abs() < 1e-6 && f[1] == 0.0));
    let mut line = TrackSet::default();
    for i in 0..500 {
        line.src.push([(i % 50) as f32, 5.5]);
        line.tgt.push([(i % 50) as f32 + 2.0, 5.5]);
        line.visibility.push(1.0);
    }
    let out = field(interpolator, &line, SIZE);
    assert!(out.flow.iter().all(|f| (f[0] - 2.0).abs() < 1e-5));
}

fn values_at_a_track_and_inside_the_range(interpolator: &dyn MotionInterpolator) {
    let mut tracks = random_tracks(60);
    tracks.src[0] = [12.5, 8.5];
    let out = field(interpolator, &tracks, SIZE);
    assert_eq!(out.confidence[8 * SIZE.width + 12], 1.0);
    let flows = || tracks.src.iter().zip(&tracks.tgt).map(|(s, t)| t[0] - s[0]);
    let (low, high) = (flows().fold(f32::MAX, f32::min), flows().fold(f32::MIN, f32::max));
    assert!(out.flow.iter().all(|f| (low - 1e-4..=high + 1e-4).contains(&f[0])));
}

fn only_the_region_is_computed(interpolator: &dyn MotionInterpolator) {
    let tracks = random_tracks(40);
    let all = field(interpolator, &tracks, SIZE);
    let region = Mask::new(SIZE, (0..SIZE.pixels()).map(|i| u8::from(i % 7 == 3)).collect()).unwrap();
    let some = interpolator.densify(&tracks, SIZE, Some(&region)).unwrap();
    for i in 0..SIZE.pixels() {
        let expected = if region.data()[i] == 1 { (all.flow[i], all.confidence[i]) } else { ([0.0; 2], 0.0) };
        assert_eq!((some.flow[i], some.confidence[i]), expected);
    }
}

fn bad_batches_are_errors(interpolator: &dyn MotionInterpolator) {
    let mut tracks = random_tracks(5);
    tracks.src[3][1] = f32::NAN;
    let error = interpolator.densify(&tracks, SIZE, None).unwrap_err();
    assert_eq!(error, MotionError::NotFinite { index: 3 });
    tracks.tgt.pop();
    assert!(matches!(interpolator.densify(&tracks, SIZE, None), Err(MotionError::Columns { .. })));
    let other = Mask::filled(ImageSize { width: 2, height: 2 }, true);
    let error = interpolator.densify(&random_tracks(5), SIZE, Some(&other)).unwrap_err();
    assert!(matches!(error, MotionError::Size { .. }));
}

#[test]
fn gaussian_knn_conforms() {
    conforms(&GaussianKnn::default());
    conforms(&GaussianKnn { k: 1, sigma: 0.01 });
    conforms(&GaussianKnn { k: 20, sigma: 0.05 });
}

#[test]
fn natural_neighbour_conforms() {
    conforms(&NaturalNeighbour::default());
}

#[test]
fn natural_neighbour_reproduces_an_affine_field_inside_the_hull() {
    let mut tracks = random_tracks(80);
    for (s, t) in tracks.src.iter().zip(&mut tracks.tgt) {
        *t = [s[0] + 0.1 * s[0] - 0.2 * s[1], s[1] + 3.0];
    }
    tracks.src.extend([[-3.0, -3.0], [40.0, -3.0], [-3.0, 30.0], [40.0, 30.0]]);
    for &[x, y] in &tracks.src[80..] {
        tracks.tgt.push([x + 0.1 * x - 0.2 * y, y + 3.0]);
        tracks.visibility.push(1.0);
    }
    let out = field(&NaturalNeighbour::default(), &tracks, SIZE);
    for (i, f) in out.flow.iter().enumerate() {
        let (x, y) = ((i % SIZE.width) as f32 + 0.5, (i / SIZE.width) as f32 + 0.5);
        assert!((f[0] - (0.1 * x - 0.2 * y)).abs() < 1e-3 && (f[1] - 3.0).abs() < 1e-4);
    }
}

#[test]
fn the_source_filter_keeps_background_out() {
    let mask = Mask::new(SIZE, (0..SIZE.pixels()).map(|i| u8::from(i % SIZE.width < 10)).collect()).unwrap();
    let tracks = TrackSet {
        src: vec![[2.5, 5.5], [12.5, 5.5], [-4.0, 5.5]],
        tgt: vec![[8.5, 5.5], [12.5, 5.5], [-4.0, 5.5]],
        visibility: vec![0.5, 1.0, 1.0],
    };
    for method in [Method::GaussianKnn, Method::NaturalNeighbour] {
        let config = VoronoiConfig { method, use_visibility: true, ..VoronoiConfig::default() };
        let out = densify_view(&config, &tracks, &mask).unwrap();
        let pixel = 5 * SIZE.width;
        assert_eq!((out.flow[pixel + 9], out.confidence[pixel + 20]), ([6.0, 0.0], 0.0));
        assert_eq!(out.confidence[pixel + 2], 0.5);
        let literal = VoronoiConfig { source_filter: SourceFilter::All, ..config };
        let out = densify_view(&literal, &tracks, &mask).unwrap();
        assert!(out.flow[pixel + 9][0] < 5.0);
    }
}

#[test]
fn an_unknown_tracker_does_not_disagree() {
    let known = |flow: [f32; 2], confidence: f32| {
        let mut out = DenseMotion::unknown(SIZE);
        out.flow.fill(flow);
        out.confidence.fill(confidence);
        out
    };
    let mut flows = [known([4.0, 0.0], 1.0), known([4.0, 0.0], 0.5), known([0.0, 0.0], 0.0)];
    agreement(&mut flows, None, &AgreementConfig::default()).unwrap();
    assert_eq!(flows.each_ref().map(|f| f.confidence[0]), [1.0, 0.5, 0.0]);
    let literal = AgreementConfig { magnitude_floor_px: 0.0, ignore_unknown: false };
    agreement(&mut flows, None, &literal).unwrap();
    assert!(flows[0].confidence[0] < 0.6);
    let mut still = [known([0.0, 0.0], 1.0), known([0.0, 0.0], 1.0)];
    agreement(&mut still, None, &literal).unwrap();
    assert_eq!(still[0].confidence[0], 1.0);
}

#[test]
fn agreement_stays_in_the_region_and_ignores_flows_of_confidence_zero() {
    let known = |flow: [f32; 2], confidence: f32| {
        let mut out = DenseMotion::unknown(SIZE);
        out.flow.fill(flow);
        out.confidence.fill(confidence);
        out
    };
    let region = Mask::new(SIZE, (0..SIZE.pixels()).map(|i| u8::from(i % 7 == 3)).collect()).unwrap();
    let mut flows = [known([4.0, 0.0], 1.0), known([0.0, 4.0], 1.0), known([f32::NAN, 0.0], 0.0)];
    agreement(&mut flows, Some(&region), &AgreementConfig::default()).unwrap();
    for (i, inside) in region.data().iter().enumerate() {
        let expected = if *inside == 1 { (-2_f32.sqrt()).exp() } else { 1.0 };
        assert!((flows[0].confidence[i] - expected).abs() < 1e-6);
        assert_eq!((flows[1].confidence[i], flows[2].confidence[i]), (flows[0].confidence[i], 0.0));
    }
}
