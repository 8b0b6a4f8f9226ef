//! Pictures that another camera of the rig took: videos, or cameras of a calibration, whose names are exchanged.

use super::{Agreement, Alike, LEAST, TIMES};
use crate::PrepareError;
use ffgs_core::{Camera, upper_median};

/// A camera is doubtful when its share of same places is below this value, ...
const SURE: f64 = 0.25;
/// ... or below this part of the usual share.
const PART: f64 = 0.7;
/// Most doubtful cameras, those with the smallest shares, whose pictures are exchanged in trials.
const MOST: usize = 12;
/// In a rig of so many cameras or fewer, all orders of the pictures are tried.
const ALL_ORDERS: usize = 5;

/// Refuses pictures that agree with other cameras than their own.
///
/// # Errors
/// When pictures are exchanged.
pub(super) fn refuse(
    alike: &mut Alike,
    cameras: &[Camera],
    names: &[String],
    agreement: &[Agreement],
) -> Result<(), PrepareError> {
    let given: Vec<usize> = (0..cameras.len()).collect();
    let doubtful = doubtful(agreement);
    let mut orders = Orders { alike, cameras, doubtful: &doubtful };
    let best = orders.best(&given);
    let moved: Vec<usize> = given.iter().copied().filter(|&camera| best[camera] != camera).collect();
    let [now, then] = [&given, &best].map(|order| orders.places(order, &moved));
    if moved.is_empty() || then < LEAST * moved.len() || then < TIMES * now {
        return Ok(());
    }
    let fits = |&camera: &usize| format!("those of '{}' fit '{}'", names[best[camera]], names[camera]);
    let all: Vec<String> = moved.iter().map(fits).collect();
    Err(PrepareError::Footage(format!(
        "pictures are not of the cameras that they are named after: {}. They agree with those of their neighbours at {now} places as they are \
         named, and at {then} in that order; rename the pictures, or the cameras in the calibration",
        all.join(", ")
    )))
}

/// Cameras that may have another's picture.
fn doubtful(agreement: &[Agreement]) -> Vec<usize> {
    if agreement.len() <= ALL_ORDERS {
        return (0..agreement.len()).collect();
    }
    let share = |camera: &usize| agreement[*camera].share();
    let usual = upper_median(agreement.iter().map(Agreement::share)).unwrap_or(0.0);
    let mut all: Vec<usize> = (0..agreement.len()).filter(|c| share(c) < SURE.max(PART * usual)).collect();
    all.sort_by(|a, b| share(a).total_cmp(&share(b)));
    all.truncate(MOST);
    all
}

/// Orders of the pictures, each given by the index of the picture of every camera, in which those of the `doubtful` cameras are exchanged.
struct Orders<'a, 'f> {
    alike: &'a mut Alike<'f>,
    cameras: &'a [Camera],
    doubtful: &'a [usize],
}

impl Orders<'_, '_> {
    /// The order in which the doubtful cameras agree with their neighbours at most places; the given one unless another has more.
    fn best(&mut self, given: &[usize]) -> Vec<usize> {
        if self.doubtful.len() <= ALL_ORDERS {
            return self.better(given, permutations(given, self.doubtful)).unwrap_or(given.to_vec());
        }
        let mut best = given.to_vec();
        while let Some(better) = self.better(&best, exchanges(&best, self.doubtful)) {
            best = better;
        }
        best
    }

    /// The best of the `orders`, if it is better than `now`.
    fn better(&mut self, now: &[usize], orders: Vec<Vec<usize>>) -> Option<Vec<usize>> {
        let (mut most, mut best) = (self.places(now, self.doubtful), None);
        for order in orders.into_iter().filter(|order| self.fits(order)).collect::<Vec<_>>() {
            let places = self.places(&order, self.doubtful);
            if places > most {
                (most, best) = (places, Some(order));
            }
        }
        best
    }

    /// Whether every camera has a picture of its size.
    fn fits(&self, order: &[usize]) -> bool {
        order.iter().zip(self.cameras).all(|(&picture, camera)| self.cameras[picture].size() == camera.size())
    }

    /// At how many places the pictures of some cameras agree with those of their neighbours.
    fn places(&mut self, order: &[usize], of: &[usize]) -> usize {
        let agreement = self.alike.agreement(self.cameras, order);
        of.iter().map(|&camera| agreement[camera].places()).sum()
    }
}

/// The order with the pictures of two of these cameras exchanged.
fn exchanges(order: &[usize], of: &[usize]) -> Vec<Vec<usize>> {
    let pairs = of.iter().enumerate().flat_map(|(i, &a)| of[i + 1..].iter().map(move |&b| (a, b)));
    pairs.map(|(a, b)| swapped(order, a, b)).collect()
}

/// The order with the pictures of these cameras in all ways.
fn permutations(order: &[usize], of: &[usize]) -> Vec<Vec<usize>> {
    let Some((&first, rest)) = of.split_first() else { return vec![order.to_vec()] };
    of.iter().flat_map(|&other| permutations(&swapped(order, first, other), rest)).collect()
}

fn swapped(order: &[usize], a: usize, b: usize) -> Vec<usize> {
    let mut order = order.to_vec();
    order.swap(a, b);
    order
}
