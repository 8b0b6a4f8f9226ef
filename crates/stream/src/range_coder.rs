//! A binary range coder with adaptive probabilities: the arithmetic of LZMA (Pavlov), with probabilities of 16 bits that are
//! the mean of a fast and a slow estimate. All arithmetic is on unsigned integers of 32 bits.

/// Below this a range is widened by a byte.
const LEAST_RANGE: u32 = 1 << 24;
/// Shifts of the fast and the slow estimate.
const RATES: [u32; 2] = [4, 7];
/// Estimates stay this far from 0 and 1, so that both values of a bit can be coded.
const MARGIN: u16 = 32;

/// How probable a 0 is, of 65 536, twice: learnt quickly and slowly.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Bit([u16; 2]);

impl Default for Bit {
    fn default() -> Self {
        Self([1 << 15; 2])
    }
}

impl Bit {
    /// Part of the range that stands for a 0.
    fn bound(self, range: u32) -> u32 {
        (range >> 16) * (u32::from(self.0[0]) + u32::from(self.0[1])).div_ceil(2)
    }

    fn learn(&mut self, bit: bool) {
        for (estimate, rate) in self.0.iter_mut().zip(RATES) {
            if bit {
                *estimate -= (*estimate - MARGIN) >> rate;
            } else {
                *estimate += (u16::MAX - MARGIN - *estimate) >> rate;
            }
        }
    }
}

/// Codes bits in one of the two directions, so that a format is written down once for both.
pub trait Coder {
    /// Codes a bit: an encoder writes `bit`, a decoder ignores it; both return what was coded.
    fn bit(&mut self, model: &mut Bit, bit: bool) -> bool;

    /// Codes `count` (at most 24) bits that are as likely 0 as 1, the highest first.
    fn plain(&mut self, count: u32, value: u32) -> u32;
}

/// Writes bits.
#[derive(Debug)]
pub struct Encoder {
    low: u64,
    range: u32,
    /// The last byte that may still change, and how many bytes of 255 follow it; none before the first.
    waiting: Option<(u8, usize)>,
    out: Vec<u8>,
}

impl Default for Encoder {
    fn default() -> Self {
        Self::new()
    }
}

impl Encoder {
    /// Nothing written yet.
    pub fn new() -> Self {
        Self { low: 0, range: u32::MAX, waiting: None, out: Vec::new() }
    }

    fn narrow(&mut self, start: u32, range: u32) {
        self.low += u64::from(start);
        self.range = range;
        while self.range < LEAST_RANGE {
            self.range <<= 8;
            self.shift();
        }
    }

    /// Moves the top byte of the low end out; a carry runs through the bytes that wait.
    fn shift(&mut self) {
        let (carry, top) = ((self.low >> 32) as u8, (self.low >> 24) as u8);
        match &mut self.waiting {
            Some((_, run)) if carry == 0 && top == u8::MAX => *run += 1,
            waiting => {
                if let Some((byte, run)) = waiting.take() {
                    self.out.push(byte.wrapping_add(carry));
                    self.out.extend(std::iter::repeat_n(u8::MAX.wrapping_add(carry), run));
                }
                *waiting = Some((top, 0));
            }
        }
        self.low = (self.low & 0x00ff_ffff) << 8;
    }

    /// The bytes; a decoder reads zeros behind them.
    pub fn finish(mut self) -> Vec<u8> {
        (0..5).for_each(|_| self.shift());
        let used = self.out.iter().rposition(|&byte| byte != 0).map_or(0, |last| last + 1);
        self.out.truncate(used);
        self.out
    }
}

impl Coder for Encoder {
    fn bit(&mut self, model: &mut Bit, bit: bool) -> bool {
        let bound = model.bound(self.range);
        if bit {
            self.narrow(bound, self.range - bound);
        } else {
            self.narrow(0, bound);
        }
        model.learn(bit);
        bit
    }

    fn plain(&mut self, count: u32, value: u32) -> u32 {
        for shift in (0..count).rev() {
            let half = self.range >> 1;
            let start = if value >> shift & 1 == 1 { half } else { 0 };
            self.narrow(start, half);
        }
        value
    }
}

/// Reads bits.
#[derive(Debug)]
pub struct Decoder<'a> {
    code: u32,
    range: u32,
    rest: &'a [u8],
}

impl<'a> Decoder<'a> {
    /// Reads what an encoder wrote.
    pub fn new(bytes: &'a [u8]) -> Self {
        let mut out = Self { code: 0, range: u32::MAX, rest: bytes };
        (0..4).for_each(|_| out.next_byte());
        out
    }

    fn next_byte(&mut self) {
        let byte = self.rest.split_off_first().copied().unwrap_or(0);
        self.code = self.code << 8 | u32::from(byte);
    }

    fn widen(&mut self) {
        while self.range < LEAST_RANGE {
            self.range <<= 8;
            self.next_byte();
        }
    }

    /// Takes the lower part of the range, up to `bound`, or what lies above.
    fn split(&mut self, bound: u32, above: u32) -> bool {
        let bit = self.code >= bound;
        if bit {
            self.code -= bound;
        }
        self.range = if bit { above } else { bound };
        self.widen();
        bit
    }
}

impl Coder for Decoder<'_> {
    fn bit(&mut self, model: &mut Bit, _: bool) -> bool {
        let bound = model.bound(self.range);
        let bit = self.split(bound, self.range - bound);
        model.learn(bit);
        bit
    }

    fn plain(&mut self, count: u32, _: u32) -> u32 {
        let mut value = 0;
        for _ in 0..count {
            let half = self.range >> 1;
            value = value << 1 | u32::from(self.split(half, half));
        }
        value
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Bits that are 1 with a probability of `share` of 256, and plain ones.
    fn sequence(share: u32) -> Vec<(bool, u32)> {
        let mut state = 1_u32;
        let mut next = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            state >> 8
        };
        (0..20_000).map(|_| ((next() & 255) < share, next() & 7)).collect()
    }

    #[test]
    fn what_is_written_is_read() {
        for share in [0, 1, 40, 128, 255, 256] {
            let (mut encoder, mut model) = (Encoder::new(), Bit::default());
            for (bit, plain) in sequence(share) {
                encoder.bit(&mut model, bit);
                encoder.plain(3, plain);
            }
            let bytes = encoder.finish();
            let (mut decoder, mut model) = (Decoder::new(&bytes), Bit::default());
            for (i, (bit, plain)) in sequence(share).into_iter().enumerate() {
                assert_eq!(
                    (decoder.bit(&mut model, false), decoder.plain(3, 0)),
                    (bit, plain),
                    "{share} {i}"
                );
            }
        }
    }

    #[test]
    fn a_rare_bit_costs_little_more_than_its_entropy() {
        let (mut encoder, mut model) = (Encoder::new(), Bit::default());
        let bits = sequence(8);
        bits.iter().for_each(|(bit, _)| {
            encoder.bit(&mut model, *bit);
        });
        let p: f64 = bits.iter().filter(|b| b.0).count() as f64 / bits.len() as f64;
        let entropy = -(p * p.log2() + (1.0 - p) * (1.0 - p).log2()) * bits.len() as f64 / 8.0;
        let found = encoder.finish().len() as f64;
        assert!(found < 1.1 * entropy && found > 0.95 * entropy, "{found} {entropy}");
    }
}
