//! A dynamic row of one frame after the same Gaussian's row of the frame before.

use crate::harmonics::{HarmonicModels, choose};
use crate::motion::Motion;
use crate::numbers::{Flag, Number};
use crate::range_coder::Coder;
use crate::row::{MAX_HARMONICS, Row};
use crate::row_models::{code_colour, plus};
use crate::steps::{Measures, Steps, largest, round, unit};

/// Differences to what motion predicts, in steps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Residual {
    /// In units of the Gaussian's own position step.
    pub(crate) position: [i32; 3],
    pub(crate) rotation: [i32; 3],
    pub(crate) scales: [i32; 3],
    pub(crate) opacity: i32,
    pub(crate) colour: [i32; 3],
    pub(crate) harmonics: [i16; MAX_HARMONICS],
}

impl Default for Residual {
    fn default() -> Self {
        Self {
            position: [0; 3],
            rotation: [0; 3],
            scales: [0; 3],
            opacity: 0,
            colour: [0; 3],
            harmonics: [0; MAX_HARMONICS],
        }
    }
}

/// Changes smaller than this many steps are not sent. The sender sees what the receiver has, so they do not add up.
pub(crate) const GATE: f64 = 0.75;
/// How much more a change of harmonics must gain per bit than a harmonic of a key frame: most of what they change by from frame
/// to frame is noise, and they are 45 of 59 numbers (docs/STREAM.md).
const HARMONIC_CHANGE: f64 = 5.0;

fn gated(target: f64, predicted: i32) -> i32 {
    let change = target - f64::from(predicted);
    if change.abs() < GATE { 0 } else { round(change) }
}

/// The changes of harmonics that are worth sending.
pub(crate) fn changed_harmonics(
    target: &Measures,
    sent: &[i16; MAX_HARMONICS],
    steps: &Steps,
) -> [i16; MAX_HARMONICS] {
    let mut change = target.harmonics;
    change.iter_mut().zip(sent).for_each(|(c, &sent)| *c -= f64::from(sent));
    choose(&change, steps.harmonics(), HARMONIC_CHANGE * target.price)
}

/// The row that a group's motion predicts: position and rotation move with it, all else stays.
pub(crate) fn predict(row: &Row, motion: &Motion, steps: &Steps) -> Row {
    let from = row.position.map(|v| f64::from(v) * steps.position);
    let quat = unit(motion.turn(steps.quat(row)));
    let largest = largest(quat);
    Row {
        position: motion.place(from).map(|v| round(v / steps.position)),
        largest,
        rotation: steps.rotation_measures(quat, largest).map(round),
        ..*row
    }
}

impl Residual {
    /// What leads from the prediction to a Gaussian, as far as it is worth sending.
    pub(crate) fn of(target: &Measures, predicted: &Row, steps: &Steps) -> Self {
        let target = &target.like(predicted, steps);
        let unit = f64::from(1_u32 << steps.level(predicted.scales));
        let turned = steps.rotation_measures(target.quat, predicted.largest);
        let three = |target: [f64; 3], from: [i32; 3]| [0, 1, 2].map(|k| gated(target[k], from[k]));
        let place = |k: usize| {
            let change = (target.position[k] - f64::from(predicted.position[k])) / unit;
            if change.abs() < GATE { 0 } else { round(change) }
        };
        Self {
            position: [0, 1, 2].map(place),
            rotation: three(turned, predicted.rotation),
            scales: three(target.scales, predicted.scales),
            opacity: gated(target.opacity, predicted.opacity),
            colour: three(target.colour, predicted.colour),
            harmonics: changed_harmonics(target, &predicted.harmonics, steps),
        }
    }

    /// Whether anything but colours changes.
    pub(crate) fn changes_shape(&self) -> bool {
        [self.position, self.rotation, self.scales] != [[0; 3]; 3] || self.opacity != 0
    }

    /// The row that the prediction and this give.
    pub(crate) fn apply(&self, predicted: &Row, steps: &Steps) -> Row {
        let level = steps.level(predicted.scales);
        let mut out = *predicted;
        for k in 0..3 {
            out.position[k] = out.position[k].wrapping_add(self.position[k].wrapping_shl(level));
        }
        out.rotation = plus(out.rotation, self.rotation);
        out.scales = plus(out.scales, self.scales);
        out.opacity = out.opacity.wrapping_add(self.opacity).clamp(0, steps.opacity);
        out.colour = plus(out.colour, self.colour);
        out.harmonics.iter_mut().zip(self.harmonics).for_each(|(v, d)| *v = v.wrapping_add(d));
        out
    }
}

/// Models of residuals: a flag for each part, then its numbers.
#[derive(Clone, Debug, Default)]
pub(crate) struct ResidualModels {
    flags: [Flag; 4],
    position: [Number; 3],
    rotation: [Number; 3],
    scales: [Number; 3],
    opacity: Number,
    colour: [Number; 3],
    harmonics: HarmonicModels,
}

impl ResidualModels {
    pub(crate) fn code(&mut self, coder: &mut impl Coder, steps: &Steps, residual: &Residual) -> Residual {
        let mut out = Residual::default();
        let [moved, turned, scaled, coloured] = &mut self.flags;
        out.position = three(moved, &mut self.position, coder, residual.position);
        out.rotation = three(turned, &mut self.rotation, coder, residual.rotation);
        out.scales = three(scaled, &mut self.scales, coder, residual.scales);
        out.opacity = self.opacity.code(coder, residual.opacity);
        if coloured.code(coder, residual.colour != [0; 3]) {
            out.colour = code_colour(&mut self.colour, coder, residual.colour);
        }
        out.harmonics = self.harmonics.code(coder, steps.coded_harmonics(), &residual.harmonics);
        out
    }
}

fn three(flag: &mut Flag, models: &mut [Number; 3], coder: &mut impl Coder, values: [i32; 3]) -> [i32; 3] {
    if !flag.code(coder, values != [0; 3]) {
        return [0; 3];
    }
    let mut out = [0; 3];
    for (k, model) in models.iter_mut().enumerate() {
        out[k] = model.code(coder, values[k]);
    }
    out
}
