use std::os::fd::OwnedFd;

use polepair_core::medium::{Parity, SerialLine, Stream};
use polepair_core::time::Instant;
use rustix::fs::{FlockOperation, Mode, OFlags, flock};
use rustix::io::Errno;
use rustix::termios::{
    ControlModes, OptionalActions, QueueSelector, SpecialCodeIndex, Termios, ioctl_tiocexcl,
    tcflush, tcgetattr, tcsetattr,
};

use super::error_counts::ErrorCounts;
use crate::clock;
use crate::descriptor::Descriptor;
use crate::error::{Cause, LinkError};
use crate::link::{LinkIo, Losses, Received};
use crate::ports;
use crate::waker::LinkWaker;

/// An open serial port or the near end of a pseudo-terminal.
#[derive(Debug)]
pub struct SerialPort {
    descriptor: Descriptor,
    /// The name that survives replugging.
    stable_path: String,
    line: std::sync::Mutex<SerialLine>,
    /// Counts of the driver when the port was opened.
    counts_at_open: ErrorCounts,
}

impl SerialPort {
    pub(super) fn open(path: &str, line: SerialLine) -> Result<Self, LinkError> {
        let stable = ports::stable_name(path).unwrap_or_else(|| path.to_owned());
        Self::open_with_stable_path(path, stable, line)
    }

    fn open_with_stable_path(
        path: &str,
        stable: String,
        line: SerialLine,
    ) -> Result<Self, LinkError> {
        let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::NONBLOCK | OFlags::CLOEXEC;
        let fd = rustix::fs::open(path, flags, Mode::empty())
            .map_err(|errno| explain_error(path, errno))?;
        lock_port(&fd, path)?;
        configure(&fd, line).map_err(|errno| explain_error(path, errno))?;
        #[cfg(all(
            target_os = "linux",
            any(
                target_arch = "x86_64",
                target_arch = "x86",
                target_arch = "aarch64",
                target_arch = "arm",
                target_arch = "riscv64"
            )
        ))]
        super::latency::request_low_latency(&fd);
        // Bytes that an earlier program left unread answer none of our requests.
        let _ = tcflush(&fd, QueueSelector::IOFlush);
        let counted = ErrorCounts::read_from(&fd);
        let descriptor = Descriptor::new(fd, path)?;
        Ok(Self { descriptor, stable_path: stable, line: line.into(), counts_at_open: counted })
    }

    fn line(&self) -> SerialLine {
        *self.line.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
    }
}

impl LinkIo<Stream> for SerialPort {
    fn now(&self) -> Instant {
        clock::now()
    }

    fn send(&self, unit: &[u8]) -> Result<(), LinkError> {
        self.descriptor.send(unit)
    }

    fn wait_writable(&self, until: Instant) -> Result<bool, LinkError> {
        self.descriptor.wait_writable(until)
    }

    fn receive(&self, buffer: &mut [u8], until: Instant) -> Result<Received, LinkError> {
        self.descriptor.receive(buffer, until)
    }

    fn set_line(&self, line: SerialLine) -> Result<(), LinkError> {
        configure(&self.descriptor.fd, line).map_err(|errno| self.descriptor.error(errno))?;
        *self.line.lock().unwrap_or_else(std::sync::PoisonError::into_inner) = line;
        Ok(())
    }

    fn waker(&self) -> LinkWaker {
        self.descriptor.waker.clone()
    }

    fn describe(&self) -> String {
        self.descriptor.name.clone()
    }

    fn losses(&self) -> Losses {
        let (overrun, malformed) =
            ErrorCounts::read_from(&self.descriptor.fd).since(self.counts_at_open);
        Losses { overrun, malformed, ..Losses::default() }
    }

    fn reopen(&self) -> Result<Box<dyn LinkIo<Stream>>, LinkError> {
        Ok(Box::new(Self::open_with_stable_path(
            &self.stable_path,
            self.stable_path.clone(),
            self.line(),
        )?))
    }
}

/// Makes the port ours. The lock is what other well-behaved programs ask for; the exclusive mode
/// stops the others. Both end with the process, however it ends.
fn lock_port(fd: &OwnedFd, path: &str) -> Result<(), LinkError> {
    flock(fd, FlockOperation::NonBlockingLockExclusive)
        .map_err(|errno| explain_error(path, errno))?;
    // A pty stays exclusive as long as its far end is open, that is after we have gone: the next
    // client of a simulated drive would be refused.
    if !is_pty(fd) {
        let _ = ioctl_tiocexcl(fd);
    }
    Ok(())
}

fn is_pty(fd: &OwnedFd) -> bool {
    rustix::termios::ttyname(fd, Vec::new())
        .is_ok_and(|name| name.as_bytes().starts_with(b"/dev/pts/"))
}

/// Sets speed and format at once, without waiting for data that is still being sent.
fn configure(fd: &OwnedFd, line: SerialLine) -> Result<(), Errno> {
    let mut termios = tcgetattr(fd)?;
    apply_format(&mut termios, line);
    // 0 means "no timing" to us and "hang up" to a terminal.
    if line.baud != 0 {
        termios.set_speed(line.baud)?;
    }
    tcsetattr(fd, OptionalActions::Now, &termios)
}

fn apply_format(termios: &mut Termios, line: SerialLine) {
    termios.make_raw();
    let modes = &mut termios.control_modes;
    modes.remove(
        ControlModes::CSIZE
            | ControlModes::CSTOPB
            | ControlModes::PARENB
            | ControlModes::PARODD
            | ControlModes::CRTSCTS,
    );
    modes.insert(ControlModes::CREAD | ControlModes::CLOCAL);
    modes.insert(if line.data_bits == 7 { ControlModes::CS7 } else { ControlModes::CS8 });
    modes.set(ControlModes::CSTOPB, line.stop_bits == 2);
    modes.set(ControlModes::PARENB, line.parity != Parity::None);
    modes.set(ControlModes::PARODD, line.parity == Parity::Odd);
    termios.special_codes[SpecialCodeIndex::VMIN] = 1;
    termios.special_codes[SpecialCodeIndex::VTIME] = 0;
}

/// The error, with details from this machine.
fn explain_error(path: &str, errno: Errno) -> LinkError {
    let error = LinkError::from_io(path, &errno.into());
    match error.cause() {
        Cause::NotFound | Cause::Gone => {
            let there = ports::serial_paths();
            let there = if there.is_empty() { "none".to_owned() } else { there.join(", ") };
            error.with_hint(&format!("Ports that exist: {there}."))
        }
        Cause::Busy => error.with_hint(&ports::holder_sentence(path)),
        _ => error,
    }
}
