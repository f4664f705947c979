//! Opens links, and identifies their drives.

use std::ffi::CString;
use std::ops::ControlFlow;
use std::path::PathBuf;

use polepair::remote::{GatewayOptions, RemoteLink, find_gateway};
use polepair::{Connector, Error, Link as Inner, LocalLink, scan as library};
use polepair_core::medium::MediumKind;
use polepair_link::Connection;
use pyo3::exceptions::PyUserWarning;
use pyo3::prelude::*;

use crate::axis::PyAxis;
use crate::blocking::Blocking;
use crate::errors::to_py_error;
use crate::events::PyEvents;
use crate::guard;
use crate::process_local::ProcessLocal;
use crate::python_link;
use crate::simulation::PySimulation;
use crate::wiretrace::WireTrace;

/// An open link and its axes.
#[pyclass(frozen, name = "Link", module = "polepair._polepair")]
#[derive(Debug)]
pub struct PyLink {
    inner: ProcessLocal<Inner>,
    trace: Option<WireTrace>,
}

/// Opens a link by its connection string, or connects to a gateway; with `trace` it keeps the last units on its
/// wires.
#[pyfunction]
#[pyo3(signature = (
    url, profile=None, trace=false, token_file=None, certificate=None, client_cert=None,
    client_key=None
))]
#[expect(clippy::too_many_arguments, reason = "they are what a caller may state")]
pub fn connect(
    py: Python<'_>,
    url: String,
    profile: Option<PathBuf>,
    trace: bool,
    token_file: Option<PathBuf>,
    certificate: Option<String>,
    client_cert: Option<PathBuf>,
    client_key: Option<PathBuf>,
) -> PyResult<PyLink> {
    if polepair::interface::is_gateway(&url) {
        let options = GatewayOptions {
            token_file,
            certificate,
            client_cert,
            client_key,
            ..GatewayOptions::default()
        };
        let found = py.detach(|| {
            let (gateway, axes) = find_gateway(&url, options)?;
            Ok((gateway, axes.map(str::to_owned)))
        });
        let (gateway, axes) = found.map_err(|error: Error| to_py_error(py, &error))?;
        let its = gateway.clone();
        let link = Blocking::start(&gateway, move || {
            RemoteLink::open(its, axes.as_deref()).map(Inner::from)
        })
        .wait(py)?;
        return Ok(PyLink { inner: link.into(), trace: None });
    }
    let trace = trace.then(WireTrace::default);
    let connector = build_connector(py, profile)?;
    let opened = py.detach(|| match trace.clone() {
        Some(trace) => connector.with_taps(move |wire| trace.tap(wire)).connect(&url),
        None => connector.connect(&url),
    });
    let opened = opened.map_err(|error| to_py_error(py, &error))?;
    Ok(PyLink { inner: opened.into(), trace })
}

/// Identifies the drives on an adapter that Python opened: a bus if `can`, else a serial port.
#[pyfunction]
#[pyo3(signature = (adapter, name, can, protocol, axes, query, profile=None))]
#[expect(clippy::too_many_arguments, reason = "they are a connection string's parts")]
pub fn connect_over(
    py: Python<'_>,
    adapter: Py<PyAny>,
    name: String,
    can: bool,
    protocol: &str,
    axes: Vec<u32>,
    query: &str,
    profile: Option<PathBuf>,
) -> PyResult<PyLink> {
    let medium = if can { MediumKind::Can } else { MediumKind::Serial };
    let link = python_link::open_link(name, adapter, medium)?;
    let connector = build_connector(py, profile)?;
    let opened = py.detach(|| connector.connect_over(link, protocol, &axes, query));
    let opened = opened.map_err(|error| to_py_error(py, &error))?;
    Ok(PyLink { inner: Inner::from(opened).into(), trace: None })
}

