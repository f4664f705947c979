//! The host end: one open request, and a comparison of every echoed field.
//!
//! A reply to a read does not repeat the address, so a late reply looks like the reply to the next request.
//! Therefore the host records pending replies. After a missing reply the line is in quarantine: a probe is
//! sent, a read with a function code without pending replies. Drives reply in order, so nothing older can
//! follow the probe's reply, even a refusal. Without a reply, the quarantine lasts three times the
//! time-out. Meanwhile a late reply belongs to the awaited request and is accepted. Only harmless requests
//! are repeated, after the quarantine.
//!
//! If an earlier program may have used the line, each station begins *unproven*: several random probes must
//! be answered one after another before its first request, except stops. A pending reply can replace one of
//! them only if it has this function code and length.

mod multiple_write;
mod proof;
mod receive;
pub mod tcp;

use super::ascii::{self, AsciiDeframer};
use super::device_id;
use super::host_request::{Answer, HostRequest, RequestBody};
use super::rtu::{self, ADU_MAX};
use super::wire::{BROADCAST, PDU_MAX, Space, WireFormat};
use crate::error::Failure;
use crate::medium::{SerialLine, Stream};
use crate::proto::HostOptions;
use crate::proto::early_bytes::{EarlyBytes, with_clock_tolerance};
use crate::proto::event_ring::EventRing;
use crate::proto::proven_addresses::ProvenAddresses;
use crate::proto::reply_ledger::LATEST_TIMEOUTS;
use crate::station::{
    self, Counters, EventSubject, HostEvent, LineEvent, RequestClass, Station, Ticket, Timed,
};
use crate::time::Instant;
use multiple_write::MultipleWriters;
use proof::StationProof;

/// Times that one request is put on the wire at most.
pub const ATTEMPTS_MAX: u8 = 3;
/// Default time-out of a reply, ms; the time of the bytes on the wire is added.
pub const REPLY_TIMEOUT_MS: u32 = 100;
/// [`HostOptions::gap_us`] of 3.5 characters at any baud rate, instead of the standard's fixed 1.75 ms above
/// 19200 baud.
pub const GAP_TRUE_CHARACTERS: u32 = HostOptions::GAP_CHARACTERS;
/// Silence after a broadcast, and before a request to another station on a timed line: more than the 10 ms of
/// silence that end a frame for the TS drive (TS manual V2 §2.3). It receives its neighbours' replies too, so
/// after a shorter pause it would read the reply and the next request as one bad frame \[I\].
pub const STATION_GAP_US: u32 = 10_500;
/// Unit of a sender that used the line while it was lent: no station has it.
const INTRUDER_UNIT: u8 = 255;

/// Requests in a row whose only reply came sooner than its bytes can travel, after which the baud
/// rate is taken for fiction (a virtual port).
const EARLY_STREAK_MAX: u8 = 2;
/// Replies in a row that took their time, after which it is believed again.
const TIMELY_STREAK_MIN: u8 = 16;
const RECEIVE_MAX: usize = 2 * ADU_MAX;
const OUTSTANDING_MAX: usize = 8;
const EVENTS_MAX: usize = 4;
/// Places among them that a request needs: its own end, and that of one that it cuts short.
const EVENT_ROOM_MIN: usize = 2;
/// A reply equal to the last one but to another question, so soon after it on a wire without
/// timing, may be that one's duplicate: it is held back, at least for as long.
const DUPLICATE_WINDOW_NS: u64 = 1_000_000;

/// The commanding end of a line.
#[derive(Clone, Debug)]
pub struct SerialHost {
    format: WireFormat,
    line: SerialLine,
    timeout_ns: u64,
    /// Silence before a frame: by the options, and by the standard.
    gap_ns: Option<u64>,
    silence_ns: u64,
    echo: EchoState,
    /// Cleared when replies come faster than the baud rate allows: the wire is none.
    is_timed: bool,
    /// True if the line has no timing.
    untimed: bool,
    early_bytes: EarlyBytes,
    /// The frame in hand began before the request had left.
    frame_is_early: bool,
    /// Requests in a row whose only reply came too soon; replies in a row that took their time.
    early_streak: u8,
    timely_streak: u8,

