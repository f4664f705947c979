//! Adapters opened by Python as links: any bus of python-can, any port of pyserial.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;

use polepair::AnyLink;
use polepair_core::medium::{Can, CanLine, Frame, Medium, MediumKind, SerialLine, Stream};
use polepair_core::time::Instant;
use polepair_link::{LinkError, LinkIo, LinkWaker, Losses, Received, clock};
use pyo3::prelude::*;
use pyo3::types::PyBytes;

use crate::process_local::ProcessLocal;

/// Limit of unread units; further ones are lost and counted.
const QUEUE_MAX: usize = 1 << 14;

/// Python half of a link: `send(unit)`, `receive() -> unit | None` within a moment, `line(rate)`, `close()`.
type PyAdapter = Arc<ProcessLocal<Py<PyAny>>>;

/// A link over an adapter of Python's. A thread of its own reads it.
struct PythonLink<M: PythonMedium> {
    name: String,
    adapter: PyAdapter,
    received: Arc<ReceiveQueue<M>>,
}

/// Received units that were not read yet.
struct ReceiveQueue<M: PythonMedium> {
    units: Mutex<VecDeque<(Instant, M::Owned)>>,
    waker: LinkWaker,
    /// Units that were not read in time.
    overrun: AtomicU64,
    lost: AtomicBool,
    ended: AtomicBool,
}

/// A medium whose units Python has words for.
trait PythonMedium: Medium {
    type Owned: Send;
    fn from_python(unit: &Bound<'_, PyAny>) -> PyResult<Self::Owned>;
    fn to_python<'py>(py: Python<'py>, unit: &Self::Unit) -> PyResult<Bound<'py, PyAny>>;
    /// Copies the unit into the reader's buffer, and returns its length; the rest stays.
    fn copy_into(unit: &mut Self::Owned, buffer: &mut Self::Out) -> (usize, bool);
    fn line_rate(line: &Self::Line) -> u32;
}

impl PythonMedium for Can {
    type Owned = Frame;

    fn from_python(unit: &Bound<'_, PyAny>) -> PyResult<Frame> {
        let (id, extended, remote, len, bytes): (u32, bool, bool, u8, Vec<u8>) = unit.extract()?;
        let mut frame = Frame { id, extended, remote, len: len.min(8), data: [0; 8] };
        let have = bytes.len().min(8);
        frame.data[..have].copy_from_slice(&bytes[..have]);
        Ok(frame)
    }

    fn to_python<'py>(py: Python<'py>, frame: &Frame) -> PyResult<Bound<'py, PyAny>> {
        let bytes = PyBytes::new(py, if frame.remote { &[] } else { frame.bytes() });
        let unit = (frame.id, frame.extended, frame.remote, frame.len, bytes);
        Ok(unit.into_pyobject(py)?.into_any())
    }

    fn copy_into(unit: &mut Frame, buffer: &mut Frame) -> (usize, bool) {
        *buffer = *unit;
        (1, true)
    }

    fn line_rate(line: &CanLine) -> u32 {
        line.bit_rate
    }
}

impl PythonMedium for Stream {
    type Owned = Vec<u8>;

    fn from_python(unit: &Bound<'_, PyAny>) -> PyResult<Vec<u8>> {
        unit.extract()
    }

    fn to_python<'py>(py: Python<'py>, unit: &[u8]) -> PyResult<Bound<'py, PyAny>> {
        Ok(PyBytes::new(py, unit).into_any())
    }

    fn copy_into(unit: &mut Vec<u8>, buffer: &mut [u8]) -> (usize, bool) {
        let count = unit.len().min(buffer.len());
        buffer[..count].copy_from_slice(&unit[..count]);
        unit.drain(..count);
        (count, unit.is_empty())
    }

    fn line_rate(line: &SerialLine) -> u32 {
        line.baud
    }
}

/// The link over an adapter.
pub fn open_link(name: String, adapter: Py<PyAny>, medium: MediumKind) -> std::io::Result<AnyLink> {
    Ok(match medium {
        MediumKind::Can => AnyLink::Can(Box::new(PythonLink::<Can>::new(name, adapter)?)),
        MediumKind::Serial => AnyLink::Serial(Box::new(PythonLink::<Stream>::new(name, adapter)?)),
    })
}

