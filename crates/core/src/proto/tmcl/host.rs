//! The commanding end, on a serial line and on CAN.
//!
//! A reply is taken only if everything that it offers agrees: checksum, host address, module
//! address, opcode, a known status, and on a line with a known baud rate the time: no reply can be
//! whole before request and reply were on the wire. Manuals call the value of a reply to a write
//! "don't care", so it is not compared.

use super::ascii;
use super::opcode::Opcode;
use super::session::{Answer, Ask, Burst, Session};
use super::wire::{DATAGRAM, HOST, Reply, Request, VersionText, checksum};
use crate::medium::{Can, CanLine, Frame, SerialLine, Stream};
use crate::proto::HostOptions;
use crate::proto::pace::{Pace, tolerated};
use crate::station::{Counters, Event, Host, LineEvent, Station, Ticket, Timed};
use crate::time::Instant;

/// Time allowed for a reply when neither caller nor profile says one, ms.
pub const REPLY_TIMEOUT_MS: u32 = 100;
/// After bytes that were no reply, the line must be silent for so many characters before the host
/// speaks.
const QUIET_CHARACTERS: u32 = 2;
/// The byte that is sent alone, to make a module that lost count of bytes count on.
const SHIFT: u8 = 0;
/// It is followed by so long a silence, that a module with a time limit between bytes drops it.
const SHIFT_PAUSE_MS: u32 = 35;
/// Bytes of a request that goes out at each place of a module's count, without those before and after.
const BURST: usize = DATAGRAM * (DATAGRAM + 1);
/// The same with those.
const BURST_MAX: usize = BURST + 2 * (DATAGRAM - 1);

/// The host on RS-232, RS-485, a pseudo-terminal or TCP.
#[derive(Debug)]
pub struct SerialHost {
    session: Session,
    line: SerialLine,
    /// How long a request and its reply take on the wire, at least and at most.
    on_wire_ns: (u64, u64),
    pace: Pace,
    /// Silence before a request after bytes that were no reply.
    quiet_ns: u64,
    host: u8,
    gap_ns: u64,
    buffer: [u8; DATAGRAM],
    len: usize,
    sent: [u8; DATAGRAM],
    echo_due: bool,
    /// So many bytes that went out alone may come back before anything else.
    shift_echo_due: u8,
    /// Bytes that are still to come of a frame whose check failed.
    spoiled: usize,
    /// What was thrown away since the end of a line: a module in ASCII mode answers in text.
    text: ascii::Line,
    /// Until when the line has to be silent.
    quiet: Instant,
}

impl SerialHost {
    /// A host as `options` say.
    #[must_use]
    pub fn new(options: &HostOptions) -> Self {
        let host = options.host.and_then(|host| u8::try_from(host).ok()).unwrap_or(HOST);
        let timeout = options.reply_timeout_ms.unwrap_or(REPLY_TIMEOUT_MS);
        let line = SerialLine::n81(options.baud);
        let paced = SerialLine::n81(options.pace());
        let soonest_ns = tolerated(paced.characters_ns(2 * DATAGRAM as u32));
        let on_wire_ns = line.characters_ns(2 * DATAGRAM as u32);
        let quiet_ns = line.characters_ns(QUIET_CHARACTERS);
        let gap_ns = match options.gap_us {
            Some(HostOptions::GAP_CHARACTERS) => line.characters_ns(7) / 2,
            gap => u64::from(gap.unwrap_or(0)) * 1_000,
        };
        Self {
            session: Session::new(host.into(), timeout, options.doubt).counting_bytes(),
            line,
            on_wire_ns: (soonest_ns, on_wire_ns),
            pace: Pace::new(&paced),
            quiet_ns,
            host,
            gap_ns,
            buffer: [0; DATAGRAM],
            len: 0,
            sent: [0; DATAGRAM],
            echo_due: false,
            shift_echo_due: 0,
            spoiled: 0,
            text: ascii::Line::EMPTY,
            quiet: Instant(quiet_ns.max(gap_ns)),
        }
    }

