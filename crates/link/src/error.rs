//! Errors of the operating system by cause, with what to try.

use std::fmt;

/// A link that could not be opened, set or used.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct LinkError {
    cause: Cause,
    name: String,
    os: Option<i32>,
    hint: String,
}

/// Cause of a link error. Each cause has its own remedy.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
#[non_exhaustive]
pub enum Cause {
    /// This user may not open it.
    Permission,
    /// There is no such port, file or host.
    NotFound,
    /// Another program has it.
    Busy,
    /// The link was lost: unplugged, or the far end closed.
    Gone,
    /// No program listens at that address.
    Refused,
    /// No way to that address, or no answer from it.
    Unreachable,
    /// The port does not support the speed or format, or is not a device of this kind.
    Unsuitable,
    /// The far end takes no bytes.
    Stalled,
    /// A network or CAN interface is there, and switched off.
    Down,
    /// This program closed it.
    Closed,
    /// Another error of the system; the error number has the details.
    System,
}

impl LinkError {
    /// An error about the link `name`, from an error of the system.
    #[must_use]
    pub fn from_io(name: &str, error: &std::io::Error) -> Self {
        let cause = cause_of(error);
        Self { os: error.raw_os_error(), ..Self::new(name, cause) }
    }

    /// An error that no system call reported.
    #[must_use]
    pub fn new(name: &str, cause: Cause) -> Self {
        Self { cause, name: name.to_owned(), os: None, hint: cause_hint(cause).to_owned() }
    }

    /// The link `name` went away.
    #[must_use]
    pub fn gone(name: &str) -> Self {
        Self::new(name, Cause::Gone)
    }

    /// Adds a hint in front of the others.
    #[must_use]
    pub fn with_hint(mut self, first: &str) -> Self {
        self.hint = if first.is_empty() { self.hint } else { format!("{first} {}", self.hint) };
        self
    }

    /// Cause by which programs decide what to do.
    #[must_use]
    pub const fn cause(&self) -> Cause {
        self.cause
    }

    /// Name of the link.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Advice for a technician, in full sentences.
    #[must_use]
    pub fn hint(&self) -> &str {
        &self.hint
    }

    /// True when the link is lost: only opening it again can help.
    #[must_use]
    pub const fn is_gone(&self) -> bool {
        !matches!(self.cause, Cause::Stalled | Cause::Unsuitable)
    }
}

impl fmt::Display for LinkError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.name, cause_sentence(self.cause))?;
        match self.os {
            Some(os) => write!(f, " ({})", std::io::Error::from_raw_os_error(os)),
            None => Ok(()),
        }
    }
}

impl std::error::Error for LinkError {}

fn cause_of(error: &std::io::Error) -> Cause {
    use std::io::ErrorKind as Kind;
    #[cfg(unix)]
    if let Some(cause) = rustix::io::Errno::from_io_error(error).and_then(cause_of_errno) {
        return cause;
    }
    match error.kind() {
        Kind::PermissionDenied => Cause::Permission,
        Kind::NotFound => Cause::NotFound,
        Kind::ConnectionRefused => Cause::Refused,
        Kind::BrokenPipe
        | Kind::ConnectionReset
        | Kind::ConnectionAborted
        | Kind::NotConnected
        | Kind::UnexpectedEof => Cause::Gone,
        Kind::TimedOut | Kind::HostUnreachable | Kind::NetworkUnreachable => Cause::Unreachable,
        Kind::ResourceBusy | Kind::AddrInUse => Cause::Busy,
        Kind::Unsupported | Kind::InvalidInput => Cause::Unsuitable,
        _ => Cause::System,
    }
}

/// Causes that the standard library's error kinds do not distinguish.
#[cfg(unix)]
fn cause_of_errno(errno: rustix::io::Errno) -> Option<Cause> {
    use rustix::io::Errno;
    match errno {
        Errno::IO | Errno::NXIO | Errno::NODEV => Some(Cause::Gone),
        Errno::BUSY | Errno::WOULDBLOCK => Some(Cause::Busy),
        Errno::NETDOWN => Some(Cause::Down),
        Errno::NOBUFS => Some(Cause::Stalled),
        Errno::NOTTY | Errno::INVAL => Some(Cause::Unsuitable),
        _ => None,
    }
}

const fn cause_sentence(cause: Cause) -> &'static str {
    match cause {
        Cause::Permission => "this user has no permission to open it",
        Cause::NotFound => "there is no such port",
        Cause::Busy => "another program is using it",
        Cause::Gone => "the connection is gone: unplugged, or closed at the far end",
        Cause::Refused => "no program is listening there",
        Cause::Unreachable => "no answer from that address",
        Cause::Unsuitable => "the adapter does not support this setting",
        Cause::Stalled => "the far end accepts no bytes",
        Cause::Down => "the interface is switched off",
        Cause::Closed => "this program has closed it",
        Cause::System => "the operating system reports an error",
    }
}

const fn cause_hint(cause: Cause) -> &'static str {
    match cause {
        Cause::Permission => {
            "Join the port's group and log in again: `sudo usermod -aG dialout $USER` (on Arch \
             `uucp`)."
        }
        Cause::NotFound => "`polepair ports` lists the ports; check plug and cable.",
        Cause::Busy => {
            "Close the other program (a terminal, a vendor's tool, ModemManager), then try again. \
             If it is `polepair serve`, run this verb on it: `--server URL`, with the address \
             that it printed after `ready` (default: http://127.0.0.1:7365)."
        }
        Cause::Gone => "Plug it in again, or check power and network at the far end.",
        Cause::Refused => {
            "Check the port number, and that the serial server is in TCP server mode."
        }
        Cause::Unreachable => "Check address, cable, power and firewall; try `ping`.",
        Cause::Unsuitable => {
            "Choose a speed and format that the adapter can do, or another adapter."
        }
        Cause::Stalled => "Check that flow control is off and that something reads at the far end.",
        Cause::Closed => "Open it again, and use the axes of the new link.",
        Cause::Down => "`ip link show` lists the interfaces; switch it on.",
        Cause::System => "The number in brackets is the system's own.",
    }
}
