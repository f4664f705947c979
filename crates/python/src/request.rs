//! A request that is being executed: awaited by a thread or an event loop.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Wake, Waker};

use polepair::interface::{AxisRequest, ReadValue, Reply};
use pyo3::prelude::*;

use crate::blocking::wait_sliced;
use crate::errors::{to_py_error, usage_error};
use crate::process_local::ProcessLocal;

/// A request that is being executed. Dropped before its end, it continues.
#[pyclass(frozen, name = "Request", module = "polepair._polepair")]
#[derive(Debug)]
pub struct PyRequest(ProcessLocal<Mutex<AxisRequest>>);

/// A parameter as a gateway read it.
#[pyclass(frozen, name = "Reading", module = "polepair._polepair")]
#[derive(Debug)]
pub struct PyReading(pub ReadValue);

/// The result of a request.
#[derive(IntoPyObject)]
pub enum Output {
    /// A raw number.
    Raw(i64),
    /// A gateway's reading.
    Reading(PyReading),
}

#[pymethods]
impl PyReading {
    /// The raw number.
    fn __index__(&self, py: Python<'_>) -> PyResult<i64> {
        self.0.require_raw("the parameter").map_err(|error| to_py_error(py, &error))
    }
}

impl PyRequest {
    pub fn new(request: AxisRequest) -> Self {
        Self(Mutex::new(request).into())
    }

    /// Waits for the end, however long that takes.
    pub fn finish(&self, py: Python<'_>) -> PyResult<Reply> {
        let ended = wait_sliced(py, None, |slice| self.lock().wait(slice))?;
        ended.ok_or_else(|| usage_error(py, "E299", "the request had no result", ""))
    }

    fn lock(&self) -> MutexGuard<'_, AxisRequest> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[pymethods]
impl PyRequest {
    /// Waits for the end, at most `timeout` seconds, and returns the last value that was read; `None` if it
    /// continues.
    #[pyo3(signature = (timeout=None))]
    fn result(&self, py: Python<'_>, timeout: Option<f64>) -> PyResult<Option<Output>> {
        self.0.in_own_process(py)?;
        let ended = wait_sliced(py, timeout, |slice| self.lock().wait(slice))?;
        Ok(ended.map(|reply| match reply {
            Reply::Raw(raw) => Output::Raw(raw),
            Reply::Reading(reading) => Output::Reading(PyReading(reading)),
        }))
    }

    /// Calls `wake` from some thread once the request has ended; true if it has already.
    #[pyo3(name = "tell")]
    fn wake_when_done(&self, py: Python<'_>, wake: Py<PyAny>) -> PyResult<bool> {
        self.0.in_own_process(py)?;
        let waker = Waker::from(Arc::new(WakeCallback(wake)));
        Ok(py.detach(|| self.lock().poll_or_wake(&waker)))
    }
}

/// A Python function that is called when a request has ended, or something happened.
pub struct WakeCallback(pub Py<PyAny>);

impl Wake for WakeCallback {
    fn wake(self: Arc<Self>) {
        Python::attach(|py| {
            // An event loop that is closed wants to hear of nothing any more.
            let _ = self.0.call0(py);
        });
    }
}
