//! Converts errors of the library to the exceptions of the Python part.

use polepair::Error;
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use pyo3::types::PyType;

/// The exceptions of `polepair.errors`, looked up once.
static CLASSES: PyOnceLock<Py<PyModule>> = PyOnceLock::new();

/// The exception for an error: its class by blame, its code, its hint, and whether the drive did
/// executed it.
pub fn to_py_error(py: Python<'_>, error: &Error) -> PyErr {
    let made = exception_class(py, error.exception().name()).and_then(|class| {
        class.call1((error.to_string(), error.code(), error.executed(), error.hint()))
    });
    made.map_or_else(|error| error, PyErr::from_value)
}

/// The exception for an error, with a further sentence.
pub fn to_py_error_with(py: Python<'_>, error: &Error, what: &str) -> PyErr {
    let made = exception_class(py, error.exception().name())
        .and_then(|class| class.call1((what, error.code(), error.executed(), error.hint())));
    made.map_or_else(|error| error, PyErr::from_value)
}

/// The exception for the caller's words, where the library was not asked.
pub fn usage_error(py: Python<'_>, code: &str, what: &str, hint: &str) -> PyErr {
    let made = exception_class(py, "Unsupported");
    let made = made.and_then(|class| class.call1((what, code, Some(false), hint)));
    made.map_or_else(|error| error, PyErr::from_value)
}

/// The exception for corrupt bytes.
pub fn corrupt_error(py: Python<'_>, what: &str) -> PyErr {
    let made = exception_class(py, "ProtocolError");
    let made = made.and_then(|class| class.call1((what, "E501", Some(false), "")));
    made.map_or_else(|error| error, PyErr::from_value)
}

fn exception_class<'py>(py: Python<'py>, name: &str) -> PyResult<Bound<'py, PyType>> {
    let module = CLASSES.get_or_try_init(py, || py.import("polepair.errors").map(Bound::unbind))?;
    Ok(module.bind(py).getattr(name)?.cast_into::<PyType>()?)
}
