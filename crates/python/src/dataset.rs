//! Captures of a data set, for `polepair.fleet`.

use std::path::PathBuf;

use polepair_cli::dataset::{self, DatasetError};
use pyo3::exceptions::PyOSError;
use pyo3::prelude::*;

use crate::errors::usage_error;

/// Whether a name ends as the names of captures do.
#[pyfunction]
pub fn is_capture_name(name: &str) -> bool {
    dataset::is_capture_name(name)
}

/// BLAKE3 of a file's bytes, hexadecimal.
#[pyfunction]
pub fn fingerprint(py: Python<'_>, path: PathBuf) -> PyResult<String> {
    py.detach(|| polepair_columns::fingerprint(&path))
        .map_err(|error| PyOSError::new_err(format!("{}: {error}", path.display())))
}

/// Checks options of `polepair decode`, and gives all that a decoded capture depends on beside itself.
#[pyfunction]
pub fn decode_inputs(py: Python<'_>, options: Vec<String>) -> PyResult<String> {
    dataset::decode_inputs(&options).map_err(|error| to_py_error(py, &error))
}

/// Decodes a capture into a data set. Gives whether it was not there before, and what was left out or is
/// doubtful.
#[pyfunction]
pub fn decode_to_dataset(
    py: Python<'_>,
    path: PathBuf,
    name: &str,
    root: PathBuf,
    options: Vec<String>,
) -> PyResult<(bool, Vec<String>)> {
    let decoded = py.detach(|| dataset::decode_capture(&path, name, &root, &options));
    let capture = decoded.map_err(|error| to_py_error(py, &error))?;
    Ok((capture.is_new, capture.remarks))
}

fn to_py_error(py: Python<'_>, error: &DatasetError) -> PyErr {
    match error.is_io {
        true => PyOSError::new_err(format!("{} ({})", error.message, error.code)),
        false => usage_error(py, &error.code, &error.message, &error.hint),
    }
}
