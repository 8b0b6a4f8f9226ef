use crate::header::{Dtype, Header};
use crate::{Array, ArraysError, Cause, Element};
use half::f16;
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;

/// The largest array that is read (8 GiB): a small deflated file can pretend to hold anything.
const MAX_BYTES: usize = 8 << 30;

/// Reads a .npy file.
pub fn read_npy<T: Element>(path: &Path) -> Result<Array<T>, ArraysError> {
    let read = || {
        let mut reader = BufReader::new(File::open(path)?);
        read_array(&mut reader)
    };
    let (shape, data) = read().map_err(|cause: Cause| ArraysError::new(path, None, cause))?;
    Ok(Array::new(shape, data, path, None))
}

/// Shape and entries in C order of the npy stream.
pub(crate) fn read_array<T: Element>(reader: &mut impl Read) -> Result<(Vec<usize>, Vec<T>), Cause> {
    let Header { dtype, fortran_order, shape } = Header::read(reader)?;
    let bytes = read_data(reader, &shape, dtype.size)?;
    let data = convert(&dtype, bytes)?;
    let data = if fortran_order && shape.len() > 1 { c_from_fortran(&shape, &data) } else { data };
    Ok((shape, data))
}

/// The bytes of the entries; grows with what is there, not with what the header says.
fn read_data(reader: &mut impl Read, shape: &[usize], item: usize) -> Result<Vec<u8>, Cause> {
    let size = shape.iter().try_fold(item, |size, &n| size.checked_mul(n));
    let expected = size.filter(|&size| size <= MAX_BYTES).ok_or_else(|| Cause::TooLarge(shape.to_vec()))?;
    let mut bytes = Vec::new();
    let found = reader.take(expected as u64).read_to_end(&mut bytes)?;
    if found < expected {
        return Err(Cause::Truncated { shape: shape.to_vec(), expected, found });
    }
    Ok(bytes)
}

fn convert<T: Element>(dtype: &Dtype, mut bytes: Vec<u8>) -> Result<Vec<T>, Cause> {
    if dtype.big_endian {
        bytes.chunks_exact_mut(dtype.size).for_each(<[u8]>::reverse);
    }
    let b = &bytes;
    let values = match (dtype.kind, dtype.size) {
        ('f', 2) => map(b, |v| T::from_f64(f16::from_le_bytes(v).to_f64())),
        ('f', 4) => map(b, |v| T::from_f64(f32::from_le_bytes(v).into())),
        ('f', _) => map(b, |v| T::from_f64(f64::from_le_bytes(v))),
        ('i', 1) => map(b, |v| T::from_i64(i8::from_le_bytes(v).into())),
        ('i', 2) => map(b, |v| T::from_i64(i16::from_le_bytes(v).into())),
        ('i', 4) => map(b, |v| T::from_i64(i32::from_le_bytes(v).into())),
        ('i', _) => map(b, |v| T::from_i64(i64::from_le_bytes(v))),
        (_, 1) => map(b, |v| T::from_u64(u8::from_le_bytes(v).into())),
        (_, 2) => map(b, |v| T::from_u64(u16::from_le_bytes(v).into())),
        (_, 4) => map(b, |v| T::from_u64(u32::from_le_bytes(v).into())),
        _ => map(b, |v| T::from_u64(u64::from_le_bytes(v))),
    };
    values.map_err(|index| Cause::Value { wanted: T::NAME, index, dtype: dtype.text.clone() })
}

/// Every entry of `K` bytes; the error is the index of the first that does not fit.
fn map<T, const K: usize>(bytes: &[u8], value: impl Fn([u8; K]) -> Option<T>) -> Result<Vec<T>, usize> {
    let entries = bytes.as_chunks::<K>().0.iter().enumerate();
    entries.map(|(index, entry)| value(*entry).ok_or(index)).collect()
}

/// Transposes the memory order: walks the C order while following the Fortran strides.
fn c_from_fortran<T: Copy>(shape: &[usize], data: &[T]) -> Vec<T> {
    let mut index = vec![0; shape.len()];
    let strides: Vec<usize> =
        shape.iter().scan(1, |stride, n| Some(std::mem::replace(stride, *stride * n))).collect();
    let mut out = Vec::with_capacity(data.len());
    for _ in 0..data.len() {
        out.push(data[index.iter().zip(&strides).map(|(i, s)| i * s).sum::<usize>()]);
        advance(&mut index, shape);
    }
    out
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
