//! Telemetry of a gateway's axis: rows of samples with the same time.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::Waker;

use polepair::Error;
use polepair::remote::{SampleRow, SampleRows};
use pyo3::prelude::*;

use crate::blocking::wait_sliced;
use crate::process_local::ProcessLocal;
use crate::request::WakeCallback;

/// Signals that are subscribed until this is dropped.
#[pyclass(frozen, name = "SampleStream", module = "polepair._polepair")]
#[derive(Debug)]
pub struct PyWatch(ProcessLocal<Mutex<SampleRows>>);

impl PyWatch {
    pub fn new(rows: SampleRows) -> Self {
        Self(Mutex::new(rows).into())
    }

    fn lock(&self) -> MutexGuard<'_, SampleRows> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[pymethods]
impl PyWatch {
    /// Waits for the next row, at most `timeout` seconds.
    #[pyo3(signature = (timeout=None))]
    fn result(&self, py: Python<'_>, timeout: Option<f64>) -> PyResult<Option<SampleRow>> {
        self.0.in_own_process(py)?;
        wait_sliced(py, timeout, |slice| self.lock().wait(slice).map_err(Error::from))
    }

    /// Calls `wake` from some thread once there may be a row; true if there may be one already.
    #[pyo3(name = "tell")]
    fn wake_when_ready(&self, py: Python<'_>, wake: Py<PyAny>) -> PyResult<bool> {
        self.0.in_own_process(py)?;
        let waker = Waker::from(Arc::new(WakeCallback(wake)));
        Ok(py.detach(|| self.lock().poll_ready(&waker)))
    }

    /// Seconds without a row after which the drive does not answer: its server continues to read it, and reports
    /// nothing. `None` for a drive that sends by itself, and may have nothing to send.
    #[getter]
    fn patience(&self, py: Python<'_>) -> PyResult<Option<f64>> {
        self.0.in_own_process(py)?;
        Ok(py.detach(|| self.lock().silence_limit()))
    }

    /// Samples that were lost on the way so far, of the signal that lost most.
    #[getter]
    fn lost(&self, py: Python<'_>) -> PyResult<u64> {
        self.0.in_own_process(py)?;
        Ok(py.detach(|| self.lock().lost()))
    }
}
