//! Raw access to a CAN wire, for python-can.

use std::fmt;
use std::time::Duration;

use polepair::{AnyLink, Connector};
use polepair_core::medium::{Can, Frame};
use polepair_core::time::Instant;
use polepair_link::{LinkError, LinkIo, Received};
use pyo3::exceptions::PyOSError;
use pyo3::prelude::*;
use pyo3::types::PyBytes;

use crate::blocking::WAIT_SLICE;
use crate::errors::{to_py_error, usage_error};
use crate::process_local::ProcessLocal;

/// A CAN wire.
#[pyclass(frozen, module = "polepair._polepair")]
pub struct CanWire(ProcessLocal<Box<dyn LinkIo<Can>>>);

impl fmt::Debug for CanWire {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "CanWire({})", self.0.describe())
    }
}

/// Seconds on the wire's clock, identifier, extended, remote, length code, bytes.
type FrameTuple<'py> = (f64, u32, bool, bool, u8, Bound<'py, PyBytes>);

#[pymethods]
impl CanWire {
    /// Opens the one CAN wire of a connection string.
    #[new]
    fn open(py: Python<'_>, url: &str) -> PyResult<Self> {
        let opened = py.detach(|| Connector::discover().open(url));
        let mut wires = opened.map_err(|error| to_py_error(py, &error))?;
        match (wires.pop(), wires.is_empty()) {
            (Some(AnyLink::Can(link)), true) => Ok(Self(link.into())),
            _ => Err(usage_error(py, "E217", &format!("{url} is not one CAN bus"), "")),
        }
    }

    /// Name of the bus.
    fn describe(&self, py: Python<'_>) -> String {
        py.detach(|| self.0.describe())
    }

    /// Sends a frame.
    fn send(
        &self,
        py: Python<'_>,
        id: u32,
        extended: bool,
        remote: bool,
        len: u8,
        bytes: &[u8],
    ) -> PyResult<()> {
        let mut frame = Frame { id, extended, remote, len, data: [0; 8] };
        frame.data[..bytes.len().min(8)].copy_from_slice(&bytes[..bytes.len().min(8)]);
        py.detach(|| self.0.send(&frame)).map_err(|error| os_error(&error))
    }

    /// Seconds on the wire's clock.
    fn now(&self, py: Python<'_>) -> f64 {
        py.detach(|| self.0.now()).since(Instant::ZERO).as_secs_f64()
    }

    /// Ends a `receive` of another thread.
    fn wake(&self) {
        self.0.waker().wake();
    }

    /// The next frame within `seconds`, or before it was woken; and whether the time passed.
    fn receive<'py>(
        &self,
        py: Python<'py>,
        timeout: f64,
    ) -> PyResult<(Option<FrameTuple<'py>>, bool)> {
        let span = Duration::try_from_secs_f64(timeout).unwrap_or(Duration::MAX);
        let ends = py.detach(|| self.0.now()) + span;
        loop {
            let result = py.detach(|| {
                let mut frame = Frame::default();
                let until = ends.min(self.0.now() + WAIT_SLICE);
                let received = self.0.receive(&mut frame, until)?;
                Ok((received, frame, self.0.now()))
            });
            let (received, frame, now) = result.map_err(|error: LinkError| os_error(&error))?;
            match received {
                Received::Bytes { at, .. } => {
                    let bytes = if frame.remote { &[] } else { frame.bytes() };
                    let seconds = at.since(Instant::ZERO).as_secs_f64();
                    let Frame { id, extended, remote, len, .. } = frame;
                    let bytes = PyBytes::new(py, bytes);
                    return Ok((Some((seconds, id, extended, remote, len, bytes)), false));
                }
                Received::Woken => return Ok((None, false)),
                Received::Line { .. } | Received::TimedOut => {}
            }
            if now >= ends {
                return Ok((None, true));
            }
            py.check_signals()?;
        }
    }
}

fn os_error(error: &LinkError) -> PyErr {
    PyOSError::new_err(error.to_string())
}