    /// Takes nine bytes that are just the good reply that is waited for. Returns false when they are
    /// not. An echo never is: no module has the host's address.
    #[inline]
    fn usual(&mut self, now: Instant, window: &[u8; DATAGRAM]) -> bool {
        let reply = Reply::unchecked(window);
        self.pace.early() == 0
            && checksum(window) == window[DATAGRAM - 1]
            && reply.host == self.host
            && self.session.usual(now, reply)
    }

    /// Judges nine bytes and returns how many of them are done with: all, or one.
    fn window(&mut self, now: Instant, window: &[u8; DATAGRAM]) -> usize {
        if self.echo_due && *window == self.sent {
            self.echo_due = false;
            self.session.counters.echoed += 1;
            return self.whole();
        }
        if checksum(window) == window[DATAGRAM - 1] {
            let reply = Reply::unchecked(window);
            if reply.host == self.host
                && (reply.status.is_named() || self.wants(Opcode::ReadMemory))
            {
                self.shift_echo_due = 0;
                self.session.reply(now, reply, self.pace.early() > 0);
                return self.whole();
            }
            if reply.status.is_named() {
                self.session.counters.foreign += 1;
                return self.whole();
            }
        }
        self.text_or_noise(now, window)
    }

    /// Nine bytes that are no reply with a checksum.
    #[cold]
    fn text_or_noise(&mut self, now: Instant, window: &[u8; DATAGRAM]) -> usize {
        if let Ok(text) = VersionText::parse(window)
            && self.wants_text()
            && text.host == self.host
        {
            self.session.text(now, text);
            return self.whole();
        }
        if window[0] == self.host && self.spoiled == 0 {
            self.session.counters.corrupt += 1;
            self.spoiled = DATAGRAM;
        }
        self.skip(window[0]);
        self.quiet = self.quiet.max(now.plus_ns(self.quiet_ns));
        1
    }

    /// A frame ends here, and all of it is done with.
    const fn whole(&mut self) -> usize {
        self.spoiled = 0;
        DATAGRAM
    }

    /// Throws a byte away. Those of a frame that was counted are not counted again.
    fn skip(&mut self, byte: u8) {
        if self.spoiled > 0 {
            self.spoiled -= 1;
            return self.text.push(byte);
        }
        if byte == SHIFT && self.shift_echo_due > 0 {
            self.shift_echo_due -= 1;
            self.session.counters.echoed += 1;
            return;
        }
        self.session.counters.skipped += 1;
        if byte != b'\r' {
            return self.text.push(byte);
        }
        let line = core::mem::replace(&mut self.text, ascii::Line::EMPTY);
        self.session.counters.texts += u64::from(ascii::Answer::parse(line.bytes()).is_some());
    }

    /// Throws away what is held.
    fn skip_held(&mut self) {
        let (held, len) = (self.buffer, core::mem::take(&mut self.len));
        held[..len].iter().for_each(|&byte| self.skip(byte));
    }

    /// Takes nine bytes that came at once and are something else.
    #[cold]
    fn unusual(&mut self, now: Instant, window: &[u8; DATAGRAM]) {
        let done = self.window(now, window);
        self.pace.took(done);
        if done < DATAGRAM {
            self.collect(now, &window[done..]);
        }
    }

    /// Takes bytes one by one.
    #[cold]
    fn collect(&mut self, now: Instant, bytes: &[u8]) {
        for &byte in bytes {
            self.buffer[self.len] = byte;
            self.len += 1;
            if self.len == DATAGRAM {
                let window = self.buffer;
                let done = self.window(now, &window);
                self.pace.took(done);
                self.buffer.copy_within(done.., 0);
                self.len -= done;
            }
        }
    }

    fn wants(&self, opcode: Opcode) -> bool {
        self.session.expected().is_some_and(|request| request.opcode == opcode)
    }

    fn wants_text(&self) -> bool {
        self.wants(Opcode::Version) && self.session.expected().is_some_and(|r| r.kind == 0)
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
        self.quiet = self.quiet.max(now.plus_ns(self.gap_ns));
        self.pace.heard(now, self.len + bytes.len());
        // A whole datagram at once, as nearly always, is looked at where it lies.
        if self.len == 0
            && let Ok(window) = bytes.try_into()
        {
            if !self.usual(now, window) {
                self.unusual(now, window);
            }
        } else {
            self.collect(now, bytes);
        }
    }

