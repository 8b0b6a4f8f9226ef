//! Bodies that move alike and lie apart: two cars, one behind the other, are one rigid group while they drive alike. As one they average over
//! more of the trackers' errors; the photographs tell where each of them is.

use crate::groups::{Groups, adjacency, boxes, next_component};
use glam::DVec3;

/// Least share of a group's Gaussians that makes a body of its own.
const BODY: f64 = 0.15;

impl Groups {
    /// Makes groups of their own, with the motion of the whole, of the parts of each group that lie farther apart than `apart` typical cell
    /// diagonals; small parts stay with the nearest large one. `places` (N, m) are those at t-1.
    pub fn separate(&mut self, places: &[DVec3], apart: f64) {
        let boxes = boxes(places, &self.cells);
        let adjacent = adjacency(&boxes, apart);
        let centres: Vec<DVec3> = boxes.iter().map(|b| (b.0 + b.1) * 0.5).collect();
        let sizes: Vec<usize> = self.cells.leaves.iter().map(ExactSizeIterator::len).collect();
        for group in 0..self.found.len() {
            let bodies = bodies(&self.of_cells(group), &adjacent, &centres, &sizes);
            for body in bodies.into_iter().skip(1) {
                let own = Some(self.found.len());
                self.found.push(self.found[group].clone());
                for leaf in body.into_iter().map(|cell| &self.cells.leaves[cell]) {
                    self.cells.members(leaf).iter().for_each(|&i| self.of[i] = own);
                }
            }
        }
    }

    /// The cells of a group, ascending.
    fn of_cells(&self, group: usize) -> Vec<usize> {
        let leaves = self.cells.leaves.iter().enumerate();
        let first = |leaf| self.cells.members(leaf).first().copied();
        leaves
            .filter(|(_, leaf)| first(leaf).is_some_and(|i| self.of[i] == Some(group)))
            .map(|l| l.0)
            .collect()
    }
}

/// The cells of each body among `cells`, the one with the first cell first; none where they are a single body. `sizes` are the Gaussians of each cell.
fn bodies(cells: &[usize], adjacent: &[Vec<usize>], centres: &[DVec3], sizes: &[usize]) -> Vec<Vec<usize>> {
    let mut open = vec![false; adjacent.len()];
    cells.iter().for_each(|&cell| open[cell] = true);
    let parts: Vec<Vec<usize>> = std::iter::from_fn(|| next_component(adjacent, &mut open)).collect();
    let size = |part: &[usize]| part.iter().map(|&cell| sizes[cell]).sum::<usize>() as f64;
    let least = BODY * size(cells);
    let (mut large, small): (Vec<_>, Vec<_>) = parts.into_iter().partition(|part| size(part) >= least);
    if large.len() < 2 {
        return Vec::new();
    }
    let founders = large.clone();
    for cell in small.into_iter().flatten() {
        let distance = |body: &[usize]| {
            let to = |&other: &usize| centres[other].distance_squared(centres[cell]);
            body.iter().map(to).fold(f64::INFINITY, f64::min)
        };
        let nearest =
            (0..founders.len()).min_by(|&a, &b| distance(&founders[a]).total_cmp(&distance(&founders[b])));
        large[nearest.unwrap_or(0)].push(cell);
    }
    large
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cells::Cells;
    use crate::groups::Group;
    use crate::rigid::RigidMotion;
    use glam::DQuat;
    use nalgebra::Matrix6;

    /// A box of 1.8 x 4.4 x 1 m, evenly filled.
    fn car(y: f64, count: usize) -> Vec<DVec3> {
        let at = |i: usize, step: f64| (i as f64 * step).fract() - 0.5;
        (0..count)
            .map(|i| DVec3::new(1.8 * at(i, 0.618_034), 4.4 * at(i, 0.754_878) + y, at(i, 0.569_84)))
            .collect()
    }

    fn one_group(places: &[DVec3]) -> Groups {
        let motion = RigidMotion { centre: DVec3::ZERO, rotation: DQuat::IDENTITY, step: DVec3::Y };
        let covariance = Matrix6::identity();
        let group = Group {
            motion,
            covariance,
            scales: Vec::new(),
            spread: 0.0,
            shared: 0.0,
            cells: 1,
            flexibility: 0.0,
            lost: false,
        };
        Groups { found: vec![group], of: vec![Some(0); places.len()], cells: Cells::new(places, 64) }
    }

    fn separated(places: &[DVec3], apart: f64) -> Groups {
        let mut groups = one_group(places);
        groups.separate(places, apart);
        groups
    }

    #[test]
    fn cars_that_follow_each_other_are_two_bodies() {
        let places = [car(0.0, 1500), car(5.1, 1500)].concat();
        let groups = separated(&places, 0.5);
        assert_eq!(groups.found.len(), 2);
        assert_eq!(groups.found[1].motion, groups.found[0].motion);
        let of = |range: &[Option<usize>]| range.iter().all(|group| *group == range[0]);
        assert!(of(&groups.of[..1500]) && of(&groups.of[1500..]) && groups.of[0] != groups.of[1500]);
        assert_eq!(separated(&places, 1.5).found.len(), 1, "the gap is shorter than that");
    }

    #[test]
    fn one_body_stays_one_and_what_is_small_stays_with_the_nearest() {
        assert_eq!(separated(&car(0.0, 1500), 0.5).found.len(), 1);
        let wing: Vec<DVec3> = car(0.0, 64).iter().map(|p| *p * 0.1 + DVec3::new(0.0, 3.5, 0.0)).collect();
        let places = [car(0.0, 1500), wing, car(8.0, 1500)].concat();
        let groups = separated(&places, 0.5);
        assert_eq!(groups.found.len(), 2);
        assert!(
            groups.of[1500..1564].iter().all(|group| *group == groups.of[0]),
            "1 m from one, 2 m from the other"
        );
        assert_eq!(separated(&places[..1564], 0.5).found.len(), 1, "a wing is no body");
    }
}
