//! The kernels on every instruction set of this machine: none fuses a product with a sum, so all find the same bits.

use crate::kernel_mean::{KernelMean, Mean};
use crate::nearest::{Candidate, Keys, KthNearest, LANES};
use ffgs_testkit::vectorised;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Tracks of which some begin at one place, and places of which some are theirs.
fn tracks_and_places() -> (Vec<Candidate>, [[f64; 8 * LANES]; 2]) {
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    let mut points: Vec<[f64; 2]> = (0..90).map(|_| [rng.random(), rng.random()]).collect();
    points.extend_from_within(..40);
    let candidate = |(track, &point): (usize, &[f64; 2])| Candidate { point, track: track as u32 };
    let candidates: Vec<Candidate> = points.iter().enumerate().map(candidate).collect();
    let mut places = [[0.0; 8 * LANES]; 2];
    for k in 0..8 * LANES {
        let place = if k % 5 == 0 { points[k] } else { [rng.random(), rng.random()] };
        (places[0][k], places[1][k]) = (place[0], place[1]);
    }
    (candidates, places)
}

#[test]
fn neighbours_are_the_same() {
    let (candidates, [x, y]) = tracks_and_places();
    let (x, y) = (x.first_chunk().unwrap(), y.first_chunk().unwrap());
    for k in [1, 2, 8, 9, 20] {
        let keys = Keys::new(candidates.len());
        let found = |set| vectorised(set, KthNearest { x, y, candidates: &candidates, keys, k });
        let expected = found(0).unwrap();
        for lane in 0..LANES {
            let squares =
                candidates.iter().map(|c| (x[lane] - c.point[0]).powi(2) + (y[lane] - c.point[1]).powi(2));
            let mut sorted: Vec<f64> = squares.collect();
            sorted.sort_by(f64::total_cmp);
            assert!((expected[lane] - sorted[k - 1]).abs() <= 1e-12 * sorted[k - 1], "{k} {lane}");
        }
        assert!((1..3).filter_map(found).all(|other| other == expected), "{k}");
    }
}

#[test]
fn means_are_the_same() {
    let (candidates, [x, y]) = tracks_and_places();
    let values: Vec<[f64; 4]> = (0..candidates.len())
        .map(|t| [(t as f64).sin(), (1.3 * t as f64).cos(), 0.01 * t as f64, 1.0])
        .collect();
    for (k, half_precision) in [(1, 2.0), (8, 200.0), (20, 0.5)] {
        let keys = Keys::new(candidates.len());
        let found = |set| {
            let mut out = [Mean::default(); 8 * LANES - 3];
            let (candidates, values) = (&candidates, &values);
            vectorised(
                set,
                KernelMean { x: &x, y: &y, candidates, values, keys, k, half_precision, out: &mut out },
            )?;
            Some(out.map(|m| [m.values[0], m.values[1], m.values[2], m.confidence].map(f64::to_bits)))
        };
        let expected = found(0).unwrap();
        assert!(expected.iter().flatten().all(|bits| f64::from_bits(*bits).is_finite()));
        assert!(expected[1] != expected[2]);
        assert!((1..3).filter_map(found).all(|other| other == expected), "{k}");
    }
}
