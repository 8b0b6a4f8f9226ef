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

    /// Refuses any other shape; `None` stands for any length of that axis. Returns the array for chaining.
    pub fn expect_shape(self, expected: &[Option<usize>]) -> Result<Self, ArraysError> {
        let axes = self.shape.iter().zip(expected);
        let fits =
            self.shape.len() == expected.len() && axes.into_iter().all(|(n, e)| e.is_none_or(|e| e == *n));
        if fits { Ok(self) } else { Err(self.shape_error(shape_text(expected))) }
    }

    /// The only entry of an array with one entry (shape `()` or all ones).
    pub fn scalar(&self) -> Result<T, ArraysError>
    where
        T: Copy,
    {
        match self.data[..] {
            [value] => Ok(value),
            _ => Err(self.shape_error("() or (1,)".to_owned())),
        }
    }

    /// The entries in rows of `K`; `None` when the count is not a multiple of `K`.
    pub fn rows<const K: usize>(&self) -> Option<&[[T; K]]> {
        let (rows, rest) = self.data.as_chunks::<K>();
        rest.is_empty().then_some(rows)
    }

    fn shape_error(&self, expected: String) -> ArraysError {
        let cause = Cause::Shape { expected, found: self.shape.clone() };
        ArraysError::new(&self.file, self.key.as_deref(), cause)
    }
}

fn shape_text(shape: &[Option<usize>]) -> String {
    let axes: Vec<_> = shape.iter().map(|n| n.map_or("*".to_owned(), |n| n.to_string())).collect();
    format!("({})", axes.join(", "))
}
