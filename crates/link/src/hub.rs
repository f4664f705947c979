//! A simulated bus for several programs. Each client is a node: it receives the frames of the drives and of
//! the other clients, not its own.

use std::net::{SocketAddr, TcpListener};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use polepair_core::medium::{Can, CanLine, Frame};
use polepair_core::time::Instant;
use rustix::event::{PollFd, PollFlags, poll};
use rustix::fd::{AsFd, BorrowedFd, OwnedFd};
use rustix::io::Errno;

use crate::clock;
use crate::descriptor::{read_bytes, write_bytes};
use crate::error::LinkError;
use crate::hex::TextWriter;
use crate::inbox::Inbox;
use crate::link::{LinkIo, Losses, Received};
#[cfg(unix)]
use crate::pty::Pty;
use crate::read_mode::timespec;
use crate::waker::LinkWaker;

/// Clients at a time; one more is turned away.
pub const CLIENTS_MAX: usize = 16;
/// Longest single message to a client.
pub const OUTPUT_MAX: usize = 128;

/// The protocol with one client. Each client has a copy of its own.
pub trait HubSession: Clone + Send {
    /// Message to a new client.
    fn greeting(&self) -> &'static [u8];

    /// Processes one byte from the client, and writes the reply.
    fn handle_byte(&mut self, byte: u8, answer: &mut SessionOutput<'_>) -> SessionAction;

    /// Writes a frame of the bus in the client's protocol; nothing when the client does not want it.
    fn write_frame(&mut self, frame: &Frame, at: Instant, saying: &mut SessionOutput<'_>);
}

/// Result of a byte from a client.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum SessionAction {
    /// Nothing for the bus.
    Nothing,
    /// The end of a message that is not valid.
    Malformed,
    /// A frame for the bus.
    Frame(Frame),
    /// A frame that the bus does not take.
    Refused,
    /// The client is to be left.
    Disconnect,
}

/// Buffer for one message to a client.
#[derive(Debug)]
pub struct SessionOutput<'a>(pub(crate) TextWriter<'a>);

/// The server's end of a bus with clients.
pub struct Hub<S> {
    name: String,
    listener: Option<TcpListener>,
    /// Kept: without it the name by which clients open it would be gone.
    #[cfg(unix)]
    _pty: Option<Pty>,
    waker: LinkWaker,
    prototype: S,
    state: Mutex<HubState<S>>,
}

struct HubState<S> {
    clients: Vec<HubClient<S>>,
    /// Client that is read first the next time, so that every client gets its turn.
    next_client: usize,
    losses: Losses,
}

struct HubClient<S> {
    fd: Arc<OwnedFd>,
    session: S,
    inbox: Inbox,
    /// True if it has sent data that was not read yet, or has left.
    readable: bool,
    /// Rest of a unit that did not fit into the client's buffer.
    unsent: [u8; OUTPUT_MAX],
    unsent_len: usize,
    disconnected: bool,
}

impl<S: HubSession> Hub<S> {
    /// Serves one client at a time on a pseudo-terminal.
    ///
    /// # Errors
    /// [`LinkError`] when the system has no descriptors left.
    #[cfg(unix)]
    pub(crate) fn serve_pty(pty: Pty, prototype: S) -> Result<Self, LinkError> {
        let name = pty.path().to_owned();
        let fd = pty.clone_far_end().map_err(|error| LinkError::from_io(&name, &error))?;
        let mut hub = Self::new(name, prototype)?;
        hub._pty = Some(pty);
        hub.add_client(fd);
        Ok(hub)
    }

    /// Serves clients on TCP, at an address as [`TcpServer::bind`](crate::tcp::TcpServer::bind)
    /// takes it.
    ///
    /// # Errors
    /// [`LinkError`], mostly that the port is taken.
    pub(crate) fn listen(address: &str, prototype: S) -> Result<Self, LinkError> {
        let listener = crate::tcp::listen(address)?;
        let at = listener.local_addr().map_err(|error| LinkError::from_io(address, &error))?;
        let mut hub = Self::new(at.to_string(), prototype)?;
        hub.listener = Some(listener);
        Ok(hub)
    }