/// Scans a link, and gives address, product, title, firmware and clash of each; only reads are sent. `progress` is
/// called with address, done and of, and may return False to end the scan. The second value is true if a CANopen device
/// without node-ID answered.
#[pyfunction]
#[pyo3(signature = (url, first=None, last=None, profile=None, progress=None))]
pub fn scan(
    py: Python<'_>,
    url: &str,
    first: Option<u32>,
    last: Option<u32>,
    profile: Option<PathBuf>,
    progress: Option<Py<PyAny>>,
) -> PyResult<(Vec<FoundTuple>, bool)> {
    let mut broken = None;
    let connector = build_connector(py, profile)?;
    let found = py.detach(|| {
        let mut report_line = |now: library::ScanProgress| {
            let goes_on = Python::attach(|py| {
                py.check_signals()?;
                let Some(progress) = &progress else { return Ok(true) };
                let answer = progress.call1(py, (now.number, now.done, now.of))?;
                Ok::<_, PyErr>(answer.is_none(py) || answer.is_truthy(py)?)
            });
            match goes_on {
                Ok(true) => ControlFlow::Continue(()),
                Ok(false) => ControlFlow::Break(()),
                Err(error) => {
                    broken = Some(error);
                    ControlFlow::Break(())
                }
            }
        };
        let range = first.map(|first| first..=last.unwrap_or(first));
        let range = range.map_or(library::ScanAddresses::ALL, library::ScanAddresses::from);
        library::scan(&connector, url, range, &mut report_line)
    });
    if let Some(error) = broken {
        return Err(error);
    }
    let scan = found.map_err(|error| to_py_error(py, &error))?;
    if let Some(lost) = scan.link_error {
        let (found, unasked) = (scan.found.len(), scan.not_queried);
        let error = polepair::Error::from(lost);
        let what =
            format!("{error}; {found} drives had answered, {unasked} addresses were not tried");
        return Err(crate::errors::to_py_error_with(py, &error, &what));
    }
    Ok((scan.found.into_iter().map(found_tuple).collect(), scan.has_unconfigured))
}

/// Address, product, title, how it was identified, clash.
type FoundTuple = (u32, &'static str, &'static str, String, Option<String>);

/// Wire, overrun, malformed, errors, refused.
type LossesTuple = (String, u64, u64, u64, u64);

fn found_tuple(found: library::DetectedDrive) -> FoundTuple {
    let profile = found.profile;
    (found.number, profile.name, profile.title, found.identified.to_string(), found.clash)
}

/// Every product that is known: name, title, protocol.
#[pyfunction]
pub fn profiles() -> Vec<(&'static str, &'static str, &'static str)> {
    polepair::profile::shipped_profiles().map(|p| (p.name, p.title, p.protocol)).collect()
}

/// Connector for new links. A wrong configuration file is reported once, as a Python warning, and affects only links
/// that need it.
pub(crate) fn build_connector(py: Python<'_>, profile: Option<PathBuf>) -> PyResult<Connector> {
    let connector = py.detach(Connector::discover);
    let category = py.get_type::<PyUserWarning>();
    for error in &connector.config.broken {
        let text = format!("{error}; nothing of this file is used").replace('\0', " ");
        PyErr::warn(py, &category, &CString::new(text)?, 1)?;
    }
    match profile {
        Some(file) => {
            py.detach(|| connector.with_profile(&file)).map_err(|error| to_py_error(py, &error))
        }
        None => Ok(connector),
    }
}

#[pymethods]
impl PyLink {
    /// Connection string of the link.
    #[getter]
    fn url(&self) -> String {
        self.inner.url()
    }

    /// Returns whether it belongs to a gateway.
    #[getter]
    fn is_remote(&self) -> bool {
        self.inner.remote().is_some()
    }

    /// Every axis, in order.
    fn axes(&self, py: Python<'_>) -> PyResult<Vec<PyAxis>> {
        Ok(self.inner.in_own_process(py)?.axes().iter().cloned().map(PyAxis::from).collect())
    }

