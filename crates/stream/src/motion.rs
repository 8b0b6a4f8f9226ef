//! Rigid motion of groups.

use nalgebra::{Matrix4, SymmetricEigen};

/// A rotation about the origin, then a translation: twelve numbers' worth in seven.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Motion {
    /// Unit quaternion (w, x, y, z).
    pub(crate) quat: [f32; 4],
    /// Point that the rotation leaves in its place (the capture's unit).
    pub(crate) centre: [f32; 3],
    /// How that point moves (the capture's unit).
    pub(crate) step: [f32; 3],
}

/// Where a point was, and where it is.
pub(crate) type Pair = ([f64; 3], [f64; 3]);

impl Motion {
    pub(crate) const NONE: Self = Self { quat: [1.0, 0.0, 0.0, 0.0], centre: [0.0; 3], step: [0.0; 3] };

    /// Numbers of a motion in a file.
    pub(crate) const NUMBERS: usize = 10;

    pub(crate) fn numbers(&self) -> [f32; Self::NUMBERS] {
        let ([w, x, y, z], [cx, cy, cz], [sx, sy, sz]) = (self.quat, self.centre, self.step);
        [w, x, y, z, cx, cy, cz, sx, sy, sz]
    }

    pub(crate) fn from_numbers([w, x, y, z, cx, cy, cz, sx, sy, sz]: [f32; Self::NUMBERS]) -> Self {
        Self { quat: [w, x, y, z], centre: [cx, cy, cz], step: [sx, sy, sz] }
    }