    fn new(name: String, prototype: S) -> Result<Self, LinkError> {
        let wake = LinkWaker::new().map_err(|error| LinkError::from_io(&name, &error))?;
        let hub_state = HubState { clients: Vec::new(), next_client: 0, losses: Losses::default() };
        Ok(Self {
            name,
            listener: None,
            #[cfg(unix)]
            _pty: None,
            waker: wake,
            prototype,
            state: hub_state.into(),
        })
    }

    /// TCP address of the hub.
    #[must_use]
    pub fn address(&self) -> Option<SocketAddr> {
        self.listener.as_ref()?.local_addr().ok()
    }

    fn lock_state(&self) -> MutexGuard<'_, HubState<S>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn add_client(&self, fd: OwnedFd) {
        let mut hub_state = self.lock_state();
        if hub_state.clients.len() == CLIENTS_MAX {
            return;
        }
        let mut client = HubClient {
            fd: Arc::new(fd),
            session: self.prototype.clone(),
            inbox: Inbox::default(),
            readable: false,
            unsent: [0; OUTPUT_MAX],
            unsent_len: 0,
            disconnected: false,
        };
        client.send(self.prototype.greeting());
        hub_state.clients.push(client);
    }

    fn accept_clients(&self) {
        let Some(listener) = &self.listener else { return };
        for _ in 0..CLIENTS_MAX {
            let Ok((stream, _)) = listener.accept() else { return };
            if stream.set_nonblocking(true).is_ok() {
                let _ = stream.set_nodelay(true);
                crate::tcp::keep_alive(&stream);
                self.add_client(stream.into());
            }
        }
    }

    /// Waits for a client, the listener or the waker; returns whether it was the waker.
    fn wait(&self, until: Instant) -> Result<bool, LinkError> {
        let mut fds: [Option<Arc<OwnedFd>>; CLIENTS_MAX] = Default::default();
        for (place, client) in fds.iter_mut().zip(&self.lock_state().clients) {
            *place = Some(Arc::clone(&client.fd));
        }
        let wake = self.waker.as_fd();
        let mut polled: [PollFd<'_>; CLIENTS_MAX + 2] = std::array::from_fn(|n| {
            let fd = match n {
                0 => Some(wake),
                1 => self.listener.as_ref().map(AsFd::as_fd),
                n => fds[n - 2].as_ref().map(AsFd::as_fd),
            };
            PollFd::from_borrowed_fd(fd.unwrap_or(wake), watched_flags(fd))
        });
        let left = until.since(clock::now());
        let timeout = (until != Instant::FAR_FUTURE).then(|| timespec(left));
        match poll(&mut polled, timeout.as_ref()) {
            Ok(_) | Err(Errno::INTR) => {}
            Err(errno) => return Err(LinkError::from_io(&self.name, &errno.into())),
        }
        for (client, polled) in self.lock_state().clients.iter_mut().zip(&polled[2..]) {
            client.readable = !polled.revents().is_empty();
        }
        if !polled[1].revents().is_empty() {
            self.accept_clients();
        }
        Ok(!polled[0].revents().is_empty() && self.waker.take_wakeup())
    }
}

fn watched_flags(fd: Option<BorrowedFd<'_>>) -> PollFlags {
    match fd {
        Some(_) => PollFlags::IN,
        None => PollFlags::empty(),
    }
}

impl<S: HubSession> HubState<S> {
    /// The next frame from a client to the bus; the other clients receive it too.
    fn next_frame(&mut self, frame: &mut Frame) -> Option<Instant> {
        for n in 0..self.clients.len() {
            let speaker = (self.next_client + n) % self.clients.len();
            if let Some((received, at)) = self.clients[speaker].next_frame(&mut self.losses) {
                self.next_client = speaker + 1;
                self.broadcast(&received, at, Some(speaker));
                *frame = received;
                return Some(at);
            }
        }
        self.clients.retain(|client| !client.disconnected);
        None
    }