impl<M: PythonMedium> PythonLink<M> {
    fn new(name: String, adapter: Py<PyAny>) -> std::io::Result<Self> {
        let adapter = Arc::new(ProcessLocal::from(adapter));
        let arrived = Arc::new(ReceiveQueue::<M> {
            units: Mutex::default(),
            waker: LinkWaker::new()?,
            overrun: AtomicU64::new(0),
            lost: AtomicBool::new(false),
            ended: AtomicBool::new(false),
        });
        let (reads, puts) = (Arc::clone(&adapter), Arc::clone(&arrived));
        thread::Builder::new()
            .name(format!("polepair-read {name}"))
            .spawn(move || Python::attach(|py| puts.read_loop(py, &reads)))?;
        Ok(Self { name, adapter, received: arrived })
    }
}

impl<M: PythonMedium> ReceiveQueue<M> {
    /// Reads until the link is closed or lost.
    fn read_loop(&self, py: Python<'_>, adapter: &PyAdapter) {
        while !self.ended.load(Ordering::Acquire) {
            match adapter.call_method0(py, "receive").and_then(|unit| {
                let unit = unit.bind(py);
                if unit.is_none() { Ok(None) } else { M::from_python(unit).map(Some) }
            }) {
                Ok(None) => {}
                Ok(Some(unit)) => {
                    let mut units = self.units.lock().unwrap_or_else(PoisonError::into_inner);
                    if units.len() < QUEUE_MAX {
                        units.push_back((clock::now(), unit));
                    } else {
                        self.overrun.fetch_add(1, Ordering::Relaxed);
                    }
                    drop(units);
                    self.waker.wake();
                }
                Err(_) => {
                    self.lost.store(true, Ordering::Release);
                    self.waker.wake();
                    return;
                }
            }
        }
        let _ = adapter.call_method0(py, "close");
    }
}

impl<M: PythonMedium> LinkIo<M> for PythonLink<M> {
    fn now(&self) -> Instant {
        clock::now()
    }

    fn send(&self, unit: &M::Unit) -> Result<(), LinkError> {
        let sent = Python::attach(|py| {
            let unit = M::to_python(py, unit)?;
            self.adapter.call_method1(py, "send", (unit,)).map(drop)
        });
        sent.map_err(|_| LinkError::gone(&self.name))
    }

    fn receive(&self, buffer: &mut M::Out, until: Instant) -> Result<Received, LinkError> {
        loop {
            let mut units = self.received.units.lock().unwrap_or_else(PoisonError::into_inner);
            if let Some((at, unit)) = units.front_mut() {
                let at = *at;
                let (len, all) = M::copy_into(unit, buffer);
                if all {
                    units.pop_front();
                }
                return Ok(Received::Bytes { len, at });
            }
            drop(units);
            if self.received.lost.load(Ordering::Acquire) {
                return Err(LinkError::gone(&self.name));
            }
            if !self.received.waker.wait(until) {
                return Ok(Received::TimedOut);
            }
            let units = self.received.units.lock().unwrap_or_else(PoisonError::into_inner);
            if units.is_empty() && !self.received.lost.load(Ordering::Acquire) {
                return Ok(Received::Woken);
            }
        }
    }

    fn set_line(&self, line: M::Line) -> Result<(), LinkError> {
        let set = Python::attach(|py| {
            self.adapter.call_method1(py, "line", (M::line_rate(&line),)).map(drop)
        });
        set.map_err(|_| LinkError::gone(&self.name))
    }

    fn waker(&self) -> LinkWaker {
        self.received.waker.clone()
    }

    fn describe(&self) -> String {
        self.name.clone()
    }

    fn losses(&self) -> Losses {
        let overrun = self.received.overrun.load(Ordering::Relaxed);
        Losses { overrun, ..Losses::default() }
    }
}

impl<M: PythonMedium> Drop for PythonLink<M> {
    fn drop(&mut self) {
        self.received.ended.store(true, Ordering::Release);
    }
}
