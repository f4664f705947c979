//! A request under way: waited for by a thread, or told to an event loop.

use std::sync::{Arc, Mutex, PoisonError};
use std::task::{Wake, Waker};
use std::time::Duration;

use polepair::Running;
use pyo3::prelude::*;

use crate::errors::raised;
use crate::outside::Outside;

/// How long a wait goes on before it looks whether Ctrl-C was pressed.
pub const SLICE: Duration = Duration::from_millis(50);

/// A request under way. Dropped before its end, it goes on by itself.
#[pyclass(frozen, module = "polepair._polepair")]
#[derive(Debug)]
pub struct Request(Outside<Mutex<Running>>);

impl Request {
    pub fn new(running: Running) -> Self {
        Self(Mutex::new(running).into())
    }
}

#[pymethods]
impl Request {
    /// Waits for the end, at most `timeout` seconds, and gives the last value that was read;
    /// `None` when it goes on.
    #[pyo3(signature = (timeout=None))]
    pub fn result(&self, py: Python<'_>, timeout: Option<f64>) -> PyResult<Option<i64>> {
        self.0.ours(py)?;
        let mut left = timeout.map(|s| Duration::try_from_secs_f64(s).unwrap_or(Duration::ZERO));
        loop {
            let slice = left.map_or(SLICE, |left| left.min(SLICE));
            let ended = py.detach(|| self.lock().wait(slice)).map_err(|e| raised(py, &e))?;
            left = left.map(|left| left - slice);
            if ended.is_some() || left == Some(Duration::ZERO) {
                return Ok(ended);
            }
            py.check_signals()?;
        }
    }

    /// Calls `wake` from some thread once the request has ended; true when it has already.
    fn tell(&self, py: Python<'_>, wake: Py<PyAny>) -> PyResult<bool> {
        self.0.ours(py)?;
        let waker = Waker::from(Arc::new(Call(wake)));
        Ok(py.detach(|| self.lock().ended_or_wake(&waker)))
    }
}

impl Request {
    fn lock(&self) -> std::sync::MutexGuard<'_, Running> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A Python function that is called when a request has ended, or something happened.
pub struct Call(pub Py<PyAny>);

impl Wake for Call {
    fn wake(self: Arc<Self>) {
        Python::attach(|py| {
            // An event loop that is closed wants to hear of nothing any more.
            let _ = self.0.call0(py);
        });
    }
}