    current: Option<CurrentExchange>,
    sending: Option<PendingSend>,
    /// Deadline of the last request, and whether the line is in quarantine until then.
    deadline: Option<Instant>,
    quarantine: bool,
    outstanding: [AwaitedReply; OUTSTANDING_MAX],
    outstanding_len: usize,

    sent: [u8; ascii::FRAME_MAX],
    sent_len: usize,
    sent_at: Instant,
    sent_unit: Option<u8>,
    /// Time of the last sent frame on the wire, ns.
    sent_ns: u64,
    /// Since the last frame was sent: its echo came; bytes came, or were thrown away.
    echo_seen: bool,
    /// A reply to the last request came sooner than its bytes can travel, and was ignored.
    early_reply_seen: bool,
    received_any: bool,
    received_noise: bool,
    /// A station that answered the last request it got.
    responsive_unit: Option<u8>,

    received: [u8; RECEIVE_MAX],
    received_len: usize,
    ascii: AsciiDeframer,
    last_activity: Option<Instant>,

    payload: [u8; ADU_MAX],
    payload_len: usize,
    last_read: Option<LastRead>,
    /// Time of arrival of the answer that is held back.
    held_since: Option<Instant>,
    events: EventRing<Answer, EVENTS_MAX>,
    counters: Counters,

    /// Stations of which it is known that nothing older can come.
    proven_addresses: ProvenAddresses,
    /// Stations that take a single register by function 16 alone.
    multiple_writers: MultipleWriters,
    /// While the present request waits for its station to be proven.
    proof: Option<StationProof>,
}

#[derive(Clone, Copy, Debug)]
struct CurrentExchange {
    ticket: Ticket,
    request: HostRequest,
    attempts: u8,
    since: Instant,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum PendingSend {
    Request,
    Probe,
}

/// True if we hear our own bytes.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum EchoState {
    /// Stated by the user.
    Always,
    /// Detected in the last exchange that could show it.
    Detected,
    /// The adapter has no echo, or there was no such exchange yet.
    NotDetected,
}

/// A reply that may still come.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
struct AwaitedReply {
    unit: u8,
    function: u8,
    /// Address and value or count that a write's reply repeats; the byte count of a read's.
    reply_fields: (u16, u16),
    role: ReplyRole,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum ReplyRole {
    Request,
    Probe,
    /// The ticket was closed for a stop.
    Abandoned,
}

/// The exchange before, if it was a read: its request, and the time of its answer. The values that it read
/// still lie where the payload begins.
#[derive(Clone, Copy, Debug)]
struct LastRead {
    at: Instant,
    latency_ns: u64,
    unit: u8,
    space: Space,
    start: u16,
    count: u16,
    len: usize,
}

const NOTHING_OUTSTANDING: AwaitedReply =
    AwaitedReply { unit: 0, function: 0, reply_fields: (0, 0), role: ReplyRole::Abandoned };

impl AwaitedReply {
    #[inline]
    fn of(request: &HostRequest, role: ReplyRole) -> Self {
        let data_len = request.body.reply_data_len();
        let reply_fields = data_len.map_or(request.body.reply_fields(), |len| (0, len));
        Self { unit: request.unit, function: request.body.function().code(), reply_fields, role }
    }

