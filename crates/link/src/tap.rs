//! A tap on a wire: every unit with time and direction, for `-v` and `--trace`.

use std::fmt::Write as _;
use std::io;
use std::sync::{Arc, Mutex, PoisonError};

use polepair_core::medium::{Frame, Medium, Stream};
use polepair_core::time::Instant;

use crate::clock;
use crate::error::LinkError;
use crate::link::{LinkIo, Losses, Received};
use crate::waker::LinkWaker;

/// Direction of a unit.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum TapDirection {
    /// Host to drive.
    ToDrive,
    /// Drive to host.
    ToHost,
}

/// Takes every unit as it passes. Called with the connection's lock held: be quick.
pub trait Tap<M: Medium = Stream>: Send {
    /// `unit` was sent or read at once; on a stream, a frame may be split over several calls.
    fn record_unit(&mut self, at: Instant, direction: TapDirection, unit: &M::Unit);
}

impl<M: Medium, F: FnMut(Instant, TapDirection, &M::Unit) + Send> Tap<M> for F {
    fn record_unit(&mut self, at: Instant, direction: TapDirection, unit: &M::Unit) {
        self(at, direction, unit);
    }
}

/// A link whose traffic a [`Tap`] sees. Wrap the host's end; reopening keeps the tap.
pub struct TappedLink<M: Medium = Stream> {
    inner: Box<dyn LinkIo<M>>,
    tap: Arc<Mutex<dyn Tap<M>>>,
}

impl<M: Medium> TappedLink<M> {
    /// Taps `inner`.
    #[must_use]
    pub fn new(inner: Box<dyn LinkIo<M>>, tap: impl Tap<M> + 'static) -> Self {
        Self { inner, tap: Arc::new(Mutex::new(tap)) }
    }

    fn record(&self, at: Instant, direction: TapDirection, unit: &M::Unit) {
        self.tap.lock().unwrap_or_else(PoisonError::into_inner).record_unit(at, direction, unit);
    }
}

impl<M: Medium> std::fmt::Debug for TappedLink<M> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_tuple("Tapped").field(&self.inner.describe()).finish()
    }
}

impl<M: Medium> LinkIo<M> for TappedLink<M> {
    fn now(&self) -> Instant {
        self.inner.now()
    }

    fn send(&self, unit: &M::Unit) -> Result<(), LinkError> {
        // Before the write: the answer may be read by another thread before this one returns.
        self.record(self.inner.now(), TapDirection::ToDrive, unit);
        self.inner.send(unit)
    }

    fn wait_writable(&self, until: Instant) -> Result<bool, LinkError> {
        self.inner.wait_writable(until)
    }

    fn receive(&self, buffer: &mut M::Out, until: Instant) -> Result<Received, LinkError> {
        let received = self.inner.receive(buffer, until)?;
        if let Received::Bytes { len, at } = received {
            self.record(at, TapDirection::ToHost, M::unit(buffer, len));
        }
        Ok(received)
    }

    fn is_real_time(&self) -> bool {
        self.inner.is_real_time()
    }

    fn set_line(&self, line: M::Line) -> Result<(), LinkError> {
        self.inner.set_line(line)
    }

    fn waker(&self) -> LinkWaker {
        self.inner.waker()
    }

    fn describe(&self) -> String {
        self.inner.describe()
    }

    fn losses(&self) -> Losses {
        self.inner.losses()
    }

    fn reopen(&self) -> Result<Box<dyn LinkIo<M>>, LinkError> {
        let inner = self.inner.reopen()?;
        Ok(Box::new(Self { inner, tap: Arc::clone(&self.tap) }))
    }
}

/// Writes captures, a line a unit. Serial lines: `(1700000000.000500) ttyUSB0 > 01 01 00 …`, `>`
/// host to drive, `<` drive to host. CAN is candump's log with its flag for the direction, T to the
/// drive and R from it: `(1700000000.000500) can0 30B#5443000000000005 T`.
#[derive(Debug)]
pub struct TraceWriter<W> {
    to: W,
    link: String,
    line: String,
}

impl<W: io::Write> TraceWriter<W> {
    /// Writes to `to`; `link` is shortened to its last part (`/dev/ttyUSB0` to `ttyUSB0`).
    pub fn new(to: W, link: &str) -> Self {
        let link = link.rsplit('/').next().unwrap_or(link).replace(char::is_whitespace, "_");
        Self { to, link, line: String::new() }
    }

    /// Bytes as they were written or read at once.
    pub fn write_bytes(&mut self, at: Instant, direction: TapDirection, bytes: &[u8]) {
        self.begin_line(at);
        self.line.push_str(if direction == TapDirection::ToDrive { " >" } else { " <" });
        for byte in bytes {
            let _ = write!(self.line, " {byte:02X}");
        }
        self.end_line();
    }

    /// A frame.
    pub fn write_frame(&mut self, at: Instant, direction: TapDirection, frame: &Frame) {
        self.begin_line(at);
        let flag = if direction == TapDirection::ToDrive { 'T' } else { 'R' };
        let _ = write!(self.line, " {frame} {flag}");
        self.end_line();
    }

    fn begin_line(&mut self, at: Instant) {
        let wall_us = clock::wall_ns(at) / 1000;
        let (seconds, micros) = (wall_us / 1_000_000, wall_us % 1_000_000);
        self.line.clear();
        let _ = write!(self.line, "({seconds}.{micros:06}) {}", self.link);
    }

    fn end_line(&mut self) {
        self.line.push('\n');
        // A full disk must not stop a motor's host: the trace is then short, the session goes on.
        let _ = self.to.write_all(self.line.as_bytes());
    }
}