    fn broadcast(&mut self, frame: &Frame, at: Instant, speaker: Option<usize>) {
        for (n, client) in self.clients.iter_mut().enumerate() {
            if speaker != Some(n) && !client.send_frame(frame, at) {
                self.losses.overrun += 1;
            }
        }
    }
}

impl<S: HubSession> HubClient<S> {
    /// The next frame in the data received from the client.
    fn next_frame(&mut self, losses: &mut Losses) -> Option<(Frame, Instant)> {
        if self.inbox.is_empty() && std::mem::take(&mut self.readable) {
            self.read();
        }
        while let Some(byte) = self.inbox.next_byte() {
            let mut buffer = [0; OUTPUT_MAX];
            let mut answer = SessionOutput(TextWriter::new(&mut buffer));
            let action = self.session.handle_byte(byte, &mut answer);
            let len = answer.0.len;
            self.send(&buffer[..len]);
            match action {
                SessionAction::Nothing => {}
                SessionAction::Malformed => losses.malformed += 1,
                SessionAction::Refused => losses.refused += 1,
                SessionAction::Frame(frame) => return Some((frame, self.inbox.received_at)),
                SessionAction::Disconnect => self.disconnected = true,
            }
        }
        None
    }

    fn read(&mut self) {
        let fd = &self.fd;
        match self.inbox.fill(clock::now(), |bytes| read_bytes(fd, bytes)) {
            Ok(0) => self.disconnected = true,
            Ok(_) | Err(Errno::WOULDBLOCK | Errno::INTR) => {}
            Err(_) => self.disconnected = true,
        }
    }

    /// False when the client takes nothing now, and loses the frame.
    fn send_frame(&mut self, frame: &Frame, at: Instant) -> bool {
        let mut buffer = [0; OUTPUT_MAX];
        let mut saying = SessionOutput(TextWriter::new(&mut buffer));
        self.session.write_frame(frame, at, &mut saying);
        let len = saying.0.len;
        self.send(&buffer[..len])
    }

    /// Sends without waiting: a client that does not read loses whole messages.
    fn send(&mut self, saying: &[u8]) -> bool {
        if saying.is_empty() || self.disconnected {
            return true;
        }
        let outstanding = self.write(&self.unsent[..self.unsent_len]);
        self.unsent.copy_within(outstanding..self.unsent_len, 0);
        self.unsent_len -= outstanding;
        if self.unsent_len > 0 {
            return false;
        }
        let written = self.write(saying);
        let rest = &saying[written..];
        if written > 0 {
            self.unsent[..rest.len()].copy_from_slice(rest);
            self.unsent_len = rest.len();
        }
        written > 0
    }

    /// Number of bytes that the client's buffer took. A closed connection is detected by reading.
    fn write(&self, bytes: &[u8]) -> usize {
        if bytes.is_empty() { 0 } else { write_bytes(&self.fd, bytes).unwrap_or(0) }
    }
}

impl<S: HubSession + Sync> LinkIo<Can> for Hub<S> {
    fn now(&self) -> Instant {
        clock::now()
    }

    fn send(&self, frame: &Frame) -> Result<(), LinkError> {
        self.lock_state().broadcast(frame, clock::now(), None);
        Ok(())
    }

    fn receive(&self, frame: &mut Frame, until: Instant) -> Result<Received, LinkError> {
        loop {
            if let Some(at) = self.lock_state().next_frame(frame) {
                return Ok(Received::Bytes { len: 1, at });
            }
            if self.wait(until)? {
                return Ok(Received::Woken);
            }
            if until <= clock::now() {
                let received_at = self.lock_state().next_frame(frame);
                return Ok(
                    received_at.map_or(Received::TimedOut, |at| Received::Bytes { len: 1, at })
                );
            }
        }
    }

    fn set_line(&self, _line: CanLine) -> Result<(), LinkError> {
        Ok(())
    }

    fn waker(&self) -> LinkWaker {
        self.waker.clone()
    }

    fn describe(&self) -> String {
        self.name.clone()
    }

    fn losses(&self) -> Losses {
        self.lock_state().losses
    }
}

impl<S> std::fmt::Debug for Hub<S> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_tuple("Hub").field(&self.name).finish()
    }
}
