//! The host end, on a serial line and on CAN.
//!
//! A reply is accepted only if all its fields match: checksum, host address, module address, opcode, a
//! known status; and on a line with a known baud rate the time, because a reply cannot be complete before
//! request and reply were on the wire. Manuals call the value of a reply to a write "don't care", so it is
//! not compared.

use super::ascii;
use super::opcode::Opcode;
use super::session::{Answer, Burst, HostRequest, Session};
use super::wire::{DATAGRAM, HOST, Reply, Request, VersionText, checksum};
use crate::medium::bits::bit_time_ns;
use crate::medium::{Can, CanLine, Frame, SerialLine, Stream};
use crate::proto::HostOptions;
use crate::proto::early_bytes::{EarlyBytes, with_clock_tolerance};
use crate::station::{
    Counters, Host, HostData, HostEvent, HostWire, LineEvent, Station, Ticket, Timed,
};
use crate::time::Instant;

/// Default time-out of a reply, ms.
pub const REPLY_TIMEOUT_MS: u32 = 100;
/// Silence of the line, in characters, after bytes that were no reply and before the next request.
// The rest of a damaged datagram follows without a pause; two characters separate its end from a hiccup of
// an adapter.
const QUIET_CHARACTERS: u32 = 2;
/// The byte that is sent alone, to make a module that lost count of bytes count on.
const FILLER_BYTE: u8 = 0;
/// Silence after a filler byte, long enough for a module with a time limit between bytes to drop it.
// A module that drops parts after a pause must not keep the byte as the first of nine.
const FILLER_PAUSE_MS: u32 = 35;
/// Bytes of a request that goes out at each place of a module's count, without those before and after.
const BURST_LEN: usize = DATAGRAM * (DATAGRAM + 1);
/// Longest burst with filler bytes.
const BURST_LEN_MAX: usize = BURST_LEN + 2 * (DATAGRAM - 1);

/// The host on RS-232, RS-485, a pseudo-terminal or TCP.
#[derive(Debug)]
pub struct SerialHost {
    session: Session,
    line: SerialLine,
    /// Time of a request and its reply on the wire, ns: least and greatest.
    on_wire_ns: (u64, u64),
    early_bytes: EarlyBytes,
    /// Silence before a request after bytes that were no reply.
    noise_gap_ns: u64,
    host_address: u8,
    gap_ns: u64,
    buffer: [u8; DATAGRAM],
    buffer_len: usize,
    sent: [u8; DATAGRAM],
    echo_pending: bool,
    /// Number of sent filler bytes whose echo may arrive first.
    filler_echoes_pending: u8,
    /// Bytes that are still to come of a frame whose check failed.
    corrupt_bytes_left: usize,
    /// Discarded bytes since the end of a line: a module in ASCII mode replies in text.
    discarded_text: ascii::AsciiLine,
    /// Time until which the line has to be silent.
    silent_until: Instant,
}

impl SerialHost {
    /// Creates a host with `options`.
    #[must_use]
    pub fn new(options: &HostOptions) -> Self {
        let host_address =
            options.host_address.and_then(|host| u8::try_from(host).ok()).unwrap_or(HOST);
        let timeout = options.reply_timeout_ms(REPLY_TIMEOUT_MS);
        let line = SerialLine::new_8n1(options.baud);
        let paced = SerialLine::new_8n1(options.timed_baud());
        // By the rate that holds for bytes; behind USB or TCP there is none, and nothing comes too soon.
        let soonest_ns = with_clock_tolerance(paced.characters_ns(2 * DATAGRAM as u32));
        let on_wire_ns = line.characters_ns(2 * DATAGRAM as u32);
        let noise_gap_ns = line.characters_ns(QUIET_CHARACTERS);
        let gap_ns = match options.gap_us {
            Some(HostOptions::GAP_CHARACTERS) => line.characters_ns(7) / 2,
            _ => options.stated_gap_ns(),
        };
        Self {
            session: Session::new(host_address.into(), timeout, options).with_byte_counting(),
            line,
            on_wire_ns: (soonest_ns, on_wire_ns),
            early_bytes: EarlyBytes::new(&paced),
            noise_gap_ns,
            host_address,
            gap_ns,
            buffer: [0; DATAGRAM],
            buffer_len: 0,
            sent: [0; DATAGRAM],
            echo_pending: false,
            filler_echoes_pending: 0,
            corrupt_bytes_left: 0,
            discarded_text: ascii::AsciiLine::EMPTY,
            silent_until: Instant(noise_gap_ns.max(gap_ns)),
        }
    }