    /// The axis of that number.
    fn axis(&self, py: Python<'_>, number: u32) -> PyResult<PyAxis> {
        self.inner
            .in_own_process(py)?
            .axis(number)
            .map(PyAxis::from)
            .map_err(|error| to_py_error(py, &error))
    }

    /// The axis with that name; on a gateway also `LINK#NUMBER`.
    fn named(&self, py: Python<'_>, name: &str) -> PyResult<PyAxis> {
        self.inner
            .in_own_process(py)?
            .axis_named(name)
            .map(PyAxis::from)
            .map_err(|error| to_py_error(py, &error))
    }

    /// Stops every axis; the first error, after every one was tried.
    fn stop_all(&self, py: Python<'_>) -> PyResult<()> {
        let link = self.inner.in_own_process(py)?;
        if let Some(remote) = link.remote().cloned() {
            let gateway = remote.gateway().clone();
            return Blocking::start(&gateway, move || remote.stop_all()).wait(py);
        }
        py.detach(|| link.stop_all()).map_err(|error| to_py_error(py, &error))
    }

    /// Listens to what happens on every wire and axis from now on.
    fn events(&self, py: Python<'_>) -> PyResult<PyEvents> {
        let link =
            self.local(py, "events", "watch signals, or read `state()` and `faults()` again")?;
        let events = py.detach(|| link.events()).map_err(|error| to_py_error(py, &error))?;
        Ok(PyEvents::new(events, link.axes().to_vec()))
    }

    /// The simulation behind it, if it is one.
    #[getter]
    fn simulation(&self, py: Python<'_>) -> PyResult<Option<PySimulation>> {
        let hint = "change its simulated drives on its page, or open `sim:` in this program";
        let link = self.local(py, "its simulation", hint)?;
        Ok(link.simulation().cloned().map(PySimulation::from))
    }

    /// Losses of its wires: of each its name, units that were not read in time, malformed units, errors that the
    /// controller reported, units that were not sent.
    fn losses(&self, py: Python<'_>) -> PyResult<Vec<LossesTuple>> {
        let link = self.local(py, "losses of wires", "its page counts what each link lost")?;
        Ok(py.detach(|| {
            let mut seen: Vec<&Connection> = Vec::new();
            for axis in link.axes() {
                if seen.iter().all(|other| !other.is_same(axis.connection())) {
                    seen.push(axis.connection());
                }
            }
            seen.into_iter()
                .map(|wire| {
                    let lost = wire.losses();
                    (wire.describe(), lost.overrun, lost.malformed, lost.errors, lost.refused)
                })
                .collect()
        }))
    }

    /// Stops, disables and disarms what this program armed of it, and raises what went wrong.
    fn stop_armed(&self, py: Python<'_>) -> PyResult<()> {
        let link = self.inner.in_own_process(py)?.clone();
        let stopped = py.detach(|| match (link.local(), link.remote()) {
            (Some(local), _) => guard::stop_link(local),
            (None, Some(remote)) => remote.stop_armed(),
            (None, None) => Ok(()),
        });
        stopped.map_err(|error| to_py_error(py, &error))
    }

    /// Closes it at once, though Python still holds axes of it.
    fn close(&self, py: Python<'_>) -> PyResult<()> {
        let link = self.inner.in_own_process(py)?.clone();
        py.detach(|| link.close());
        Ok(())
    }

    /// The last units on its wires, as the lines of a capture; `None` unless it was opened with `trace`.
    fn trace(&self, py: Python<'_>) -> PyResult<Option<Vec<String>>> {
        let hint = "its page shows frames; or open the link in this program, trace=True";
        self.local(py, "frames", hint)?;
        Ok(self.trace.as_ref().map(WireTrace::lines))
    }
}

impl PyLink {
    /// The link, if this program opened its wires.
    fn local(&self, py: Python<'_>, what: &str, hint: &str) -> PyResult<&LocalLink> {
        let link = self.inner.in_own_process(py)?;
        link.require_local(what, hint).map_err(|error| to_py_error(py, &error))
    }
}
