//! Serial ports: any baud rate, exclusive access, low latency if the adapter supports it.

#[cfg(unix)]
mod error_counts;
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
mod latency;
#[cfg(unix)]
mod unix;
#[cfg(windows)]
mod windows;

#[cfg(unix)]
pub use unix::SerialPort;
#[cfg(windows)]
pub use windows::SerialPort;

use polepair_core::medium::SerialLine;

use crate::error::LinkError;

/// Opens the port at `path` with `line`, for this process alone.
///
/// On Linux the name that survives replugging (`/dev/serial/by-id/…`) is remembered when there is
/// one, and [`reopen`](crate::LinkIo::reopen) uses it.
///
/// # Errors
/// [`LinkError`], saying which ports there are, or who holds this one.
pub fn open(path: &str, line: SerialLine) -> Result<SerialPort, LinkError> {
    SerialPort::open(path, line)
}