    /// Takes nine bytes that are just the good reply that is waited for. Returns false when they are
    /// not. An echo never is: no module has the host's address.
    #[inline]
    fn try_fast_reply(&mut self, now: Instant, window: &[u8; DATAGRAM]) -> bool {
        let reply = Reply::unchecked(window);
        self.early_bytes.count() == 0
            && checksum(window) == window[DATAGRAM - 1]
            && reply.host == self.host_address
            && self.session.try_fast_reply(now, reply)
    }

    /// Judges nine bytes and returns how many of them are done with: all, or one.
    fn process_window(&mut self, now: Instant, window: &[u8; DATAGRAM]) -> usize {
        // A module in ASCII mode and some adapters send back what they receive.
        if self.echo_pending && *window == self.sent {
            self.echo_pending = false;
            self.session.counters.echoed += 1;
            return self.finish_frame();
        }
        if checksum(window) == window[DATAGRAM - 1] {
            let reply = Reply::unchecked(window);
            if reply.host == self.host_address
                && (reply.status.is_named() || self.expects_opcode(Opcode::ReadMemory))
            {
                self.filler_echoes_pending = 0;
                self.session.handle_reply(now, reply, self.early_bytes.count() > 0);
                return self.finish_frame();
            }
            if reply.status.is_named() {
                debug_assert_eq!(checksum(window), window[DATAGRAM - 1]);
                self.session.note_other_host(reply.host.into(), &reply);
                return self.finish_frame();
            }
        }
        self.process_text_or_noise(now, window)
    }

    /// Nine bytes that are no reply with a checksum.
    #[cold]
    fn process_text_or_noise(&mut self, now: Instant, window: &[u8; DATAGRAM]) -> usize {
        if let Ok(text) = VersionText::parse(window)
            && self.expects_version_text()
            && text.host == self.host_address
        {
            self.session.handle_version_text(now, text);
            return self.finish_frame();
        }
        if window[0] == self.host_address && self.corrupt_bytes_left == 0 {
            self.session.counters.corrupt += 1;
            self.corrupt_bytes_left = DATAGRAM;
        }
        self.skip_byte(window[0]);
        // A request into the middle of noise would be counted together with it.
        self.silent_until = self.silent_until.max(now.plus_ns(self.noise_gap_ns));
        1
    }

    /// A frame ends here, and all of it is done with.
    const fn finish_frame(&mut self) -> usize {
        self.corrupt_bytes_left = 0;
        DATAGRAM
    }

    /// Throws a byte away. Those of a frame that was counted are not counted again.
    fn skip_byte(&mut self, byte: u8) {
        if self.corrupt_bytes_left > 0 {
            self.corrupt_bytes_left -= 1;
            return self.discarded_text.push(byte);
        }
        // Our own bytes between requests come back as well; they are no sign of a wrong baud rate.
        if byte == FILLER_BYTE && self.filler_echoes_pending > 0 {
            self.filler_echoes_pending -= 1;
            self.session.counters.echoed += 1;
            return;
        }
        self.session.counters.skipped += 1;
        if byte != b'\r' {
            return self.discarded_text.push(byte);
        }
        let line = core::mem::replace(&mut self.discarded_text, ascii::AsciiLine::EMPTY);
        self.session.counters.texts += u64::from(ascii::AsciiReply::parse(line.bytes()).is_some());
    }

    /// Discards the held bytes.
    fn skip_buffered(&mut self) {
        let (held, len) = (self.buffer, core::mem::take(&mut self.buffer_len));
        held[..len].iter().for_each(|&byte| self.skip_byte(byte));
    }

    /// Processes nine received bytes that are not the expected reply.
    #[cold]
    fn process_received_window(&mut self, now: Instant, window: &[u8; DATAGRAM]) {
        let done = self.process_window(now, window);
        self.early_bytes.consume(done);
        if done < DATAGRAM {
            self.buffer_bytes(now, &window[done..]);
        }
    }

