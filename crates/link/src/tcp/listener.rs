use std::net::{SocketAddr, TcpListener};
use std::sync::{Arc, Mutex, PoisonError};

use polepair_core::medium::{SerialLine, Stream};
use polepair_core::time::Instant;

use crate::clock;
use crate::descriptor::Descriptor;
use crate::error::LinkError;
use crate::link::{LinkIo, Received};
use crate::read_mode::ReadMode;
use crate::waker::LinkWaker;
use rustix::event::{PollFd, PollFlags, poll};

/// The drive's end of a TCP connection: accepts one client after another. Data sent without a client is
/// lost, as on a wire without a listener.
#[derive(Debug)]
pub struct TcpServer {
    listener: TcpListener,
    address: SocketAddr,
    waker: LinkWaker,
    client: Mutex<Option<Arc<Descriptor>>>,
}

impl TcpServer {
    /// Listens at `address`; port 0 takes a free one. An address without a host
    /// (`:0`, `4001`) means this machine only.
    ///
    /// # Errors
    /// [`LinkError`], mostly that the port is taken.
    pub fn bind(address: &str) -> Result<Self, LinkError> {
        let fail = |error: std::io::Error| LinkError::from_io(address, &error);
        let listener = listen(address)?;
        let at = listener.local_addr().map_err(fail)?;
        Ok(Self {
            listener,
            address: at,
            waker: LinkWaker::new().map_err(fail)?,
            client: None.into(),
        })
    }

    /// Address of the listener.
    #[must_use]
    pub const fn address(&self) -> SocketAddr {
        self.address
    }

    fn client(&self) -> Option<Arc<Descriptor>> {
        self.client.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    fn set_client(&self, client: Option<Arc<Descriptor>>) {
        *self.client.lock().unwrap_or_else(PoisonError::into_inner) = client;
    }

    /// Waits for a client; `None` when one connected.
    fn wait_for_client(&self, until: Instant) -> Result<Option<Received>, LinkError> {
        let name = self.address.to_string();
        loop {
            if let Ok((stream, _)) = self.listener.accept() {
                let _ = stream.set_nodelay(true);
                stream.set_nonblocking(true).map_err(|error| LinkError::from_io(&name, &error))?;
                let client = Descriptor::with_waker(
                    ReadMode::Stream,
                    stream.into(),
                    self.waker.clone(),
                    &name,
                );
                self.set_client(Some(Arc::new(client)));
                return Ok(None);
            }
            let left = until.since(clock::now());
            if left.is_zero() {
                return Ok(Some(Received::TimedOut));
            }
            let mut fds = [
                PollFd::new(&self.listener, PollFlags::IN),
                PollFd::from_borrowed_fd(self.waker.as_fd(), PollFlags::IN),
            ];
            let timeout = (until != Instant::FAR_FUTURE).then(|| crate::read_mode::timespec(left));
            let _ = poll(&mut fds, timeout.as_ref());
            if !fds[1].revents().is_empty() && self.waker.take_wakeup() {
                return Ok(Some(Received::Woken));
            }
        }
    }
}

impl LinkIo<Stream> for TcpServer {
    fn now(&self) -> Instant {
        clock::now()
    }

    fn send(&self, unit: &[u8]) -> Result<(), LinkError> {
        // A client that left or reads nothing is found out by `receive`.
        match self.client() {
            Some(client) => client.send(unit).or(Ok(())),
            None => Ok(()),
        }
    }

    fn receive(&self, buffer: &mut [u8], until: Instant) -> Result<Received, LinkError> {
        loop {
            if let Some(client) = self.client() {
                match client.receive(buffer, until) {
                    Err(error) if error.is_gone() => self.set_client(None),
                    received => return received,
                }
            }
            if let Some(other) = self.wait_for_client(until)? {
                return Ok(other);
            }
        }
    }

    fn set_line(&self, _line: SerialLine) -> Result<(), LinkError> {
        Ok(())
    }

    fn waker(&self) -> LinkWaker {
        self.waker.clone()
    }

    fn describe(&self) -> String {
        self.address.to_string()
    }
}

/// Listens without ever waiting.
pub(crate) fn listen(address: &str) -> Result<TcpListener, LinkError> {
    let listener = TcpListener::bind(with_host(address))
        .and_then(|listener| listener.set_nonblocking(true).map(|()| listener));
    listener.map_err(|error| LinkError::from_io(address, &error))
}

/// Adds the loopback address where none is given, so that drives are reachable from this machine only.
fn with_host(address: &str) -> String {
    match address.rsplit_once(':') {
        Some(("", port)) => format!("127.0.0.1:{port}"),
        Some(_) => address.to_owned(),
        None => format!("127.0.0.1:{address}"),
    }
}
