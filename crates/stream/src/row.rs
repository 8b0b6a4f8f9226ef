//! A Gaussian as integers, and how a row of them is coded after the one before it.

use crate::numbers::{Flag, Number, Symbol};
use crate::range_coder::Coder;
use crate::steps::{Measures, Steps, largest, round};

/// SH values above degree 0: 15 coefficients of three channels.
pub(crate) const MAX_HARMONICS: usize = 45;
/// Bits of a group's number.
const GROUP_BITS: u32 = 4;
/// Groups that move together.
pub(crate) const MAX_GROUPS: usize = 1 << GROUP_BITS;

/// A Gaussian in steps of its layer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Row {
    pub(crate) position: [i32; 3],
    /// Which component of the quaternion is not stored.
    pub(crate) largest: u8,
    pub(crate) rotation: [i32; 3],
    pub(crate) scales: [i32; 3],
    pub(crate) opacity: i32,
    pub(crate) colour: [i32; 3],
    pub(crate) harmonics: [i16; MAX_HARMONICS],
    /// Which group it moves with.
    pub(crate) group: u8,
}

impl Default for Row {
    fn default() -> Self {
        Self {
            position: [0; 3],
            largest: 0,
            rotation: [0; 3],
            scales: [0; 3],
            opacity: 0,
            colour: [0; 3],
            harmonics: [0; MAX_HARMONICS],
            group: 0,
        }
    }
}

impl Row {
    /// Rounds a Gaussian.
    pub(crate) fn rounded(m: &Measures, steps: &Steps, group: u8) -> Self {
        let scales = m.scales.map(round);
        let level = steps.level(scales);
        let unit = f64::from(1_u32 << level);
        let largest = largest(m.quat);
        Self {
            position: m.position.map(|v| round(v / unit) << level),
            largest,
            rotation: steps.rotation_measures(m.quat, largest).map(round),
            scales,
            opacity: round(m.opacity).clamp(0, steps.opacity),
            colour: m.colour.map(round),
            harmonics: m.harmonics.map(|v| dead_zone(v) as i16),
            group,
        }
    }
}

impl Row {
    /// All of a row, little-endian, with so many harmonics.
    pub(crate) fn bytes(&self, harmonics: usize) -> Vec<u8> {
        let numbers = [self.position, self.rotation, self.scales, self.colour].into_iter().flatten();
        let mut out: Vec<u8> = numbers.chain([self.opacity]).flat_map(i32::to_le_bytes).collect();
        out.extend([self.largest, self.group]);
        out.extend(self.harmonics[..harmonics].iter().flat_map(|v| v.to_le_bytes()));
        out
    }
}

/// Rounds with a wider 0, which costs next to nothing to code.
fn dead_zone(v: f64) -> i32 {
    /// Magnitudes below this become 0.
    const EDGE: f64 = 0.65;
    if v.abs() < EDGE { 0 } else { round(v).clamp(-(1 << 14), 1 << 14) }
}

/// Models of whole rows, each coded after its neighbour in space.
pub(crate) struct RowModels {
    previous: Row,
    group: Symbol,
    scales: [Number; 3],
    position: [Number; 3],
    largest: Symbol,
    rotation: [Symbol; 3],
    opacity: Symbol,
    colour: [Number; 3],
    harmonics: HarmonicModels,
}

impl RowModels {
    pub(crate) fn new(steps: &Steps) -> Self {
        Self {
            previous: Row::default(),
            group: Symbol::new(GROUP_BITS),
            scales: Default::default(),
            position: Default::default(),
            largest: Symbol::new(2),
            rotation: [(); 3].map(|()| Symbol::new(steps.rotation_bits())),
            opacity: Symbol::new(steps.opacity_bits()),
            colour: Default::default(),
            harmonics: HarmonicModels::default(),
        }
    }

    /// Codes a row; a decoder gets it back whatever it hands in.
    pub(crate) fn code(&mut self, coder: &mut impl Coder, steps: &Steps, row: &Row) -> Row {
        let before = self.previous;
        let mut out = Row { group: self.group.code(coder, row.group.into()) as u8, ..Row::default() };
        // The second axis is like the first of the same Gaussian, the third, the thin one, like its neighbour's.
        out.scales[0] = self.after(coder, Column::Scale(0), before.scales[0], row.scales[0]);
        out.scales[1] = self.after(coder, Column::Scale(1), out.scales[0], row.scales[1]);
        out.scales[2] = self.after(coder, Column::Scale(2), before.scales[2], row.scales[2]);
        let level = steps.level(out.scales);
        for axis in 0..3 {
            let [from, to] = [before.position[axis] >> level, row.position[axis] >> level];
            let cell = self.after(coder, Column::Position(axis), from, to);
            out.position[axis] = cell.wrapping_shl(level);
        }
        out.largest = self.largest.code(coder, row.largest.into()) as u8;
        for (k, model) in self.rotation.iter_mut().enumerate() {
            let value = (row.rotation[k] + steps.rotation).max(0) as u32;
            out.rotation[k] = model.code(coder, value) as i32 - steps.rotation;
        }
        out.opacity = self.opacity.code(coder, row.opacity as u32) as i32;
        let change = code_colour(&mut self.colour, coder, minus(row.colour, before.colour));
        out.colour = plus(before.colour, change);
        out.harmonics = self.harmonics.code(coder, steps.harmonics(), &row.harmonics);
        self.previous = out;
        out
    }

    fn after(&mut self, coder: &mut impl Coder, column: Column, from: i32, to: i32) -> i32 {
        let model = match column {
            Column::Scale(k) => &mut self.scales[k],
            Column::Position(k) => &mut self.position[k],
        };
        from.wrapping_add(model.code(coder, to.wrapping_sub(from)))
    }
}

/// Columns that are coded as differences.
#[derive(Clone, Copy)]
enum Column {
    Scale(usize),
    Position(usize),
}

/// Codes a difference of colours as that of green, and what red and blue differ from it.
pub(crate) fn code_colour(models: &mut [Number; 3], coder: &mut impl Coder, [r, g, b]: [i32; 3]) -> [i32; 3] {
    let [first, second, third] = models;
    let green = first.code(coder, g);
    let red = green.wrapping_add(second.code(coder, r.wrapping_sub(g)));
    let blue = green.wrapping_add(third.code(coder, b.wrapping_sub(g)));
    [red, green, blue]
}

pub(crate) fn plus(a: [i32; 3], b: [i32; 3]) -> [i32; 3] {
    [0, 1, 2].map(|k| a[k].wrapping_add(b[k]))
}

pub(crate) fn minus(a: [i32; 3], b: [i32; 3]) -> [i32; 3] {
    [0, 1, 2].map(|k| a[k].wrapping_sub(b[k]))
}

/// Models of values above degree 0, nearly all of which are 0: whether any is not, then each.
#[derive(Clone, Debug, Default)]
pub(crate) struct HarmonicModels {
    any: Flag,
    /// One per degree.
    values: [Number; 3],
}

impl HarmonicModels {
    /// Codes the first `count` values.
    pub(crate) fn code(
        &mut self,
        coder: &mut impl Coder,
        count: usize,
        values: &[i16; MAX_HARMONICS],
    ) -> [i16; MAX_HARMONICS] {
        let mut out = [0; MAX_HARMONICS];
        if count == 0 || !self.any.code(coder, values.iter().any(|&v| v != 0)) {
            return out;
        }
        for k in 0..count {
            let degree = usize::from(k >= 9) + usize::from(k >= 24);
            out[k] = self.values[degree].code(coder, values[k].into()) as i16;
        }
        out
    }
}
