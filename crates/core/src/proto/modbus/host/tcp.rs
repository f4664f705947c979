//! The host end on TCP: several requests at once, each known again by its transaction.
//!
//! An answer repeats the transaction of its request, so nothing has to be proven or quarantined, and a stop does not
//! wait for earlier answers. One request at a time goes to each station, stops excepted, so that no server can carry
//! them out in another order.

use super::multiple_write::MultipleWriters;
use super::receive::matches_outstanding;
use super::{AwaitedReply, ReplyRole};
use crate::error::Failure;
use crate::medium::{SerialLine, Stream};
use crate::proto::HostOptions;
use crate::proto::event_ring::EventRing;
use crate::proto::modbus::host_request::{Answer, HostRequest, RequestBody};
use crate::proto::modbus::tcp::{self, ADU_MAX, Header};
use crate::proto::modbus::wire::{AnnouncedLength, BROADCAST, Exception, ReplyPdu, WireFormat};
use crate::station::{
    self, Counters, EventSubject, HostEvent, LineEvent, Request as _, RequestClass, Station,
    Ticket, Timed,
};
use crate::time::{Instant, earliest};

/// Default time-out of an answer, ms. Behind a gateway is a serial line, with time-outs of its own.
pub const REPLY_TIMEOUT_MS: u32 = 1000;
/// Default time-out in a scan, where an address may be empty.
const SCAN_TIMEOUT_MS: u32 = 300;
/// Open requests at most: as many as MTG 4.3.1 has a server take.
const OPEN_MAX: usize = 16;
/// Among them those that are kept for stops.
const STOPS_RESERVED: usize = 4;
/// Times that a harmless request is sent at most.
const ATTEMPTS_MAX: u8 = 2;
const EVENTS_MAX: usize = 32;
const RECEIVED_MAX: usize = 4 * ADU_MAX;

/// The commanding end of a connection.
#[derive(Clone, Debug)]
pub struct TcpHost {
    timeout_ns: u64,
    is_scanning: bool,
    open: [Option<Exchange>; OPEN_MAX],
    /// Transaction of the next request.
    next_transaction: u16,
    /// Number of the next submitted request, for their order.
    next_order: u64,
    received: [u8; RECEIVED_MAX],
    received_len: usize,
    events: EventRing<Answer, EVENTS_MAX>,
    counters: Counters,
    multiple_writers: MultipleWriters,
}

/// A request that has no answer yet.
#[derive(Clone, Copy, Debug)]
struct Exchange {
    ticket: Ticket,
    request: HostRequest,
    order: u64,
    attempts_left: u8,
    /// Transactions under which it was sent; an answer to the first may come after the second was sent.
    sent_as: [Option<u16>; ATTEMPTS_MAX as usize],
    /// Time of the end of the wait; `None` before it is sent.
    deadline: Option<Instant>,
}

impl Exchange {
    fn has_transaction(&self, transaction: u16) -> bool {
        self.sent_as.contains(&Some(transaction))
    }
}

impl TcpHost {
    /// A host of these options; those of a serial line mean nothing.
    #[must_use]
    pub fn new(options: &HostOptions) -> Self {
        let usual_ms = if options.scanning { SCAN_TIMEOUT_MS } else { REPLY_TIMEOUT_MS };
        let timeout_ms = options.reply_timeout_ms(usual_ms);
        Self {
            timeout_ns: u64::from(timeout_ms.max(1)) * 1_000_000,
            is_scanning: options.scanning,
            open: [None; OPEN_MAX],
            next_transaction: 1,
            next_order: 0,
            received: [0; RECEIVED_MAX],
            received_len: 0,
            events: EventRing::new(),
            counters: Counters::default(),
            multiple_writers: MultipleWriters::default(),
        }
    }

    fn open_len(&self) -> usize {
        self.open.iter().flatten().count()
    }

    /// Returns whether a request can be taken now.
    fn has_room_for(&self, request: &HostRequest) -> bool {
        let len = self.open_len();
        if self.events.room() <= len {
            return false;
        }
        if request.is_stop() {
            return len < OPEN_MAX;
        }
        let is_busy = self.open.iter().flatten().any(|open| open.request.unit == request.unit);
        !is_busy && len < OPEN_MAX - STOPS_RESERVED
    }

    /// The request that is sent next: a stop before all others.
    fn next_unsent(&self) -> Option<usize> {
        let unsent =
            self.open.iter().enumerate().filter_map(|(at, open)| Some((at, open.as_ref()?)));
        unsent
            .filter(|(_, open)| open.deadline.is_none())
            .min_by_key(|(_, open)| (!open.request.is_stop(), open.order))
            .map(|(at, _)| at)
    }

