//! Wakes a blocked wait.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use polepair_core::time::Instant;

#[cfg(unix)]
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};

/// Makes one wait return: the one under way, or else the next. Cheap to clone and to use twice.
#[derive(Clone, Debug)]
pub struct LinkWaker(Arc<WakeSignal>);

impl LinkWaker {
    /// A waker of its own.
    ///
    /// # Errors
    /// What the operating system says when it has no descriptors left.
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

    /// Readable after a wake-up.
    #[cfg(unix)]
    #[must_use]
    pub fn as_fd(&self) -> BorrowedFd<'_> {
        self.0.read_end.as_fd()
    }
}

#[derive(Debug)]
struct WakeSignal {
    pending: AtomicBool,
    #[cfg(unix)]
    read_end: OwnedFd,
    /// The writing end where the system has pipes only.
    #[cfg(all(unix, not(target_os = "linux")))]
    write_end: OwnedFd,
}

impl WakeSignal {
    #[cfg(unix)]
    fn sleep(&self, span: Option<Duration>) {
        use rustix::event::{PollFd, PollFlags, poll};
        let timeout = span.map(crate::descriptor::timespec);
        // A signal ends it early: the caller looks again.
        let _ = poll(&mut [PollFd::new(&self.read_end, PollFlags::IN)], timeout.as_ref());
    }

    /// In slices, where the system offers nothing that a waker could end.
    #[cfg(not(unix))]
    fn sleep(&self, span: Option<Duration>) {
        let slice = Duration::from_millis(5);
        std::thread::sleep(span.unwrap_or(slice).min(slice));
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

#[cfg(not(unix))]
impl WakeSignal {
    #[allow(clippy::unnecessary_wraps, reason = "the other systems can fail here")]
    fn new() -> std::io::Result<Self> {
        Ok(Self { pending: AtomicBool::new(false) })
    }

    fn signal(&self) {}

    fn clear(&self) -> bool {
        false
    }
}

/// Waiting in slices, where the system offers nothing that a waker could end.
#[cfg(windows)]
pub(crate) struct SlicedWait<'a> {
    pub(crate) waker: &'a LinkWaker,
    pub(crate) name: &'a str,
}

#[cfg(windows)]
impl SlicedWait<'_> {
    /// Reads with `read(timeout)` until something comes, `until` has come or somebody wakes.
    pub(crate) fn receive(
        &self,
        until: polepair_core::time::Instant,
        mut read: impl FnMut(std::time::Duration) -> std::io::Result<usize>,
    ) -> Result<crate::link::Received, crate::error::LinkError> {
        use crate::clock;
        use crate::error::LinkError;
        use crate::link::Received;
        use std::io::ErrorKind;
        use std::time::Duration;
        const SLICE_MAX: Duration = Duration::from_millis(10);
        loop {
            let left = until.since(clock::now());
            match read(left.clamp(Duration::from_millis(1), SLICE_MAX)) {
                Ok(0) => return Err(LinkError::gone(self.name)),
                Ok(len) => return Ok(Received::Bytes { len, at: clock::now() }),
                Err(error) => match error.kind() {
                    ErrorKind::TimedOut | ErrorKind::WouldBlock | ErrorKind::Interrupted => {}
                    _ => return Err(LinkError::from_io(self.name, &error)),
                },
            }
            if self.waker.take_wakeup() {
                return Ok(Received::Woken);
            }
            if left.is_zero() {
                return Ok(Received::TimedOut);
            }
        }
    }
}
