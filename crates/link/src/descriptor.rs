//! A file descriptor that is awaited together with a waker. Serial ports, pseudo-terminals and sockets use
//! it.

use std::time::Duration;

use polepair_core::time::Instant;
use rustix::event::{PollFd, PollFlags, poll};
use rustix::fd::{AsFd, BorrowedFd, OwnedFd};
use rustix::io::Errno;

use crate::clock;
#[cfg(target_os = "linux")]
use crate::epoll_set::EpollSet;
use crate::error::{Cause, LinkError};
use crate::link::Received;
use crate::read_mode::{ReadMode, timespec};
use crate::waker::LinkWaker;

/// Time limit of a send to a far end that takes no bytes, before the unit is given up. The lock of a connection is held
/// meanwhile, so it is short.
const SEND_STALL_MAX: Duration = Duration::from_millis(20);

#[derive(Debug)]
pub(crate) struct Descriptor {
    pub(crate) fd: OwnedFd,
    pub(crate) waker: LinkWaker,
    pub(crate) name: String,
    #[cfg(target_os = "linux")]
    epoll: EpollSet,
}

impl Descriptor {
    /// Takes a stream's descriptor, which is already non-blocking.
    pub(crate) fn new(fd: OwnedFd, name: &str) -> Result<Self, LinkError> {
        Self::with_mode(ReadMode::Stream, fd, name)
    }

    /// Takes one that is read otherwise.
    pub(crate) fn with_mode(reads: ReadMode, fd: OwnedFd, name: &str) -> Result<Self, LinkError> {
        let wake = LinkWaker::new().map_err(|error| LinkError::from_io(name, &error))?;
        Ok(Self::with_waker(reads, fd, wake, name))
    }

    /// [`new`](Self::new) with a waker that others share.
    pub(crate) fn with_waker(reads: ReadMode, fd: OwnedFd, waker: LinkWaker, name: &str) -> Self {
        #[cfg(not(target_os = "linux"))]
        let _ = reads;
        Self {
            #[cfg(target_os = "linux")]
            epoll: EpollSet::new(fd.as_fd(), reads, waker.as_fd()),
            fd,
            waker,
            name: name.to_owned(),
        }
    }

    pub(crate) fn send(&self, mut bytes: &[u8]) -> Result<(), LinkError> {
        while !bytes.is_empty() {
            match write_bytes(&self.fd, bytes) {
                Ok(sent) => bytes = &bytes[sent..],
                Err(Errno::INTR) => {}
                Err(Errno::WOULDBLOCK) => self.wait_for_room(self.fd.as_fd())?,
                Err(errno) => return Err(self.error(errno)),
            }
        }
        Ok(())
    }

    pub(crate) fn receive(&self, buffer: &mut [u8], until: Instant) -> Result<Received, LinkError> {
        self.receive_with(until, || self.read(buffer))
    }

    /// Waits as [`Link::receive`](crate::Link::receive) does. `read` takes the available data, `None`
    /// if there is none, or none of interest.
    pub(crate) fn receive_with(
        &self,
        until: Instant,
        mut read: impl FnMut() -> Result<Option<Received>, LinkError>,
    ) -> Result<Received, LinkError> {
        if until == Instant::ZERO {
            return Ok(read()?.unwrap_or(Received::TimedOut));
        }
        loop {
            let (ready, woken) = match self.wait_readable(until) {
                Ok(ready) => ready,
                Err(Errno::INTR) => (PollFlags::empty(), false),
                Err(errno) => return Err(self.error(errno)),
            };
            if !ready.is_empty() {
                if let Some(received) = read()? {
                    return Ok(received);
                }
                // Hung up, and nothing to read: without this the loop would spin.
                if ready.intersects(PollFlags::HUP | PollFlags::ERR | PollFlags::NVAL) {
                    return Err(LinkError::gone(&self.name));
                }
            }
            if woken && self.waker.take_wakeup() {
                return Ok(Received::Woken);
            }
            if until <= clock::now() {
                // A last check: data may have arrived without a notice.
                return Ok(read()?.unwrap_or(Received::TimedOut));
            }
        }
    }