    fn fail(&mut self, at: usize, failure: Failure) {
        let Some(open) = self.open[at].take() else { return };
        match failure {
            Failure::Refused { .. } => self.counters.answered += 1,
            Failure::Silent => self.counters.silent += 1,
            _ => {}
        }
        self.events.push(EventSubject::Request(open.ticket), Err(failure));
    }

    fn complete(&mut self, at: usize, data: &[u8]) {
        let Some(open) = self.open[at].take() else { return };
        self.counters.answered += 1;
        let event = self.events.push(EventSubject::Request(open.ticket), Ok(Answer::BLANK));
        if let Ok(answer) = event {
            answer.fill(&open.request, data);
        }
    }

    /// No answer came: a harmless request is sent once more, as another transaction.
    fn retry_or_fail(&mut self, at: usize) {
        let Some(open) = &mut self.open[at] else { return };
        let is_harmless =
            matches!(open.request.class, RequestClass::Idempotent | RequestClass::Stop);
        if is_harmless && open.attempts_left > 0 {
            open.deadline = None;
            self.counters.resent += 1;
        } else {
            self.fail(at, Failure::Silent);
        }
    }

    fn process_received(&mut self) {
        let mut used = 0;
        while used < self.received_len {
            match tcp::span(&self.received[used..self.received_len]) {
                AnnouncedLength::Bytes(len) if used + len <= self.received_len => {
                    let mut adu = [0; ADU_MAX];
                    adu[..len].copy_from_slice(&self.received[used..used + len]);
                    self.handle_frame(&adu[..len]);
                    used += len;
                }
                AnnouncedLength::Bytes(_) | AnnouncedLength::More => break,
                // No server of this protocol: the next header, if there is one.
                AnnouncedLength::Unknown | AnnouncedLength::Never => {
                    self.counters.skipped += 1;
                    used += 1;
                }
            }
        }
        self.received.copy_within(used..self.received_len, 0);
        self.received_len -= used;
    }

    fn handle_frame(&mut self, adu: &[u8]) {
        let Ok((Header { transaction, unit }, pdu)) = tcp::decode(adu) else { return };
        let Some(at) = self
            .open
            .iter()
            .position(|open| open.is_some_and(|open| open.has_transaction(transaction)))
        else {
            self.counters.late += 1;
            return;
        };
        let Some(Exchange { request, .. }) = self.open[at] else { return };
        if unit != request.unit {
            self.counters.misaddressed += 1;
            self.counters.other_address = Some(unit.into());
            return;
        }
        let awaited = AwaitedReply::of(&request, ReplyRole::Request);
        match ReplyPdu::parse(pdu) {
            Ok(reply) if matches_outstanding(&awaited, &reply) => self.handle_reply(at, &reply),
            Ok(_) | Err(_) => self.counters.foreign += 1,
        }
    }

    fn handle_reply(&mut self, at: usize, reply: &ReplyPdu<'_>) {
        match *reply {
            ReplyPdu::Exception { exception, .. } if self.is_of_gateway(exception) => {
                self.counters.relayed += 1;
                self.retry_or_fail(at);
            }
            ReplyPdu::Exception { exception, .. } => {
                if !self.retry_as_multiple_write(at, exception) {
                    self.fail(at, Failure::Refused { code: exception.code().into() });
                }
            }
            ReplyPdu::Read { data, .. } | ReplyPdu::ReadWritten { data } => self.complete(at, data),
            ReplyPdu::Unknown { data, .. } => {
                let body = self.open[at].map(|open| open.request.body);
                let text = body.and_then(|body| body.device_text(data)).unwrap_or_default();
                self.complete(at, text);
            }
            _ => self.complete(at, &[]),
        }
    }

    /// Returns whether an exception is that of a gateway whose station is silent. Some servers (pymodbus 3.16) report a
    /// failure of the device for units that they do not have, which a scan must not take for drives.
    const fn is_of_gateway(&self, exception: Exception) -> bool {
        match exception {
            Exception::GatewayPath | Exception::GatewayTarget => true,
            Exception::DeviceFailure => self.is_scanning,
            _ => false,
        }
    }

    /// A station without function 06 takes the same value by function 16: what it does not have was not carried out.
    fn retry_as_multiple_write(&mut self, at: usize, exception: Exception) -> bool {
        let Some(open) = &mut self.open[at] else { return false };
        let is_single = matches!(open.request.body, RequestBody::WriteRegister { .. });
        if !is_single || exception != Exception::IllegalFunction {
            return false;
        }
        self.multiple_writers.insert(open.request.unit);
        open.request = self.multiple_writers.adapt(open.request);
        (open.attempts_left, open.deadline) = (ATTEMPTS_MAX, None);
        open.sent_as = Default::default();
        self.counters.answered += 1;
        true
    }
}

