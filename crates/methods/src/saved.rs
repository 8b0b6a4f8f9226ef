//! What methods keep between frames, as bytes: counts (u64) and columns of f32 with their lengths, little-endian.

use anyhow::{Context, Result, ensure};

/// Writes a state.
#[derive(Default)]
pub(crate) struct Writer(Vec<u8>);

impl Writer {
    #[must_use]
    pub(crate) fn count(mut self, count: usize) -> Self {
        self.0.extend((count as u64).to_le_bytes());
        self
    }

    #[must_use]
    pub(crate) fn column(self, values: &[f32]) -> Self {
        let mut out = self.count(values.len());
        out.0.extend(values.iter().flat_map(|value| value.to_le_bytes()));
        out
    }

    pub(crate) fn finish(self) -> Vec<u8> {
        self.0
    }
}

/// Reads it.
pub(crate) struct Reader<'a>(pub &'a [u8]);

impl Reader<'_> {
    pub(crate) fn count(&mut self) -> Result<usize> {
        let (word, rest) = self.0.split_first_chunk::<8>().context("the state ends early")?;
        self.0 = rest;
        usize::try_from(u64::from_le_bytes(*word)).context("a count is too large")
    }

    pub(crate) fn column(&mut self) -> Result<Vec<f32>> {
        let bytes = self.count()?.saturating_mul(4);
        let (values, rest) = self.0.split_at_checked(bytes).context("the state ends early")?;
        self.0 = rest;
        Ok(values.as_chunks::<4>().0.iter().map(|value| f32::from_le_bytes(*value)).collect())
    }

    pub(crate) fn end(self) -> Result<()> {
        ensure!(self.0.is_empty(), "{} bytes behind the state", self.0.len());
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_written_is_read_and_damage_is_found() {
        let bytes = Writer::default().count(7).column(&[1.5, -0.0]).finish();
        let read = |bytes: &[u8]| -> Result<(usize, Vec<f32>)> {
            let mut reader = Reader(bytes);
            let out = (reader.count()?, reader.column()?);
            reader.end().map(|()| out)
        };
        let (count, column) = read(&bytes).unwrap();
        assert_eq!((count, column[0], column[1].to_bits()), (7, 1.5, (-0.0_f32).to_bits()));
        for length in 0..bytes.len() {
            assert!(read(&bytes[..length]).is_err(), "{length} bytes");
        }
        assert!(read(&[&bytes[..], &[0]].concat()).is_err());
        assert!(read(&[0xff; 24]).is_err(), "a column longer than memory");
    }
}
