//! Waits in slices, between which Ctrl-C is looked for, while other Python threads continue.

use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::Duration;

use polepair::Error;
use polepair::remote::Gateway;
use pyo3::prelude::*;

use crate::errors::{to_py_error, usage_error};

/// Length of a wait between two checks for Ctrl-C.
pub const WAIT_SLICE: Duration = Duration::from_millis(50);

/// A call that waits for a gateway, on a thread of its own. Dropped before its end, it continues.
pub struct Blocking<T>(Receiver<Result<T, Error>>);

impl<T: Send + 'static> Blocking<T> {
    /// Starts a call on a thread of the gateway's client.
    pub fn start(
        gateway: &Gateway,
        call: impl FnOnce() -> Result<T, Error> + Send + 'static,
    ) -> Self {
        let (sender, receiver) = channel();
        // The waiting future may have been dropped.
        gateway.spawn_blocking(move || drop(sender.send(call())));
        Self(receiver)
    }

    /// Waits for the end.
    pub fn wait(self, py: Python<'_>) -> PyResult<T> {
        let Self(receiver) = self;
        let ended = wait_sliced(py, None, move |slice| match receiver.recv_timeout(slice) {
            Ok(ended) => ended.map(Some),
            Err(RecvTimeoutError::Timeout) => Ok(None),
            Err(RecvTimeoutError::Disconnected) => {
                Err(Error::Interrupted { what: "a call to a gateway".to_owned() })
            }
        })?;
        ended.ok_or_else(|| usage_error(py, "E299", "the call had no result", ""))
    }
}

/// Waits in slices, at most `timeout` seconds; `None` if it continues.
pub fn wait_sliced<T: Send>(
    py: Python<'_>,
    timeout: Option<f64>,
    mut wait: impl FnMut(Duration) -> Result<Option<T>, Error> + Send,
) -> PyResult<Option<T>> {
    let mut left = timeout.map(|s| Duration::try_from_secs_f64(s).unwrap_or(Duration::ZERO));
    loop {
        let slice = left.map_or(WAIT_SLICE, |left| left.min(WAIT_SLICE));
        let ended = py.detach(|| wait(slice)).map_err(|error| to_py_error(py, &error))?;
        left = left.map(|left| left - slice);
        if ended.is_some() || left == Some(Duration::ZERO) {
            return Ok(ended);
        }
        py.check_signals()?;
    }
}
