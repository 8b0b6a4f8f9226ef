//! ReCon-GS's motion: levels of anchors sampled from the Gaussians, with one motion each.

use super::RecongsConfig;
use crate::added::AddedConfig;
use crate::deformation::{DELTA, Deformation, Deltas, MotionFitConfig, columns, unit};
use crate::nearest::nearest;
use crate::photographs::frame_seed;
use crate::saved::{Reader, Writer};
use crate::two_stages::Nodes;
use anyhow::{Context, Result, ensure};
use ffgs_method::Step;
use ffgs_trainer::AdamVec;
use nalgebra::{Matrix4, Vector4};
use rand::SeedableRng;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

/// Old anchors that a new one inherits from.
const HEIRS_OF: usize = 3;

/// Anchors, level after level from fine to coarse, with a delta each. They stay where they were sampled.
pub(super) struct Anchors {
    /// Places (m), per level.
    levels: Vec<Vec<[f32; 3]>>,
    /// Of all anchors.
    deltas: Deltas,
}

impl Anchors {
    /// Samples Gaussians at `means`; nothing moves yet.
    fn new(means: &[[f32; 3]], config: &RecongsConfig, seed: u64) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let finest = means.len().div_ceil(config.gaussians_per_anchor);
        let sizes = std::iter::successors(Some(finest), |n| Some(n / config.level_ratio));
        let sizes = sizes.take_while(|n| *n > 0).take(config.levels);
        let levels: Vec<Vec<[f32; 3]>> = sizes.map(|count| sample(means, count, &mut rng)).collect();
        let nodes = levels.iter().map(Vec::len).sum();
        Self { levels, deltas: Deltas::identity(nodes) }
    }

    /// Samples anew. A new anchor takes the mean motion of the nearest old ones of its level.
    ///
    /// # Errors
    /// When a position is not finite.
    fn renewed(&self, means: &[[f32; 3]], config: &RecongsConfig, seed: u64) -> Result<Self> {
        let mut new = Self::new(means, config, seed);
        let (mut values, mut first) = (Vec::new(), 0);
        for (level, old) in new.levels.iter().zip(&self.levels) {
            for near in nearest(level, old, HEIRS_OF)? {
                let heirs: Vec<_> =
                    near.iter().map(|(_, i)| self.deltas.nodes()[first + *i as usize]).collect();
                values.extend(mean(&heirs));
            }
            first += old.len();
        }
        values.resize(new.deltas.values.len(), 0.0);
        new.deltas = Deltas::new(values);
        Ok(new)
    }
}

impl Nodes for Anchors {
    type Config = RecongsConfig;

    fn stages(config: &RecongsConfig) -> (&MotionFitConfig, &AddedConfig) {
        (&config.motion, &config.added)
    }

    fn next(last: Option<Self>, means: &[[f32; 3]], config: &RecongsConfig, step: &Step) -> Result<Self> {
        let seed = frame_seed(step);
        match last {
            None => Ok(Self::new(means, config, seed)),
            Some(old) if step.frame.is_multiple_of(config.renew_every) => old.renewed(means, config, seed),
            Some(old) => Ok(old),
        }
    }

    fn deformation(&mut self, means: &[[f32; 3]]) -> Result<(Deformation, &mut Deltas)> {
        let mut first = 0;
        let mut levels = Vec::new();
        for level in &self.levels {
            let near = nearest(means, level, 1)?;
            levels.push(near.iter().map(|near| first + near.first().map_or(0, |n| n.1)).collect());
            first += level.len() as u32;
        }
        Ok((Deformation::new(levels, self.deltas.nodes().len()), &mut self.deltas))
    }

    fn deltas(&self) -> &Deltas {
        &self.deltas
    }

    fn save(&self, out: Writer) -> Writer {
        let levels = self.levels.iter();
        let out = levels.fold(out.count(self.levels.len()), |out, level| out.column(level.as_flattened()));
        let [first, second] = self.deltas.adam.moments();
        let steps = self.deltas.adam.steps().first().map_or(0, |&steps| steps as usize);
        out.column(&self.deltas.values).column(first).column(second).count(steps)
    }

    fn restore(state: &mut Reader, _: &RecongsConfig) -> Result<Self> {
        let levels = (0..state.count()?).map(|_| state.column());
        let levels = levels.map(|level| level.map(|level| level.as_chunks::<3>().0.to_vec()));
        let levels: Vec<Vec<[f32; 3]>> = levels.collect::<Result<_>>()?;
        let nodes: usize = levels.iter().map(Vec::len).sum();
        let [values, first, second] = [state.column()?, state.column()?, state.column()?];
        for column in [&values, &first, &second] {
            ensure!(column.len() == nodes * DELTA, "{} values of {nodes} anchors", column.len());
        }
        let steps = u32::try_from(state.count()?).context("a count is too large")?;
        let adam = AdamVec::resumed([first, second], vec![steps; nodes], DELTA);
        Ok(Self { levels, deltas: Deltas { values, adam, applied: Vec::new() } })
    }
}

