//! The `polepair` program that the package installs.

use std::ffi::OsString;

use pyo3::prelude::*;

/// Runs the program with its command line, of which the first word is its own name, and returns its exit code. `python`
/// is the interpreter in `--version`.
#[pyfunction]
pub fn run_command(py: Python<'_>, command_line: Vec<OsString>, python: &str) -> u8 {
    let (program, module) = (polepair_cli::VERSION, env!("CARGO_PKG_VERSION"));
    let version = format!("{program} (Python module {module}, {python})");
    py.detach(|| polepair_cli::run(command_line, &version))
}
