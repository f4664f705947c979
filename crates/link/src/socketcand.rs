//! CAN buses that a `socketcand` server shares over TCP.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

use polepair_core::medium::{Can, CanLine, Frame, Stream};
use polepair_core::station::LineEvent;
use polepair_core::time::Instant;

use crate::clock;
use crate::error::{Cause, LinkError};
use crate::hex::TextWriter;
use crate::inbox::Inbox;
use crate::link::{LinkIo, Losses, Received};
use crate::tcp::TcpLink;
use crate::waker::LinkWaker;

pub mod codec;
mod server;
#[cfg(test)]
mod tests;

use codec::{ELEMENT_MAX, ElementEnd, ElementSplitter, ServerReply};
pub use server::{SocketcandSession, listen};

/// Default port of socketcand.
pub const PORT: u16 = 29536;
/// Time limit of the server's reply.
const ANSWER_MS: u32 = 2000;
/// Error classes of `linux/can/error.h`.
const BUS_OFF: u32 = 0x40;
const RESTARTED: u32 = 0x100;

/// A bus of a socketcand server, in its raw mode.
pub struct SocketcandLink {
    inner: Box<dyn LinkIo<Stream>>,
    bus: String,
    name: String,
    input: Mutex<SocketcandInput>,
    malformed: AtomicU64,
    errors: AtomicU64,
    refused: AtomicU64,
}

/// Received bytes that were not processed yet.
#[derive(Default)]
struct SocketcandInput {
    inbox: Inbox,
    elements: ElementSplitter,
}

/// Opens `bus` (`can0`) of the server at `address` (`10.0.0.5:29536`).
///
/// # Errors
/// [`LinkError`] of the connection; [`Cause::NotFound`] when the server has no such bus,
/// [`Cause::Unsuitable`] when what answers there is no socketcand.
pub fn connect(address: &str, bus: &str) -> Result<SocketcandLink, LinkError> {
    SocketcandLink::open(Box::new(TcpLink::connect(address)?), bus)
}

impl SocketcandLink {
    fn open(inner: Box<dyn LinkIo<Stream>>, bus: &str) -> Result<Self, LinkError> {
        let link = Self {
            name: format!("{}/{bus}", inner.describe()),
            bus: bus.to_owned(),
            inner,
            input: Mutex::default(),
            malformed: AtomicU64::new(0),
            errors: AtomicU64::new(0),
            refused: AtomicU64::new(0),
        };
        if bus.is_empty() || bus.bytes().any(|byte| matches!(byte, b' ' | b'<' | b'>')) {
            let hint = "Name the server's bus, for example can0.";
            return Err(LinkError::new(&link.name, Cause::NotFound).with_hint(hint));
        }
        link.wait_for_reply(|reply| reply == ServerReply::Hi)?;
        link.inner.send(format!("< open {bus} >").as_bytes())?;
        link.wait_for_reply(|reply| reply == ServerReply::Ok)?;
        link.inner.send(b"< rawmode >")?;
        link.wait_for_reply(|reply| reply == ServerReply::Ok)?;
        Ok(link)
    }

