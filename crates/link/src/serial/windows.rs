use std::io::{Read, Write};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use polepair_core::medium::{Parity, SerialLine, Stream};
use polepair_core::time::Instant;

use crate::clock;
use crate::error::{Cause, LinkError};
use crate::link::{LinkIo, Received};
use crate::ports;
use crate::waker::{LinkWaker, SlicedWait};

/// An open serial port.
pub struct SerialPort {
    /// Reading and writing have a handle each: the reader waits while others write.
    reader: Mutex<Box<dyn serialport::SerialPort>>,
    writer: Mutex<Box<dyn serialport::SerialPort>>,
    waker: LinkWaker,
    path: String,
    line: Mutex<SerialLine>,
}

impl SerialPort {
    pub(super) fn open(path: &str, line: SerialLine) -> Result<Self, LinkError> {
        let baud = if line.baud == 0 { 9600 } else { line.baud };
        let reader = serialport::new(path, baud)
            .timeout(Duration::from_millis(10))
            .open()
            .map_err(|error| explain_error(path, &error))?;
        let writer = reader.try_clone().map_err(|error| explain_error(path, &error))?;
        let waker = LinkWaker::new().map_err(|error| LinkError::from_io(path, &error))?;
        let port = Self {
            reader: reader.into(),
            writer: writer.into(),
            waker,
            path: path.to_owned(),
            line: line.into(),
        };
        port.set_line(line)?;
        let _ = lock(&port.writer).clear(serialport::ClearBuffer::All);
        Ok(port)
    }
}

impl std::fmt::Debug for SerialPort {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("SerialPort").field("path", &self.path).finish_non_exhaustive()
    }
}

impl LinkIo<Stream> for SerialPort {
    fn now(&self) -> Instant {
        clock::now()
    }

    fn send(&self, unit: &[u8]) -> Result<(), LinkError> {
        lock(&self.writer).write_all(unit).map_err(|e| LinkError::from_io(&self.path, &e))
    }

    fn receive(&self, buffer: &mut [u8], until: Instant) -> Result<Received, LinkError> {
        let mut reader = lock(&self.reader);
        SlicedWait { waker: &self.waker, name: &self.path }.receive(until, |slice| {
            reader.set_timeout(slice)?;
            reader.read(buffer)
        })
    }

    fn set_line(&self, line: SerialLine) -> Result<(), LinkError> {
        let mut port = lock(&self.writer);
        apply_line(port.as_mut(), line).map_err(|error| explain_error(&self.path, &error))?;
        *lock(&self.line) = line;
        Ok(())
    }

    fn waker(&self) -> LinkWaker {
        self.waker.clone()
    }

    fn describe(&self) -> String {
        self.path.clone()
    }

    fn reopen(&self) -> Result<Box<dyn LinkIo<Stream>>, LinkError> {
        let line = *lock(&self.line);
        Ok(Box::new(Self::open(&self.path, line)?))
    }
}

fn lock<T: ?Sized>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

fn apply_line(port: &mut dyn serialport::SerialPort, line: SerialLine) -> serialport::Result<()> {
    if line.baud != 0 {
        port.set_baud_rate(line.baud)?;
    }
    port.set_data_bits(match line.data_bits {
        7 => serialport::DataBits::Seven,
        _ => serialport::DataBits::Eight,
    })?;
    port.set_parity(match line.parity {
        Parity::None => serialport::Parity::None,
        Parity::Even => serialport::Parity::Even,
        Parity::Odd => serialport::Parity::Odd,
    })?;
    port.set_stop_bits(match line.stop_bits {
        2 => serialport::StopBits::Two,
        _ => serialport::StopBits::One,
    })
}

fn explain_error(path: &str, error: &serialport::Error) -> LinkError {
    use serialport::ErrorKind as Kind;
    let cause = match error.kind() {
        // Windows says "access denied" for a port that another program has open.
        Kind::NoDevice if ports::serial_paths().iter().any(|name| name == path) => Cause::Busy,
        Kind::NoDevice => Cause::NotFound,
        Kind::InvalidInput => Cause::Unsuitable,
        Kind::Io(std::io::ErrorKind::PermissionDenied) => Cause::Busy,
        Kind::Io(std::io::ErrorKind::NotFound) => Cause::NotFound,
        _ => Cause::System,
    };
    let there = format!("Ports that exist: {}.", ports::serial_paths().join(", "));
    LinkError::new(path, cause).with_hint(if cause == Cause::NotFound { &there } else { "" })
}
