//! A request that is being executed: awaited by a thread or an event loop.

use std::sync::{Arc, Mutex, PoisonError};
use std::task::{Wake, Waker};
use std::time::Duration;

use polepair::RunningRequest;
use pyo3::prelude::*;

use crate::errors::to_py_error;
use crate::process_local::ProcessLocal;

/// How long a wait goes on before it looks whether Ctrl-C was pressed.
pub const WAIT_SLICE: Duration = Duration::from_millis(50);

/// A request under way. Dropped before its end, it goes on by itself.
#[pyclass(frozen, name = "Request", module = "polepair._polepair")]
#[derive(Debug)]
pub struct PyRequest(ProcessLocal<Mutex<RunningRequest>>);

impl PyRequest {
    pub fn new(running: RunningRequest) -> Self {
        Self(Mutex::new(running).into())
    }
}

#[pymethods]
impl PyRequest {
    /// Waits for the end, at most `timeout` seconds, and gives the last value that was read;
    /// `None` when it goes on.
    #[pyo3(signature = (timeout=None))]
    pub fn result(&self, py: Python<'_>, timeout: Option<f64>) -> PyResult<Option<i64>> {
        self.0.in_own_process(py)?;
        let mut left = timeout.map(|s| Duration::try_from_secs_f64(s).unwrap_or(Duration::ZERO));
        loop {
            let slice = left.map_or(WAIT_SLICE, |left| left.min(WAIT_SLICE));
            let ended = py.detach(|| self.lock().wait(slice)).map_err(|e| to_py_error(py, &e))?;
            left = left.map(|left| left - slice);
            if ended.is_some() || left == Some(Duration::ZERO) {
                return Ok(ended);
            }
            py.check_signals()?;
        }
    }

    /// Calls `wake` from some thread once the request has ended; true when it has already.
    #[pyo3(name = "tell")]
    fn wake_when_done(&self, py: Python<'_>, wake: Py<PyAny>) -> PyResult<bool> {
        self.0.in_own_process(py)?;
        let waker = Waker::from(Arc::new(WakeCallback(wake)));
        Ok(py.detach(|| self.lock().poll_or_wake(&waker)))
    }
}

impl PyRequest {
    fn lock(&self) -> std::sync::MutexGuard<'_, RunningRequest> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
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
