//! The server's end: what python-can, Kayak and others attach to, with a simulated bus behind it.

use polepair_core::medium::Frame;
use polepair_core::time::Instant;

use super::codec::{self, Elements, End, Request};
use crate::clock;
use crate::error::LinkError;
use crate::hub::{Hub, Saying, Session, Taken};

/// The longest name of a bus, the kernel's limit for an interface.
const BUS_MAX: usize = 15;

/// One client of the server.
#[derive(Clone, Debug)]
pub struct Daemon {
    bus: [u8; BUS_MAX],
    bus_len: usize,
    elements: Elements,
    mode: Mode,
}

/// How far a client has come.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Mode {
    NoBus,
    /// Nothing is subscribed to: subscriptions are not offered.
    Bcm,
    Raw,
}

/// Serves a bus called `bus` (`can0`, at most 15 characters) at `address`. Port 0 takes a free
/// one; an address without a host means this machine only.
///
/// # Errors
/// [`LinkError`], mostly that the port is taken.
pub fn listen(address: &str, bus: &str) -> Result<Hub<Daemon>, LinkError> {
    Hub::listen(address, Daemon::new(bus))
}

impl Daemon {
    pub(super) fn new(bus: &str) -> Self {
        let mut name = [0; BUS_MAX];
        let bus_len = bus.len().min(BUS_MAX);
        name[..bus_len].copy_from_slice(&bus.as_bytes()[..bus_len]);
        Self { bus: name, bus_len, elements: Elements::default(), mode: Mode::NoBus }
    }

    fn request(&mut self, request: Request<'_>, answer: &mut Saying<'_>) -> Taken {
        let (said, taken) = match (request, self.mode) {
            (Request::Open(bus), Mode::NoBus) => {
                if bus != &self.bus[..self.bus_len] {
                    answer.0.bytes(b"< error could not open bus >");
                    return Taken::Leave;
                }
                self.mode = Mode::Bcm;
                (&b"< ok >"[..], Taken::Nothing)
            }
            (Request::RawMode, Mode::Bcm | Mode::Raw) => {
                self.mode = Mode::Raw;
                (&b"< ok >"[..], Taken::Nothing)
            }
            (Request::BcmMode, Mode::Bcm | Mode::Raw) => {
                self.mode = Mode::Bcm;
                (&b"< ok >"[..], Taken::Nothing)
            }
            (Request::Echo, Mode::Bcm | Mode::Raw) => (&b"< echo >"[..], Taken::Nothing),
            (Request::Send(frame), Mode::Bcm | Mode::Raw) => (&b""[..], Taken::Frame(frame)),
            _ => (&b"< error unknown command >"[..], Taken::Junk),
        };
        answer.0.bytes(said);
        taken
    }
}

impl Session for Daemon {
    fn greeting(&self) -> &'static [u8] {
        b"< hi >"
    }

    fn take(&mut self, byte: u8, answer: &mut Saying<'_>) -> Taken {
        match self.elements.push(byte) {
            None => Taken::Nothing,
            Some(End::Spoilt) => Taken::Junk,
            Some(End::Element) => {
                let elements = self.elements.clone();
                self.request(Request::of(elements.text()), answer)
            }
        }
    }

    fn show(&self, frame: &Frame, at: Instant, saying: &mut Saying<'_>) {
        if self.mode == Mode::Raw {
            codec::write_frame(frame, clock::wall_ns(at) / 1000, &mut saying.0);
        }
    }
}