    /// Length of the expected PDU, if it is not an exception; the longest where it is not known.
    #[inline]
    fn pdu_len(self) -> usize {
        match self.function {
            1..=4 | 0x17 => 2 + usize::from(self.reply_fields.1),
            device_id::FUNCTION => PDU_MAX,
            _ => 5,
        }
    }
}

impl SerialHost {
    /// A host that sends `format`, one of a serial line.
    #[must_use]
    pub fn new(format: WireFormat, options: &HostOptions) -> Self {
        debug_assert_ne!(format, WireFormat::Tcp, "it has a host of its own");
        let timeout_ms = options.reply_timeout_ms(REPLY_TIMEOUT_MS);
        let line = SerialLine::new_8n1(options.baud);
        Self {
            format,
            line,
            timeout_ns: u64::from(timeout_ms.max(1)) * 1_000_000,
            gap_ns: options.gap_us.map(|gap| match gap {
                GAP_TRUE_CHARACTERS => rtu::character_silence_ns(&line),
                us => u64::from(us) * 1000,
            }),
            silence_ns: match format {
                WireFormat::Rtu => rtu::silence_ns(&line),
                WireFormat::Ascii | WireFormat::Tcp => 0,
            },
            echo: if options.echo { EchoState::Always } else { EchoState::NotDetected },
            is_timed: options.timed_baud() != 0,
            untimed: options.untimed,
            early_bytes: EarlyBytes::new(&SerialLine::new_8n1(options.timed_baud())),
            frame_is_early: false,
            early_streak: 0,
            timely_streak: 0,
            current: None,
            sending: None,
            deadline: None,
            quarantine: false,
            outstanding: [NOTHING_OUTSTANDING; OUTSTANDING_MAX],
            outstanding_len: 0,
            sent: [0; ascii::FRAME_MAX],
            sent_len: 0,
            sent_at: Instant::ZERO,
            sent_unit: None,
            sent_ns: 0,
            echo_seen: false,
            early_reply_seen: false,
            received_any: false,
            received_noise: false,
            responsive_unit: None,
            received: [0; RECEIVE_MAX],
            received_len: 0,
            ascii: AsciiDeframer::default(),
            last_activity: options.line_used_at,
            payload: [0; ADU_MAX],
            payload_len: 0,
            last_read: None,
            held_since: None,
            events: EventRing::new(),
            counters: Counters::default(),
            proven_addresses: ProvenAddresses::new(options.probe_seed),
            multiple_writers: MultipleWriters::default(),
            proof: None,
        }
    }

    /// Data of the last read, as in the reply: big-endian words, or bits eight to a byte. Valid until the
    /// next request is submitted.
    #[must_use]
    pub fn payload(&self) -> &[u8] {
        &self.payload[..self.payload_len]
    }

    fn outstanding(&self) -> &[AwaitedReply] {
        &self.outstanding[..self.outstanding_len]
    }

    /// Completes the present request; the values of a read become the payload.
    #[inline]
    fn complete_current(&mut self) {
        let Some(CurrentExchange { ticket, request, .. }) = &self.current else { return };
        self.counters.answered += 1;
        self.responsive_unit = Some(request.unit);
        let event = self.events.push(EventSubject::Request(*ticket), Ok(Answer::BLANK));
        if let Ok(answer) = event {
            answer.fill(request, &self.payload[..self.payload_len]);
        }
        self.clear_current();
    }

    /// The present request was refused, or brought no answer.
    #[cold]
    fn fail_current(&mut self, failure: Failure) {
        let Some(CurrentExchange { ticket, request, .. }) = &self.current else { return };
        match failure {
            Failure::Refused { .. } => self.counters.answered += 1,
            Failure::Silent => self.counters.silent += 1,
            _ => {}
        }
        match failure {
            Failure::Cancelled => {}
            Failure::Silent => self.responsive_unit = None,
            _ => self.responsive_unit = Some(request.unit),
        }
        self.events.push(EventSubject::Request(*ticket), Err(failure));
        self.clear_current();
    }

    #[inline]
    fn clear_current(&mut self) {
        self.current = None;
        self.proof = None;
        if self.sending == Some(PendingSend::Request) {
            self.sending = None;
        }
    }

    /// Nothing is outstanding and nothing can still come.
    #[inline]
    fn end_quarantine(&mut self) {
        self.quarantine = false;
        self.deadline = None;
        self.outstanding_len = 0;
        self.held_since = None;
        if self.sending == Some(PendingSend::Probe) {
            self.sending = None;
        }
    }

    /// Time of the next frame: after the silence that the line needs, but at most one time-out after the
    /// request was submitted, whatever is received.
    fn send_at(&self) -> Instant {
        self.silent_at().min(self.latest_send_at())
    }

    /// Time at which the line has been silent for long enough.
    #[inline]
    fn silent_at(&self) -> Instant {
        let Some(active) = self.last_activity else { return Instant::ZERO };
        let unit = match (self.sending, &self.current) {
            (Some(PendingSend::Request), Some(current)) => Some(current.request.unit),
            (_, Some(current)) if self.proof.is_some() => Some(current.request.unit),
            _ => self.sent_unit,
        };
        let gap = self.gap_ns.unwrap_or(if self.is_timed { self.silence_ns } else { 0 });
        if unit == self.sent_unit && unit != Some(BROADCAST) {
            return active.plus_ns(gap);
        }
        active.plus_ns(gap.max(self.station_gap_ns()))
    }

