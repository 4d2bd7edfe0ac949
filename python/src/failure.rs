//! Conversion of errors and panics to Python exceptions.

use std::any::Any;
use std::error::Error;
use std::panic::{AssertUnwindSafe, catch_unwind};

use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use supple::util::terminal::complaint;

/// Converts an error about an invalid argument to `ValueError`.
pub fn refused(error: impl Error) -> PyErr {
    PyValueError::new_err(complaint(&error))
}

/// Converts any other error to `RuntimeError`.
pub fn failed(error: impl Error) -> PyErr {
    PyRuntimeError::new_err(complaint(&error))
}

/// Runs `work` without the interpreter's lock. A panic, which is a defect of Supple, becomes a `RuntimeError`.
pub fn apart<T: Send>(py: Python<'_>, work: impl FnOnce() -> PyResult<T> + Send) -> PyResult<T> {
    py.detach(|| catch_unwind(AssertUnwindSafe(work))).unwrap_or_else(|panic| {
        let words = words(&*panic);
        Err(PyRuntimeError::new_err(format!("this is a defect of supple, please report it: {words}")))
    })
}

/// Returns the message of a panic.
fn words(panic: &(dyn Any + Send)) -> &str {
    let text = panic.downcast_ref::<String>().map(String::as_str);
    text.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("a panic without a message")
}

/// Panics inside [`apart`], to test that a panic becomes an exception.
#[pyfunction]
#[pyo3(name = "_panic")]
pub fn panic(py: Python<'_>) -> PyResult<()> {
    apart(py, || panic!("asked for by a test"))
}
