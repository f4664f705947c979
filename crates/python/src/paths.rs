//! Stored paths of a drive.

use std::path::PathBuf;
use std::time::Duration;

use polepair::Axis;
use polepair::paths::{PathPreview, PathTable, PathUnit, PreviewEnd, path_words};
use polepair_core::axis::{Command, Verb};
use pyo3::prelude::*;

use crate::axis::PyAxis;
use crate::errors::{to_py_error, usage_error};
use crate::request::PyRequest;

/// A difference: number of the path, field, value before and after.
type ChangeTuple = (Option<u8>, &'static str, String, String);
/// Times in s, positions in the unit of the mechanics, and speeds in rpm.
type PreviewTuple = (Vec<f64>, Vec<f64>, Vec<f64>);

/// The paths of a drive, as in a file.
#[pyclass(name = "PathTable", module = "polepair", frozen, eq)]
#[derive(Clone, PartialEq, Debug)]
pub struct PyPathTable(PathTable);

/// A finding of a check of paths.
#[pyclass(name = "PathFinding", module = "polepair", frozen, get_all, eq)]
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct PyPathFinding {
    /// Number of the path; None for the mechanics.
    path: Option<u8>,
    /// True for what the drive refuses, or cannot do.
    is_error: bool,
    /// The finding in words.
    text: String,
}

#[pymethods]
impl PyPathFinding {
    fn __repr__(&self) -> String {
        let Self { path, is_error, text } = self;
        let path = path.map_or_else(|| "None".to_owned(), |path| path.to_string());
        let is_error = if *is_error { "True" } else { "False" };
        format!("PathFinding(path={path}, is_error={is_error}, text={text:?})")
    }
}

#[pymethods]
impl PyPathTable {
    /// Reads a table from the text of a file.
    #[staticmethod]
    fn parse(py: Python<'_>, text: &str) -> PyResult<Self> {
        let parsed = PathTable::parse("text", text);
        parsed.map(Self).map_err(|error| to_py_error(py, &error.into()))
    }

    /// Reads a file.
    #[staticmethod]
    fn load(py: Python<'_>, file: PathBuf) -> PyResult<Self> {
        PathTable::load(&file).map(Self).map_err(|error| to_py_error(py, &error))
    }

    fn __str__(&self) -> String {
        self.0.to_string()
    }

    fn __repr__(&self) -> String {
        let numbers: Vec<String> = self.0.paths.keys().map(u8::to_string).collect();
        format!("<PathTable: paths {}>", numbers.join(", "))
    }

    /// Turns of the motor in which the mechanics move by the travel.
    #[getter]
    fn motor_turns(&self) -> u16 {
        self.0.motor_turns
    }

    /// Travel of the mechanics, in `unit`.
    #[getter]
    fn travel(&self) -> u16 {
        self.0.travel
    }

    /// Unit of positions: deg or mm.
    #[getter]
    fn unit(&self) -> &'static str {
        self.0.unit.symbol()
    }

    /// Numbers of the paths.
    #[getter]
    fn numbers(&self) -> Vec<u16> {
        self.0.paths.keys().map(|number| u16::from(*number)).collect()
    }

    /// Fields of a path in words, with their names.
    fn words(&self, path: u8) -> Vec<(&'static str, String)> {
        path_words(&self.0.path(path), self.0.unit).to_vec()
    }

    /// Findings: what a drive refuses, and what may be intended.
    fn check(&self) -> Vec<PyPathFinding> {
        let findings = self.0.check().into_iter();
        let pack = |it: polepair::paths::PathFinding| PyPathFinding {
            path: it.path,
            is_error: it.is_error,
            text: it.text,
        };
        findings.map(pack).collect()
    }

    /// The paths that run when one of them is started, in words.
    fn chain(&self, path: u8) -> String {
        self.0.chain(path).to_string()
    }

    /// Differences of another table from this one.
    fn changes(&self, other: &Self) -> Vec<ChangeTuple> {
        change_tuples(&self.0, &other.0)
    }

    /// Runs a path on the motor model, from a position.
    fn preview(
        &self,
        py: Python<'_>,
        path: u8,
        start: f64,
        seconds: f64,
    ) -> PyResult<PreviewTuple> {
        let within = Duration::try_from_secs_f64(seconds)
            .map_err(|_| usage_error(py, "E217", "seconds are a positive time", ""))?;
        let start = (start * 1000.0).round() as i32;
        let preview = py.detach(|| self.0.preview(path, start, within));
        let preview = preview.map_err(|error| to_py_error(py, &error))?;
        if let PreviewEnd::Alarm(text) = preview.end {
            let what = format!("the model of the drive stops with an alarm: {text}");
            return Err(usage_error(py, "E102", &what, "look at speeds and ramps"));
        }
        Ok(preview_tuple(&preview))
    }
}

fn preview_tuple(preview: &PathPreview) -> PreviewTuple {
    let points = &preview.points;
    (
        points.iter().map(|point| point.time.as_secs_f64()).collect(),
        points.iter().map(|point| point.position).collect(),
        points.iter().map(|point| point.speed).collect(),
    )
}

fn change_tuples(from: &PathTable, to: &PathTable) -> Vec<ChangeTuple> {
    let changes = from.changes(to).into_iter();
    changes.map(|it| (it.path, it.field, it.from, it.to)).collect()
}

/// Reads the paths of a drive; `unit` is deg or mm, which the drive does not store.
#[pyfunction]
pub fn read_paths(py: Python<'_>, axis: &PyAxis, unit: Option<&str>) -> PyResult<PyPathTable> {
    let unit = match unit {
        None => None,
        Some("deg") => Some(PathUnit::Degree),
        Some("mm") => Some(PathUnit::Millimetre),
        Some(other) => {
            let what = format!("`{other}` is no unit of paths");
            return Err(usage_error(py, "E217", &what, "deg or mm"));
        }
    };
    axis.detach(py, |axis| PathTable::read(axis, unit, |_| {})).map(PyPathTable)
}

/// Writes a table to a drive, and returns the differences that it had.
#[pyfunction]
pub fn write_paths(
    py: Python<'_>,
    axis: &PyAxis,
    table: &PyPathTable,
    store: bool,
) -> PyResult<Vec<ChangeTuple>> {
    axis.detach(py, |axis| {
        let table = &table.0;
        let drive = PathTable::read(axis, Some(table.unit), |_| {})?;
        table.write(axis, &drive, store)?;
        Ok(change_tuples(&drive, &table.written_over(&drive)))
    })
}

/// Starts a path that is stored in the drive.
#[pyfunction]
pub fn start_path(py: Python<'_>, axis: &PyAxis, path: u8) -> PyResult<PyRequest> {
    let command = Command { path: Some(path.into()), ..Command::new(Verb::RunPath) };
    axis.start_request(py, |axis| axis.start(command))
}

/// Position of a drive in the unit of its mechanics.
#[pyfunction]
pub fn path_position(py: Python<'_>, axis: &PyAxis, table: &PyPathTable) -> PyResult<f64> {
    axis.detach(py, |axis| table.0.position(axis))
}

/// Measures the end of a run that began at `start`, in the unit of the mechanics.
#[pyfunction]
pub fn path_arrival(
    py: Python<'_>,
    axis: &PyAxis,
    table: &PyPathTable,
    path: u8,
    start: f64,
) -> PyResult<f64> {
    let measure = |axis: &Axis| table.0.check_arrival(axis, path, start);
    axis.detach(py, |axis| measure(axis)).map(|arrival| arrival.position)
}
