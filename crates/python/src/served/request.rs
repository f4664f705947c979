//! A request to a server, and its result.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::Waker;
use std::time::Duration;

use polepair_client::message::{ParameterInput, ParameterReading};
use polepair_client::{GatewayError, PendingOperation};
use pyo3::prelude::*;

use super::axis::raw_number;
use crate::errors::{refused_to_py_error, usage_error};
use crate::process_local::ProcessLocal;
use crate::request::{WAIT_SLICE, WakeCallback};

/// Something under way. Dropped before its end, it goes on by itself.
#[pyclass(frozen, name = "ServedRequest", module = "polepair._polepair")]
#[derive(Debug)]
pub struct ServedRequest(ProcessLocal<Mutex<PendingAction>>);

/// A command, a question after a parameter, or one for a number.
#[derive(Debug)]
pub enum PendingAction {
    Command(PendingOperation),
    Read(PendingOperation<ParameterReading>),
    Number(PendingOperation<i64>),
}

/// What came of it.
enum ActionResult {
    Read(ParameterReading),
    Number(i64),
}

/// A parameter as it was read.
#[pyclass(frozen, name = "ServedRead", module = "polepair._polepair")]
#[derive(Debug)]
pub struct ServedRead(pub(super) ParameterReading);

#[pymethods]
impl ServedRead {
    /// As it lies in the drive.
    fn __index__(&self, py: Python<'_>) -> PyResult<i64> {
        raw_number(py, &self.0)
    }
}

/// What a parameter is to have, in words that the server reads.
#[pyclass(frozen, name = "ServedAmount", module = "polepair._polepair")]
#[derive(Debug)]
pub struct ServedAmount(pub(super) ParameterInput);

impl PendingAction {
    fn wait(&mut self, within: Duration) -> Result<Option<ActionResult>, GatewayError> {
        Ok(match self {
            Self::Command(pending) => pending.wait(within)?.map(|()| ActionResult::Number(0)),
            Self::Read(pending) => pending.wait(within)?.map(ActionResult::Read),
            Self::Number(pending) => pending.wait(within)?.map(ActionResult::Number),
        })
    }
}

impl ServedRequest {
    pub fn new(going: PendingAction) -> Self {
        Self(Mutex::new(going).into())
    }

    fn lock(&self) -> MutexGuard<'_, PendingAction> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[pymethods]
impl ServedRequest {
    /// Waits for the end, at most `timeout` seconds, and gives what came of it; `None` when it goes
    /// on.
    #[pyo3(signature = (timeout=None))]
    fn result(&self, py: Python<'_>, timeout: Option<f64>) -> PyResult<Option<Py<PyAny>>> {
        self.0.in_own_process(py)?;
        let came = wait_sliced(py, timeout, |slice| self.lock().wait(slice))?;
        came.map(|came| match came {
            ActionResult::Read(read) => Ok(Py::new(py, ServedRead(read))?.into_any()),
            ActionResult::Number(number) => Ok(number.into_pyobject(py)?.into_any().unbind()),
        })
        .transpose()
    }

    /// Calls `wake` from some thread once it has ended; true when it has already.
    #[pyo3(name = "tell")]
    fn wake_when_done(&self, py: Python<'_>, wake: Py<PyAny>) -> PyResult<bool> {
        self.0.in_own_process(py)?;
        let waker = Waker::from(Arc::new(WakeCallback(wake)));
        Ok(py.detach(|| match &mut *self.lock() {
            PendingAction::Command(pending) => pending.poll_finished(&waker),
            PendingAction::Read(pending) => pending.poll_finished(&waker),
            PendingAction::Number(pending) => pending.poll_finished(&waker),
        }))
    }
}

/// Waits in slices, between which Ctrl-C is looked for, while other threads go on.
pub(super) fn wait_sliced<T: Send>(
    py: Python<'_>,
    timeout: Option<f64>,
    mut wait: impl FnMut(Duration) -> Result<Option<T>, GatewayError> + Send,
) -> PyResult<Option<T>> {
    let mut left = timeout.map(|s| Duration::try_from_secs_f64(s).unwrap_or(Duration::ZERO));
    loop {
        let slice = left.map_or(WAIT_SLICE, |left| left.min(WAIT_SLICE));
        let came =
            py.detach(|| wait(slice)).map_err(|refused| refused_to_py_error(py, &refused))?;
        left = left.map(|left| left - slice);
        if came.is_some() || left == Some(Duration::ZERO) {
            return Ok(came);
        }
        py.check_signals()?;
    }
}

/// Waits for the end, however long that takes.
pub(super) fn wait_end<T: Clone + Send>(
    py: Python<'_>,
    mut pending: PendingOperation<T>,
) -> PyResult<T> {
    require_result(py, wait_sliced(py, None, |slice| pending.wait(slice)))
}

/// What was waited for without a bound.
pub(super) fn require_result<T>(py: Python<'_>, waited: PyResult<Option<T>>) -> PyResult<T> {
    waited?.ok_or_else(|| usage_error(py, "E299", "nothing came of it", ""))
}
