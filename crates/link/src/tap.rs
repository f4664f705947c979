//! A wire tapped: every unit with its time and direction, for `-v` and `--trace`.

use std::io::Write;
use std::sync::{Arc, Mutex, PoisonError};

use polepair_core::medium::{SerialLine, Stream};
use polepair_core::time::Instant;

use crate::clock;
use crate::error::LinkError;
use crate::link::{Link, Received};
use crate::wake::Waker;

/// Which way a unit went.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Direction {
    /// Host to drive.
    ToDrive,
    /// Drive to host.
    ToHost,
}

/// Takes every unit as it passes. Called with the connection's lock held: be quick.
pub trait Tap: Send {
    /// `bytes` were sent or read at once; a frame may be split over several calls.
    fn unit(&mut self, at: Instant, direction: Direction, bytes: &[u8]);
}

impl<F: FnMut(Instant, Direction, &[u8]) + Send> Tap for F {
    fn unit(&mut self, at: Instant, direction: Direction, bytes: &[u8]) {
        self(at, direction, bytes);
    }
}

/// A link whose traffic a [`Tap`] sees. Wrap the host's end; reopening keeps the tap.
pub struct Tapped {
    inner: Box<dyn Link<Stream>>,
    tap: Arc<Mutex<dyn Tap>>,
}

impl Tapped {
    /// Taps `inner`.
    #[must_use]
    pub fn new(inner: Box<dyn Link<Stream>>, tap: impl Tap + 'static) -> Self {
        Self { inner, tap: Arc::new(Mutex::new(tap)) }
    }

    fn note(&self, at: Instant, direction: Direction, bytes: &[u8]) {
        self.tap.lock().unwrap_or_else(PoisonError::into_inner).unit(at, direction, bytes);
    }
}

impl std::fmt::Debug for Tapped {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_tuple("Tapped").field(&self.inner.describe()).finish()
    }
}

impl Link<Stream> for Tapped {
    fn now(&self) -> Instant {
        self.inner.now()
    }

    fn send(&self, unit: &[u8]) -> Result<(), LinkError> {
        // Before the write: the answer may be read by another thread before this one returns.
        self.note(self.inner.now(), Direction::ToDrive, unit);
        self.inner.send(unit)
    }

    fn receive(&self, buffer: &mut [u8], until: Instant) -> Result<Received, LinkError> {
        let received = self.inner.receive(buffer, until)?;
        if let Received::Bytes { len, at } = received {
            self.note(at, Direction::ToHost, &buffer[..len]);
        }
        Ok(received)
    }

    fn set_line(&self, line: SerialLine) -> Result<(), LinkError> {
        self.inner.set_line(line)
    }

    fn waker(&self) -> Waker {
        self.inner.waker()
    }

    fn describe(&self) -> String {
        self.inner.describe()
    }

    fn reopen(&self) -> Result<Box<dyn Link<Stream>>, LinkError> {
        let inner = self.inner.reopen()?;
        Ok(Box::new(Self { inner, tap: Arc::clone(&self.tap) }))
    }
}

/// Writes the serial capture format: `(1700000000.000500) ttyUSB0 > 01 01 00 …`, `>` host to
/// drive, `<` drive to host, a line a unit.
#[derive(Debug)]
pub struct SerialLog<W> {
    to: W,
    link: String,
    line: String,
}

impl<W: Write + Send> SerialLog<W> {
    /// Writes to `to`; `link` is shortened to its last part (`/dev/ttyUSB0` to `ttyUSB0`).
    pub fn new(to: W, link: &str) -> Self {
        let link = link.rsplit('/').next().unwrap_or(link).replace(char::is_whitespace, "_");
        Self { to, link, line: String::new() }
    }
}

impl<W: Write + Send> Tap for SerialLog<W> {
    fn unit(&mut self, at: Instant, direction: Direction, bytes: &[u8]) {
        use std::fmt::Write as _;
        let wall_us = clock::wall_ns(at) / 1000;
        let arrow = if direction == Direction::ToDrive { '>' } else { '<' };
        self.line.clear();
        let (seconds, micros) = (wall_us / 1_000_000, wall_us % 1_000_000);
        let _ = write!(self.line, "({seconds}.{micros:06}) {} {arrow}", self.link);
        for byte in bytes {
            let _ = write!(self.line, " {byte:02X}");
        }
        self.line.push('\n');
        // A full disk must not stop a motor's host: the trace is then short, the session goes on.
        let _ = self.to.write_all(self.line.as_bytes());
    }
}
