//! Hard concrete gates (Louizos et al. 2018), one per Gaussian: how much of its displacement counts.

use crate::saved::{Reader, Writer};
use anyhow::{Result, ensure};
use ffgs_core::sigmoid;
use ffgs_trainer::{AdamVec, Update};

/// Temperature, and the interval to which the sigmoid is stretched before it is cut to 0..1.
const TEMPERATURE: f32 = 0.3;
const STRETCHED: [f32; 2] = [-0.5, 1.01];
/// Probabilities stay this far from 0 and 1.
const MARGIN: f32 = 1e-6;
/// Log odds stay within these of 0: the logarithm of a thousand.
const LIMIT: f32 = 6.907_755;
/// Of Adam.
const EPSILON: f32 = 1e-15;

/// A gate at log odds `a`, and its derivative; the derivative is 0 where the gate is shut or fully open.
pub(super) fn gate(a: f32) -> (f32, f32) {
    let [low, high] = STRETCHED;
    let share = sigmoid(a / TEMPERATURE);
    let stretched = low + share * (high - low);
    if stretched > 0.0 && stretched < 1.0 {
        (stretched, (high - low) * share * (1.0 - share) / TEMPERATURE)
    } else {
        (stretched.clamp(0.0, 1.0), 0.0)
    }
}

/// Log odds at which the concrete distribution has half of its mass at 0 and below.
fn even_odds() -> f32 {
    let [low, high] = STRETCHED;
    TEMPERATURE * (-low / high).ln()
}

/// Probability that a gate at log odds `a` is not shut, and its derivative.
pub(super) fn probability(a: f32) -> (f32, f32) {
    let open = sigmoid(a - even_odds());
    let slope = if open > MARGIN && open < 1.0 - MARGIN { open * (1.0 - open) } else { 0.0 };
    (open.clamp(MARGIN, 1.0 - MARGIN), slope)
}

/// The gates of all Gaussians.
#[derive(Clone)]
pub(super) struct Gates {
    pub log_odds: Vec<f32>,
    /// Goes on over the frames, as in the official code.
    adam: AdamVec,
}

impl Gates {
    pub(super) fn new(count: usize) -> Self {
        Self { log_odds: vec![0.0; count], adam: AdamVec::new(count, 1) }
    }

    /// At the start of a frame: a Gaussian whose `change` is c is open with probability `c / (c + median)`.
    pub(super) fn start(&mut self, changes: &[f32]) {
        let mut sorted = changes.to_vec();
        sorted.sort_by(f32::total_cmp);
        let median = sorted.get(sorted.len().saturating_sub(1) / 2).copied().unwrap_or_default();
        self.log_odds.clear();
        self.log_odds.extend(changes.iter().map(|change| {
            // 0 / 0 is no change.
            let open = if *change > 0.0 { change / (change + median) } else { 0.0 };
            let open = open.clamp(MARGIN, 1.0 - MARGIN);
            ((open / (1.0 - open)).ln() + even_odds()).clamp(-LIMIT, LIMIT)
        }));
    }

    /// Adds the derivative of `weight * mean probability` to `gradient` and returns its value.
    pub(super) fn regularise(&self, weight: f32, gradient: &mut [f32]) -> f64 {
        let share = weight / self.log_odds.len().max(1) as f32;
        let mut sum = 0.0;
        for (a, gradient) in self.log_odds.iter().zip(gradient) {
            let (open, slope) = probability(*a);
            sum += f64::from(open);
            *gradient += share * slope;
        }
        f64::from(share) * sum
    }

    pub(super) fn step(&mut self, gradient: &[f32], rate: f32) {
        self.adam.step(&mut self.log_odds, gradient, (rate, EPSILON), Update::Dense);
        self.log_odds.iter_mut().for_each(|a| *a = a.clamp(-LIMIT, LIMIT));
    }

    /// Gates of Gaussians that come from these: the first `kept` go on, the others are new.
    pub(super) fn carry(&self, sources: &[usize], kept: usize) -> Self {
        let log_odds = sources.iter().map(|&i| self.log_odds[i]).collect();
        Self { log_odds, adam: carried(&self.adam, 1, sources, kept) }
    }

