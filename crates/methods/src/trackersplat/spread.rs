//! Motions of neighbours: the median of those that were solved, and their mean where nothing was.

use crate::neighbours::Neighbours;
use glam::DVec3;
use rayon::prelude::*;

/// Rounds of spreading at most.
const ROUNDS: usize = 100;

/// Weights of the neighbours of one Gaussian by their distances (m).
pub(super) fn weights(lengths: &[f32]) -> Vec<f32> {
    let norm = lengths.iter().map(|length| length * length).sum::<f32>().sqrt().max(1e-12);
    lengths.iter().map(|length| (-length / norm).exp()).collect()
}

/// Each solved value becomes the median, axis by axis, of the solved ones among its neighbours (the upper one of two); its own where
/// there are none.
pub(super) fn median(edges: &Neighbours, values: &[Option<(DVec3, f64)>]) -> Vec<Option<(DVec3, f64)>> {
    let of = |i: usize| {
        let (own, trust) = values[i]?;
        let near = edges.leaving(i).filter_map(|edge| values[edges.ends[edge] as usize]);
        let near: Vec<DVec3> = near.map(|(value, _)| value).collect();
        let axis = |a: usize| {
            let mut column: Vec<f64> = near.iter().map(|value| value[a]).collect();
            column.sort_by(f64::total_cmp);
            column.get(column.len() / 2).copied().unwrap_or(own[a])
        };
        Some((DVec3::new(axis(0), axis(1), axis(2)), trust))
    };
    (0..values.len()).into_par_iter().map(of).collect()
}

/// Spreads values to those that have none, round by round: the mean of the neighbours that lead there, by trust and weight.
/// What is never reached is zero.
pub(super) fn spread(edges: &Neighbours, values: &[Option<(DVec3, f64)>]) -> Vec<DVec3> {
    let mut all = values.to_vec();
    for _ in 0..ROUNDS {
        let reach = |i: usize| {
            if all[i].is_some() {
                return None;
            }
            let from = edges.arriving(i).filter_map(|edge| {
                let (value, trust) = all[edge / edges.per_gaussian]?;
                Some((value, trust * f64::from(edges.weights[edge])))
            });
            let (mut sum, mut weight, mut count) = (DVec3::ZERO, 0.0, 0.0);
            from.for_each(|(value, own)| {
                (sum, weight, count) = (sum + own * value, weight + own, count + 1.0);
            });
            (weight > 0.0).then(|| (sum / weight, weight / count))
        };
        let reached: Vec<_> = (0..all.len()).into_par_iter().map(reach).collect();
        if reached.iter().all(Option::is_none) {
            break;
        }
        all.iter_mut().zip(reached).for_each(|(value, reached)| *value = value.or(reached));
    }
    all.into_iter().map(|value| value.map_or(DVec3::ZERO, |(value, _)| value)).collect()
}

/// Those that are fixed, and round by round those of whom three quarters of the neighbours are.
pub(super) fn spread_fixed(edges: &Neighbours, fixed: &[bool]) -> Vec<bool> {
    let mut all = fixed.to_vec();
    let needed = edges.per_gaussian * 3 / 4;
    for _ in 0..ROUNDS {
        let near = |i: usize| edges.leaving(i).filter(|&edge| all[edges.ends[edge] as usize]).count();
        let next: Vec<bool> = (0..all.len()).map(|i| all[i] || (needed > 0 && near(i) >= needed)).collect();
        if next == all {
            break;
        }
        all = next;
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Five in a row, two neighbours each.
    fn row() -> Neighbours {
        let means: Vec<[f32; 3]> = (0..5).map(|i| [i as f32, 0.0, 0.0]).collect();
        Neighbours::new(&means, 2, weights).unwrap()
    }

    fn value(x: f64) -> (DVec3, f64) {
        (DVec3::new(x, 0.0, 0.0), 1.0)
    }

    #[test]
    fn weights_fall_with_the_distance() {
        let found = weights(&[3.0, 4.0]);
        assert!((found[0] - (-0.6_f32).exp()).abs() < 1e-6 && (found[1] - (-0.8_f32).exp()).abs() < 1e-6);
        assert_eq!(weights(&[0.0, 0.0]), [1.0, 1.0]);
    }

    #[test]
    fn an_outlier_takes_the_median_and_what_nobody_solved_stays_unsolved() {
        let found =
            median(&row(), &[Some(value(1.0)), Some(value(1.0)), Some(value(50.0)), Some(value(1.5)), None]);
        let places: Vec<Option<f64>> = found.iter().map(|v| v.map(|(v, _)| v.x)).collect();
        assert_eq!(places, [Some(50.0), Some(50.0), Some(1.5), Some(50.0), None]);
        let alone = median(&row(), &[None, None, Some(value(2.0)), None, None]);
        assert_eq!(alone[2], Some(value(2.0)));
    }

    #[test]
    fn values_spread_to_the_ends_and_nothing_comes_from_nothing() {
        let found = spread(&row(), &[Some(value(2.0)), None, None, None, None]);
        assert!(found.iter().take(3).all(|v| (v.x - 2.0).abs() < 1e-12), "{found:?}");
        assert_eq!(spread(&row(), &[None; 5]), [DVec3::ZERO; 5]);
        let kept = spread(
            &row(),
            &[Some(value(1.0)), Some(value(2.0)), Some(value(3.0)), Some(value(4.0)), Some(value(5.0))],
        );
        assert_eq!(kept[4].x, 5.0);
    }

    #[test]
    fn three_quarters_of_fixed_neighbours_fix() {
        // Two neighbours: one is enough.
        assert_eq!(spread_fixed(&row(), &[true, false, false, false, false]), [true, true, true, true, true]);
        assert_eq!(spread_fixed(&row(), &[false; 5]), [false; 5]);
    }
}
