//! Terms of the loss beside the photographs, with their derivatives in closed form.

use super::Dynamic3dgsConfig;
use crate::deformation::columns;
use crate::neighbours::Neighbours;
use glam::{Quat, Vec3};
use rayon::prelude::*;

/// Under each square root, so that it has a derivative at 0.
const FLOOR: f32 = 1e-20;

/// Places (m) and unit quaternions.
#[derive(Clone, Default)]
pub(super) struct Poses {
    pub places: Vec<Vec3>,
    pub turns: Vec<Quat>,
}

/// A value, and its derivatives by places and unit quaternions.
pub(super) struct Term {
    pub value: f64,
    pub by_places: Vec<Vec3>,
    pub by_turns: Vec<Quat>,
}

/// One edge's part: derivatives by the difference of places and by the turns of its end and its start.
#[derive(Clone, Copy)]
struct Part {
    value: f32,
    difference: Vec3,
    end: Quat,
    start: Quat,
}

/// Weights `exp(-decay d^2)` of neighbours at distances d (m); `decay` in 1/m^2.
pub(super) fn fall(decay: f32) -> impl Fn(&[f32]) -> Vec<f32> {
    move |lengths| lengths.iter().map(|length| (-decay * length * length).exp()).collect()
}

/// Rigidity (neighbours keep their place in the Gaussian's own axes), equal turns of neighbours, and isometry (distances of the first
/// frame), with the weights of `config`: means over all edges of `sqrt(w |.|^2 + 1e-20)` (equations 6 to 9 of the paper).
pub(super) fn neighbourhood(
    config: &Dynamic3dgsConfig,
    edges: &Neighbours,
    before: &Poses,
    now: &Poses,
) -> Term {
    // From t - 1 to t.
    let relative: Vec<Quat> =
        now.turns.iter().zip(&before.turns).map(|(now, before)| *now * before.conjugate()).collect();
    let share = 1.0 / edges.ends.len().max(1) as f32;
    let part = |edge: usize| {
        let (i, j) = (edge / edges.per_gaussian, edges.ends[edge] as usize);
        let weight = edges.weights[edge];
        let difference = now.places[j] - now.places[i];
        let offset = before.places[j] - before.places[i];
        let rigid = config.rigidity * share;
        let (rigid_value, by_seen) = root(relative[i].conjugate() * difference - offset, weight);
        let by_seen = relative[i] * (rigid * by_seen);
        let turned = relative[j] - relative[i];
        let root_of = (turned.length_squared() * weight + FLOOR).sqrt();
        let by_relative = turned * (config.rotation * share * weight / root_of);
        let length = (difference.length_squared() + FLOOR).sqrt();
        let (iso_value, by_length) = root(Vec3::X * (length - edges.lengths[edge]), weight);
        let isometry = config.isometry * share;
        Part {
            value: rigid * rigid_value + config.rotation * share * root_of + isometry * iso_value,
            difference: by_seen + difference * (isometry * by_length.x / length),
            end: by_relative * before.turns[j],
            // A turn of the axes by w changes what is seen by -w x difference: a derivative by w of that torque.
            start: -(by_relative * before.turns[i]) - (spin(difference.cross(by_seen)) * now.turns[i]) * 2.0,
        }
    };
    let parts: Vec<Part> = (0..edges.ends.len()).into_par_iter().map(part).collect();
    let gather = |i: usize| {
        let mut sum = (Vec3::ZERO, spin(Vec3::ZERO));
        edges.leaving(i).for_each(|edge| sum = (sum.0 - parts[edge].difference, sum.1 + parts[edge].start));
        edges.arriving(i).for_each(|edge| sum = (sum.0 + parts[edge].difference, sum.1 + parts[edge].end));
        sum
    };
    let (by_places, by_turns) = (0..now.places.len()).into_par_iter().map(gather).unzip();
    Term { value: parts.iter().map(|part| f64::from(part.value)).sum(), by_places, by_turns }
}