    pub(super) fn save(&self, out: Writer) -> Writer {
        let steps: Vec<f32> = self.adam.steps().iter().map(|&steps| steps as f32).collect();
        let [first, second] = self.adam.moments();
        out.column(first).column(second).column(&steps)
    }

    pub(super) fn restore(state: &mut Reader) -> Result<Self> {
        let (first, second, steps) = (state.column()?, state.column()?, state.column()?);
        let count = steps.len();
        ensure!(first.len() == count && second.len() == count, "moments of {count} gates");
        let steps = steps.iter().map(|&steps| steps as u32).collect();
        Ok(Self { log_odds: vec![0.0; count], adam: AdamVec::resumed([first, second], steps, 1) })
    }
}

/// Adam for items that come from others: the first `kept` go on, the others start anew.
pub(super) fn carried(adam: &AdamVec, width: usize, sources: &[usize], kept: usize) -> AdamVec {
    let moments = adam.moments().map(|all| {
        let row = |(to, &from): (usize, &usize)| {
            let value = move |k: usize| if to < kept { all[from * width + k] } else { 0.0 };
            (0..width).map(value).collect::<Vec<f32>>()
        };
        sources.iter().enumerate().flat_map(row).collect()
    });
    let steps = sources.iter().enumerate().map(|(to, &from)| if to < kept { adam.steps()[from] } else { 0 });
    AdamVec::resumed(moments, steps.collect(), width)
}

#[cfg(test)]
mod tests {
    use super::*;

    const STEP: f32 = 1e-3;

    #[test]
    fn derivatives_are_those_of_finite_differences() {
        let slope = |f: &dyn Fn(f32) -> f32, a: f32| (f(a + STEP) - f(a - STEP)) / (2.0 * STEP);
        for a in [-1.0, -0.19, -0.1, 0.0, 0.3, 0.9, 2.0] {
            for (name, f) in [("gate", gate as fn(f32) -> (f32, f32)), ("probability", probability)] {
                let numeric = slope(&|a| f(a).0, a);
                assert!((f(a).1 - numeric).abs() < 2e-3 * (1.0 + numeric.abs()), "{name} at {a}: {numeric}");
            }
        }
        let mut gates = Gates::new(3);
        gates.log_odds = vec![-0.4, 0.2, 1.3];
        let mut gradient = vec![0.0; 3];
        gates.regularise(0.01, &mut gradient);
        for k in 0..3 {
            let at = |step: f32| {
                let mut moved = gates.clone();
                moved.log_odds[k] += step;
                moved.regularise(0.01, &mut [0.0; 3])
            };
            let numeric = (at(STEP) - at(-STEP)) / f64::from(2.0 * STEP);
            assert!((f64::from(gradient[k]) - numeric).abs() < 1e-6, "{k}: {} {numeric}", gradient[k]);
        }
    }

    #[test]
    fn gates_of_more_than_the_median_change_start_open_and_those_of_less_shut() {
        let mut gates = Gates::new(5);
        gates.start(&[0.0, 1.0, 2.0, 4.0, 200.0]);
        let found: Vec<f32> = gates.log_odds.iter().map(|a| gate(*a).0).collect();
        assert_eq!(found[..2], [0.0, 0.0]);
        assert!(found[2] < 1e-5, "the median itself is where a gate begins to open: {found:?}");
        assert!(found[3] > 0.3 && found[4] > 0.99, "{found:?}");
        assert_eq!(gates.log_odds[0], -LIMIT);
        gates.start(&[0.0; 5]);
        assert!(gates.log_odds.iter().all(|a| gate(*a).0 == 0.0), "nothing changed");
    }

    #[test]
    fn new_gates_start_their_moments_anew() {
        let mut gates = Gates::new(3);
        gates.step(&[1.0, -1.0, 0.5], 0.1);
        let carried = gates.carry(&[2, 0, 1, 1], 2);
        assert_eq!(carried.log_odds, [-0.1, -0.1, 0.1, 0.1]);
        assert_eq!(carried.adam.steps(), [1, 1, 0, 0]);
        let [first, second] = carried.adam.moments();
        assert!(first[0] > 0.0 && second[1] > 0.0 && first[2..] == [0.0; 2] && second[2..] == [0.0; 2]);
    }
}