    /// Least silence before a frame to another station than the last one.
    #[cold]
    fn station_gap_ns(&self) -> u64 {
        let timed = self.is_timed && self.format == WireFormat::Rtu && self.gap_ns.is_none();
        match self.sent_unit {
            Some(BROADCAST) => u64::from(STATION_GAP_US) * 1000,
            // Which station spoke to an earlier session is not known.
            _ if timed => u64::from(STATION_GAP_US) * 1000,
            _ => 0,
        }
    }

    fn latest_send_at(&self) -> Instant {
        let patience = self.timeout_ns.max(2 * u64::from(STATION_GAP_US) * 1000);
        match (self.sending, &self.current) {
            (Some(PendingSend::Request), Some(current)) => current.since.plus_ns(patience),
            (_, Some(current)) if self.proof.is_some() => current.since.plus_ns(patience),
            _ => self.deadline.unwrap_or(Instant::FAR_FUTURE),
        }
    }

    /// A read of one bit or register, with a function code of which no reply is pending.
    fn quarantine_probe(&self) -> Option<HostRequest> {
        let unit = self.sent_unit.filter(|&unit| unit != BROADCAST)?;
        let spaces = [Space::Holding, Space::Coil, Space::Input, Space::Discrete];
        let space = spaces.into_iter().find(|space| {
            let code = space.read_function().code();
            !self.outstanding().iter().any(|awaited| awaited.function == code)
        })?;
        let request = RequestBody::Read { space, start: 0, count: 1 };
        Some(HostRequest { unit, body: request, class: RequestClass::Idempotent })
    }

    /// Notes that the bytes in `sent` go out now, and the expected reply.
    #[inline]
    fn note_sent(&mut self, now: Instant, awaited: AwaitedReply) {
        let gone = self.line.characters_ns(self.sent_len as u32);
        self.sending = None;
        self.sent_at = now;
        self.sent_unit = Some(awaited.unit);
        self.last_activity = Some(now.plus_ns(gone));
        self.sent_ns = gone;
        self.echo_seen = false;
        self.early_reply_seen &= awaited.role == ReplyRole::Probe;
        self.received_any &= awaited.role == ReplyRole::Probe;
        if self.received_len > 0 {
            self.skip_bytes(self.received_len);
        }
        self.received_noise = false;
        self.ascii.clear();
        self.early_bytes.note_sent(now, with_clock_tolerance(gone));
        self.counters.sent += 1;
        if awaited.unit == BROADCAST {
            self.complete_current();
            return self.end_quarantine();
        }
        // A probe may be answered as late as any request.
        let timeouts = self.deadline_timeouts();
        let reply = self.line.characters_ns(self.frame_characters(awaited.pdu_len()) as u32);
        self.deadline = Some(now.plus_ns(gone + reply + timeouts * self.timeout_ns));
        self.add_outstanding(awaited);
    }

    /// Characters of a frame around a PDU of `pdu_len` bytes.
    #[inline]
    fn frame_characters(&self, pdu_len: usize) -> usize {
        match self.format {
            WireFormat::Rtu | WireFormat::Tcp => pdu_len + 3,
            WireFormat::Ascii => 2 * pdu_len + 7,
        }
    }

    /// Enters a reply that may come. Where there is no room the oldest one goes, which was abandoned for a
    /// stop: drives answer in order, so it comes before the others or never. The newest one must be in, or
    /// nothing would ever end its request.
    #[inline]
    fn add_outstanding(&mut self, awaited: AwaitedReply) {
        if self.outstanding_len == OUTSTANDING_MAX {
            self.outstanding.rotate_left(1);
            self.outstanding_len -= 1;
        }
        self.outstanding[self.outstanding_len] = awaited;
        self.outstanding_len += 1;
    }

    fn handle_deadline(&mut self, now: Instant) {
        if self.proof.is_some() {
            return self.handle_proof_timeout();
        }
        if self.quarantine {
            return self.expire_quarantine(now);
        }
        self.quarantine = true;
        if self.outstanding_len < OUTSTANDING_MAX && self.quarantine_probe().is_some() {
            self.sending = Some(PendingSend::Probe);
        }
        self.extend_deadline();
    }

