//! Errors and panics on their way to Python.

use std::any::Any;
use std::error::Error;
use std::panic::{AssertUnwindSafe, catch_unwind};

use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use supple::util::terminal::complaint;

/// What was given is not what it should be: `ValueError`.
pub fn refused(error: impl Error) -> PyErr {
    PyValueError::new_err(complaint(&error))
}

/// What was given is fine, and it did not work all the same: `RuntimeError`.
pub fn failed(error: impl Error) -> PyErr {
    PyRuntimeError::new_err(complaint(&error))
}

/// Works without the interpreter's lock. A panic, which is a defect of ours, becomes a `RuntimeError`.
pub fn apart<T: Send>(py: Python<'_>, work: impl FnOnce() -> PyResult<T> + Send) -> PyResult<T> {
    py.detach(|| catch_unwind(AssertUnwindSafe(work))).unwrap_or_else(|panic| {
        let words = words(&*panic);
        Err(PyRuntimeError::new_err(format!("this is a defect of supple, please report it: {words}")))
    })
}

/// Returns the message of a panic.
fn words(panic: &(dyn Any + Send)) -> &str {
    let text = panic.downcast_ref::<String>().map(String::as_str);
    text.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("a panic without words")
}

/// Panics where the real work is done, for the test that no panic gets through.
#[pyfunction]
#[pyo3(name = "_panic")]
pub fn panic(py: Python<'_>) -> PyResult<()> {
    apart(py, || panic!("asked for by a test"))
}
