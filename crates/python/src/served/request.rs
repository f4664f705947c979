//! What was asked of a server and is under way, and what comes of it.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::Waker;
use std::time::Duration;

use polepair_client::message::{Given, ParameterRead};
use polepair_client::{Pending, Refused};
use pyo3::prelude::*;

use crate::errors::{told, usage};
use crate::outside::Outside;
use crate::request::{Call, SLICE};

/// Something under way. Dropped before its end, it goes on by itself.
#[pyclass(frozen, name = "ServedRequest", module = "polepair._polepair")]
#[derive(Debug)]
pub struct Request(Outside<Mutex<Going>>);

/// A command, a question after a parameter, or one for a number.
#[derive(Debug)]
pub enum Going {
    Command(Pending),
    Read(Pending<ParameterRead>),
    Number(Pending<i64>),
}

/// What came of it.
enum Came {
    Read(ParameterRead),
    Number(i64),
}

/// A parameter as it was read.
#[pyclass(frozen, name = "ServedRead", module = "polepair._polepair")]
#[derive(Debug)]
pub struct Read(pub(super) ParameterRead);

#[pymethods]
impl Read {
    /// As it lies in the drive.
    fn __index__(&self) -> i64 {
        self.0.raw
    }
}

/// What a parameter is to have, in words that the server reads.
#[pyclass(frozen, name = "ServedAmount", module = "polepair._polepair")]
#[derive(Debug)]
pub struct Amount(pub(super) Given);

impl Going {
    fn wait(&mut self, within: Duration) -> Result<Option<Came>, Refused> {
        Ok(match self {
            Self::Command(pending) => pending.wait(within)?.map(|()| Came::Number(0)),
            Self::Read(pending) => pending.wait(within)?.map(Came::Read),
            Self::Number(pending) => pending.wait(within)?.map(Came::Number),
        })
    }
}

impl Request {
    pub fn new(going: Going) -> Self {
        Self(Mutex::new(going).into())
    }

    fn lock(&self) -> MutexGuard<'_, Going> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[pymethods]
impl Request {
    /// Waits for the end, at most `timeout` seconds, and gives what came of it; `None` when it goes
    /// on.
    #[pyo3(signature = (timeout=None))]
    fn result(&self, py: Python<'_>, timeout: Option<f64>) -> PyResult<Option<Py<PyAny>>> {
        self.0.ours(py)?;
        let came = waited(py, timeout, |slice| self.lock().wait(slice))?;
        came.map(|came| match came {
            Came::Read(read) => Ok(Py::new(py, Read(read))?.into_any()),
            Came::Number(number) => Ok(number.into_pyobject(py)?.into_any().unbind()),
        })
        .transpose()
    }

    /// Calls `wake` from some thread once it has ended; true when it has already.
    fn tell(&self, py: Python<'_>, wake: Py<PyAny>) -> PyResult<bool> {
        self.0.ours(py)?;
        let waker = Waker::from(Arc::new(Call(wake)));
        Ok(py.detach(|| match &mut *self.lock() {
            Going::Command(pending) => pending.ended_or_wake(&waker),
            Going::Read(pending) => pending.ended_or_wake(&waker),
            Going::Number(pending) => pending.ended_or_wake(&waker),
        }))
    }
}

/// Waits in slices, between which Ctrl-C is looked for, while other threads go on.
pub(super) fn waited<T: Send>(
    py: Python<'_>,
    timeout: Option<f64>,
    mut wait: impl FnMut(Duration) -> Result<Option<T>, Refused> + Send,
) -> PyResult<Option<T>> {
    let mut left = timeout.map(|s| Duration::try_from_secs_f64(s).unwrap_or(Duration::ZERO));
    loop {
        let slice = left.map_or(SLICE, |left| left.min(SLICE));
        let came = py.detach(|| wait(slice)).map_err(|refused| told(py, &refused))?;
        left = left.map(|left| left - slice);
        if came.is_some() || left == Some(Duration::ZERO) {
            return Ok(came);
        }
        py.check_signals()?;
    }
}

/// Waits for the end, however long that takes.
pub(super) fn ended<T: Clone + Send>(py: Python<'_>, mut pending: Pending<T>) -> PyResult<T> {
    came(py, waited(py, None, |slice| pending.wait(slice)))
}

/// What was waited for without a bound.
pub(super) fn came<T>(py: Python<'_>, waited: PyResult<Option<T>>) -> PyResult<T> {
    waited?.ok_or_else(|| usage(py, "E299", "nothing came of it", ""))
}
