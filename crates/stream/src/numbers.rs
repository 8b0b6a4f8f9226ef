//! Integers as adaptive bits.

use crate::range_coder::{Bit, Coder};

/// Magnitudes have at most so many bits.
const MAX_BITS: usize = 31;

/// Models of a signed integer that is usually near 0: whether it is 0, its sign, the number of its bits in unary, the highest
/// of the bits that follow, and the others as they are. All but the sign depend on a context.
#[derive(Clone, Debug)]
pub(crate) struct ContextNumber<const CONTEXTS: usize> {
    zero: [Bit; CONTEXTS],
    sign: Bit,
    more: [[Bit; MAX_BITS]; CONTEXTS],
    next: [[Bit; MAX_BITS]; CONTEXTS],
}

impl<const CONTEXTS: usize> Default for ContextNumber<CONTEXTS> {
    fn default() -> Self {
        Self {
            zero: [Bit::default(); CONTEXTS],
            sign: Bit::default(),
            more: [[Bit::default(); MAX_BITS]; CONTEXTS],
            next: [[Bit::default(); MAX_BITS]; CONTEXTS],
        }
    }
}

impl<const CONTEXTS: usize> ContextNumber<CONTEXTS> {
    /// Codes a number; -2^31 cannot be coded.
    pub(crate) fn code(&mut self, coder: &mut impl Coder, context: usize, value: i32) -> i32 {
        if !coder.bit(&mut self.zero[context], value != 0) {
            return 0;
        }
        let negative = coder.bit(&mut self.sign, value < 0);
        let magnitude = value.unsigned_abs();
        let top = magnitude.max(1).ilog2() as usize;
        let mut bits = 0;
        while bits + 1 < MAX_BITS && coder.bit(&mut self.more[context][bits], bits < top) {
            bits += 1;
        }
        let mut out = 1_u32;
        if bits > 0 {
            let next = magnitude >> (bits - 1) & 1 == 1;
            out = 2 | u32::from(coder.bit(&mut self.next[context][bits], next));
        }
        let rest = bits.saturating_sub(1) as u32;
        let (high, low) = (rest.saturating_sub(16), rest.min(16));
        out = out << high | coder.plain(high, magnitude >> low & ((1 << high) - 1));
        out = out << low | coder.plain(low, magnitude & ((1 << low) - 1));
        let signed = out as i32;
        if negative { signed.wrapping_neg() } else { signed }
    }
}

/// What a number tells of its neighbours: 0, 1 for a magnitude of 1, or 2.
pub(crate) fn class(value: i32) -> usize {
    value.unsigned_abs().min(2) as usize
}

/// Models of a signed integer that resembles the last one.
#[derive(Clone, Debug, Default)]
pub struct Number {
    last: usize,
    models: ContextNumber<3>,
}

impl Number {
    /// Codes a number; -2^31 cannot be coded.
    pub fn code(&mut self, coder: &mut impl Coder, value: i32) -> i32 {
        let value = self.models.code(coder, self.last, value);
        self.last = class(value);
        value
    }
}

/// Models of an unsigned integer of a fixed number of bits, without any order among its values.
#[derive(Clone, Debug)]
pub(crate) struct Symbol {
    bits: u32,
    tree: Vec<Bit>,
}

impl Symbol {
    /// Of `bits` bits, at most 12.
    pub(crate) fn new(bits: u32) -> Self {
        Self { bits, tree: vec![Bit::default(); 1 << bits] }
    }

    /// Codes a value below `2^bits`.
    pub(crate) fn code(&mut self, coder: &mut impl Coder, value: u32) -> u32 {
        let mut node = 1;
        for shift in (0..self.bits).rev() {
            let bit = coder.bit(&mut self.tree[node], value >> shift & 1 == 1);
            node = node << 1 | usize::from(bit);
        }
        node as u32 - (1 << self.bits)
    }
}

/// Models of a flag that depends on the one before it.
#[derive(Clone, Debug, Default)]
pub struct Flag {
    last: usize,
    bits: [Bit; 2],
}

impl Flag {
    /// Codes a flag.
    pub fn code(&mut self, coder: &mut impl Coder, flag: bool) -> bool {
        let out = coder.bit(&mut self.bits[self.last], flag);
        self.last = usize::from(out);
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::range_coder::{Decoder, Encoder};

    #[test]
    fn every_magnitude_survives() {
        let mut values = vec![0, 0, 1, -1, 5, i32::MAX, -i32::MAX, 0, 3];
        for shift in 0..31 {
            values.extend([1 << shift, -(1 << shift), (1 << shift) + (0x5555_5555 & ((1 << shift) - 1))]);
        }
        let (mut encoder, mut model) = (Encoder::new(), Number::default());
        values.iter().for_each(|&v| assert_eq!(model.code(&mut encoder, v), v));
        let bytes = encoder.finish();
        let (mut decoder, mut model) = (Decoder::new(&bytes), Number::default());
        values.iter().for_each(|&v| assert_eq!(model.code(&mut decoder, 0), v));
    }

    #[test]
    fn symbols_and_flags_survive() {
        let (mut encoder, mut symbol, mut flag) = (Encoder::new(), Symbol::new(7), Flag::default());
        for i in 0..500_u32 {
            symbol.code(&mut encoder, i * i % 128);
            flag.code(&mut encoder, i % 5 == 0);
        }
        let bytes = encoder.finish();
        let (mut decoder, mut symbol, mut flag) = (Decoder::new(&bytes), Symbol::new(7), Flag::default());
        for i in 0..500_u32 {
            assert_eq!(symbol.code(&mut decoder, 0), i * i % 128);
            assert_eq!(flag.code(&mut decoder, false), i % 5 == 0);
        }
    }
}
