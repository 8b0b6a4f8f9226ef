//! Kernels against their CPU twins in `ffgs-voronoi`: random tracks, masks, ties, and input that is no motion.

use ffgs_core::{DenseMotion, ImageSize, Mask, TrackSet};
use ffgs_gpu::Gpu;
use ffgs_motion_gpu::{FieldsError, ViewFields, supports};
use ffgs_voronoi::{
    AgreementConfig, Method, MotionError, SourceFilter, VoronoiConfig, agreement, densify_view,
};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

const SIZE: ImageSize = ImageSize { width: 83, height: 47 };
/// f32 against f64 (px, for flows of some 30 px).
const FLOW_TOLERANCE: f32 = 2e-3;
/// Where two tracks are equally far within f32, another may be the last of the K: its weight is small, its flow is not.
const FLIP_TOLERANCE: f32 = 1.0;
const FLIP_SHARE: f64 = 5e-3;

fn mask(every: usize) -> Mask {
    let inside = |p: usize| u8::from(p % SIZE.width > 20 && p / SIZE.width < 40 && p % every != 1);
    Mask::new(SIZE, (0..SIZE.pixels()).map(inside).collect()).unwrap()
}

fn tracks(n: usize, seed: u64) -> TrackSet {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut out = TrackSet::default();
    for _ in 0..n {
        let src = [rng.random_range(0.0..SIZE.width as f32), rng.random_range(0.0..SIZE.height as f32)];
        out.src.push(src);
        out.tgt.push([src[0] + rng.random_range(20.0..30.0), src[1] + rng.random_range(-3.0..3.0)]);
        out.visibility.push(rng.random());
    }
    out
}

fn assert_close(found: &DenseMotion, expected: &DenseMotion, what: &str) {
    let mut flips = 0;
    for p in 0..SIZE.pixels() {
        let (f, e) = (found.flow[p], expected.flow[p]);
        let error = (f[0] - e[0])
            .abs()
            .max((f[1] - e[1]).abs())
            .max((found.visibility[p] - expected.visibility[p]).abs());
        assert!(error < FLIP_TOLERANCE, "{what}, pixel {p}: {f:?}, not {e:?}");
        flips += usize::from(error > FLOW_TOLERANCE);
        let (f, e) = (found.confidence[p], expected.confidence[p]);
        assert!(
            (f - e).abs() <= 1e-4 * e + 1e-7 || error > FLOW_TOLERANCE,
            "{what}, pixel {p}: confidence {f}, not {e}"
        );
    }
    assert!(flips as f64 <= FLIP_SHARE * SIZE.pixels() as f64, "{what}: {flips} pixels differ");
}

#[test]
#[ignore = "needs a GPU"]
fn densification_agrees_for_any_number_of_tracks_and_neighbours() {
    let gpu = Gpu::for_test();
    for (n, k, sigma, every, source_filter, use_visibility) in [
        (0, 8, 0.05, 9999, SourceFilter::Foreground, false),
        (1, 8, 0.05, 9999, SourceFilter::All, false),
        (5, 8, 0.05, 3, SourceFilter::All, true),
        (400, 8, 0.05, 9999, SourceFilter::Foreground, false),
        (400, 1, 0.05, 7, SourceFilter::All, false),
        (2000, 16, 0.2, 2, SourceFilter::Foreground, true),
        // So narrow that a weight would underflow if it were not relative to the nearest.
        (30, 4, 0.003, 9999, SourceFilter::All, false),
    ] {
        let config = VoronoiConfig { k, sigma, source_filter, use_visibility, ..VoronoiConfig::default() };
        assert!(supports(&config, 1));
        let (mask, tracks) = (mask(every), tracks(n, n as u64));
        let expected = densify_view(&config, &tracks, &mask).unwrap();
        let fields = ViewFields::new(&gpu, &mask, 2).unwrap();
        fields.densify(1, &config, &tracks, &mask).unwrap();
        assert_close(&fields.download(1).unwrap(), &expected, &format!("{n} tracks, K = {k}"));
        assert_eq!(fields.download(0).unwrap(), DenseMotion::unknown(SIZE), "the other tracker is as it was");
    }
}

/// Fields with pixels that are unknown, equal, opposite and still.
fn fields(seed: u64) -> Vec<DenseMotion> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut out = vec![DenseMotion::unknown(SIZE); 3];
    for p in 0..SIZE.pixels() {
        let common = [rng.random_range(-30.0..30.0), rng.random_range(-5.0..5.0)];
        for (l, field) in out.iter_mut().enumerate() {
            let apart = match p % 5 {
                0 => 0.0,
                1 => 0.3,
                2 => 20.0,
                _ => 2.0,
            };
            let still = if p % 7 == 0 { 0.0 } else { 1.0 };
            field.flow[p] = common.map(|c: f32| still * (c + apart * l as f32));
            field.confidence[p] = if (p + l) % 4 == 0 { 0.0 } else { rng.random() };
            field.visibility[p] = rng.random();
        }
    }
    out
}