    /// Takes bytes one by one.
    #[cold]
    fn buffer_bytes(&mut self, now: Instant, bytes: &[u8]) {
        for &byte in bytes {
            debug_assert!(self.buffer_len < DATAGRAM, "a whole window is processed at once");
            self.buffer[self.buffer_len] = byte;
            self.buffer_len += 1;
            if self.buffer_len == DATAGRAM {
                let window = self.buffer;
                let done = self.process_window(now, &window);
                self.early_bytes.consume(done);
                self.buffer.copy_within(done.., 0);
                self.buffer_len -= done;
            }
        }
    }

    fn expects_opcode(&self, opcode: Opcode) -> bool {
        let request = self.session.expected_request();
        request.is_some_and(|request| request.opcode == opcode) && !self.session.expects_stored()
    }

    fn expects_version_text(&self) -> bool {
        self.expects_opcode(Opcode::Version)
            && self.session.expected_request().is_some_and(|r| r.kind == 0)
    }
}

impl Timed for SerialHost {
    fn handle_timeout(&mut self, now: Instant) {
        self.session.handle_timeout(now);
    }

    fn poll_timeout(&self) -> Option<Instant> {
        self.session.poll_timeout()
    }
}

impl Station<Stream> for SerialHost {
    #[inline]
    fn handle_input(&mut self, now: Instant, bytes: &[u8]) {
        self.silent_until = self.silent_until.max(now.plus_ns(self.gap_ns));
        self.early_bytes.note_received(now, self.buffer_len + bytes.len());
        // A whole datagram at once, as nearly always, is looked at where it lies.
        if self.buffer_len == 0
            && let Ok(window) = bytes.try_into()
        {
            if !self.try_fast_reply(now, window) {
                self.process_received_window(now, window);
            }
        } else {
            self.buffer_bytes(now, bytes);
        }
    }

    fn handle_line(&mut self, now: Instant, event: LineEvent) {
        self.skip_buffered();
        self.session.handle_line(now, event);
    }

    #[inline]
    fn poll_transmit(&mut self, now: Instant, out: &mut [u8]) -> Option<usize> {
        if !self.session.has_unsent() {
            return None;
        }
        let shift = self.session.take_filler_bytes(now);
        if shift > 0 {
            self.session.delay_sending(now.plus_ms(FILLER_PAUSE_MS));
            // Before the request, and a pause between them: see `alignment`.
            self.filler_echoes_pending = shift;
            out.get_mut(..shift.into())?.fill(FILLER_BYTE);
            return Some(shift.into());
        }
        if now < self.silent_until {
            self.session.delay_sending(self.silent_until);
        }
        // A caller with a shorter buffer gets the plain request; a part of a block would shift the module's
        // count.
        let burst = self.session.burst().filter(|_| out.len() >= BURST_LEN_MAX);
        let on_wire_ns = match burst {
            // Their own answers may be as many, and belong to no request.
            Some(burst) => {
                (self.on_wire_ns.0, burst_len(burst) * self.on_wire_ns.1 / DATAGRAM as u64)
            }
            None => self.on_wire_ns,
        };
        let request = self.session.transmit(now, on_wire_ns, burst)?;
        if self.buffer_len > 0 {
            self.skip_buffered();
        }
        // Half of the exchange is the request, of as many bytes as the reply.
        self.early_bytes.note_sent(now, self.on_wire_ns.0 / 2);
        let bytes = request.emit();
        self.sent = bytes;
        self.echo_pending = true;
        *out.first_chunk_mut()? = bytes;
        if let Some(burst) = burst {
            debug_assert!(
                on_wire_ns.1 >= self.on_wire_ns.1,
                "a block takes longer than one datagram"
            );
            self.silent_until = self.silent_until.max(now.plus_ns(on_wire_ns.1));
            return Some(write_burst(bytes, out, burst));
        }
        Some(DATAGRAM)
    }

    fn line(&self) -> SerialLine {
        self.line
    }
}

impl HostWire for SerialHost {
    fn unparsed_len(&self) -> usize {
        self.buffer_len
    }

