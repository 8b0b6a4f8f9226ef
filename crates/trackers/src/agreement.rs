//! Tracks that their neighbours agree with (docs/adr/0091-tracks-need-neighbours-that-agree.md).
//!
//! What is photographed moves smoothly, so a right track has others around it that move alike; a wrong match of a repeated pattern
//! leads somewhere else than those around it. Like the counts of Bian et al., "GMS: Grid-based motion statistics for fast,
//! ultra-robust feature correspondence" (CVPR 2017), but by nearest neighbours instead of a grid, and apart for what the mask holds and the rest:
//! a small car does not move with the road around it.

use ffgs_core::{Mask, TrackSet};
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use rayon::prelude::*;
use std::num::NonZero;

/// Nearest tracks that are asked.
const NEIGHBOURS: NonZero<usize> = NonZero::new(12).unwrap();
/// Of so many neighbours one has to agree.
const NEIGHBOURS_PER_VOTE: usize = 4;
/// Displacements of neighbours agree within this part of the picture's width (and a pixel and a half at least), ...
const SLACK: f32 = 0.003;
const LEAST_SLACK_PX: f32 = 1.5;
/// ... and, as things turn and come nearer, within this part of the distance between the two.
const STRETCH: f32 = 0.3;

/// The tracks with which enough of their neighbours agree. Tracks that begin inside `interest` are compared with each other,
/// those outside likewise. Fewer than five of a kind are all kept: there is nothing to judge them by.
pub(crate) fn agreed(tracks: &TrackSet, interest: Option<&Mask>, width: usize) -> TrackSet {
    let slack = (SLACK * width as f32).max(LEAST_SLACK_PX);
    let inside = |p: &[f32; 2]| interest.is_some_and(|m| m.contains(p[0] as usize, p[1] as usize));
    let (held, rest): (Vec<usize>, Vec<usize>) = (0..tracks.src.len()).partition(|&i| inside(&tracks.src[i]));
    let mut kept: Vec<usize> = [held, rest].iter().flat_map(|group| judged(tracks, group, slack)).collect();
    kept.sort_unstable();
    TrackSet {
        src: kept.iter().map(|&i| tracks.src[i]).collect(),
        tgt: kept.iter().map(|&i| tracks.tgt[i]).collect(),
        visibility: kept.iter().map(|&i| tracks.visibility[i]).collect(),
    }
}

/// Those of a group of tracks with which enough of the others agree.
fn judged(tracks: &TrackSet, group: &[usize], slack: f32) -> Vec<usize> {
    let starts: Vec<[f32; 2]> = group.iter().map(|&i| tracks.src[i]).collect();
    let moved = |i: usize| [tracks.tgt[i][0] - tracks.src[i][0], tracks.tgt[i][1] - tracks.src[i][1]];
    let Ok(tree) = ImmutableKdTree::<f32, 2>::new_from_slice(&starts) else {
        return group.to_vec();
    };
    let agrees = |at: usize| {
        let wanted = NEIGHBOURS.saturating_add(1);
        let nearest = tree.query(&starts[at]).nearest_n::<SquaredEuclidean<f32>>(wanted).execute();
        let others = nearest.iter().filter(|n| n.item as usize != at).take(NEIGHBOURS.get());
        let own = moved(group[at]);
        let (mut asked, mut agreeing) = (0, 0);
        for other in others {
            let theirs = moved(group[other.item as usize]);
            let apart = (own[0] - theirs[0]).hypot(own[1] - theirs[1]);
            asked += 1;
            agreeing += usize::from(apart <= slack + STRETCH * other.distance.sqrt());
        }
        agreeing >= asked / NEIGHBOURS_PER_VOTE
    };
    (0..group.len()).into_par_iter().filter(|&at| agrees(at)).map(|at| group[at]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use ffgs_core::ImageSize;

    const SIZE: ImageSize = ImageSize { width: 320, height: 180 };

    fn tracks(of: impl IntoIterator<Item = ([f32; 2], [f32; 2])>) -> TrackSet {
        let (src, tgt): (Vec<_>, Vec<_>) =
            of.into_iter().map(|(at, by)| (at, [at[0] + by[0], at[1] + by[1]])).unzip();
        TrackSet { visibility: vec![1.0; src.len()], src, tgt }
    }

    /// A floor that turns by 0.1 and grows by 5 % around (160, 90).
    fn floor(i: usize) -> ([f32; 2], [f32; 2]) {
        let at = [(i % 20) as f32 * 15.0 + 5.0, (i / 20) as f32 * 15.0 + 5.0];
        let (x, y) = (at[0] - 160.0, at[1] - 90.0);
        (at, [0.05 * x - 0.1 * y, 0.1 * x + 0.05 * y])
    }

    #[test]
    fn matches_one_square_of_a_pattern_aside_go_and_a_floor_that_turns_stays() {
        let aside = |i: usize| {
            let (at, by) = floor(i);
            (
                at,
                if i % 7 == 3 { [by[0] + if i.is_multiple_of(2) { 30.0 } else { -30.0 }, by[1]] } else { by },
            )
        };
        let left = agreed(&tracks((0..220).map(aside)), None, SIZE.width);
        assert_eq!(left.src, (0..220).filter(|i| i % 7 != 3).map(|i| floor(i).0).collect::<Vec<_>>());
    }

    #[test]
    fn few_tracks_on_something_small_and_fast_stay_where_a_mask_holds_them() {
        let car = [([150.0, 80.0], [40.0, 3.0]), ([158.0, 84.0], [41.0, 3.0])];
        let all = || tracks((0..220).map(floor).chain(car));
        let mut held = vec![0; SIZE.pixels()];
        for y in 75..90 {
            held[y * SIZE.width + 145..y * SIZE.width + 165].fill(1);
        }
        let mask = Mask::new(SIZE, held).unwrap();
        let on_car = |set: &TrackSet| set.src.iter().filter(|p| car.iter().any(|c| c.0 == **p)).count();
        assert_eq!(on_car(&agreed(&all(), Some(&mask), SIZE.width)), 2);
        assert_eq!(on_car(&agreed(&all(), None, SIZE.width)), 0);
    }

    #[test]
    fn few_tracks_and_none_are_not_judged() {
        for n in 0..5 {
            let wild = tracks((0..n).map(|i| ([i as f32 * 9.0, 5.0], [(i * i) as f32 * 40.0, 0.0])));
            assert_eq!(agreed(&wild, None, SIZE.width).src.len(), n);
        }
    }
}
