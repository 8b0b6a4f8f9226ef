//! View-dependent colours: SH coefficients above degree 0, and which of them are worth their bytes.

use crate::numbers::{ContextNumber, Flag, class};
use crate::range_coder::Coder;
use crate::row::MAX_HARMONICS;
use serde::{Deserialize, Serialize};
use std::f64::consts::FRAC_1_SQRT_2;

/// What the three numbers of a coefficient stand for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum HarmonicChannels {
    /// Red, green, blue: streams before version 3.
    #[default]
    Rgb,
    /// Brightness, red minus blue, and both minus green, of unit length and at right angles. The highlights of a scene are nearly
    /// white, so that the latter two are nearly always 0.
    Opponent,
}

const FRAC_1_SQRT_3: f64 = 0.577_350_269_189_625_8;
const FRAC_1_SQRT_6: f64 = 0.408_248_290_463_863;

impl HarmonicChannels {
    pub(crate) fn of_rgb(self, [r, g, b]: [f64; 3]) -> [f64; 3] {
        match self {
            Self::Rgb => [r, g, b],
            Self::Opponent => {
                [(r + g + b) * FRAC_1_SQRT_3, (r - b) * FRAC_1_SQRT_2, (r - 2.0 * g + b) * FRAC_1_SQRT_6]
            }
        }
    }

    pub(crate) fn to_rgb(self, [x, y, z]: [f64; 3]) -> [f64; 3] {
        match self {
            Self::Rgb => [x, y, z],
            Self::Opponent => {
                let (white, across, green) = (x * FRAC_1_SQRT_3, y * FRAC_1_SQRT_2, z * FRAC_1_SQRT_6);
                [white + across + green, white - 2.0 * green, white - across + green]
            }
        }
    }

    /// Which model codes value `k` of a row.
    fn model(self, k: usize) -> usize {
        let degree = usize::from(k >= 9) + usize::from(k >= 24);
        match self {
            Self::Rgb => degree,
            Self::Opponent => 3 * degree + k % 3,
        }
    }

    /// In which context: of the class of the last value of the model, and the same value of the row before.
    fn context(self, last: usize, before: i16) -> usize {
        match self {
            Self::Rgb => last,
            Self::Opponent => 3 * class(before.into()) + last,
        }
    }
}

/// Models of a row's values, nearly all of which are 0: whether any is not, then each, knowing the last value of the same
/// model and, from version 3 on, the same value of the row before.
#[derive(Clone, Debug)]
pub(crate) struct HarmonicModels {
    any: Flag,
    values: [ContextNumber<9>; MODELS],
    last: [usize; MODELS],
    before: [i16; MAX_HARMONICS],
}

const MODELS: usize = 9;

impl Default for HarmonicModels {
    fn default() -> Self {
        Self {
            any: Flag::default(),
            values: Default::default(),
            last: [0; MODELS],
            before: [0; MAX_HARMONICS],
        }
    }
}

impl HarmonicModels {
    /// Codes the first `count` values.
    pub(crate) fn code(
        &mut self,
        coder: &mut impl Coder,
        (channels, count): (HarmonicChannels, usize),
        values: &[i16; MAX_HARMONICS],
    ) -> [i16; MAX_HARMONICS] {
        let mut out = [0; MAX_HARMONICS];
        if count > 0 && self.any.code(coder, values.iter().any(|&v| v != 0)) {
            for k in 0..count {
                let model = channels.model(k);
                let context = channels.context(self.last[model], self.before[k]);
                out[k] = self.values[model].code(coder, context, values[k].into()) as i16;
                self.last[model] = class(out[k].into());
            }
        }
        self.before = out;
        out
    }
}

/// What a bit must gain (squared steps) in a Gaussian of mean importance, or where importances are not known.
pub(crate) const PRICE: f64 = 0.07;
/// Bits of a 0 in a row that has other values, of a 1 or -1, and of each further doubling, about.
const BITS: [f64; 3] = [0.4, 4.0, 2.0];
/// Values are kept within these limits; two of them added stay within 16 bits.
const MOST: f64 = 8191.0;

fn bits(value: f64) -> f64 {
    let [zero, one, doubling] = BITS;
    if value == 0.0 { zero } else { one + doubling * value.abs().log2() }
}