    fn handle_line(&mut self, now: Instant, event: LineEvent) {
        self.skip_held();
        self.session.handle_line(now, event);
    }

    #[inline]
    fn poll_transmit(&mut self, now: Instant, out: &mut [u8]) -> Option<usize> {
        if !self.session.has_unsent() {
            return None;
        }
        let shift = self.session.take_shift(now);
        if shift > 0 {
            self.session.hold(now.plus_ms(SHIFT_PAUSE_MS));
            self.shift_echo_due = shift;
            out.get_mut(..shift.into())?.fill(SHIFT);
            return Some(shift.into());
        }
        if now < self.quiet {
            self.session.hold(self.quiet);
        }
        let burst = self.session.burst().filter(|_| out.len() >= BURST_MAX);
        let on_wire_ns = match burst {
            // Their own answers may be as many, and are nobody's.
            Some(burst) => {
                (self.on_wire_ns.0, burst_len(burst) * self.on_wire_ns.1 / DATAGRAM as u64)
            }
            None => self.on_wire_ns,
        };
        let request = self.session.transmit(now, on_wire_ns, burst)?;
        if self.len > 0 {
            self.skip_held();
        }
        self.pace.sent(now, self.on_wire_ns.0 / 2);
        let bytes = request.emit();
        self.sent = bytes;
        self.echo_due = true;
        *out.first_chunk_mut()? = bytes;
        if let Some(burst) = burst {
            self.quiet = self.quiet.max(now.plus_ns(on_wire_ns.1));
            return Some(repeat_shifted(bytes, out, burst));
        }
        Some(DATAGRAM)
    }

    fn line(&self) -> SerialLine {
        self.line
    }
}

impl Host<Stream> for SerialHost {
    type Request = Ask;
    type Answer = Answer;

    #[inline]
    fn submit(&mut self, now: Instant, ticket: Ticket, request: Ask) -> Result<(), Ask> {
        self.session.submit(now, ticket, request)
    }

    fn recall(&mut self, _stop: &Ask) -> Option<Ticket> {
        self.session.recall()
    }

    fn send_once(&mut self, ticket: Ticket) {
        self.session.send_once(ticket);
    }

    fn own_address(&self) -> Option<u32> {
        Some(self.host.into())
    }

    #[inline]
    fn poll_event(&mut self) -> Option<&Event<Answer>> {
        self.session.poll_event()
    }

    fn emit(&self, request: &Ask, out: &mut [u8]) -> usize {
        let bytes = request.request.emit();
        let len = bytes.len().min(out.len());
        out[..len].copy_from_slice(&bytes[..len]);
        len
    }

    fn mistrust(&mut self, now: Instant, address: u32) {
        self.session.mistrust(now, address);
    }

    fn disturbed(&mut self, now: Instant) {
        self.quiet = self.quiet.max(now.plus_ns(self.gap_ns));
    }

    fn counters(&self) -> Counters {
        self.session.counters
    }

    fn unread(&self) -> usize {
        self.len
    }
}

/// The host on CAN. \[I\] A module's address is its CAN id of requests, as from the factory.
#[derive(Debug)]
pub struct CanHost {
    session: Session,
    reply_id: u16,
    bit_rate: u32,
    /// A request and its reply take at least so long. What comes sooner is the second copy of an
    /// older reply, which a disturbed last bit makes its sender repeat.
    soonest_ns: u64,
    eight: bool,
}

/// Bits of a request and its reply without a single stuff bit: 47 each and seven bytes, less the
/// pause behind the last.
const EXCHANGE_BITS: u64 = 2 * (47 + 7 * 8) - 3;

impl CanHost {
    /// A host as `options` say: `host` is the CAN id of replies.
    #[must_use]
    pub fn new(options: &HostOptions) -> Self {
        let reply_id = reply_id(options);
        let timeout = options.reply_timeout_ms.unwrap_or(REPLY_TIMEOUT_MS);
        let session = Session::new(reply_id, timeout, options.doubt);
        let bit_rate = options.bit_rate;
        let exchange_ns = EXCHANGE_BITS * 1_000_000_000;
        let soonest_ns = tolerated(exchange_ns.checked_div(bit_rate.into()).unwrap_or(0));
        Self { session, reply_id, bit_rate, soonest_ns, eight: false }
    }

