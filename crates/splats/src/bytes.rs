//! Little-endian encoding of the columns of a checkpoint.

use crate::Problem;

pub(crate) fn put_f32s<'a>(out: &mut Vec<u8>, values: impl IntoIterator<Item = &'a f32>) {
    values.into_iter().for_each(|v| out.extend(v.to_le_bytes()));
}

pub(crate) fn put_f64s<'a>(out: &mut Vec<u8>, values: impl IntoIterator<Item = &'a f64>) {
    values.into_iter().for_each(|v| out.extend(v.to_le_bytes()));
}

pub(crate) fn put_u64(out: &mut Vec<u8>, value: u64) {
    out.extend(value.to_le_bytes());
}

pub(crate) fn put_text(out: &mut Vec<u8>, text: &str) {
    put_u64(out, text.len() as u64);
    out.extend(text.as_bytes());
}

/// A cursor over a payload; never reads or allocates past its end.
pub(crate) struct Cursor<'a>(pub &'a [u8]);

impl<'a> Cursor<'a> {
    fn take(&mut self, count: usize, bytes_each: usize) -> Result<&'a [u8], Problem> {
        let split = count.checked_mul(bytes_each).and_then(|n| self.0.split_at_checked(n));
        let (head, tail) = split.ok_or_else(|| Problem::Corrupt("a column is cut off".into()))?;
        self.0 = tail;
        Ok(head)
    }

    pub(crate) fn bytes(&mut self, count: usize) -> Result<&'a [u8], Problem> {
        self.take(count, 1)
    }

    pub(crate) fn u64(&mut self) -> Result<u64, Problem> {
        Ok(u64::from_le_bytes(le(self.take(1, 8)?)))
    }

    pub(crate) fn length(&mut self) -> Result<usize, Problem> {
        usize::try_from(self.u64()?).map_err(|_| Problem::Corrupt("a length is out of range".into()))
    }

    pub(crate) fn f64(&mut self) -> Result<f64, Problem> {
        Ok(f64::from_bits(self.u64()?))
    }

    pub(crate) fn text(&mut self) -> Result<String, Problem> {
        let length = self.length()?;
        let bytes = self.take(length, 1)?.to_vec();
        String::from_utf8(bytes).map_err(|_| Problem::Corrupt("a name is not UTF-8".into()))
    }

    pub(crate) fn f32s(&mut self, count: usize) -> Result<Vec<f32>, Problem> {
        Ok(self.take(count, 4)?.chunks_exact(4).map(|b| f32::from_le_bytes(le(b))).collect())
    }

    pub(crate) fn u32s(&mut self, count: usize) -> Result<Vec<u32>, Problem> {
        Ok(self.take(count, 4)?.chunks_exact(4).map(|b| u32::from_le_bytes(le(b))).collect())
    }

    /// `rows` rows of N values.
    pub(crate) fn f32_rows<const N: usize>(&mut self, rows: usize) -> Result<Vec<[f32; N]>, Problem> {
        let bytes = self.take(rows, 4 * N)?;
        let row = |b: &[u8]| std::array::from_fn(|i| f32::from_le_bytes(le(&b[4 * i..4 * i + 4])));
        Ok(bytes.chunks_exact(4 * N).map(row).collect())
    }

    pub(crate) fn f64_rows<const N: usize>(&mut self, rows: usize) -> Result<Vec<[f64; N]>, Problem> {
        let bytes = self.take(rows, 8 * N)?;
        let row = |b: &[u8]| std::array::from_fn(|i| f64::from_le_bytes(le(&b[8 * i..8 * i + 8])));
        Ok(bytes.chunks_exact(8 * N).map(row).collect())
    }
}

/// The N bytes of `bytes`, which holds exactly N: every caller cuts that many.
fn le<const N: usize>(bytes: &[u8]) -> [u8; N] {
    let mut out = [0; N];
    out.copy_from_slice(bytes);
    out
}