/// `sqrt(weight |v|^2 + 1e-20)` and its derivative by v.
fn root(v: Vec3, weight: f32) -> (f32, Vec3) {
    let root = (v.length_squared() * weight + FLOOR).sqrt();
    (root, v * (weight / root))
}

fn spin(v: Vec3) -> Quat {
    Quat::from_xyzw(v.x, v.y, v.z, 0.0)
}

/// Adds to `gradient` the derivative of `weight` times the mean over rows of the L1 distance of `values` from `to`, and returns the value.
pub(super) fn stay<const N: usize>(
    weight: f32,
    values: &[[f32; N]],
    to: &[[f32; N]],
    gradient: &mut [[f32; N]],
) -> f64 {
    let share = weight / values.len().max(1) as f32;
    let mut sum = 0.0;
    for ((value, to), gradient) in values.iter().zip(to).zip(gradient) {
        for c in 0..N {
            let far = value[c] - to[c];
            sum += f64::from(far.abs());
            gradient[c] += if far == 0.0 { 0.0 } else { share * far.signum() };
        }
    }
    f64::from(share) * sum
}

/// Adds the derivative of `weight` times the mean depth below the floor at y = 0 (y points down), and returns the value.
pub(super) fn floor(weight: f32, places: &[Vec3], gradient: &mut [[f32; 3]]) -> f64 {
    let share = weight / places.len().max(1) as f32;
    for (place, gradient) in places.iter().zip(gradient) {
        gradient[1] += if place.y > 0.0 { share } else { 0.0 };
    }
    f64::from(share) * places.iter().map(|place| f64::from(place.y.max(0.0))).sum::<f64>()
}

