//! The server's end: what python-can, Kayak and others attach to, with a simulated bus behind it.

use polepair_core::medium::Frame;
use polepair_core::time::Instant;

use super::codec::{self, Elements, End, Id, Request, Wanted};
use crate::clock;
use crate::error::LinkError;
use crate::hub::{Hub, Saying, Session, Taken};

/// The longest name of a bus, the kernel's limit for an interface.
const BUS_MAX: usize = 15;

/// Identifiers that one client hears of in BCM mode; what it asks for beyond is refused.
pub const WANTED_MAX: usize = 64;

/// One client of the server.
#[derive(Clone, Debug)]
pub struct Daemon {
    bus: [u8; BUS_MAX],
    bus_len: usize,
    elements: Elements,
    mode: Mode,
    subscriptions: [Option<Subscription>; WANTED_MAX],
}

#[derive(Clone, Copy, Debug)]
struct Subscription {
    wanted: Wanted,
    /// When its client was told last, and which bytes.
    told: Option<(Instant, [u8; 8])>,
}

impl Subscription {
    fn takes(&mut self, frame: &Frame, at: Instant) -> bool {
        let Wanted { every_ns, mask, .. } = self.wanted;
        if let Some((when, data)) = self.told {
            let pairs = || data.iter().zip(frame.data);
            let same = |mask: [u8; 8]| pairs().zip(mask).all(|((a, b), mask)| (a ^ b) & mask == 0);
            if at < when.plus_ns(every_ns) || mask.is_some_and(same) {
                return false;
            }
        }
        self.told = Some((at, frame.data));
        true
    }
}

/// How far a client has come.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Mode {
    NoBus,
    /// Hears what it has subscribed to.
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
        Self {
            bus: name,
            bus_len,
            elements: Elements::default(),
            mode: Mode::NoBus,
            subscriptions: [None; WANTED_MAX],
        }
    }

    /// The place of what is wanted of an identifier, else the first free one.
    fn place(&mut self, id: Id) -> Option<&mut Option<Subscription>> {
        let places = &mut self.subscriptions;
        let its = places.iter().position(|each| each.is_some_and(|each| each.wanted.id == id));
        let at = its.or_else(|| places.iter().position(Option::is_none))?;
        places.get_mut(at)
    }

    fn wants(&mut self, frame: &Frame, at: Instant) -> bool {
        let id = (frame.id, frame.extended);
        let mut of = self.subscriptions.iter_mut().flatten().filter(|each| each.wanted.id == id);
        of.next().is_some_and(|subscription| subscription.takes(frame, at))
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
                self.subscriptions = [None; WANTED_MAX];
                (&b"< ok >"[..], Taken::Nothing)
            }
            (Request::BcmMode, Mode::Bcm | Mode::Raw) => {
                self.mode = Mode::Bcm;
                (&b"< ok >"[..], Taken::Nothing)
            }
            (Request::Echo, Mode::Bcm | Mode::Raw) => (&b"< echo >"[..], Taken::Nothing),
            (Request::Send(frame), Mode::Bcm | Mode::Raw) => (&b""[..], Taken::Frame(frame)),
            // Neither is answered, as by the original.
            (Request::Subscribe(wanted), Mode::Bcm) => match self.place(wanted.id) {
                Some(place) => {
                    *place = Some(Subscription { wanted, told: None });
                    (&b""[..], Taken::Nothing)
                }
                None => (&b"< error too many subscriptions >"[..], Taken::Refused),
            },
            (Request::Unsubscribe(id), Mode::Bcm) => {
                if let Some(place) = self.place(id) {
                    *place = None;
                }
                (&b""[..], Taken::Nothing)
            }
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

    fn show(&mut self, frame: &Frame, at: Instant, saying: &mut Saying<'_>) {
        let told = match self.mode {
            Mode::NoBus => false,
            Mode::Bcm => self.wants(frame, at),
            Mode::Raw => true,
        };
        if told {
            codec::write_frame(frame, clock::wall_ns(at) / 1000, &mut saying.0);
        }
    }
}
