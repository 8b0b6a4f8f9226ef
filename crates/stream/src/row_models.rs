//! How a row is coded after the one before it.

use crate::harmonics::HarmonicModels;
use crate::numbers::{Number, Symbol};
use crate::range_coder::Coder;
use crate::row::{GROUP_BITS, Row};
use crate::steps::Steps;

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
        out.harmonics = self.harmonics.code(coder, steps.coded_harmonics(), &row.harmonics);
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
