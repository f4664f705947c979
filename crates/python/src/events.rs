//! Event streams of a link, for threads and event loops.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::Waker;
use std::time::Duration;

use polepair::events::{Event, EventKind};
use polepair::{Events as Inner, LocalAxis};
use polepair_core::profile;
use polepair_core::time::Instant;
use pyo3::prelude::*;

use crate::blocking::WAIT_SLICE;
use crate::fault::{FaultTuple, fault_tuple};
use crate::process_local::ProcessLocal;
use crate::request::WakeCallback;

/// Events of a link from its creation until the link is closed.
#[pyclass(frozen, name = "Events", module = "polepair._polepair")]
#[derive(Debug)]
pub struct PyEvents {
    inner: ProcessLocal<Mutex<Option<Arc<Inner>>>>,
    axes: ProcessLocal<Vec<LocalAxis>>,
    is_virtual: bool,
}

/// Seconds on the link's clock, axis, sort, name, value, raw value, unit, fault.
pub type EventTuple =
    (f64, Option<u32>, &'static str, String, f64, i64, &'static str, Option<FaultTuple>);

impl PyEvents {
    /// Events of those axes, in the order of their places.
    pub fn new(events: Inner, axes: Vec<LocalAxis>) -> Self {
        let is_virtual = events.in_virtual_time();
        Self { inner: Mutex::new(Some(Arc::new(events))).into(), axes: axes.into(), is_virtual }
    }

    fn lock(&self) -> MutexGuard<'_, Option<Arc<Inner>>> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Lends the events while other threads go on; `None` once they are closed.
    fn with_events<T: Send>(
        &self,
        py: Python<'_>,
        what: impl Send + FnOnce(&Inner) -> T,
    ) -> PyResult<Option<T>> {
        self.inner.in_own_process(py)?;
        Ok(py.detach(|| {
            let events = self.lock().clone();
            events.map(|events| what(&events))
        }))
    }

    fn event_tuple(&self, event: &Event) -> EventTuple {
        let none = (String::new(), f64::NAN, 0, "", None);
        let of_fault = |code: u32, of: Option<&'static profile::Fault>| {
            (
                String::new(),
                f64::NAN,
                i64::from(code),
                "",
                of.map(|fault| fault_tuple(fault.into())),
            )
        };
        let (sort, (name, value, raw, unit, fault)) = match &event.kind {
            EventKind::Signal { signal, reading } => {
                ("signal", (signal.name().to_owned(), reading.value, reading.raw, "", None))
            }
            EventKind::Parameter { parameter, raw, value, unit } => {
                let axis = self.axes.get(event.index);
                let known = axis.and_then(|axis| axis.parameter(*parameter));
                let name = known.map_or(String::new(), |parameter| parameter.name.to_owned());
                ("parameter", (name, *value, *raw, unit.symbol(), None))
            }
            EventKind::FaultAppeared { code, fault } => ("fault appeared", of_fault(*code, *fault)),
            EventKind::FaultCleared { code, fault } => ("fault cleared", of_fault(*code, *fault)),
            EventKind::Presence(presence) => {
                ("presence", (presence.name().to_owned(), f64::NAN, 0, "", None))
            }
            EventKind::Armed => ("armed", none),
            EventKind::Disarmed => ("disarmed", none),
            EventKind::LinkLost { error } => {
                ("link lost", (error.to_string(), f64::NAN, 0, "", None))
            }
            EventKind::LinkBack => ("link back", none),
            // Events of later versions of the library.
            other => ("other", (other.to_string(), f64::NAN, 0, "", None)),
        };
        let at = event.at.since(Instant::ZERO).as_secs_f64();
        (at, event.axis, sort, name, value, raw, unit, fault)
    }
}

#[pymethods]
impl PyEvents {
    /// Waits for the next event, at most `timeout` seconds of the link's time; `None` when there was
    /// none, and once this is closed.
    #[pyo3(signature = (timeout=None))]
    fn result(&self, py: Python<'_>, timeout: Option<f64>) -> PyResult<Option<EventTuple>> {
        let mut left = timeout.map(|s| Duration::try_from_secs_f64(s).unwrap_or(Duration::ZERO));
        loop {
            let slice = left.map_or(WAIT_SLICE, |left| left.min(WAIT_SLICE));
            let Some(event) = self.with_events(py, |events| events.next(slice))? else {
                return Ok(None);
            };
            if let Some(event) = event {
                return Ok(Some(self.event_tuple(&event)));
            }
            left = left.map(|left| left - slice);
            if left == Some(Duration::ZERO) {
                return Ok(None);
            }
            py.check_signals()?;
        }
    }

    /// Calls `wake` from some thread once there is an event; true when there is already, and once
    /// this is closed.
    #[pyo3(name = "tell")]
    fn wake_when_ready(&self, py: Python<'_>, wake: Py<PyAny>) -> PyResult<bool> {
        let waker = Waker::from(Arc::new(WakeCallback(wake)));
        Ok(self.with_events(py, |events| events.ready_or_wake(&waker))?.unwrap_or(true))
    }

    /// Number of events that were dropped because they were not read in time.
    #[getter]
    fn lost(&self, py: Python<'_>) -> PyResult<u64> {
        Ok(self.with_events(py, Inner::lost)?.unwrap_or_default())
    }

    /// Returns whether time passes only while a caller waits.
    #[getter]
    fn in_virtual_time(&self) -> bool {
        self.is_virtual
    }

    #[getter]
    fn closed(&self, py: Python<'_>) -> PyResult<bool> {
        Ok(self.with_events(py, |_| ())?.is_none())
    }

    /// Ends a wait under way, and listens no more.
    fn close(&self, py: Python<'_>) -> PyResult<()> {
        self.inner.in_own_process(py)?;
        py.detach(|| {
            let events = self.lock().take();
            if let Some(events) = events {
                events.interrupt();
            }
        });
        Ok(())
    }
}