#[test]
#[ignore = "needs a GPU"]
fn agreement_agrees_for_one_to_three_trackers() {
    let gpu = Gpu::for_test();
    let whole = Mask::filled(SIZE, true);
    for trackers in 1..=3 {
        for (magnitude_floor_px, ignore_unknown) in [(0.5, true), (0.0, false)] {
            let config = AgreementConfig { magnitude_floor_px, ignore_unknown };
            let mut expected = fields(3)[..trackers].to_vec();
            let on_device = ViewFields::new(&gpu, &whole, trackers).unwrap();
            for (l, field) in expected.iter_mut().enumerate() {
                on_device.take(l, field).unwrap();
                // Both from what 16 bits keep.
                *field = on_device.download(l).unwrap();
            }
            agreement(&mut expected, None, &config).unwrap();
            on_device.agree(&config).unwrap();
            for (l, expected) in expected.iter().enumerate() {
                assert_close(
                    &on_device.download(l).unwrap(),
                    expected,
                    &format!("tracker {l} of {trackers}"),
                );
            }
        }
    }
}

#[test]
#[ignore = "needs a GPU"]
fn planes_hold_what_association_sums() {
    let gpu = Gpu::for_test();
    let (mask, floor) = (mask(3), 0.25);
    let fields = fields(5);
    let on_device = ViewFields::new(&gpu, &mask, 2).unwrap();
    (0..2).for_each(|l| on_device.take(l, &fields[l]).unwrap());
    let planes: Vec<f32> =
        gpu.download(&on_device.planes(floor).unwrap(), on_device.plane_count() * SIZE.pixels()).unwrap();
    let plane = |c: usize, p: usize| planes[c * SIZE.pixels() + p];
    for p in 0..SIZE.pixels() {
        let inside = f32::from(mask.data()[p]);
        assert_eq!(plane(0, p), inside);
        for l in 0..2 {
            let field = on_device.download(l).unwrap();
            let known = inside * f32::from(field.confidence[p] > 0.0);
            let [x, y] = field.flow[p];
            let weight = inside * field.confidence[p] * x.hypot(y).max(floor);
            let found = [0, 1, 2, 3].map(|c| plane(1 + 4 * l + c, p));
            for (found, expected) in found.iter().zip([known, known * x, known * y, weight]) {
                assert!(
                    (found - expected).abs() <= 1e-5 * expected.abs(),
                    "pixel {p}: {found}, not {expected}"
                );
            }
        }
    }
}

#[test]
#[ignore = "needs a GPU"]
fn what_is_no_motion_is_refused_as_on_the_cpu() {
    let gpu = Gpu::for_test();
    let mask = mask(3);
    let fields = ViewFields::new(&gpu, &mask, 1).unwrap();
    let config = VoronoiConfig::default();
    let mut poisoned = tracks(5, 1);
    poisoned.tgt[3][0] = f32::NAN;
    let error = fields.densify(0, &config, &poisoned, &mask).unwrap_err();
    assert_eq!(error, FieldsError::Motion(MotionError::NotFinite { index: 3 }));
    let error = fields.densify(0, &VoronoiConfig { sigma: 0.0, ..config }, &tracks(5, 1), &mask).unwrap_err();
    assert_eq!(error, FieldsError::Motion(MotionError::Sigma(0.0)));
    let small = DenseMotion::unknown(ImageSize { width: 2, height: 2 });
    assert!(matches!(fields.take(0, &small), Err(FieldsError::Motion(MotionError::Size { .. }))));
    let floor = AgreementConfig { magnitude_floor_px: -1.0, ..AgreementConfig::default() };
    assert_eq!(fields.agree(&floor).unwrap_err(), FieldsError::Motion(MotionError::Floor(-1.0)));
    assert!(!supports(&VoronoiConfig { k: 17, ..config }, 1));
    assert!(!supports(&VoronoiConfig { method: Method::NaturalNeighbour, ..config }, 1));
    assert!(!supports(&config, 9) && !supports(&config, 0));
}

#[test]
#[ignore = "needs a GPU"]
fn an_empty_mask_has_empty_fields() {
    let gpu = Gpu::for_test();
    let mask = Mask::filled(SIZE, false);
    let fields = ViewFields::new(&gpu, &mask, 1).unwrap();
    fields.densify(0, &VoronoiConfig::default(), &tracks(5, 1), &mask).unwrap();
    fields.agree(&AgreementConfig::default()).unwrap();
    assert_eq!(fields.download(0).unwrap(), DenseMotion::unknown(SIZE));
}