/// From the derivative by a unit quaternion to that by one of any length that is normalised.
pub(super) fn through_normalisation(by_unit: Quat, unit: Quat, length: f32) -> [f32; 4] {
    let across = by_unit - unit * unit.dot(by_unit);
    columns(if length > 0.0 { across / length } else { spin(Vec3::ZERO) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::waves;
    use ffgs_testkit::largest_difference;

    const COUNT: usize = 9;

    /// Poses at two instants that no rigid motion connects, and quaternions of lengths that are not 1.
    fn case() -> (Neighbours, Poses, Vec<[f32; 3]>, Vec<[f32; 4]>) {
        let mut places = vec![[0.0; 3]; COUNT];
        waves(places.as_flattened_mut(), 0.7);
        let neighbours = Neighbours::new(&places, 4, fall(0.3)).unwrap();
        let before = Poses {
            places: places.iter().map(|p| Vec3::from(*p) * 1.1).collect(),
            turns: (0..COUNT).map(|i| Quat::from_rotation_z(0.2 * i as f32)).collect(),
        };
        let mut turns = vec![[0.0; 4]; COUNT];
        waves(turns.as_flattened_mut(), 1.9);
        turns.iter_mut().for_each(|turn| turn[0] += 1.5);
        let mut moved = [[0.0; 3]; COUNT];
        waves(moved.as_flattened_mut(), 3.1);
        places.as_flattened_mut().iter_mut().zip(moved.as_flattened()).for_each(|(p, m)| *p += 0.3 * m);
        (neighbours, before, places, turns)
    }

    fn poses(places: &[[f32; 3]], turns: &[[f32; 4]]) -> Poses {
        Poses {
            places: places.iter().map(|p| Vec3::from(*p)).collect(),
            turns: turns.iter().map(|t| crate::deformation::unit(*t)).collect(),
        }
    }

    /// Analytic and numeric derivatives by places, then by quaternions before they are normalised.
    fn derivatives(config: &Dynamic3dgsConfig) -> (Vec<f32>, Vec<f64>) {
        const STEP: f32 = 4e-3;
        let (edges, before, places, turns) = case();
        let term = neighbourhood(config, &edges, &before, &poses(&places, &turns));
        let by_turns = (0..COUNT).map(|i| {
            let length = turns[i].iter().map(|t| t * t).sum::<f32>().sqrt();
            through_normalisation(term.by_turns[i], poses(&places, &turns).turns[i], length)
        });
        let mut analytic: Vec<f32> = term.by_places.iter().flat_map(Vec3::to_array).collect();
        analytic.extend(by_turns.flatten());
        let value = |k: usize, step: f32| {
            let (mut places, mut turns) = (places.clone(), turns.clone());
            if k < 3 * COUNT {
                places.as_flattened_mut()[k] += step;
            } else {
                turns.as_flattened_mut()[k - 3 * COUNT] += step;
            }
            neighbourhood(config, &edges, &before, &poses(&places, &turns)).value
        };
        let numeric =
            (0..7 * COUNT).map(|k| (value(k, STEP) - value(k, -STEP)) / f64::from(2.0 * STEP)).collect();
        (analytic, numeric)
    }

    #[test]
    fn every_term_has_the_derivative_of_finite_differences() {
        let none =
            Dynamic3dgsConfig { rigidity: 0.0, rotation: 0.0, isometry: 0.0, ..Dynamic3dgsConfig::default() };
        for config in [
            Dynamic3dgsConfig { rigidity: 4.0, ..none },
            Dynamic3dgsConfig { rotation: 4.0, ..none },
            Dynamic3dgsConfig { isometry: 2.0, ..none },
        ] {
            let (analytic, numeric) = derivatives(&config);
            let far = largest_difference(&analytic, &numeric);
            assert!(far < 2e-3, "{far}: {config:?}");
            assert!(analytic.iter().any(|v| v.abs() > 0.05), "no derivative to speak of: {config:?}");
        }
    }

    /// Rotation and translation of all as one: nothing to pay but the roots' floor.
    #[test]
    fn a_rigid_motion_costs_nothing() {
        let (_, before, ..) = case();
        let start: Vec<[f32; 3]> = before.places.iter().map(Vec3::to_array).collect();
        let edges = Neighbours::new(&start, 4, fall(0.3)).unwrap();
        let (turn, far) = (Quat::from_rotation_x(0.8), Vec3::new(1.0, -2.0, 0.5));
        let now = Poses {
            places: before.places.iter().map(|place| turn * *place + far).collect(),
            turns: before.turns.iter().map(|own| turn * *own).collect(),
        };
        let value = neighbourhood(&Dynamic3dgsConfig::default(), &edges, &before, &now).value;
        assert!(value < 1e-5, "{value}");
        let bent = Poses { places: now.places.iter().map(|p| *p * 1.05).collect(), ..now };
        assert!(neighbourhood(&Dynamic3dgsConfig::default(), &edges, &before, &bent).value > 1e-2);
    }

    #[test]
    fn weights_fall_with_the_square_of_the_distance() {
        assert!(
            largest_difference(&fall(2.0)(&[0.0, 1.0, 2.0]), &[1.0, (-2.0_f32).exp(), (-8.0_f32).exp()])
                < 1e-7
        );
    }

    #[test]
    fn what_stays_and_the_floor_are_means_of_distances() {
        let mut gradient = [[0.0; 3]; 2];
        let value =
            stay(20.0, &[[1.0, 2.0, 3.0], [0.0, 0.0, 0.0]], &[[1.0, 2.5, 2.0], [0.0; 3]], &mut gradient);
        assert!((value - 20.0 * 1.5 / 2.0).abs() < 1e-6);
        assert_eq!(gradient, [[0.0, -10.0, 10.0], [0.0; 3]]);
        let mut gradient = [[0.0; 3]; 2];
        let value = floor(2.0, &[Vec3::new(5.0, 0.5, 0.0), Vec3::new(0.0, -3.0, 0.0)], &mut gradient);
        assert!((value - 0.5).abs() < 1e-6);
        assert_eq!(gradient, [[0.0, 1.0, 0.0], [0.0; 3]]);
    }
}
