//! The server's end of socketcand, with a simulated bus: for python-can, Kayak and others.

use polepair_core::medium::Frame;
use polepair_core::time::Instant;

use super::codec::{self, CanId, ClientRequest, ElementEnd, ElementSplitter, SubscribeRequest};
use crate::clock;
use crate::error::LinkError;
use crate::hub::{Hub, HubSession, SessionAction, SessionOutput};

/// The longest name of a bus, the kernel's limit for an interface.
const BUS_NAME_MAX: usize = 15;

/// Most subscriptions of a client in BCM mode; further ones are refused.
pub const SUBSCRIPTIONS_MAX: usize = 64;

/// One client of the server.
#[derive(Clone, Debug)]
pub struct SocketcandSession {
    bus: [u8; BUS_NAME_MAX],
    bus_len: usize,
    elements: ElementSplitter,
    mode: SessionMode,
    subscriptions: [Option<Subscription>; SUBSCRIPTIONS_MAX],
}

#[derive(Clone, Copy, Debug)]
struct Subscription {
    request: SubscribeRequest,
    /// Time and data of the last frame sent to the client.
    last_sent: Option<(Instant, [u8; 8])>,
}

impl Subscription {
    fn accepts(&mut self, frame: &Frame, at: Instant) -> bool {
        let SubscribeRequest { min_interval_ns, mask, .. } = self.request;
        if let Some((when, data)) = self.last_sent {
            let pairs = || data.iter().zip(frame.data);
            let same = |mask: [u8; 8]| pairs().zip(mask).all(|((a, b), mask)| (a ^ b) & mask == 0);
            if at < when.plus_ns(min_interval_ns) || mask.is_some_and(same) {
                return false;
            }
        }
        self.last_sent = Some((at, frame.data));
        true
    }
}

/// Mode of a client's session.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum SessionMode {
    NoBus,
    /// Receives subscribed identifiers.
    Bcm,
    Raw,
}

/// Serves a bus called `bus` (`can0`, at most 15 characters) at `address`. Port 0 takes a free
/// one; an address without a host means this machine only.
///
/// # Errors
/// [`LinkError`], mostly that the port is taken.
pub fn listen(address: &str, bus: &str) -> Result<Hub<SocketcandSession>, LinkError> {
    Hub::listen(address, SocketcandSession::new(bus))
}

impl SocketcandSession {
    pub(super) fn new(bus: &str) -> Self {
        let mut name = [0; BUS_NAME_MAX];
        let bus_len = bus.len().min(BUS_NAME_MAX);
        name[..bus_len].copy_from_slice(&bus.as_bytes()[..bus_len]);
        Self {
            bus: name,
            bus_len,
            elements: ElementSplitter::default(),
            mode: SessionMode::NoBus,
            subscriptions: [None; SUBSCRIPTIONS_MAX],
        }
    }

    /// The slot of an identifier's subscription, otherwise the first free one.
    fn subscription_slot(&mut self, id: CanId) -> Option<&mut Option<Subscription>> {
        let places = &mut self.subscriptions;
        let its = places.iter().position(|each| each.is_some_and(|each| each.request.id == id));
        let at = its.or_else(|| places.iter().position(Option::is_none))?;
        places.get_mut(at)
    }

    fn accepts_frame(&mut self, frame: &Frame, at: Instant) -> bool {
        let id = (frame.id, frame.extended);
        let mut of = self.subscriptions.iter_mut().flatten().filter(|each| each.request.id == id);
        of.next().is_some_and(|subscription| subscription.accepts(frame, at))
    }

    fn handle_request(
        &mut self,
        request: ClientRequest<'_>,
        answer: &mut SessionOutput<'_>,
    ) -> SessionAction {
        let (bytes, action) = match (request, self.mode) {
            (ClientRequest::Open(bus), SessionMode::NoBus) => {
                if bus != &self.bus[..self.bus_len] {
                    answer.0.push_bytes(b"< error could not open bus >");
                    return SessionAction::Disconnect;
                }
                self.mode = SessionMode::Bcm;
                (&b"< ok >"[..], SessionAction::Nothing)
            }
            (ClientRequest::RawMode, SessionMode::Bcm | SessionMode::Raw) => {
                self.mode = SessionMode::Raw;
                self.subscriptions = [None; SUBSCRIPTIONS_MAX];
                (&b"< ok >"[..], SessionAction::Nothing)
            }
            (ClientRequest::BcmMode, SessionMode::Bcm | SessionMode::Raw) => {
                self.mode = SessionMode::Bcm;
                (&b"< ok >"[..], SessionAction::Nothing)
            }
            (ClientRequest::Echo, SessionMode::Bcm | SessionMode::Raw) => {
                (&b"< echo >"[..], SessionAction::Nothing)
            }
            (ClientRequest::Send(frame), SessionMode::Bcm | SessionMode::Raw) => {
                (&b""[..], SessionAction::Frame(frame))
            }
            // Neither is answered, as by the original.
            (ClientRequest::Subscribe(wanted), SessionMode::Bcm) => {
                match self.subscription_slot(wanted.id) {
                    Some(subscription) => {
                        *subscription = Some(Subscription { request: wanted, last_sent: None });
                        (&b""[..], SessionAction::Nothing)
                    }
                    None => (&b"< error too many subscriptions >"[..], SessionAction::Refused),
                }
            }
            (ClientRequest::Unsubscribe(id), SessionMode::Bcm) => {
                if let Some(subscription) = self.subscription_slot(id) {
                    *subscription = None;
                }
                (&b""[..], SessionAction::Nothing)
            }
            _ => (&b"< error unknown command >"[..], SessionAction::Malformed),
        };
        answer.0.push_bytes(bytes);
        action
    }
}

impl HubSession for SocketcandSession {
    fn greeting(&self) -> &'static [u8] {
        b"< hi >"
    }

    fn handle_byte(&mut self, byte: u8, answer: &mut SessionOutput<'_>) -> SessionAction {
        match self.elements.push(byte) {
            None => SessionAction::Nothing,
            Some(ElementEnd::Malformed) => SessionAction::Malformed,
            Some(ElementEnd::Element) => {
                let elements = self.elements.clone();
                self.handle_request(ClientRequest::parse(elements.text()), answer)
            }
        }
    }

    fn write_frame(&mut self, frame: &Frame, at: Instant, saying: &mut SessionOutput<'_>) {
        let reported = match self.mode {
            SessionMode::NoBus => false,
            SessionMode::Bcm => self.accepts_frame(frame, at),
            SessionMode::Raw => true,
        };
        if reported {
            codec::write_frame(frame, clock::wall_ns(at) / 1000, &mut saying.0);
        }
    }
}