/// `count` of the positions, spread evenly: in each cube of a grid of about so many the one nearest to its centre; of too many a random
/// part, and random others where there are too few.
fn sample(means: &[[f32; 3]], count: usize, rng: &mut ChaCha8Rng) -> Vec<[f32; 3]> {
    let corner = |pick: fn(f32, f32) -> f32, from: f32| {
        [0, 1, 2].map(|a| means.iter().map(|mean| mean[a]).fold(from, pick))
    };
    let (least, most) = (corner(f32::min, f32::INFINITY), corner(f32::max, f32::NEG_INFINITY));
    let cubes = ((count as f64).cbrt().round() as usize).max(1);
    let cell = |mean: &[f32; 3]| {
        let share = |a: usize| (mean[a] - least[a]) / (most[a] - least[a] + 1e-6);
        [0, 1, 2].map(|a| ((share(a) * cubes as f32) as usize).min(cubes - 1))
    };
    let far = |mean: &[f32; 3], cell: [usize; 3]| {
        let centre = |a: usize| (cell[a] as f32 + 0.5) / cubes as f32 * (most[a] - least[a]) + least[a];
        (0..3).map(|a| (mean[a] - centre(a)).powi(2)).sum::<f32>()
    };
    let mut best: Vec<Option<(f32, usize)>> = vec![None; cubes * cubes * cubes];
    for (i, mean) in means.iter().enumerate() {
        let [x, y, z] = cell(mean);
        let (far, best) = (far(mean, [x, y, z]), &mut best[x + cubes * (y + cubes * z)]);
        if best.is_none_or(|(nearest, _)| far < nearest) {
            *best = Some((far, i));
        }
    }
    let mut chosen: Vec<usize> = best.into_iter().flatten().map(|(_, i)| i).collect();
    if chosen.len() > count {
        chosen.shuffle(rng);
        chosen.truncate(count);
    }
    let mut others: Vec<usize> = (0..means.len()).collect();
    let (extra, _) = others.partial_shuffle(rng, count - chosen.len());
    chosen.extend_from_slice(extra);
    chosen.into_iter().map(|i| means[i]).collect()
}

/// Mean translation, and the rotation nearest to all, in the sense of the first one's sign: the eigenvector of the largest eigenvalue of
/// the sum of `q q^T` (Markley et al. 2007).
fn mean(deltas: &[[f32; DELTA]]) -> [f32; DELTA] {
    let count = deltas.len().max(1) as f32;
    let [x, y, z] = [0, 1, 2].map(|a| deltas.iter().map(|delta| delta[a]).sum::<f32>() / count);
    let turns = deltas.iter().map(|[_, _, _, turn @ ..]| Vector4::from(columns(unit(*turn))));
    let turns: Vec<Vector4<f32>> = turns.collect();
    let Some(first) = turns.first() else { return crate::deformation::IDENTITY };
    let eigen = turns.iter().map(|turn| turn * turn.transpose()).sum::<Matrix4<f32>>().symmetric_eigen();
    let turn = eigen.eigenvectors.column(eigen.eigenvalues.imax());
    let turn = if turn.dot(first) < 0.0 { -turn } else { turn.into_owned() };
    [x, y, z, turn[0], turn[1], turn[2], turn[3]]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::world::waves;
    use ffgs_testkit::largest_difference;
    use glam::Quat;

    fn places() -> Vec<[f32; 3]> {
        let mut places = vec![[0.0; 3]; 200];
        waves(places.as_flattened_mut(), 0.9);
        places
    }

    #[test]
    fn samples_are_as_many_as_asked_for_and_spread_over_the_cubes() {
        let places = places();
        for count in [1, 8, 27, 60, 200] {
            let sampled = sample(&places, count, &mut ChaCha8Rng::seed_from_u64(1));
            assert_eq!(sampled.len(), count);
            assert!(sampled.iter().all(|place| places.contains(place)));
        }
        // Eight octants, in each the one nearest to its centre.
        let corners: Vec<[f32; 3]> = (0..16)
            .map(|i| [i & 1, i >> 1 & 1, i >> 2 & 1].map(|b| b as f32 + 0.1 * (i / 8) as f32))
            .collect();
        let sampled = sample(&corners, 8, &mut ChaCha8Rng::seed_from_u64(1));
        for octant in 0..8 {
            let inside = |p: &&[f32; 3]| (0..3).all(|a| (p[a] > 0.55) == (octant >> a & 1 == 1));
            assert_eq!(sampled.iter().filter(inside).count(), 1, "octant {octant}");
        }
    }

    #[test]
    fn a_motion_that_all_share_is_inherited_and_survives_a_saved_state() {
        let (places, config) =
            (places(), RecongsConfig { gaussians_per_anchor: 5, ..RecongsConfig::default() });
        let mut anchors = Anchors::new(&places, &config, 1);
        assert_eq!(anchors.levels.iter().map(Vec::len).collect::<Vec<_>>(), [40, 13, 4]);
        let shared = [0.1, -0.2, 0.3, 0.8, 0.0, 0.6, 0.0];
        anchors.deltas = Deltas::new(shared.repeat(57));
        let renewed = anchors.renewed(&places, &config, 2).unwrap();
        assert!(largest_difference(&renewed.deltas.values, &shared.repeat(57)) < 1e-6);
        assert_ne!(renewed.levels, anchors.levels, "other samples");
        let bytes = renewed.save(Writer::default()).finish();
        let restored = Anchors::restore(&mut Reader(&bytes), &config).unwrap();
        assert!(restored.levels == renewed.levels && restored.deltas.values == renewed.deltas.values);
    }

    /// q and -q are one rotation; the mean of a and its inverse is none.
    #[test]
    fn the_mean_rotation_does_not_depend_on_signs() {
        let of = |turn: Quat, sign: f32| {
            let [w, x, y, z] = columns(turn).map(|v| sign * v);
            [1.0, 2.0, 3.0, w, x, y, z]
        };
        let (ahead, back) = (Quat::from_rotation_y(0.4), Quat::from_rotation_y(-0.4));
        for sign in [1.0, -1.0] {
            let found = mean(&[of(ahead, 1.0), of(back, sign)]);
            assert!(largest_difference(&found, &[1.0, 2.0, 3.0, 1.0, 0.0, 0.0, 0.0]) < 1e-6, "{found:?}");
        }
    }
}
