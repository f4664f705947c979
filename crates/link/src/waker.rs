//! Wakes a blocked wait.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use polepair_core::time::Instant;

#[cfg(unix)]
use rustix::fd::OwnedFd;
use rustix::fd::{AsFd, BorrowedFd};
#[cfg(windows)]
use std::net::UdpSocket;

#[cfg(windows)]
use crate::sys::WaitEvent;

/// Makes one wait return: the one under way, or else the next. Cheap to clone and to use twice.
#[derive(Clone, Debug)]
pub struct LinkWaker(Arc<WakeSignal>);

impl LinkWaker {
    /// A waker of its own.
    ///
    /// # Errors
    /// The error of the operating system if it has no descriptors left.
    pub fn new() -> std::io::Result<Self> {
        Ok(Self(Arc::new(WakeSignal::new()?)))
    }

    /// Wakes. Calls before the sleeper has noticed count as one.
    pub fn wake(&self) {
        if !self.0.pending.swap(true, Ordering::AcqRel) {
            self.0.signal();
        }
    }

    /// Takes the wake-up, if there was one.
    #[must_use]
    pub fn take_wakeup(&self) -> bool {
        // Both, always: a ring may come a moment after its flag was taken, and would keep the
        // descriptor readable for ever.
        let received = self.0.clear();
        self.0.pending.swap(false, Ordering::AcqRel) || received
    }

    /// Waits for the waker or until `until`; true for the waker. For links with nothing else to wait for,
    /// such as simulated ones.
    #[must_use]
    pub fn wait(&self, until: Instant) -> bool {
        while !self.take_wakeup() {
            let now = crate::clock::now();
            if until <= now {
                return false;
            }
            self.0.sleep((until != Instant::FAR_FUTURE).then(|| until.since(now)));
        }
        true
    }

    /// Readable after a wake-up: a descriptor, or a socket on Windows.
    #[must_use]
    pub fn as_fd(&self) -> BorrowedFd<'_> {
        self.0.read_end.as_fd()
    }

    /// Set after a wake-up.
    #[cfg(windows)]
    pub(crate) fn event(&self) -> &WaitEvent {
        &self.0.event
    }
}

#[derive(Debug)]
struct WakeSignal {
    pending: AtomicBool,
    #[cfg(unix)]
    read_end: OwnedFd,
    /// Connected to itself, because Windows waits for sockets with sockets alone.
    #[cfg(windows)]
    read_end: UdpSocket,
    /// For what waits for events: serial ports.
    #[cfg(windows)]
    event: WaitEvent,
    /// The writing end where the system has pipes only.
    #[cfg(all(unix, not(target_os = "linux")))]
    write_end: OwnedFd,
}

impl WakeSignal {
    fn sleep(&self, span: Option<Duration>) {
        use rustix::event::{PollFd, PollFlags, poll};
        let timeout = span.map(crate::read_mode::timespec);
        // A signal ends it early: the caller looks again.
        let _ = poll(&mut [PollFd::new(&self.read_end, PollFlags::IN)], timeout.as_ref());
    }
}

#[cfg(target_os = "linux")]
impl WakeSignal {
    fn new() -> std::io::Result<Self> {
        use rustix::event::{EventfdFlags, eventfd};
        let read_end = eventfd(0, EventfdFlags::CLOEXEC | EventfdFlags::NONBLOCK)?;
        Ok(Self { pending: AtomicBool::new(false), read_end })
    }

    fn signal(&self) {
        let _ = rustix::io::write(&self.read_end, &1_u64.to_ne_bytes());
    }

    fn clear(&self) -> bool {
        rustix::io::read(&self.read_end, &mut [0_u8; 8]).is_ok()
    }
}

#[cfg(all(unix, not(target_os = "linux")))]
impl WakeSignal {
    fn new() -> std::io::Result<Self> {
        let (read_end, write_end) = rustix::pipe::pipe()?;
        for end in [&read_end, &write_end] {
            rustix::io::fcntl_setfd(end, rustix::io::FdFlags::CLOEXEC)?;
            rustix::io::ioctl_fionbio(end, true)?;
        }
        Ok(Self { pending: AtomicBool::new(false), read_end, write_end })
    }

    fn signal(&self) {
        let _ = rustix::io::write(&self.write_end, &[1]);
    }

    fn clear(&self) -> bool {
        rustix::io::read(&self.read_end, &mut [0_u8; 16]).is_ok()
    }
}

#[cfg(windows)]
impl WakeSignal {
    fn new() -> std::io::Result<Self> {
        let read_end = UdpSocket::bind((std::net::Ipv4Addr::LOCALHOST, 0))?;
        read_end.connect(read_end.local_addr()?)?;
        read_end.set_nonblocking(true)?;
        Ok(Self { pending: AtomicBool::new(false), read_end, event: WaitEvent::new()? })
    }

    fn signal(&self) {
        let _ = self.read_end.send(&[1]);
        self.event.set();
    }

    fn clear(&self) -> bool {
        self.event.reset();
        let mut was_signalled = false;
        while self.read_end.recv(&mut [0; 4]).is_ok() {
            was_signalled = true;
        }
        was_signalled
    }
}
