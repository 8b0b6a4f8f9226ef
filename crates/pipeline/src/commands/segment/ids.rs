//! Ids of Gaussians over a seam.

use ffgs_core::Dynamic;
use std::collections::HashMap;

/// New ids of a part's Gaussians.
pub(super) struct Ids {
    /// From the part's id to the id in the joined run.
    known: HashMap<u32, u32>,
    /// The first id that no Gaussian of the joined run has had.
    next: u32,
}

/// How many of the Gaussians of a key frame are which.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Counts {
    /// Of the first frame: they keep their id.
    pub(super) kept: usize,
    /// Younger ones that stand where one of the part before stands, and take its id.
    pub(super) matched: usize,
    /// The others.
    pub(super) new: usize,
}

impl Ids {
    /// At a seam: `before` is the frame as the part before ends with it, with the ids of the joined run, `after` as the next
    /// part begins with it. Ids below `first` are of the first frame and mean the same in both.
    pub(super) fn at_seam(before: &Dynamic, after: &Dynamic, first: u32) -> (Self, Counts) {
        let mut ids = Self { known: HashMap::new(), next: before.next_id.max(after.next_id) };
        let mut counts = Counts::default();
        let reach = mean_width(after);
        let mut places = Places::new(before, first, reach);
        for (i, &id) in after.ids.iter().enumerate() {
            let new = if id < first {
                counts.kept += 1;
                id
            } else if let Some(taken) = places.take_nearest(after.gaussians.means[i]) {
                counts.matched += 1;
                taken
            } else {
                counts.new += 1;
                ids.fresh()
            };
            ids.known.insert(id, new);
        }
        (ids, counts)
    }

    fn fresh(&mut self) -> u32 {
        self.next += 1;
        self.next - 1
    }

    /// Gives a frame of the part the ids of the joined run.
    pub(super) fn apply(&mut self, dynamic: &mut Dynamic, first: u32) {
        for id in &mut dynamic.ids {
            *id = match self.known.get(id) {
                Some(&new) => new,
                None if *id < first => *id,
                None => {
                    let new = self.fresh();
                    self.known.insert(*id, new);
                    new
                }
            };
        }
        dynamic.next_id = self.next;
    }
}

/// Mean of the largest standard deviations (m).
fn mean_width(dynamic: &Dynamic) -> f32 {
    let scales = &dynamic.gaussians.log_scales;
    let widest = |s: &[f32; 3]| s.iter().copied().fold(f32::MIN, f32::max).exp();
    scales.iter().map(widest).sum::<f32>() / scales.len().max(1) as f32
}

/// Younger Gaussians by the cell that they are in; each is taken once.
struct Places<'a> {
    cells: HashMap<[i32; 3], Vec<usize>>,
    before: &'a Dynamic,
    reach: f32,
}

impl<'a> Places<'a> {
    fn new(before: &'a Dynamic, first: u32, reach: f32) -> Self {
        let mut cells: HashMap<[i32; 3], Vec<usize>> = HashMap::new();
        for (i, mean) in before.gaussians.means.iter().enumerate().filter(|(i, _)| before.ids[*i] >= first) {
            cells.entry(cell(*mean, reach)).or_default().push(i);
        }
        Self { cells, before, reach }
    }

    /// The id of the nearest one within reach, which is then gone.
    fn take_nearest(&mut self, mean: [f32; 3]) -> Option<u32> {
        let [x, y, z] = cell(mean, self.reach);
        let around = (-1..=1).flat_map(|i| (-1..=1).flat_map(move |j| (-1..=1).map(move |k| [i, j, k])));
        let mut best: Option<(f32, [i32; 3], usize)> = None;
        for [i, j, k] in around {
            let at = [x.saturating_add(i), y.saturating_add(j), z.saturating_add(k)];
            for &place in self.cells.get(&at).into_iter().flatten() {
                let other = self.before.gaussians.means[place];
                let square = (0..3).map(|c| (other[c] - mean[c]).powi(2)).sum::<f32>();
                if square <= self.reach * self.reach && best.is_none_or(|(least, _, _)| square < least) {
                    best = Some((square, at, place));
                }
            }
        }
        let (_, at, place) = best?;
        self.cells.get_mut(&at)?.retain(|&p| p != place);
        Some(self.before.ids[place])
    }
}

fn cell(mean: [f32; 3], side: f32) -> [i32; 3] {
    mean.map(|v| (v / side.max(f32::MIN_POSITIVE)).floor() as i32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use ffgs_core::Gaussians;

    fn layer(places: &[(u32, f32)], next_id: u32) -> Dynamic {
        let mut gaussians = Gaussians::zeros(places.len(), 0);
        for (mean, (_, x)) in gaussians.means.iter_mut().zip(places) {
            mean[0] = *x;
        }
        Dynamic { gaussians, ids: places.iter().map(|p| p.0).collect(), next_id, ..Dynamic::default() }
    }

    #[test]
    fn the_first_frames_keep_their_ids_and_neighbours_hand_theirs_on() {
        // Ids 0 and 1 are of the first frame; 5 and 6 were born before the seam in one part, 2 to 4 in the other.
        let before = layer(&[(0, 0.0), (5, 3.0), (6, 9.0)], 7);
        let mut after = layer(&[(0, 0.1), (1, 1.0), (2, 3.2), (3, 3.4), (4, -50.0)], 5);
        let (mut ids, counts) = Ids::at_seam(&before, &after, 2);
        assert_eq!(counts, Counts { kept: 2, matched: 1, new: 2 });
        ids.apply(&mut after, 2);
        assert_eq!((after.ids.as_slice(), after.next_id), (&[0, 1, 5, 7, 8][..], 9));
        let mut later = layer(&[(4, 0.0), (9, 0.0)], 10);
        ids.apply(&mut later, 2);
        assert_eq!((later.ids.as_slice(), later.next_id), (&[8, 9][..], 10));
        ids.apply(&mut later, 2);
        assert_eq!(later.ids.len(), 2);
    }
}