    /// Where a point goes: `R (p - centre) + centre + step`.
    pub(crate) fn place(&self, p: [f64; 3]) -> [f64; 3] {
        let [w, x, y, z] = self.quat.map(f64::from);
        let rows = [
            [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
            [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
            [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
        ];
        let (centre, step) = (self.centre.map(f64::from), self.step.map(f64::from));
        let d = [0, 1, 2].map(|k| p[k] - centre[k]);
        [0, 1, 2].map(|k| {
            let row = rows[k];
            row[0] * d[0] + row[1] * d[1] + row[2] * d[2] + centre[k] + step[k]
        })
    }

    /// A rotation after it has moved: the product of both quaternions (w, x, y, z).
    pub(crate) fn turn(&self, q: [f64; 4]) -> [f64; 4] {
        product(self.quat.map(f64::from), q)
    }

    /// The rigid motion that takes points nearest to others, in least squares (Horn 1987); `NONE` of no points.
    pub(crate) fn fit(pairs: &[Pair]) -> Self {
        let n = pairs.len() as f64;
        if pairs.is_empty() {
            return Self::NONE;
        }
        let mean = |side: fn(&Pair) -> [f64; 3]| {
            [0, 1, 2].map(|k| pairs.iter().map(|p| side(p)[k]).sum::<f64>() / n)
        };
        let (from, to) = (mean(|p| p.0), mean(|p| p.1));
        let mut s = [[0.0; 3]; 3];
        for (a, b) in pairs {
            for i in 0..3 {
                for j in 0..3 {
                    s[i][j] += (a[i] - from[i]) * (b[j] - to[j]);
                }
            }
        }
        let quat = rotation(s);
        Self {
            quat: quat.map(|v| v as f32),
            centre: from.map(|v| v as f32),
            step: [0, 1, 2].map(|k| (to[k] - from[k]) as f32),
        }
    }
}

/// The product of two quaternions (w, x, y, z): the second rotation, then the first.
pub(crate) fn product([a, b, c, d]: [f64; 4], [w, x, y, z]: [f64; 4]) -> [f64; 4] {
    [
        a * w - b * x - c * y - d * z,
        a * x + b * w + c * z - d * y,
        a * y - b * z + c * w + d * x,
        a * z + b * y - c * x + d * w,
    ]
}

/// Quaternion of the rotation that aligns points with the given sums of products.
fn rotation(s: [[f64; 3]; 3]) -> [f64; 4] {
    let [[xx, xy, xz], [yx, yy, yz], [zx, zy, zz]] = s;
    #[rustfmt::skip]
    let n = Matrix4::new(
        xx + yy + zz, yz - zy,      zx - xz,       xy - yx,
        yz - zy,      xx - yy - zz, xy + yx,       zx + xz,
        zx - xz,      xy + yx,      -xx + yy - zz, yz + zy,
        xy - yx,      zx + xz,      yz + zy,       -xx - yy + zz,
    );
    let eigen = SymmetricEigen::new(n);
    let best = eigen.eigenvalues.imax();
    let q = eigen.eigenvectors.column(best);
    let sign = if q[0] < 0.0 { -1.0 } else { 1.0 };
    let q = [sign * q[0], sign * q[1], sign * q[2], sign * q[3]];
    if q.iter().all(|v| v.is_finite()) { q } else { [1.0, 0.0, 0.0, 0.0] }
}

/// Rounds of refitting without the pairs that fit worst.
const TRIMS: usize = 2;
/// Share of the pairs kept in such a round: finetuning moves some Gaussians along surfaces, freely.
const KEPT: f64 = 0.7;

/// [`Motion::fit`] of the pairs that agree best.
pub(crate) fn robust_fit(pairs: &[Pair]) -> Motion {
    /// Fewer pairs leave a rotation open.
    const LEAST: usize = 8;
    let mut motion = Motion::fit(pairs);
    if pairs.len() < LEAST {
        return Motion { quat: Motion::NONE.quat, ..motion };
    }
    for _ in 0..TRIMS {
        let error = |p: &Pair| {
            let at = motion.place(p.0);
            (0..3).map(|k| (at[k] - p.1[k]).powi(2)).sum::<f64>()
        };
        let mut sorted = pairs.to_vec();
        sorted.sort_by(|a, b| error(a).total_cmp(&error(b)));
        sorted.truncate(((pairs.len() as f64 * KEPT) as usize).max(LEAST));
        motion = Motion::fit(&sorted);
    }
    motion
}

/// Rounds of [`clusters`].
const ROUNDS: usize = 12;

/// Deals points to at most `count` groups by nearness (Lloyd's algorithm from points far from each other); the group of each, and the
/// centres.
pub(crate) fn clusters(points: &[[f64; 3]], count: usize) -> (Vec<u8>, Vec<[f64; 3]>) {
    let mut centres = far_apart(points, count);
    let mut groups = vec![0; points.len()];
    for _ in 0..ROUNDS {
        groups = points.iter().map(|p| nearest(&centres, p)).collect();
        let mut sums = vec![[0.0; 4]; centres.len()];
        for (group, p) in groups.iter().zip(points) {
            let sum = &mut sums[usize::from(*group)];
            (0..3).for_each(|k| sum[k] += p[k]);
            sum[3] += 1.0;
        }
        for (centre, sum) in centres.iter_mut().zip(sums) {
            if sum[3] > 0.0 {
                *centre = [0, 1, 2].map(|k| sum[k] / sum[3]);
            }
        }
    }
    (groups, centres)
}

/// Points of which each is the farthest from those before it.
fn far_apart(points: &[[f64; 3]], count: usize) -> Vec<[f64; 3]> {
    let mut out: Vec<[f64; 3]> = points.first().copied().into_iter().collect();
    while out.len() < count.min(points.len()) {
        let distance = |p: &[f64; 3]| squared(p, &out[usize::from(nearest(&out, p))]);
        let next = points.iter().max_by(|a, b| distance(a).total_cmp(&distance(b))).copied();
        out.extend(next);
    }
    out
}

/// The nearest of up to 256 centres; 0 of none.
pub(crate) fn nearest(centres: &[[f64; 3]], p: &[f64; 3]) -> u8 {
    let order = |a: &usize, b: &usize| squared(&centres[*a], p).total_cmp(&squared(&centres[*b], p));
    (0..centres.len()).min_by(order).unwrap_or(0) as u8
}

fn squared(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    (0..3).map(|k| (a[k] - b[k]).powi(2)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_known_motion_is_found_in_spite_of_strays() {
        let half = 0.2_f32;
        let truth = Motion {
            quat: [half.cos(), 0.0, 0.0, half.sin()],
            centre: [5.0, -2.0, 1.0],
            step: [1.3, 0.2, -0.1],
        };
        let mut pairs: Vec<_> = (0..60)
            .map(|i| {
                let t = f64::from(i);
                let p = [5.0 + t.sin(), -2.0 + (1.7 * t).cos(), 1.0 + 0.5 * (0.3 * t).sin()];
                (p, truth.place(p))
            })
            .collect();
        pairs.iter_mut().step_by(7).for_each(|p| p.1[0] += 0.4);
        let found = robust_fit(&pairs);
        for (p, q) in pairs.iter().skip(1).take(6) {
            let at = found.place(*p);
            assert!((0..3).all(|k| (at[k] - q[k]).abs() < 1e-4), "{at:?} {q:?}");
        }
        let turned = found.turn([1.0, 0.0, 0.0, 0.0]);
        assert!((turned[3] - f64::from(half.sin())).abs() < 1e-5, "{turned:?}");
        assert_eq!(robust_fit(&[]), Motion::NONE);
    }

    #[test]
    fn two_bodies_are_two_groups() {
        let points: Vec<[f64; 3]> =
            (0..40).map(|i| [f64::from(i % 2) * 30.0, f64::from(i) * 0.01, 0.0]).collect();
        let (groups, centres) = clusters(&points, 2);
        assert_eq!(centres.len(), 2);
        assert!((0..40).all(|i| groups[i] == groups[i % 2]) && groups[0] != groups[1]);
        assert!(clusters(&[], 4).0.is_empty());
    }
}
