//! Reading of one npy array, block by block, within a limit of memory that the caller sets.

use crate::array::{fits, shape_text};
use crate::header::{Dtype, Header};
use crate::{Array, ArraysError, Cause, Element};
use ffgs_core::open_input;
use half::f16;
use std::io::{BufReader, Read};
use std::path::Path;

/// The largest array that is read unless the reader sets its own limit (8 GiB): a small deflated file can pretend to
/// hold anything.
pub(crate) const MAX_BYTES: usize = 8 << 30;
/// Bytes read at a time; a multiple of every item size.
const BLOCK: usize = 1 << 16;

/// What a reader accepts, judged from an array's header before any entry is read.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Accepted<'a> {
    /// The shape; `None` = any.
    pub shape: Option<&'a [Option<usize>]>,
    /// Most bytes of the entries, in the file as well as in memory.
    pub bytes: usize,
}

/// Reads a .npy file of that shape (`None` = any length of that axis) whose entries take at most `max_bytes`.
///
/// # Errors
/// Shape and size are judged from the header, before any entry is read.
pub fn read_npy<T: Element>(
    path: &Path,
    shape: &[Option<usize>],
    max_bytes: usize,
) -> Result<Array<T>, ArraysError> {
    let read = || {
        let mut reader = BufReader::new(open_input(path)?);
        read_array(&mut reader, Accepted { shape: Some(shape), bytes: max_bytes })
    };
    let (shape, data) = read().map_err(|cause: Cause| ArraysError::new(path, None, cause))?;
    Ok(Array::new(shape, data, path, None))
}

/// Shape and entries in C order of the npy stream.
pub(crate) fn read_array<T: Element>(
    reader: &mut impl Read,
    accepted: Accepted,
) -> Result<(Vec<usize>, Vec<T>), Cause> {
    let Header { dtype, fortran_order, shape } = Header::read(reader)?;
    if let Some(expected) = accepted.shape.filter(|expected| !fits(&shape, expected)) {
        return Err(Cause::Shape { expected: shape_text(expected), found: shape });
    }
    let count = entries(&shape, dtype.size.max(size_of::<T>()), accepted.bytes)?;
    let data = read_entries(reader, &dtype, &shape, count)?;
    let data = if fortran_order && shape.len() > 1 { c_from_fortran(&shape, &data)? } else { data };
    Ok((shape, data))
}

/// Number of entries; an error where they would take too many bytes.
fn entries(shape: &[usize], item: usize, max_bytes: usize) -> Result<usize, Cause> {
    let size = shape.iter().try_fold(item, |size, &n| size.checked_mul(n));
    match size {
        Some(size) if size <= max_bytes => Ok(size / item),
        _ => Err(Cause::TooLarge(shape.to_vec())),
    }
}

/// Reads and converts block by block: memory grows with what is there, not with what the header says, and where
/// there is none left the file is refused.
fn read_entries<T: Element>(
    reader: &mut impl Read,
    dtype: &Dtype,
    shape: &[usize],
    count: usize,
) -> Result<Vec<T>, Cause> {
    let expected = count * dtype.size;
    let (mut out, mut block, mut found) = (Vec::new(), Vec::with_capacity(BLOCK), 0);
    while found < expected {
        block.clear();
        let wanted = BLOCK.min(expected - found);
        let read = reader.by_ref().take(wanted as u64).read_to_end(&mut block)?;
        found += read;
        if read < wanted {
            return Err(Cause::Truncated { shape: shape.to_vec(), expected, found });
        }
        out.try_reserve(read / dtype.size).map_err(|_| Cause::NoMemory(expected))?;
        convert(dtype, &mut block, &mut out)?;
    }
    Ok(out)
}

/// Appends the entries of a block.
fn convert<T: Element>(dtype: &Dtype, bytes: &mut [u8], out: &mut Vec<T>) -> Result<(), Cause> {
    if dtype.big_endian {
        bytes.chunks_exact_mut(dtype.size).for_each(<[u8]>::reverse);
    }
    let b = &*bytes;
    let converted = match (dtype.kind, dtype.size) {
        ('f', 2) => map(b, out, |v| T::from_f64(f16::from_le_bytes(v).to_f64())),
        ('f', 4) => map(b, out, |v| T::from_f64(f32::from_le_bytes(v).into())),
        ('f', _) => map(b, out, |v| T::from_f64(f64::from_le_bytes(v))),
        ('i', 1) => map(b, out, |v| T::from_i64(i8::from_le_bytes(v).into())),
        ('i', 2) => map(b, out, |v| T::from_i64(i16::from_le_bytes(v).into())),
        ('i', 4) => map(b, out, |v| T::from_i64(i32::from_le_bytes(v).into())),
        ('i', _) => map(b, out, |v| T::from_i64(i64::from_le_bytes(v))),
        (_, 1) => map(b, out, |v| T::from_u64(u8::from_le_bytes(v).into())),
        (_, 2) => map(b, out, |v| T::from_u64(u16::from_le_bytes(v).into())),
        (_, 4) => map(b, out, |v| T::from_u64(u32::from_le_bytes(v).into())),
        _ => map(b, out, |v| T::from_u64(u64::from_le_bytes(v))),
    };
    converted.map_err(|index| Cause::Value { wanted: T::NAME, index, dtype: dtype.text.clone() })
}

/// Every entry of `K` bytes; the error is the index of the first that does not fit.
fn map<T, const K: usize>(
    bytes: &[u8],
    out: &mut Vec<T>,
    value: impl Fn([u8; K]) -> Option<T>,
) -> Result<(), usize> {
    bytes.as_chunks::<K>().0.iter().try_for_each(|entry| {
        out.push(value(*entry).ok_or(out.len())?);
        Ok(())
    })
}

/// Transposes the memory order: walks the C order while following the Fortran strides.
fn c_from_fortran<T: Copy>(shape: &[usize], data: &[T]) -> Result<Vec<T>, Cause> {
    let mut index = vec![0; shape.len()];
    let strides: Vec<usize> =
        shape.iter().scan(1, |stride, n| Some(std::mem::replace(stride, *stride * n))).collect();
    let mut out = Vec::new();
    out.try_reserve_exact(data.len()).map_err(|_| Cause::NoMemory(size_of_val(data)))?;
    for _ in 0..data.len() {
        out.push(data[index.iter().zip(&strides).map(|(i, s)| i * s).sum::<usize>()]);
        advance(&mut index, shape);
    }
    Ok(out)
}

/// The next index in C order.
fn advance(index: &mut [usize], shape: &[usize]) {
    for axis in (0..shape.len()).rev() {
        index[axis] += 1;
        if index[axis] < shape[axis] {
            return;
        }
        index[axis] = 0;
    }
}
