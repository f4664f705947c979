//! TCP: a client for serial servers, and a listener for a simulated drive.

use std::io::ErrorKind;
use std::net::{SocketAddr, TcpStream, ToSocketAddrs};
use std::time::Duration;

use polepair_core::medium::{SerialLine, Stream};
use polepair_core::time::Instant;

use crate::clock;
use crate::error::{Cause, LinkError};
use crate::link::{LinkIo, Received};
use crate::waker::LinkWaker;

mod listener;
pub use listener::TcpServer;
pub(crate) use {listener::listen, socket::keep_alive};

/// Time limit of a connection attempt to one address.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(2);
/// Addresses of one host name that are tried.
const ADDRESSES_MAX: usize = 4;

/// A connection to a serial server, or to a drive with Ethernet.
#[derive(Debug)]
pub struct TcpLink {
    socket: socket::TcpSocket,
    address: String,
}

impl TcpLink {
    /// Connects to `address` (`10.0.0.5:4001`, `server.local:4001`). Data is sent at once (no Nagle). The
    /// loss of the other end is detected within about ten seconds (keep-alive).
    ///
    /// # Errors
    /// [`LinkError`] of the last address tried.
    pub fn connect(address: &str) -> Result<Self, LinkError> {
        let stream = connect(address)?;
        let _ = stream.set_nodelay(true);
        Ok(Self { socket: socket::TcpSocket::new(stream, address)?, address: address.to_owned() })
    }
}

impl LinkIo<Stream> for TcpLink {
    fn now(&self) -> Instant {
        clock::now()
    }

    fn send(&self, unit: &[u8]) -> Result<(), LinkError> {
        self.socket.send(unit)
    }

    fn wait_writable(&self, until: Instant) -> Result<bool, LinkError> {
        self.socket.wait_writable(until)
    }

    fn receive(&self, buffer: &mut [u8], until: Instant) -> Result<Received, LinkError> {
        self.socket.receive(buffer, until)
    }

    fn set_line(&self, _line: SerialLine) -> Result<(), LinkError> {
        Ok(())
    }

    fn waker(&self) -> LinkWaker {
        self.socket.waker()
    }

    fn describe(&self) -> String {
        self.address.clone()
    }

    fn reopen(&self) -> Result<Box<dyn LinkIo<Stream>>, LinkError> {
        Ok(Box::new(Self::connect(&self.address)?))
    }
}

fn connect(address: &str) -> Result<TcpStream, LinkError> {
    let mut last = LinkError::new(address, Cause::NotFound)
        .with_hint("The host name or port number is not understood.");
    for address_of_host in resolve(address)? {
        match TcpStream::connect_timeout(&address_of_host, clock::scale_timeout(CONNECT_TIMEOUT)) {
            Ok(stream) => return Ok(stream),
            Err(error) => last = LinkError::from_io(address, &error),
        }
    }
    Err(last)
}

fn resolve(address: &str) -> Result<Vec<SocketAddr>, LinkError> {
    let found = address.to_socket_addrs().map_err(|error| match error.kind() {
        ErrorKind::InvalidInput => LinkError::new(address, Cause::NotFound)
            .with_hint("An address is HOST:PORT, for example 10.0.0.5:4001."),
        _ => LinkError::new(address, Cause::NotFound).with_hint("No such host."),
    })?;
    Ok(found.take(ADDRESSES_MAX).collect())
}

mod socket {
    use super::{Duration, LinkError, TcpStream};
    use crate::descriptor::Descriptor;
    use crate::link::Received;
    use crate::waker::LinkWaker;
    use polepair_core::time::Instant;
    use rustix::net::sockopt;

    #[derive(Debug)]
    pub(super) struct TcpSocket(Descriptor);

    impl TcpSocket {
        pub(super) fn new(stream: TcpStream, name: &str) -> Result<Self, LinkError> {
            stream.set_nonblocking(true).map_err(|error| LinkError::from_io(name, &error))?;
            keep_alive(&stream);
            Ok(Self(Descriptor::new(stream.into(), name)?))
        }

        pub(super) fn send(&self, bytes: &[u8]) -> Result<(), LinkError> {
            self.0.send(bytes)
        }

        pub(super) fn wait_writable(&self, until: Instant) -> Result<bool, LinkError> {
            self.0.wait_writable(until)
        }

        pub(super) fn receive(
            &self,
            buffer: &mut [u8],
            until: Instant,
        ) -> Result<Received, LinkError> {
            self.0.receive(buffer, until)
        }

        pub(super) fn waker(&self) -> LinkWaker {
            self.0.waker.clone()
        }
    }

    /// Detects a far end that lost power, which sends no end: probes it, and gives up on bytes that are never
    /// acknowledged.
    pub(crate) fn keep_alive(stream: &TcpStream) {
        let _ = sockopt::set_socket_keepalive(stream, true);
        let _ = sockopt::set_tcp_keepidle(stream, Duration::from_secs(5));
        let _ = sockopt::set_tcp_keepintvl(stream, Duration::from_secs(1));
        let _ = sockopt::set_tcp_keepcnt(stream, 5);
        #[cfg(target_os = "linux")]
        let _ = sockopt::set_tcp_user_timeout(stream, 10_000);
    }
}