    /// Sends eight data bytes, the last one the serial checksum, as the vendor's library does.
    #[must_use]
    pub fn sending_eight(mut self) -> Self {
        self.eight = true;
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
        if frame.id != u32::from(self.reply_id) || frame.extended || frame.remote {
            return;
        }
        let host = self.reply_id as u8;
        let expected = self.session.expected();
        let text = expected.is_some_and(|r| r.opcode == Opcode::Version && r.kind == 0);
        let memory = expected.is_some_and(|r| r.opcode == Opcode::ReadMemory);
        if text && let Ok(text) = VersionText::parse_can(frame.bytes(), host) {
            return self.session.text(now, text);
        }
        match Reply::parse_can(frame.bytes(), host) {
            Ok(reply) if reply.status.is_named() || memory => {
                self.session.reply(now, reply, false);
            }
            _ => self.session.counters.corrupt += 1,
        }
    }

    fn handle_line(&mut self, now: Instant, event: LineEvent) {
        self.session.handle_line(now, event);
    }

    fn poll_transmit(&mut self, now: Instant, out: &mut Frame) -> Option<usize> {
        let request = self.session.transmit(now, (self.soonest_ns, 0), None)?;
        *out = self.frame(&request);
        Some(1)
    }

    fn line(&self) -> CanLine {
        CanLine { bit_rate: self.bit_rate }
    }
}

impl Host<Can> for CanHost {
    type Request = Ask;
    type Answer = Answer;

    #[inline]
    fn submit(&mut self, now: Instant, ticket: Ticket, request: Ask) -> Result<(), Ask> {
        self.session.submit(now, ticket, request)
    }

    fn recall(&mut self, _stop: &Ask) -> Option<Ticket> {
        self.session.recall()
    }

    fn send_once(&mut self, ticket: Ticket) {
        self.session.send_once(ticket);
    }

    fn own_address(&self) -> Option<u32> {
        Some(self.reply_id.into())
    }

    fn mistrust(&mut self, now: Instant, address: u32) {
        self.session.mistrust(now, address);
    }

    #[inline]
    fn poll_event(&mut self) -> Option<&Event<Answer>> {
        self.session.poll_event()
    }

    fn emit(&self, request: &Ask, out: &mut Frame) -> usize {
        *out = self.frame(&request.request);
        1
    }

    fn counters(&self) -> Counters {
        self.session.counters
    }
}

impl CanHost {
    fn frame(&self, request: &Request) -> Frame {
        request.emit_can(request.address.into(), self.eight)
    }
}

fn reply_id(options: &HostOptions) -> u16 {
    let host = options.host.and_then(|id| u16::try_from(id).ok()).filter(|id| *id <= 0x7FF);
    host.unwrap_or(HOST.into())
}

/// The module that sent a reply, if the frame is one.
pub(super) fn sender(options: &HostOptions, frame: &Frame) -> Option<u32> {
    let to_host = frame.id == u32::from(reply_id(options)) && !frame.extended && !frame.remote;
    let reply = Reply::parse_can(frame.bytes(), HOST).ok().filter(|_| to_host)?;
    reply.status.is_named().then_some(reply.module.into())
}

/// Bytes of a request that goes out for every place.
fn burst_len(burst: Burst) -> u64 {
    BURST as u64 + u64::from(burst.lead) + u64::from(burst.trail)
}

/// A datagram nine times, with a byte between: whatever a module that counts to nine has counted, one of
/// them is the next that it takes, and its count is then as before, but for the bytes before and after.
/// Returns how many bytes that are.
fn repeat_shifted(datagram: [u8; DATAGRAM], out: &mut [u8], burst: Burst) -> usize {
    let len = burst_len(burst) as usize;
    out[..len].fill(SHIFT);
    let lead = usize::from(burst.lead);
    for place in out[lead..lead + BURST].chunks_exact_mut(DATAGRAM + 1) {
        place[..DATAGRAM].copy_from_slice(&datagram);
    }
    len
}