impl Timed for TcpHost {
    fn handle_timeout(&mut self, now: Instant) {
        for at in 0..OPEN_MAX {
            let is_due =
                self.open[at].is_some_and(|open| open.deadline.is_some_and(|due| due <= now));
            if is_due {
                self.retry_or_fail(at);
            }
        }
    }

    fn poll_timeout(&self) -> Option<Instant> {
        let due = |open: &Exchange| open.deadline.unwrap_or(Instant::ZERO);
        self.open.iter().flatten().fold(None, |first, open| earliest(first, Some(due(open))))
    }
}

impl Station<Stream> for TcpHost {
    fn handle_input(&mut self, _now: Instant, unit: &[u8]) {
        for piece in unit.chunks(ADU_MAX) {
            // Four frames fit, so a full buffer is of no server that keeps the protocol.
            if self.received_len + piece.len() > RECEIVED_MAX {
                self.counters.skipped += self.received_len as u64;
                self.received_len = 0;
            }
            let end = self.received_len + piece.len();
            self.received[self.received_len..end].copy_from_slice(piece);
            self.received_len = end;
            self.process_received();
        }
    }

    fn handle_line(&mut self, _now: Instant, event: LineEvent) {
        if matches!(event, LineEvent::Down | LineEvent::BusOff) {
            (0..OPEN_MAX).for_each(|at| self.fail(at, Failure::LinkDown));
        }
        if !matches!(event, LineEvent::Break) {
            self.received_len = 0;
        }
    }

    fn poll_transmit(&mut self, now: Instant, out: &mut [u8]) -> Option<usize> {
        let at = self.next_unsent()?;
        let transaction = self.next_transaction;
        self.next_transaction = transaction.wrapping_add(1);
        let timeout_ns = self.timeout_ns;
        let open = self.open[at].as_mut()?;
        let len = open.request.emit(WireFormat::Tcp, out);
        out[..2].copy_from_slice(&transaction.to_be_bytes());
        open.attempts_left = open.attempts_left.saturating_sub(1);
        open.sent_as.rotate_right(1);
        open.sent_as[0] = Some(transaction);
        open.deadline = Some(now.plus_ns(timeout_ns));
        self.counters.sent += 1;
        if open.request.unit == BROADCAST {
            self.complete(at, &[]);
        }
        Some(len)
    }

    fn line(&self) -> SerialLine {
        SerialLine::new_8n1(0)
    }
}

impl station::HostWire for TcpHost {
    fn unparsed_len(&self) -> usize {
        self.received_len
    }
}

impl station::HostData for TcpHost {}

impl station::Host<Stream> for TcpHost {
    type Request = HostRequest;

    type Answer = Answer;

    const PARALLEL: bool = true;

    fn submit(
        &mut self,
        _now: Instant,
        ticket: Ticket,
        request: HostRequest,
    ) -> Result<(), HostRequest> {
        if !self.has_room_for(&request) {
            return Err(request);
        }
        let Some(slot) = self.open.iter_mut().find(|slot| slot.is_none()) else {
            return Err(request);
        };
        *slot = Some(Exchange {
            ticket,
            request: self.multiple_writers.adapt(request),
            order: self.next_order,
            attempts_left: if self.is_scanning { 1 } else { ATTEMPTS_MAX },
            sent_as: Default::default(),
            deadline: None,
        });
        self.next_order += 1;
        Ok(())
    }

    fn recall(&mut self, stop: &HostRequest) -> Option<Ticket> {
        let slot = self.open.iter_mut().find(|slot| {
            slot.is_some_and(|open| {
                open.request.unit == stop.unit
                    && !open.request.is_stop()
                    && open.sent_as == [None; ATTEMPTS_MAX as usize]
            })
        })?;
        slot.take().map(|open| open.ticket)
    }

    fn disable_retries(&mut self, ticket: Ticket) {
        let open = self.open.iter_mut().flatten().find(|open| open.ticket == ticket);
        if let Some(open) = open {
            open.attempts_left = 1;
        }
    }

    fn poll_event(&mut self) -> Option<&HostEvent<Answer>> {
        self.events.next()
    }

    fn encode_request(&self, request: &HostRequest, out: &mut [u8]) -> usize {
        request.emit(WireFormat::Tcp, out)
    }

    fn counters(&self) -> Counters {
        self.counters
    }
}