    /// The deadline becomes that of the latest possible reply.
    fn extend_deadline(&mut self) {
        let more = (LATEST_TIMEOUTS - 1) * self.timeout_ns;
        self.deadline = self.deadline.map(|deadline| deadline.plus_ns(more));
    }

    /// Handles the loss of the wire. A pending reply may still arrive after its return, and does not repeat
    /// its request: the line stays closed until the latest one is past.
    fn abandon_outstanding(&mut self) {
        self.sending = None;
        self.held_since = None;
        self.responsive_unit = None;
        self.ascii.clear();
        self.skip_bytes(self.received_len);
        if self.outstanding_len == 0 {
            self.sent_unit = None;
            return self.end_quarantine();
        }
        self.outstanding[..self.outstanding_len]
            .iter_mut()
            .for_each(|awaited| awaited.role = ReplyRole::Abandoned);
        if !core::mem::replace(&mut self.quarantine, true) {
            self.extend_deadline();
        }
    }

    #[inline]
    fn start_request(&mut self, now: Instant, ticket: Ticket, request: HostRequest) {
        self.held_since = None;
        self.payload_len = 0;
        let request = self.multiple_writers.adapt(request);
        self.current = Some(CurrentExchange { ticket, request, attempts: 1, since: now });
        self.sending = Some(PendingSend::Request);
    }

    /// Submits a request that has to wait, or returns it if it cannot: a stop replaces the present request of
    /// a quarantined line.
    #[cold]
    fn submit_slow_path(
        &mut self,
        now: Instant,
        ticket: Ticket,
        request: HostRequest,
    ) -> Result<(), HostRequest> {
        let full = self.events.room() < EVENT_ROOM_MIN;
        let busy = self.current.is_some() || self.quarantine;
        let stop = station::Request::is_stop(&request);
        if full || (busy && !(stop && self.quarantine && self.proof.is_none())) {
            return Err(request);
        }
        if !busy && !stop && request.unit != BROADCAST {
            self.begin_proof(now, ticket, request);
            return Ok(());
        }
        // The caller gets the reason for which a read was not repeated.
        let given_up = self.current.as_ref().is_some_and(|current| {
            current.request.class == RequestClass::Idempotent && current.attempts < ATTEMPTS_MAX
        });
        self.fail_current(if given_up { Failure::Cancelled } else { Failure::Silent });
        for awaited in &mut self.outstanding[..self.outstanding_len] {
            if awaited.role == ReplyRole::Request {
                awaited.role = ReplyRole::Abandoned;
            }
        }
        self.start_request(now, ticket, request);
        if request.unit == BROADCAST && request.body.function().read_space().is_some() {
            // A broadcast has no reply (MSL 2.1): a read of it is silence without a byte sent.
            self.fail_current(Failure::Silent);
        }
        Ok(())
    }

    /// The quarantine ran out: nothing can still come.
    fn expire_quarantine(&mut self, now: Instant) {
        let worth = self.received_any
            || self.current.is_some_and(|c| self.responsive_unit == Some(c.request.unit));
        self.end_quarantine();
        if worth {
            self.retry_or_fail(now);
        } else {
            self.fail_current(Failure::Silent);
        }
    }

    /// The request or its reply was lost, and the line is clean.
    fn retry_or_fail(&mut self, now: Instant) {
        if self.early_reply_seen {
            self.early_streak += 1;
            self.is_timed &= self.early_streak < EARLY_STREAK_MAX;
        }
        let Some(current) = &mut self.current else { return };
        let harmless =
            matches!(current.request.class, RequestClass::Idempotent | RequestClass::Stop);
        if harmless && current.attempts < ATTEMPTS_MAX && self.outstanding_len == 0 {
            current.attempts += 1;
            current.since = now;
            self.counters.resent += 1;
            self.sending = Some(PendingSend::Request);
            self.quarantine = false;
            self.deadline = None;
        } else {
            self.fail_current(Failure::Silent);
        }
    }
}

impl Timed for SerialHost {
    fn handle_timeout(&mut self, now: Instant) {
        if self.deadline.is_none_or(|deadline| now < deadline)
            || self.sending == Some(PendingSend::Request)
        {
            return;
        }
        match self.held_since.take() {
            Some(at) => {
                self.remember_read(at, now);
                self.end_quarantine();
                self.complete_current();
            }
            None => self.handle_deadline(now),
        }
    }