    /// Waits for the reply that is wanted; an error is the end.
    fn wait_for_reply(&self, wanted: impl Fn(ServerReply<'_>) -> bool) -> Result<(), LinkError> {
        let until = self.inner.now().plus_ms(clock::scaled_ms(ANSWER_MS));
        let mut unread = self.lock_input();
        loop {
            match unread.next_end() {
                Some(ElementEnd::Element) => match ServerReply::parse(unread.elements.text()) {
                    reply if wanted(reply) => return Ok(()),
                    ServerReply::Error(why) => return Err(self.refusal_error(why)),
                    _ => {}
                },
                Some(ElementEnd::Malformed) => {}
                None => match unread.inbox.receive(&*self.inner, until)? {
                    Received::Bytes { .. } => {}
                    _ => return Err(self.no_answer_error()),
                },
            }
        }
    }

    fn refusal_error(&self, why: &[u8]) -> LinkError {
        let why = String::from_utf8_lossy(why);
        let hint = format!(
            "The server says `{}`; it shares the buses that it was started with (`socketcand -i \
             can0,can1`).",
            why.trim()
        );
        LinkError::new(&self.name, Cause::NotFound).with_hint(&hint)
    }

    fn no_answer_error(&self) -> LinkError {
        let hint = "What listens there does not greet as socketcand does.";
        LinkError::new(&self.name, Cause::Unsuitable).with_hint(hint)
    }

    fn lock_input(&self) -> MutexGuard<'_, SocketcandInput> {
        self.input.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The next thing of interest among the bytes that were read.
    fn next_received(&self, unread: &mut SocketcandInput, frame: &mut Frame) -> Option<Received> {
        loop {
            let end = unread.next_end()?;
            let at = unread.inbox.received_at;
            let reply = match end {
                ElementEnd::Element => ServerReply::parse(unread.elements.text()),
                ElementEnd::Malformed => ServerReply::Unknown,
            };
            let count = match reply {
                ServerReply::Frame(arrived) => {
                    *frame = arrived;
                    return Some(Received::Bytes { len: 1, at });
                }
                ServerReply::ErrorFrame(class) if class & BUS_OFF != 0 => {
                    return Some(Received::Line { event: LineEvent::BusOff, at });
                }
                ServerReply::ErrorFrame(class) if class & RESTARTED != 0 => {
                    return Some(Received::Line { event: LineEvent::Up, at });
                }
                ServerReply::ErrorFrame(_) => &self.errors,
                ServerReply::Error(_) => &self.refused,
                ServerReply::Unknown => &self.malformed,
                ServerReply::Hi | ServerReply::Ok | ServerReply::Echo => continue,
            };
            count.fetch_add(1, Ordering::Relaxed);
        }
    }
}

impl SocketcandInput {
    /// The end of the next element in the received bytes, if any.
    fn next_end(&mut self) -> Option<ElementEnd> {
        while let Some(byte) = self.inbox.next_byte() {
            if let Some(end) = self.elements.push(byte) {
                return Some(end);
            }
        }
        None
    }
}

impl std::fmt::Debug for SocketcandLink {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_tuple("SocketcandLink").field(&self.name).finish()
    }
}

impl LinkIo<Can> for SocketcandLink {
    fn now(&self) -> Instant {
        self.inner.now()
    }

    fn send(&self, frame: &Frame) -> Result<(), LinkError> {
        let mut buffer = [0; ELEMENT_MAX];
        let mut text = TextWriter::new(&mut buffer);
        if !codec::write_send(frame, &mut text) {
            let hint = "socketcand carries no remote frames.";
            return Err(LinkError::new(&self.name, Cause::Unsuitable).with_hint(hint));
        }
        let len = text.len;
        self.inner.send(&buffer[..len])
    }

    fn wait_writable(&self, until: Instant) -> Result<bool, LinkError> {
        self.inner.wait_writable(until)
    }

    fn receive(&self, frame: &mut Frame, until: Instant) -> Result<Received, LinkError> {
        let mut unread = self.lock_input();
        loop {
            if let Some(received) = self.next_received(&mut unread, frame) {
                return Ok(received);
            }
            match unread.inbox.receive(&*self.inner, until)? {
                Received::Bytes { .. } => {}
                other => return Ok(other),
            }
        }
    }

    /// The server's matter: its buses run at the bit rate that they were set up with.
    fn set_line(&self, _line: CanLine) -> Result<(), LinkError> {
        Ok(())
    }

    fn waker(&self) -> LinkWaker {
        self.inner.waker()
    }

    fn describe(&self) -> String {
        self.name.clone()
    }

    fn losses(&self) -> Losses {
        Losses {
            malformed: self.malformed.load(Ordering::Relaxed),
            errors: self.errors.load(Ordering::Relaxed),
            refused: self.refused.load(Ordering::Relaxed),
            ..self.inner.losses()
        }
    }

    fn reopen(&self) -> Result<Box<dyn LinkIo<Can>>, LinkError> {
        Ok(Box::new(Self::open(self.inner.reopen()?, &self.bus)?))
    }
}