    fn handle_resume(&mut self, now: Instant) {
        self.silent_until = self.silent_until.max(now.plus_ns(self.gap_ns));
    }

    fn own_address(&self) -> Option<u32> {
        Some(self.host_address.into())
    }
}

impl HostData for SerialHost {}

impl Host<Stream> for SerialHost {
    type Request = HostRequest;

    type Answer = Answer;

    #[inline]
    fn submit(
        &mut self,
        now: Instant,
        ticket: Ticket,
        request: HostRequest,
    ) -> Result<(), HostRequest> {
        self.session.submit(now, ticket, request)
    }

    fn recall(&mut self, _stop: &HostRequest) -> Option<Ticket> {
        self.session.recall()
    }

    fn disable_retries(&mut self, ticket: Ticket) {
        self.session.disable_retries(ticket);
    }

    #[inline]
    fn poll_event(&mut self) -> Option<&HostEvent<Answer>> {
        self.session.poll_event()
    }

    fn encode_request(&self, request: &HostRequest, out: &mut [u8]) -> usize {
        let bytes = request.request.emit();
        let len = bytes.len().min(out.len());
        out[..len].copy_from_slice(&bytes[..len]);
        len
    }

    fn quarantine_drive(&mut self, now: Instant, address: u32) {
        self.session.quarantine_module(now, address);
    }

    fn counters(&self) -> Counters {
        self.session.counters
    }
}

/// The host on CAN. \[I\] A module's address is its CAN id of requests, as from the factory.
#[derive(Debug)]
pub struct CanHost {
    session: Session,
    reply_id: u16,
    bit_rate: u32,
    /// Shortest time of a request and its reply. An earlier reply is the second copy of an
    /// older reply, which a disturbed last bit makes its sender repeat.
    min_exchange_ns: u64,
    eight_bytes: bool,
    /// The identifier of each module that was asked, by its low byte, which is all that replies and
    /// probes have.
    can_ids: [Option<u16>; 256],
}

/// Bits of a request and its reply without a single stuff bit: 47 each and seven bytes, less the
/// pause behind the last.
const EXCHANGE_BITS: u64 = 2 * (47 + 7 * 8) - 3;

impl CanHost {
    /// Creates a host with `options`: `host` is the CAN id of replies.
    #[must_use]
    pub fn new(options: &HostOptions) -> Self {
        let reply_id = reply_id(options);
        let timeout = options.reply_timeout_ms(REPLY_TIMEOUT_MS);
        let session = Session::new(reply_id, timeout, options);
        let bit_rate = options.bit_rate;
        let min_exchange_ns = with_clock_tolerance(bit_time_ns(EXCHANGE_BITS, bit_rate));
        let can_ids = [None; 256];
        Self { session, reply_id, bit_rate, min_exchange_ns, eight_bytes: false, can_ids }
    }

    /// Sends eight data bytes, the last one the serial checksum, as the vendor's library does.
    #[must_use]
    pub fn with_eight_bytes(mut self) -> Self {
        self.eight_bytes = true;
        self
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
        // TMCL has standard data frames only; a frame of another protocol on the bus is no damage of ours.
        if frame.extended || frame.remote {
            return;
        }
        if frame.id != u32::from(self.reply_id) {
            if let Ok(reply) = Reply::parse_can(frame.bytes(), 0)
                && self.session.answers_pending(&reply)
            {
                self.session.note_other_host(frame.id, &reply);
            }
            if let Some(request) = self.other_hosts_request(frame) {
                self.session.note_other_request(now, request);
            }
            return;
        }
        let host = self.reply_id as u8;
        let expected = self.session.expected_request();
        let text = expected.is_some_and(|r| r.opcode == Opcode::Version && r.kind == 0)
            && !self.session.expects_stored();
        let memory = expected.is_some_and(|r| r.opcode == Opcode::ReadMemory);
        if text && let Ok(text) = VersionText::parse_can(frame.bytes(), host) {
            return self.session.handle_version_text(now, text);
        }
        match Reply::parse_can(frame.bytes(), host) {
            Ok(reply) if reply.status.is_named() || memory => {
                self.session.handle_reply(now, reply, false);
            }
            _ => self.session.counters.corrupt += 1,
        }
    }