    fn poll_timeout(&self) -> Option<Instant> {
        match self.sending {
            Some(_) => Some(self.send_at()),
            None => self.deadline,
        }
    }
}

impl Station<Stream> for SerialHost {
    #[inline]
    fn handle_input(&mut self, now: Instant, unit: &[u8]) {
        self.last_activity = Some(self.last_activity.map_or(now, |active| active.max(now)));
        self.received_any = true;
        if self.format == WireFormat::Ascii {
            return self.process_ascii(now, unit);
        }
        match self.expected_read_data(unit) {
            Some(data) => self.accept_read(now, unit.len(), data),
            None => self.buffer_bytes(now, unit),
        }
    }

    fn handle_line(&mut self, _now: Instant, event: LineEvent) {
        if matches!(event, LineEvent::Down | LineEvent::BusOff) {
            self.fail_current(Failure::LinkDown);
        }
        if !matches!(event, LineEvent::Break) && self.current.is_none() {
            self.abandon_outstanding();
        }
    }

    #[inline]
    fn poll_transmit(&mut self, now: Instant, out: &mut [u8]) -> Option<usize> {
        let sending = self.sending?;
        if now < self.silent_at() && now < self.latest_send_at() {
            return None;
        }
        let (request, role) = match sending {
            PendingSend::Request => (&self.current.as_ref()?.request, ReplyRole::Request),
            PendingSend::Probe => (&self.probe_request()?, ReplyRole::Probe),
        };
        self.sent_len = request.emit(self.format, &mut self.sent);
        let awaited = AwaitedReply::of(request, role);
        self.note_sent(now, awaited);
        if self.sent_len == rtu::SHORT_FRAME_LEN {
            *out.first_chunk_mut::<{ rtu::SHORT_FRAME_LEN }>()? = *self.sent.first_chunk()?;
        } else {
            out.get_mut(..self.sent_len)?.copy_from_slice(&self.sent[..self.sent_len]);
        }
        Some(self.sent_len)
    }

    fn line(&self) -> SerialLine {
        self.line
    }
}

impl station::HostWire for SerialHost {
    fn unparsed_len(&self) -> usize {
        self.received_len + self.ascii.pending()
    }

    fn handle_resume(&mut self, now: Instant) {
        self.last_activity = Some(now);
        // This host has sent nothing to that unit: the frame is another station's in any case.
        self.sent_unit = Some(INTRUDER_UNIT);
    }
}

impl station::HostData for SerialHost {}

impl station::Host<Stream> for SerialHost {
    type Request = HostRequest;

    type Answer = Answer;

    #[inline]
    fn submit(
        &mut self,
        now: Instant,
        ticket: Ticket,
        request: HostRequest,
    ) -> Result<(), HostRequest> {
        let busy = self.current.is_some() || self.quarantine;
        let unit = request.unit;
        if busy
            || self.events.room() < EVENT_ROOM_MIN
            || unit == BROADCAST
            || !self.proven_addresses.contains(unit)
        {
            return self.submit_slow_path(now, ticket, request);
        }
        self.start_request(now, ticket, request);
        Ok(())
    }

    /// A request that waits for the line to be silent, for the first time or once more.
    fn recall(&mut self, _stop: &HostRequest) -> Option<Ticket> {
        let unsent = self.sending == Some(PendingSend::Request) || self.proof.is_some();
        let current = self.current.as_ref().filter(|_| unsent)?;
        if station::Request::is_stop(&current.request) {
            return None;
        }
        let ticket = current.ticket;
        self.clear_current();
        if self.outstanding_len == 0 {
            self.end_quarantine();
        }
        Some(ticket)
    }

    fn disable_retries(&mut self, ticket: Ticket) {
        if let Some(current) = self.current.as_mut().filter(|current| current.ticket == ticket) {
            current.attempts = ATTEMPTS_MAX;
        }
    }

    #[inline]
    fn poll_event(&mut self) -> Option<&HostEvent<Answer>> {
        self.events.next()
    }

    fn encode_request(&self, request: &HostRequest, out: &mut [u8]) -> usize {
        request.emit(self.format, out)
    }

    fn counters(&self) -> Counters {
        self.counters
    }
}
