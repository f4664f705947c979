//! The host end, called controller in the manual.

use super::session::{Answer, HostRequest, MinExchangeTime, Session};
use super::wire::{DriveMessage, node_of_id};
use crate::medium::bits::bit_time_ns;
use crate::medium::{Can, CanLine, Frame};
use crate::proto::HostOptions;
use crate::proto::early_bytes::with_clock_tolerance;
use crate::station::{
    Counters, Host, HostData, HostEvent, HostWire, LineEvent, Station, Ticket, Timed,
};
use crate::time::Instant;

/// Default time-out of a reply, ms. Drives reply at once (section 1.3). \[I\]
pub const REPLY_TIMEOUT_MS: u32 = 50;

/// Bits of the shortest request and its reply without a single stuff bit: 47 each, four and eight
/// bytes, less the pause behind the last.
const EXCHANGE_BITS: u64 = 2 * 47 + (4 + 8) * 8 - 3;
/// Bits of the four bytes more that a request with a value has.
const VALUE_BITS: u64 = 4 * 8;

/// The host of any number of drives on one bus.
#[derive(Debug)]
pub struct CanHost {
    session: Session,
    bit_rate: u32,
}

impl CanHost {
    /// Creates a host with `options`.
    #[must_use]
    pub fn new(options: &HostOptions) -> Self {
        let timeout = options.reply_timeout_ms(REPLY_TIMEOUT_MS);
        let soonest = MinExchangeTime {
            base_ns: with_clock_tolerance(bit_time_ns(EXCHANGE_BITS, options.bit_rate)),
            value_extra_ns: with_clock_tolerance(bit_time_ns(VALUE_BITS, options.bit_rate)),
        };
        Self { session: Session::new(timeout, soonest), bit_rate: options.bit_rate }
    }
}

impl Timed for CanHost {
    fn handle_timeout(&mut self, now: Instant) {
        self.session.handle_timeout(now);
    }

    fn poll_timeout(&self) -> Option<Instant> {
        self.session.poll_timeout()
    }
}

impl Station<Can> for CanHost {
    fn handle_input(&mut self, now: Instant, frame: &Frame) {
        if frame.extended || frame.remote {
            return;
        }
        let Some(Err(id)) = node_of_id(frame.id) else { return };
        match DriveMessage::parse(frame.bytes()) {
            Ok(message) => self.session.handle_message(id, message, now),
            Err(_) => self.session.handle_damaged(id),
        }
    }

    fn handle_line(&mut self, now: Instant, event: LineEvent) {
        self.session.handle_line(now, event);
    }

    fn poll_transmit(&mut self, now: Instant, out: &mut Frame) -> Option<usize> {
        let (id, request) = self.session.transmit(now)?;
        *out = request.frame(id);
        Some(1)
    }

    fn line(&self) -> CanLine {
        CanLine { bit_rate: self.bit_rate }
    }
}

impl HostWire for CanHost {
    fn sends_keepalive(&self) -> bool {
        self.session.needs_feeding()
    }
}

impl HostData for CanHost {}

impl Host<Can> for CanHost {
    type Request = HostRequest;

    type Answer = Answer;

    fn submit(
        &mut self,
        now: Instant,
        ticket: Ticket,
        request: HostRequest,
    ) -> Result<(), HostRequest> {
        self.session.submit(now, ticket, request)
    }

    fn poll_event(&mut self) -> Option<&HostEvent<Answer>> {
        self.session.poll_event()
    }

    fn encode_request(&self, request: &HostRequest, out: &mut Frame) -> usize {
        *out = request.request.frame(request.id);
        1
    }

    fn counters(&self) -> Counters {
        self.session.counters
    }
}