    fn handle_line(&mut self, now: Instant, event: LineEvent) {
        self.session.handle_line(now, event);
    }

    fn poll_transmit(&mut self, now: Instant, out: &mut Frame) -> Option<usize> {
        let request = self.session.transmit(now, (self.min_exchange_ns, 0), None)?;
        *out = self.encode_frame(&request);
        Some(1)
    }

    fn line(&self) -> CanLine {
        CanLine { bit_rate: self.bit_rate }
    }
}

impl HostWire for CanHost {
    fn own_address(&self) -> Option<u32> {
        Some(self.reply_id.into())
    }
}

impl HostData for CanHost {}

impl Host<Can> for CanHost {
    type Request = HostRequest;

    type Answer = Answer;

    #[inline]
    fn submit(
        &mut self,
        now: Instant,
        ticket: Ticket,
        request: HostRequest,
    ) -> Result<(), HostRequest> {
        // Only for identifiers above FFh; a module below that has the same number in both.
        let slot = &mut self.can_ids[usize::from(request.request.address)];
        if *slot.get_or_insert(request.can_id) != request.can_id {
            const RULE: &str = "replies have the low byte of the CAN id alone: two modules on one bus need \
                                ids that differ there";
            return self.session.reject(ticket, request, RULE);
        }
        self.session.submit(now, ticket, request)
    }

    fn recall(&mut self, _stop: &HostRequest) -> Option<Ticket> {
        self.session.recall()
    }

    fn disable_retries(&mut self, ticket: Ticket) {
        self.session.disable_retries(ticket);
    }

    fn quarantine_drive(&mut self, now: Instant, address: u32) {
        self.session.quarantine_module(now, address);
    }

    #[inline]
    fn poll_event(&mut self) -> Option<&HostEvent<Answer>> {
        self.session.poll_event()
    }

    fn encode_request(&self, request: &HostRequest, out: &mut Frame) -> usize {
        *out = request.request.emit_can(request.can_id, self.eight_bytes);
        1
    }

    fn counters(&self) -> Counters {
        self.session.counters
    }
}

impl CanHost {
    /// The request of another host to a module that this one asks as well.
    fn other_hosts_request(&self, frame: &Frame) -> Option<Request> {
        let address = frame.id as u8;
        let asked = u32::from(self.can_ids[usize::from(address)]?) == frame.id;
        Request::parse_can(frame.bytes(), address).ok().filter(|_| asked)
    }

    fn encode_frame(&self, request: &Request) -> Frame {
        let can_id = self.can_ids[usize::from(request.address)];
        request.emit_can(can_id.unwrap_or(request.address.into()), self.eight_bytes)
    }
}

fn reply_id(options: &HostOptions) -> u16 {
    let host = options.host_address.and_then(|id| u16::try_from(id).ok()).filter(|id| *id <= 0x7FF);
    host.unwrap_or(HOST.into())
}

/// The module that sent a reply, if the frame is one.
pub(super) fn reply_sender(options: &HostOptions, frame: &Frame) -> Option<u32> {
    let to_host = frame.id == u32::from(reply_id(options)) && !frame.extended && !frame.remote;
    let reply = Reply::parse_can(frame.bytes(), HOST).ok().filter(|_| to_host)?;
    reply.status.is_named().then_some(reply.module.into())
}

/// Length of a request that is sent at every byte position.
fn burst_len(burst: Burst) -> u64 {
    BURST_LEN as u64 + u64::from(burst.lead_bytes) + u64::from(burst.trail_bytes)
}

/// Writes a datagram nine times, with a byte between: for any byte position of a module that counts to nine,
/// one of them is aligned, and its position is then as before, except for the bytes before and after. Returns
/// the number of bytes.
fn write_burst(datagram: [u8; DATAGRAM], out: &mut [u8], burst: Burst) -> usize {
    let len = burst_len(burst) as usize;
    out[..len].fill(FILLER_BYTE);
    let lead = usize::from(burst.lead_bytes);
    for slot in out[lead..lead + BURST_LEN].chunks_exact_mut(DATAGRAM + 1) {
        slot[..DATAGRAM].copy_from_slice(&datagram);
    }
    len
}