    /// Waits for data. Returns the poll flags and whether the waker was used.
    fn wait_readable(&self, until: Instant) -> Result<(PollFlags, bool), Errno> {
        #[cfg(target_os = "linux")]
        if let Some(waited) = self.epoll.wait(until) {
            return waited;
        }
        let timeout = (until != Instant::FAR_FUTURE).then(|| timespec(until.since(clock::now())));
        let mut fds = [
            PollFd::new(&self.fd, PollFlags::IN),
            PollFd::from_borrowed_fd(self.waker.as_fd(), PollFlags::IN),
        ];
        poll(&mut fds, timeout.as_ref())?;
        Ok((fds[0].revents(), !fds[1].revents().is_empty()))
    }

    /// `None` when there is nothing now.
    fn read(&self, buffer: &mut [u8]) -> Result<Option<Received>, LinkError> {
        loop {
            return match read_bytes(&self.fd, &mut *buffer) {
                // A port unplugged and a socket closed both read as an end, for ever.
                Ok(0) => Err(LinkError::gone(&self.name)),
                Ok(len) => {
                    self.note_drained(len < buffer.len());
                    Ok(Some(Received::Bytes { len, at: clock::now() }))
                }
                Err(Errno::INTR) => continue,
                Err(Errno::WOULDBLOCK) => {
                    self.note_drained(true);
                    Ok(None)
                }
                Err(errno) => Err(self.error(errno)),
            };
        }
    }

    /// Notes whether a read has taken all there was.
    fn note_drained(&self, drained: bool) {
        #[cfg(target_os = "linux")]
        self.epoll.set_drained(drained);
        #[cfg(not(target_os = "linux"))]
        let _ = drained;
    }

    /// Waits for room until `until`.
    pub(crate) fn wait_writable(&self, until: Instant) -> Result<bool, LinkError> {
        loop {
            let mut fds = [PollFd::new(&self.fd, PollFlags::OUT)];
            match poll(&mut fds, Some(&timespec(until.since(clock::now())))) {
                Ok(0) => return Ok(false),
                Ok(_) => return Ok(true),
                Err(Errno::INTR) => {}
                Err(errno) => return Err(self.error(errno)),
            }
        }
    }

    /// Waits until `fd`, this or what sends beside it, takes more.
    pub(crate) fn wait_for_room(&self, fd: BorrowedFd<'_>) -> Result<(), LinkError> {
        let mut fds = [PollFd::from_borrowed_fd(fd, PollFlags::OUT)];
        match poll(&mut fds, Some(&timespec(SEND_STALL_MAX))) {
            Ok(0) => Err(LinkError::new(&self.name, Cause::Stalled)),
            Ok(_) | Err(Errno::INTR) => Ok(()),
            Err(errno) => Err(self.error(errno)),
        }
    }

    pub(crate) fn error(&self, errno: Errno) -> LinkError {
        LinkError::from_io(&self.name, &errno.into())
    }
}

/// Reads the available bytes, without waiting.
#[cfg(unix)]
pub(crate) fn read_bytes(fd: &OwnedFd, buffer: &mut [u8]) -> Result<usize, Errno> {
    rustix::io::read(fd, buffer)
}

/// Writes the bytes for which there is room, without waiting.
#[cfg(unix)]
pub(crate) fn write_bytes(fd: &OwnedFd, bytes: &[u8]) -> Result<usize, Errno> {
    rustix::io::write(fd, bytes)
}

#[cfg(windows)]
pub(crate) fn read_bytes(fd: &OwnedFd, buffer: &mut [u8]) -> Result<usize, Errno> {
    rustix::net::recv(fd, buffer, rustix::net::RecvFlags::empty()).map(|(len, _)| len)
}

#[cfg(windows)]
pub(crate) fn write_bytes(fd: &OwnedFd, bytes: &[u8]) -> Result<usize, Errno> {
    rustix::net::send(fd, bytes, rustix::net::SendFlags::empty())
}
