use std::io;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use polepair_core::medium::{Parity, SerialLine, Stream};
use polepair_core::time::Instant;

use crate::clock;
use crate::error::{Cause, LinkError};
use crate::link::{LinkIo, Received};
use crate::ports;
use crate::sys::{OverlappedRead, use_fine_timers, wait_either};
use crate::waker::LinkWaker;

/// A read ends with the first bytes; without any it lasts for as long as the system allows.
const READ_TIMEOUT: Duration = Duration::from_millis(u32::MAX as u64 - 1);
/// Time limit of a write.
const WRITE_TIMEOUT: Duration = Duration::from_secs(1);

/// An open serial port. One thread reads while others write.
pub struct SerialPort {
    port: serial2::SerialPort,
    read: Mutex<OverlappedRead>,
    waker: LinkWaker,
    path: String,
    line: Mutex<SerialLine>,
}

impl SerialPort {
    pub(super) fn open(path: &str, line: SerialLine) -> Result<Self, LinkError> {
        use_fine_timers();
        let fail = |error: io::Error| explain_error(path, &error);
        let mut port = serial2::SerialPort::open(path, serial2::KeepSettings).map_err(fail)?;
        let _ = port.set_read_timeout(READ_TIMEOUT);
        let _ = port.set_write_timeout(WRITE_TIMEOUT);
        let opened = Self {
            port,
            read: OverlappedRead::new().map_err(fail)?.into(),
            waker: LinkWaker::new().map_err(fail)?,
            path: path.to_owned(),
            line: line.into(),
        };
        opened.set_line(line)?;
        let _ = opened.port.discard_buffers();
        Ok(opened)
    }
}

impl Drop for SerialPort {
    fn drop(&mut self) {
        lock(&self.read).cancel(&self.port);
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
        self.port.write_all(unit).map_err(|error| match error.kind() {
            io::ErrorKind::TimedOut => LinkError::new(&self.path, Cause::Stalled),
            _ => lost_error(&self.path, &error),
        })
    }

    fn receive(&self, buffer: &mut [u8], until: Instant) -> Result<Received, LinkError> {
        let lost = |error: io::Error| lost_error(&self.path, &error);
        let mut read = lock(&self.read);
        loop {
            read.start(&self.port).map_err(lost)?;
            let taken = read.take_unread(buffer);
            if taken > 0 {
                return Ok(Received::Bytes { len: taken, at: clock::now() });
            }
            let left = (until != Instant::FAR_FUTURE).then(|| until.since(clock::now()));
            match wait_either(read.event(), self.waker.event(), left).map_err(lost)? {
                Some(0) => {
                    let len = read.collect_bytes(&self.port, buffer).map_err(lost)?;
                    // A port that was unplugged reads as an end, for ever.
                    return match len {
                        0 => Err(LinkError::gone(&self.path)),
                        len => Ok(Received::Bytes { len, at: clock::now() }),
                    };
                }
                Some(_) if self.waker.take_wakeup() => return Ok(Received::Woken),
                _ if until <= clock::now() => return Ok(Received::TimedOut),
                _ => {}
            }
        }
    }

    fn set_line(&self, line: SerialLine) -> Result<(), LinkError> {
        let set = |settings: &mut serial2::Settings| {
            settings.set_raw();
            settings.set_baud_rate(if line.baud == 0 { 9600 } else { line.baud })?;
            settings.set_char_size(match line.data_bits {
                7 => serial2::CharSize::Bits7,
                _ => serial2::CharSize::Bits8,
            });
            settings.set_parity(match line.parity {
                Parity::None => serial2::Parity::None,
                Parity::Even => serial2::Parity::Even,
                Parity::Odd => serial2::Parity::Odd,
            });
            settings.set_stop_bits(match line.stop_bits {
                2 => serial2::StopBits::Two,
                _ => serial2::StopBits::One,
            });
            settings.set_flow_control(serial2::FlowControl::None);
            io::Result::Ok(())
        };
        // The handles are of one open port.
        let applied = self.port.try_clone().and_then(|mut port| {
            let mut settings = port.get_configuration()?;
            set(&mut settings)?;
            port.set_configuration(&settings)
        });
        applied.map_err(|error| explain_error(&self.path, &error))?;
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

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The error of a port that was open: the codes that Windows has for an adapter that was unplugged are many.
fn lost_error(path: &str, error: &io::Error) -> LinkError {
    let known = LinkError::from_io(path, error);
    match known.cause() {
        Cause::Permission | Cause::NotFound | Cause::System => LinkError::gone(path),
        _ => known,
    }
}

fn explain_error(path: &str, error: &io::Error) -> LinkError {
    let exists = || ports::serial_paths().iter().any(|name| name.eq_ignore_ascii_case(path));
    let cause = match error.kind() {
        // Windows reports "access denied" for a port that another program has open.
        io::ErrorKind::PermissionDenied => Cause::Busy,
        io::ErrorKind::NotFound if exists() => Cause::Gone,
        io::ErrorKind::NotFound => Cause::NotFound,
        io::ErrorKind::InvalidInput => Cause::Unsuitable,
        _ => return LinkError::from_io(path, error),
    };
    let there = format!("Ports that exist: {}.", ports::serial_paths().join(", "));
    LinkError::new(path, cause).with_hint(if cause == Cause::NotFound { &there } else { "" })
}
