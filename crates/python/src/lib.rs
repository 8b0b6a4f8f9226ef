//! The native half of the Python package `fastflowgs`: what `python/fastflowgs/__init__.py` offers, over the crates of the program.
// Its `#[pymodule]` and `#[pyclass]` expand to calls of Python's C interface.
#![allow(unsafe_code, reason = "written by the macros of pyo3")]
#![allow(clippy::needless_pass_by_value, reason = "pyo3 hands over what it made of Python's values")]

mod arrays;
mod capture;
mod frame;
mod program;
mod run;
mod stream;

use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;

pyo3::create_exception!(
    fastflowgs,
    Error,
    PyRuntimeError,
    "What the program refuses or cannot do; the message names the file."
);

/// An error with its causes, as Python's.
fn failed(error: impl Into<anyhow::Error>) -> PyErr {
    Error::new_err(format!("{:#}", error.into()))
}

#[pymodule(name = "_native")]
fn native(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("Error", module.py().get_type::<Error>())?;
    module.add_class::<capture::PyCapture>()?;
    module.add_class::<frame::Frame>()?;
    module.add_class::<run::Run>()?;
    module.add_class::<stream::Stream>()?;
    module.add_function(wrap_pyfunction!(program::stage, module)?)?;
    module.add_function(wrap_pyfunction!(program::train_first_frame, module)?)?;
    module.add_function(wrap_pyfunction!(program::reconstruct, module)?)
}
