//! Captures of a data set, for `polepair.fleet`.

use std::path::{Path, PathBuf};

use polepair_cli::dataset::{self, DatasetError};
use polepair_columns::{CaptureContent, CaptureFile, DatasetLock};
use pyo3::exceptions::PyOSError;
use pyo3::prelude::*;
use pyo3::types::PyTuple;

use crate::errors::usage_error;

/// Returns whether a name ends as the names of captures do.
#[pyfunction]
pub fn is_capture_name(name: &str) -> bool {
    dataset::is_capture_name(name)
}

/// The content of a capture as a line: BLAKE3, bytes, BLAKE3 of the part that stays while it grows, and `place`.
#[pyfunction]
pub fn capture_content(py: Python<'_>, path: PathBuf, place: String) -> PyResult<String> {
    let capture = py.detach(|| CaptureFile::read_copy(&path, "", place));
    Ok(capture.map_err(|error| file_error(&path, &error))?.content().to_line())
}

/// Earlier contents, as lines, of which a capture is a continuation.
#[pyfunction]
pub fn grown_from(
    py: Python<'_>,
    path: PathBuf,
    place: String,
    contents: Vec<String>,
) -> PyResult<Vec<String>> {
    let earlier: Vec<_> =
        contents.iter().filter_map(|line| CaptureContent::from_line(line)).collect();
    let grown = py.detach(|| CaptureFile::read_copy(&path, "", place)?.grown_from(&earlier));
    let grown = grown.map_err(|error| file_error(&path, &error))?;
    Ok(grown.iter().map(CaptureContent::to_line).collect())
}

/// BLAKE3 of a text, hexadecimal.
#[pyfunction]
pub fn text_hash(text: &str) -> String {
    polepair_columns::text_hash(text)
}

/// Keeps other programs on this machine from publishing parts of a data set, as a context manager.
#[pyclass(name = "DatasetLock")]
#[derive(Debug)]
pub struct PyDatasetLock {
    root: PathBuf,
    held: Option<DatasetLock>,
}

#[pymethods]
impl PyDatasetLock {
    #[new]
    fn new(root: PathBuf) -> Self {
        Self { root, held: None }
    }

    fn __enter__(&mut self, py: Python<'_>) -> PyResult<()> {
        let root = self.root.clone();
        let held = py.detach(|| DatasetLock::acquire(&root));
        self.held = Some(held.map_err(|error| file_error(&root, &error))?);
        Ok(())
    }

    #[pyo3(signature = (*_error))]
    fn __exit__(&mut self, _error: &Bound<'_, PyTuple>) {
        self.held = None;
    }
}

fn file_error(path: &Path, error: &std::io::Error) -> PyErr {
    PyOSError::new_err(format!("{}: {error}", path.display()))
}

/// Checks options of `polepair decode`, and gives all that a decoded capture depends on beside itself.
#[pyfunction]
pub fn decode_inputs(py: Python<'_>, options: Vec<String>) -> PyResult<String> {
    dataset::decode_inputs(&options).map_err(|error| to_py_error(py, &error))
}

/// Decodes a capture into a data set. Returns whether it was new there, and its omissions and
/// doubts.
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
    if error.is_io {
        PyOSError::new_err(format!("{} ({})", error.message, error.code))
    } else {
        usage_error(py, &error.code, &error.message, &error.hint)
    }
}
