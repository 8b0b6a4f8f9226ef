//! The nearest tracks of several places side by side: one place per SIMD lane.

use pulp::{Simd, WithSimd};

/// Places at once at most: the lanes of the widest instruction set.
pub(crate) const LANES: usize = 8;
/// Neighbours found in one pass: they and what they are compared with stay in registers.
pub(crate) const SLOTS: usize = 8;

/// A track that may be near.
#[derive(Clone, Copy)]
pub(crate) struct Candidate {
    /// Where it begins (normalised).
    pub point: [f64; 2],
    pub track: u32,
}

/// Squared distances whose lowest bits are replaced by the number of the track. They order as the distances do, equal
/// distances order as the tracks do, and no two are equal. Fewer than 2^32 tracks leave 20 bits of a distance, 4096 leave
/// 40.
#[derive(Clone, Copy)]
pub(crate) struct Keys {
    track: u64,
}

impl Keys {
    /// For tracks 0 to `tracks - 1`.
    pub(crate) fn new(tracks: usize) -> Self {
        Self { track: (tracks as u64).next_power_of_two() - 1 }
    }

    #[inline(always)]
    pub(crate) fn squared_distances<S: Simd>(self, simd: S, keys: S::f64s) -> S::f64s {
        simd.and_f64s(keys, simd.splat_f64s(f64::from_bits(!self.track)))
    }

    #[inline(always)]
    pub(crate) fn track(self, key: f64) -> usize {
        (key.to_bits() & self.track) as usize
    }

    /// The keys of the nearest [`SLOTS`] candidates in each lane that come after the key `after`, ascending; infinity
    /// where there are no more.
    #[inline(always)]
    pub(crate) fn nearest<S: Simd>(
        self,
        simd: S,
        [x, y]: [S::f64s; 2],
        candidates: &[Candidate],
        after: S::f64s,
    ) -> [S::f64s; SLOTS] {
        let far = simd.splat_f64s(f64::INFINITY);
        let mut slots = [far; SLOTS];
        for candidate in candidates {
            let [px, py] = candidate.point.map(|p| simd.splat_f64s(p));
            let (dx, dy) = (simd.sub_f64s(x, px), simd.sub_f64s(y, py));
            let d2 = simd.add_f64s(simd.mul_f64s(dx, dx), simd.mul_f64s(dy, dy));
            let track = simd.splat_f64s(f64::from_bits(candidate.track.into()));
            let key = simd.or_f64s(self.squared_distances(simd, d2), track);
            let mut key = simd.select_f64s(simd.less_than_f64s(after, key), key, far);
            for slot in &mut slots {
                let low = simd.min_f64s(key, *slot);
                key = simd.max_f64s(key, *slot);
                *slot = low;
            }
        }
        slots
    }
}

/// The squared distances of the `k`-th nearest of the candidates (at least `k`) from some places.
pub(crate) struct KthNearest<'a> {
    pub x: &'a [f64; LANES],
    pub y: &'a [f64; LANES],
    pub candidates: &'a [Candidate],
    pub keys: Keys,
    pub k: usize,
}

impl WithSimd for KthNearest<'_> {
    type Output = [f64; LANES];

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> [f64; LANES] {
        let Self { x, y, candidates, keys, k } = self;
        let mut out = [0.0; LANES];
        let places = S::as_simd_f64s(x).0.iter().zip(S::as_simd_f64s(y).0);
        for (kth, (&x, &y)) in S::as_mut_simd_f64s(&mut out).0.iter_mut().zip(places) {
            *kth = simd.splat_f64s(-1.0);
            for pass in (0..k).step_by(SLOTS) {
                *kth = keys.nearest(simd, [x, y], candidates, *kth)[(k - pass).min(SLOTS) - 1];
            }
            *kth = keys.squared_distances(simd, *kth);
        }
        out
    }
}
