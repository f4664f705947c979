//! The commanding end: one request at a time, without repeats.

use polepair_core::error::Failure;
use polepair_core::medium::{Can, CanLine, Frame};
use polepair_core::station::{
    Counters, EventSubject, Host, HostData, HostEvent, HostWire, LineEvent, Request, RequestClass,
    Station, Ticket, Timed,
};
use polepair_core::time::Instant;

use super::wire::ToyMessage;

const REPLY_TIMEOUT_MS: u32 = 50;

/// A message with its class.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct ToyRequest {
    pub message: ToyMessage,
    pub is_stop: bool,
}

impl Request for ToyRequest {
    fn class(&self) -> RequestClass {
        if self.is_stop { RequestClass::Stop } else { RequestClass::Idempotent }
    }
}

/// The host of any number of toy drives.
#[derive(Debug)]
pub struct ToyHost {
    bit_rate: u32,
    /// The request under way, and when it is given up; `None` until it is sent.
    pending: Option<(Ticket, ToyRequest, Option<Instant>)>,
    event: Option<HostEvent<i32>>,
    shown: Option<HostEvent<i32>>,
    counters: Counters,
}

impl ToyHost {
    pub fn new(bit_rate: u32) -> Self {
        Self { bit_rate, pending: None, event: None, shown: None, counters: Counters::default() }
    }

    fn end(&mut self, result: Result<i32, Failure>) {
        if let Some((ticket, ..)) = self.pending.take() {
            self.event = Some((EventSubject::Request(ticket), result));
        }
    }
}

impl Timed for ToyHost {
    fn handle_timeout(&mut self, now: Instant) {
        if self.poll_timeout().is_some_and(|due| due <= now) {
            self.end(Err(Failure::Silent));
        }
    }

    fn poll_timeout(&self) -> Option<Instant> {
        self.pending.and_then(|(_, _, due)| due)
    }
}

impl Station<Can> for ToyHost {
    fn handle_input(&mut self, _now: Instant, frame: &Frame) {
        let Some(reply) = ToyMessage::parse_reply(frame) else { return };
        let asked = self.pending.map(|(_, request, _)| request.message);
        let is_ours = asked.is_some_and(|asked| {
            (asked.address, asked.writes, asked.register)
                == (reply.address, reply.writes, reply.register)
        });
        if is_ours {
            self.counters.answered += 1;
            self.end(Ok(reply.value));
        } else {
            self.counters.foreign += 1;
        }
    }

    fn handle_line(&mut self, _now: Instant, event: LineEvent) {
        if event == LineEvent::Down {
            self.end(Err(Failure::LinkDown));
        }
    }

    fn poll_transmit(&mut self, now: Instant, out: &mut Frame) -> Option<usize> {
        let (_, request, due) = self.pending.as_mut().filter(|(_, _, due)| due.is_none())?;
        *due = Some(now.plus_ms(REPLY_TIMEOUT_MS));
        *out = request.message.request();
        self.counters.sent += 1;
        Some(1)
    }

    fn line(&self) -> CanLine {
        CanLine { bit_rate: self.bit_rate }
    }
}

impl HostWire for ToyHost {}

impl HostData for ToyHost {}

impl Host<Can> for ToyHost {
    type Request = ToyRequest;

    type Answer = i32;

    fn submit(
        &mut self,
        _now: Instant,
        ticket: Ticket,
        request: ToyRequest,
    ) -> Result<(), ToyRequest> {
        if self.pending.is_some() {
            return Err(request);
        }
        self.pending = Some((ticket, request, None));
        Ok(())
    }

    fn poll_event(&mut self) -> Option<&HostEvent<i32>> {
        self.shown = self.event.take();
        self.shown.as_ref()
    }

    fn encode_request(&self, request: &ToyRequest, out: &mut Frame) -> usize {
        *out = request.message.request();
        1
    }

    fn counters(&self) -> Counters {
        self.counters
    }
}
