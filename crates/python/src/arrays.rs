//! Columns as numpy arrays, and back.

use bytemuck::NoUninit;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyBytes;

/// A type of numpy's.
pub(crate) trait Element: NoUninit {
    /// Its name there.
    const NAME: &'static str;
}

impl Element for f32 {
    const NAME: &'static str = "float32";
}

impl Element for f64 {
    const NAME: &'static str = "float64";
}

impl Element for u32 {
    const NAME: &'static str = "uint32";
}

impl Element for u8 {
    const NAME: &'static str = "uint8";
}

/// A copy of values as an array of a shape, row-major.
pub(crate) fn array<'py, T: Element>(
    py: Python<'py>,
    values: &[T],
    shape: &[usize],
) -> PyResult<Bound<'py, PyAny>> {
    let bytes = PyBytes::new(py, bytemuck::cast_slice(values));
    let flat = py.import("numpy")?.call_method1("frombuffer", (bytes, T::NAME))?;
    // What shares the memory of bytes cannot be written.
    flat.call_method1("reshape", (shape.to_vec(),))?.call_method0("copy")
}

/// An (N, 3) array of any number type as rows.
pub(crate) fn rows(values: &Bound<'_, PyAny>, n: usize) -> PyResult<Vec<[f32; 3]>> {
    let numpy = values.py().import("numpy")?;
    let values = numpy.call_method1("ascontiguousarray", (values, f32::NAME))?;
    let shape: Vec<usize> = values.getattr("shape")?.extract()?;
    if shape != [n, 3] {
        return Err(PyValueError::new_err(format!("an array of shape ({n}, 3) is needed, not {shape:?}")));
    }
    let bytes = values.call_method0("tobytes")?;
    // Python's bytes need not be aligned.
    Ok(bytemuck::pod_collect_to_vec(bytes.cast::<PyBytes>()?.as_bytes()))
}