/// The integers for the first `count` of `values` (in steps) that are best when a bit must take away `price` (squared steps) of error: each value is
/// rounded, or less, or 0; and all are 0 where that is better.
pub(crate) fn choose(values: &[f64; MAX_HARMONICS], count: usize, price: f64) -> [i16; MAX_HARMONICS] {
    let mut out = [0; MAX_HARMONICS];
    let mut gain = 0.0;
    for (out, &value) in out.iter_mut().zip(values).take(count) {
        let nearest = (value.abs() + 0.5).floor().min(MOST);
        let cost = |q: f64| (value.abs() - q).powi(2) + price * bits(q);
        let mut best = (cost(0.0), 0.0);
        for q in [nearest - 1.0, nearest] {
            if q > 0.0 && cost(q) < best.0 {
                best = (cost(q), q);
            }
        }
        gain += value * value - best.0;
        *out = best.1.copysign(value) as i16;
    }
    if gain > 0.0 { out } else { [0; MAX_HARMONICS] }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn values() -> [f64; MAX_HARMONICS] {
        let mut out = [0.0; MAX_HARMONICS];
        out.iter_mut().zip(1..).for_each(|(v, k)| *v = 4.0 * f64::from(k * k).sin().powi(3));
        out
    }

    /// Errors, and bits as far as they are counted.
    fn cost(values: &[f64; MAX_HARMONICS], chosen: &[i16; MAX_HARMONICS], price: f64) -> f64 {
        let one = |(v, &q): (&f64, &i16)| (v - f64::from(q)).powi(2) + price * bits(f64::from(q));
        let empty = chosen.iter().all(|&q| q == 0);
        if empty { values.iter().map(|v| v * v).sum() } else { values.iter().zip(chosen).map(one).sum() }
    }

    #[test]
    fn opponents_come_back_as_rgb_and_keep_lengths() {
        for rgb in [[0.3, -0.2, 0.9], [1.0, 1.0, 1.0], [-0.4, 0.7, 0.1]] {
            let opponent = HarmonicChannels::Opponent.of_rgb(rgb);
            let back = HarmonicChannels::Opponent.to_rgb(opponent);
            assert!(rgb.iter().zip(back).all(|(a, b)| (a - b).abs() < 1e-15), "{rgb:?} {back:?}");
            let length = |v: [f64; 3]| v.iter().map(|x| x * x).sum::<f64>();
            assert!((length(rgb) - length(opponent)).abs() < 1e-14);
        }
        let grey = HarmonicChannels::Opponent.of_rgb([0.5; 3]);
        assert!(grey[1].abs() < 1e-15 && grey[2].abs() < 1e-15);
    }

    #[test]
    fn nothing_is_cheaper_than_what_is_chosen() {
        let values = values();
        for price in [0.01, 0.1, 0.5, 2.0] {
            let chosen = choose(&values, MAX_HARMONICS, price);
            let best = cost(&values, &chosen, price);
            assert!(best <= cost(&values, &[0; MAX_HARMONICS], price));
            for k in 0..MAX_HARMONICS {
                for step in [-1, 1] {
                    let mut other = chosen;
                    other[k] += step;
                    assert!(best <= cost(&values, &other, price) + 1e-12, "{price}: value {k} by {step}");
                }
            }
        }
    }

    #[test]
    fn free_bits_round_and_dear_ones_leave_all_out() {
        let values = values();
        let rounded = values.map(|v| v.round() as i16);
        assert_eq!(choose(&values, MAX_HARMONICS, 0.0), rounded);
        assert_eq!(choose(&values, MAX_HARMONICS, 100.0), [0; MAX_HARMONICS]);
        // 1.1 steps are worth 4 bits, but not those of 44 zeros beside them.
        let mut one = [0.0; MAX_HARMONICS];
        one[0] = 1.1;
        assert_eq!([9, MAX_HARMONICS].map(|count| choose(&one, count, 0.12)[0]), [1, 0]);
        assert_eq!(
            choose(&values.map(|v| v * 1e9), MAX_HARMONICS, 0.0).map(i16::abs),
            values.map(|v| if v == 0.0 { 0 } else { 8191 })
        );
    }
}
