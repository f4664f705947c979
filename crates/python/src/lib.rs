//! The native half of the Python package: links, axes, requests under way, simulations, captures.
//!
//! ```text
//!   polepair (Python)   names, units, context managers, asyncio, pytest and python-can plugins
//!    └ _polepair        this module: everything that blocks lets other Python threads go on
//!       └ polepair      the library
//! ```
//!
//! Nothing here decides anything: verbs and parameters are defined in the library, and their Python spelling in the
//! Python half.
#![deny(unsafe_code)]

mod axis;
mod blocking;
mod bus;
mod capture;
mod codec;
mod columns;
mod command;
mod coupling;
mod dataset;
mod drive_log;
mod errors;
mod events;
mod explain;
mod fault;
mod guard;
mod layout;
mod link;
mod lss;
mod paths;
mod process_local;
mod python_link;
mod request;
mod simulation;
mod watch;
mod wiretrace;

use mimalloc::MiMalloc;
use pyo3::prelude::*;

/// Columns of a capture take and give back much memory in short order. This allocator keeps returned memory
/// for a while; the system's own gives it back, and fetches it anew page by page (PY-4).
#[global_allocator]
static MEMORY: MiMalloc = MiMalloc;

/// The native module.
#[pymodule]
fn _polepair(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add_class::<link::PyLink>()?;
    module.add_class::<axis::PyAxis>()?;
    module.add_class::<axis::PyParameter>()?;
    module.add_class::<request::PyRequest>()?;
    module.add_class::<events::PyEvents>()?;
    module.add_class::<bus::CanWire>()?;
    module.add_class::<lss::PyLssMaster>()?;
    module.add_class::<request::PyReading>()?;
    module.add_class::<axis::PyWriteAmount>()?;
    module.add_class::<watch::PyWatch>()?;
    module.add_class::<simulation::PySimulation>()?;
    module.add_class::<simulation::Truth>()?;
    module.add_class::<capture::Decoder>()?;
    module.add_class::<capture::PyFrame>()?;
    module.add_class::<columns::Columns>()?;
    module.add_class::<columns::Lent>()?;
    module.add_class::<codec::Codec>()?;
    module.add_class::<layout::Layout>()?;
    module.add_function(wrap_pyfunction!(link::connect, module)?)?;
    module.add_function(wrap_pyfunction!(link::connect_over, module)?)?;
    module.add_function(wrap_pyfunction!(link::scan, module)?)?;
    module.add_function(wrap_pyfunction!(link::profiles, module)?)?;
    module.add_function(wrap_pyfunction!(simulation::rack_of_word, module)?)?;
    module.add_function(wrap_pyfunction!(axis::begin_together, module)?)?;
    module.add_function(wrap_pyfunction!(axis::is_signal, module)?)?;
    module.add_function(wrap_pyfunction!(coupling::follow_gear, module)?)?;
    module.add_function(wrap_pyfunction!(coupling::follow_cam, module)?)?;
    module.add_function(wrap_pyfunction!(coupling::uncouple, module)?)?;
    module.add_class::<paths::PyPathTable>()?;
    module.add_class::<paths::PyPathFinding>()?;
    module.add_function(wrap_pyfunction!(paths::read_paths, module)?)?;
    module.add_function(wrap_pyfunction!(paths::write_paths, module)?)?;
    module.add_function(wrap_pyfunction!(paths::start_path, module)?)?;
    module.add_function(wrap_pyfunction!(paths::path_position, module)?)?;
    module.add_function(wrap_pyfunction!(paths::path_arrival, module)?)?;
    module.add_function(wrap_pyfunction!(process_local::forked, module)?)?;
    module.add_function(wrap_pyfunction!(guard::stop_each, module)?)?;
    module.add_function(wrap_pyfunction!(guard::stop_armed, module)?)?;
    module.add_function(wrap_pyfunction!(command::run_command, module)?)?;
    module.add_function(wrap_pyfunction!(dataset::is_capture_name, module)?)?;
    module.add_function(wrap_pyfunction!(dataset::capture_content, module)?)?;
    module.add_function(wrap_pyfunction!(dataset::grown_from, module)?)?;
    module.add_function(wrap_pyfunction!(dataset::text_hash, module)?)?;
    module.add_class::<dataset::PyDatasetLock>()?;
    module.add_function(wrap_pyfunction!(dataset::decode_inputs, module)?)?;
    module.add_function(wrap_pyfunction!(dataset::decode_to_dataset, module)?)?;
    module.add_function(wrap_pyfunction!(explain::explain, module)?)?;
    module.add_function(wrap_pyfunction!(explain::explain_code, module)?)
}
