//! An n-dimensional array in memory, as numpy files hold it: a shape and entries in C order.

use crate::{ArraysError, Cause};
use std::path::{Path, PathBuf};

/// An n-dimensional array in C order. Invariant: `data.len()` is the product of `shape`.
#[derive(Clone, Debug)]
pub struct Array<T> {
    /// Lengths of the axes; empty for a scalar.
    pub shape: Vec<usize>,
    /// Entries, last axis fastest.
    pub data: Vec<T>,
    file: PathBuf,
    key: Option<String>,
}

impl<T> Array<T> {
    pub(crate) fn new(shape: Vec<usize>, data: Vec<T>, file: &Path, key: Option<&str>) -> Self {
        Self { shape, data, file: file.to_owned(), key: key.map(str::to_owned) }
    }

    /// The only entry of an array with one entry (shape `()` or all ones).
    ///
    /// # Errors
    /// When the array has another shape than one value.
    pub fn scalar(&self) -> Result<T, ArraysError>
    where
        T: Copy,
    {
        if let [value] = self.data[..] {
            return Ok(value);
        }
        let cause = Cause::Shape { expected: "() or (1,)".to_owned(), found: self.shape.clone() };
        Err(ArraysError::new(&self.file, self.key.as_deref(), cause))
    }

    /// The entries in rows of `K`; `None` when the count is not a multiple of `K`.
    pub fn rows<const K: usize>(&self) -> Option<&[[T; K]]> {
        let (rows, rest) = self.data.as_chunks::<K>();
        rest.is_empty().then_some(rows)
    }
}

/// Whether a shape is the expected one; `None` stands for any length of that axis.
pub(crate) fn fits(shape: &[usize], expected: &[Option<usize>]) -> bool {
    shape.len() == expected.len() && shape.iter().zip(expected).all(|(n, e)| e.is_none_or(|e| e == *n))
}

pub(crate) fn shape_text(shape: &[Option<usize>]) -> String {
    let axes: Vec<_> = shape.iter().map(|n| n.map_or("*".to_owned(), |n| n.to_string())).collect();
    format!("({})", axes.join(", "))
}
