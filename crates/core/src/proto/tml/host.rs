//! The host end: on a serial line, and on CAN in either encapsulation.
//!
//! Sources: TML communication manual, chapters 3 to 5. Serial servers insert bytes between frames (00, 0D,
//! 0A, rests of an older connection); these are skipped and counted.

mod baud_recovery;

use core::marker::PhantomData;

use super::host_request::{Answer, HostRequest};
use super::rules::{TmlWire, WireRule};
use super::serial::{self, Deframer, FRAME_MAX, RecoveryPolicy, SerialPiece};
use super::session::{BaudFallback, Outgoing, SYNCS_MAX, Session, Timeouts, Topology};
use super::wire::{IdCode, Instruction, Message};
use super::{technocan, tmlcan};
use crate::error::WireError;
use crate::medium::{Can, CanLine, Frame, SerialLine, Stream};
use crate::proto::early_bytes::{EarlyBytes, with_clock_tolerance};
use crate::proto::{self, GROUP, HostOptions};
use crate::station::{
    Counters, Host, HostData, HostEvent, HostWire, LineEvent, Station, Ticket, Timed,
};
use crate::time::Instant;
use baud_recovery::BaudRecovery;
pub(super) use baud_recovery::{BAUDS, SCIBR_OPCODE, baud_of_code};

/// Default time-out of a reply, ms.
pub const REPLY_TIMEOUT_MS: u32 = 100;
/// Reply time-out on a serial port during a scan: a relay acknowledges for each address behind it, so there only a
/// missing reply shows an empty address. Includes a relay, its bus, and twice an adapter's latency.
// Two frames at 9,600 baud take 30 ms; most addresses of a scan belong to no drive (TML-5).
const SCAN_ANSWER_MS: u32 = 40;
/// Time allowed for an acknowledgement, and for each SYNC byte, on a serial port, ms. The manual's
/// typical value is 2 (chapter 3); adapters need more.
pub const ACK_SERIAL_MS: u32 = 20;
/// Acknowledgement time-out through a serial server or a pseudo-terminal.
pub const ACK_NETWORK_MS: u32 = 100;
/// Less is never waited (manual, chapter 3).
pub const ACK_MIN_MS: u32 = 2;
/// Between messages to axes behind a relay, where the line itself does not pace them, µs: longer
/// than a CAN frame takes at 250 kbit/s.
// The time of a message on the relay's CAN bus at 500 kbit/s, so that its queue does not grow.
const RELAY_GAP_US: u32 = 600;
/// The host's axis ID on RS-485 and CAN, unless an axis has it; 255 is what drives have from the
/// factory.
pub const HOST_ID: u8 = 254;

/// The host on RS-232, RS-485, a pseudo-terminal or TCP.
#[derive(Debug)]
pub struct SerialHost {
    session: Session,
    /// The line as it times bytes; on a pseudo-terminal they take no time.
    line: SerialLine,
    /// Baud rate that the port is set to; 0 for none.
    port_baud: u32,
    early_bytes: EarlyBytes,
    untimed: bool,
    deframer: Deframer,
    gap_ns: u64,
    /// A pause of this length ends a frame, which is then incomplete.
    stale_ns: u64,
    last_byte: Instant,
    sent: Option<Message>,
    baud_recovery: BaudRecovery,
    ack_ns: u64,
}

impl SerialHost {
    /// Creates a host of these axes with `options`. On RS-232 the drive connected is `relay_axis`, or the first axis.
    #[must_use]
    pub fn new(options: &HostOptions, axes: &[u32]) -> Self {
        let wire = match options.standard {
            Some(proto::SerialStandard::Rs485) => TmlWire::Rs485,
            _ => TmlWire::Rs232,
        };
        // Two stop bits (communication manual, chapter 3).
        let line = SerialLine { stop_bits: 2, ..SerialLine::new_8n1(options.baud) };
        let waits = Timeouts::new(options, line.characters_ns(1));
        let topology = topology_of(wire, options, axes);
        // Only one drive is ever set to another rate: the others of a line would receive garbage (TML-8).
        let alone = (wire == TmlWire::Rs232 || topology.single_drive) && !topology.scanning;
        let baud_recovery = BaudRecovery::new(
            options.port_baud,
            topology.relay_axis.or(topology.first_axis).filter(|_| alone),
        );
        let mut session = Session::new(topology, waits);
        if baud_recovery.can_restore() {
            session.fallback = BaudFallback::Armed;
        }
        Self {
            session,
            line,
            port_baud: options.port_baud,
            early_bytes: early_bytes_of(options.untimed, &line),
            untimed: options.untimed,
            deframer: Deframer::new(RecoveryPolicy::Search),
            gap_ns: match options.gap_us {
                Some(HostOptions::GAP_CHARACTERS) => line.characters_ns(7) / 2,
                _ => options.stated_gap_ns(),
            },
            // A frame never pauses for longer than a drive takes to answer.
            stale_ns: waits.ack_ns + line.characters_ns(2),
            last_byte: Instant::ZERO,
            sent: None,
            baud_recovery,
            ack_ns: waits.ack_ns,
        }
    }

    /// Processes complete pieces of the received bytes.
    #[inline]
    fn process_pieces(&mut self, now: Instant) {
        let mut held = self.deframer.pending().len();
        while let Some(piece) = self.deframer.next_piece() {
            let early = self.early_bytes.count() > 0;
            let left = self.deframer.pending().len();
            self.early_bytes.consume(held - left);
            held = left;
            self.handle_piece(now, piece, early);
        }
    }

    #[inline]
    fn handle_piece(&mut self, now: Instant, piece: SerialPiece, early: bool) {
        match piece {
            // Adapters for RS-485 return what the host sends.
            SerialPiece::Message(message) if self.sent == Some(message) => {
                self.sent = None;
                self.session.counters.echoed += 1;
            }
            SerialPiece::Message(Message { to, instruction }) => {
                if early {
                    self.session.handle_early_message(now, Some(to), &instruction)
                } else {
                    self.session.handle_message(now, Some(to), &instruction)
                }
                self.rearm_fallback();
            }
            SerialPiece::Ack if self.baud_recovery.handle_ack(now) => {}
            SerialPiece::Ack => {
                let before = self.session.counters.acknowledged;
                self.session.handle_ack(now, early);
                if self.session.counters.acknowledged > before {
                    self.baud_recovery.note_accepted(now);
                }
                self.rearm_fallback();
            }
            SerialPiece::Sync => self.session.handle_sync(now),
            SerialPiece::Stray(_) => self.session.counters.skipped += 1,
            SerialPiece::Broken(error) => {
                let corrupt = matches!(error, WireError::Checksum { .. });
                self.session.counters.corrupt += u64::from(corrupt);
                self.session.counters.skipped += 1;
            }
        }
    }

    /// The drive was there, so that silence from now on may be another rate's.
    fn rearm_fallback(&mut self) {
        if self.baud_recovery.can_restore() && self.session.fallback == BaudFallback::Exhausted {
            self.session.fallback = BaudFallback::Armed;
        }
    }

    /// Has the line's rate back where RESET or power-up took it.
    fn restore_baud(&mut self, now: Instant) {
        if self.session.is_idle() {
            self.baud_recovery.note_reset(now);
        }
        if self.session.fallback == BaudFallback::Requested && self.baud_recovery.is_at_wanted() {
            self.baud_recovery.fall_back(now);
        }
        if self.baud_recovery.advance(now) {
            self.session.finish_fallback(now);
        }
        let baud = self.baud_recovery.baud();
        if self.port_baud != baud {
            self.port_baud = baud;
            if self.line.baud != 0 {
                self.line.baud = baud;
                self.early_bytes = early_bytes_of(self.untimed, &self.line);
            }
            self.deframer.clear();
        }
    }

    /// Sends the new baud rate at the rate that the drive has after RESET.
    fn send_baud(&mut self, now: Instant, out: &mut [u8]) -> Option<usize> {
        let left = now.plus_ns(self.line.characters_ns(FRAME_MAX as u32) + self.ack_ns);
        let message = self.baud_recovery.next_message(now, left)?;
        let mut frame = [0; FRAME_MAX];
        let len = serial::encode(&message, &mut frame);
        self.sent = Some(message);
        out.get_mut(..len)?.copy_from_slice(&frame[..len]);
        Some(len)
    }

    /// Handles the head of a frame whose end never came: the bytes after the first one are scanned again.
    fn rescan_pending(&mut self, now: Instant) {
        let mut bytes = [0; FRAME_MAX];
        // Each round gives up one byte, so a wrong length costs no more than the bytes that it claims.
        for _ in 0..FRAME_MAX {
            let held = self.deframer.pending();
            let len = held.len();
            if len == 0 {
                return;
            }
            bytes[..len].copy_from_slice(held);
            self.deframer.clear();
            self.session.counters.skipped += 1;
            for &byte in &bytes[1..len] {
                self.deframer.push(byte);
                self.process_pieces(now);
            }
        }
    }
}

/// On a port whose baud rate is fiction nothing comes too soon.
const fn early_bytes_of(untimed: bool, line: &SerialLine) -> EarlyBytes {
    EarlyBytes::new(&SerialLine { baud: if untimed { 0 } else { line.baud }, ..*line })
}

impl Timeouts {
    fn new(options: &HostOptions, character_ns: u64) -> Self {
        // Without a baud rate the line is a network or a pseudo-terminal, and those pause.
        let usual = if options.baud == 0 { ACK_NETWORK_MS } else { ACK_SERIAL_MS };
        let quick = options.scanning && options.baud != 0;
        let usual_answer = if quick { SCAN_ANSWER_MS } else { REPLY_TIMEOUT_MS };
        let answer = options.reply_timeout_ms(usual_answer);
        let pace_us = if options.baud == 0 { RELAY_GAP_US } else { 0 };
        Self {
            ack_ns: scaled_timeout(options.ack_timeout_ms, usual, options),
            sync_pause_ns: scaled_timeout(
                options.resync_pause_ms.or(options.ack_timeout_ms),
                usual,
                options,
            ),
            answer_ns: u64::from(answer) * 1_000_000 + FRAME_MAX as u64 * character_ns,
            character_ns,
            relay_gap_ns: u64::from(pace_us) * 1_000,
        }
    }
}

fn scaled_timeout(given: Option<u32>, usual: u32, options: &HostOptions) -> u64 {
    let timeout_ms = options.scaled_ms(given.unwrap_or(usual).max(ACK_MIN_MS));
    u64::from(timeout_ms) * 1_000_000
}

/// Place of the host on a wire with these axes.
fn topology_of(wire: TmlWire, options: &HostOptions, axes: &[u32]) -> Topology {
    let first = axes.iter().find(|axis| **axis & GROUP == 0).map(|axis| *axis as u8);
    let given = options.host_address.and_then(|host| u8::try_from(host).ok());
    let through = options.relay_axis.and_then(|relay| u8::try_from(relay).ok());
    let connected = through.or(first);
    let id = match wire {
        TmlWire::Rs232 => given.or(connected).unwrap_or(u8::MAX),
        _ => given.unwrap_or_else(|| free_id(wire, axes)),
    };
    let relay = (wire == TmlWire::Rs232).then(|| connected.unwrap_or(id));
    Topology {
        wire,
        own_code: wire.host_id_code(id),
        relay_axis: relay,
        first_axis: first,
        single_drive: axes.len() == 1 && first.is_some() && connected == first,
        behind_technocan: options.relay_axis_max.is_some(),
        scanning: options.scanning,
        broken_rule: relay.and_then(|relay| wire.check_host_id(id, relay).err()),
    }
}

/// An axis ID that none of these axes has, the usual one if possible.
fn free_id(wire: TmlWire, axes: &[u32]) -> u8 {
    let taken =
        |id: u8| axes.iter().any(|axis| wire_number(*axis as u8, &wire) == wire_number(id, &wire));
    (1..=HOST_ID).rev().find(|id| wire_number(*id, &wire) != 0 && !taken(*id)).unwrap_or(HOST_ID)
}

fn wire_number(id: u8, wire: &TmlWire) -> u8 {
    if *wire == TmlWire::TechnoCan { id % 32 } else { id }
}

impl Timed for SerialHost {
    fn handle_timeout(&mut self, now: Instant) {
        // Noise before the acknowledgement may have looked like the beginning of a frame.
        if self.session.is_ack_overdue(now) {
            self.rescan_pending(now);
        }
        self.session.handle_timeout(now);
        self.restore_baud(now);
    }

    fn poll_timeout(&self) -> Option<Instant> {
        if self.baud_recovery.is_at_wanted() {
            self.session.poll_timeout()
        } else {
            // Messages that wait in the session wait for the line.
            self.baud_recovery.deadline()
        }
    }
}

impl Station<Stream> for SerialHost {
    fn handle_input(&mut self, now: Instant, bytes: &[u8]) {
        if now >= self.last_byte.plus_ns(self.stale_ns) {
            self.rescan_pending(now);
        }
        self.last_byte = now;
        self.early_bytes.note_received(now, self.deframer.pending().len() + bytes.len());
        for &byte in bytes {
            self.deframer.push(byte);
            self.process_pieces(now);
        }
        self.restore_baud(now);
    }

    fn handle_line(&mut self, now: Instant, event: LineEvent) {
        self.session.counters.skipped += self.deframer.pending().len() as u64;
        self.deframer.clear();
        self.session.handle_line(now, event);
    }

    fn poll_transmit(&mut self, now: Instant, out: &mut [u8]) -> Option<usize> {
        if !self.baud_recovery.is_at_wanted() {
            return self.send_baud(now, out);
        }
        if !self.session.has_unsent() {
            return None;
        }
        let quiet = self.last_byte.plus_ns(self.gap_ns);
        if now < quiet {
            self.session.delay_sending(quiet);
        }
        match self.session.transmit(now)? {
            Outgoing::Message(message) => {
                let mut frame = [0; FRAME_MAX];
                let len = serial::encode(&message, &mut frame);
                self.early_bytes
                    .note_sent(now, with_clock_tolerance(self.line.characters_ns(len as u32)));
                self.sent = Some(message);
                self.baud_recovery.note_sent(&message);
                if message.instruction.opcode == SCIBR_OPCODE {
                    self.rearm_fallback();
                }
                out.get_mut(..len)?.copy_from_slice(&frame[..len]);
                Some(len)
            }
            Outgoing::Sync(byte, count) => {
                let count = usize::from(count.min(SYNCS_MAX));
                out.get_mut(..count)?.fill(byte);
                Some(count)
            }
        }
    }

    fn line(&self) -> SerialLine {
        SerialLine { baud: self.port_baud, ..self.line }
    }
}

impl HostWire for SerialHost {
    fn unparsed_len(&self) -> usize {
        self.deframer.pending().len()
    }

    fn handle_resume(&mut self, now: Instant) {
        // The rest of an earlier frame does not begin the next one.
        self.rescan_pending(now);
        self.last_byte = now;
    }

    fn can_add_drive(&self, address: u32) -> bool {
        let busy =
            !self.baud_recovery.is_settled() || self.session.fallback == BaudFallback::Requested;
        !busy && self.session.can_add_drive(address)
    }

    fn add_drive(&mut self, _address: u32) {
        self.session.add_drive();
        // A drive that is not alone is not set to another rate, or the others would not understand any more.
        if self.session.wire() != TmlWire::Rs232 {
            self.baud_recovery = BaudRecovery::new(self.port_baud, None);
            self.session.fallback = BaudFallback::Exhausted;
        }
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
        self.session.no_retry_ticket.take_if(|once| *once == ticket);
        self.session.submit(now, ticket, request)
    }

    fn recall(&mut self, _stop: &HostRequest) -> Option<Ticket> {
        self.session.recall()
    }

    fn disable_retries(&mut self, ticket: Ticket) {
        self.session.no_retry_ticket = Some(ticket);
    }

    #[inline]
    fn poll_event(&mut self) -> Option<&HostEvent<Answer>> {
        self.session.poll_event()
    }

    fn encode_request(&self, request: &HostRequest, out: &mut [u8]) -> usize {
        let mut frame = [0; FRAME_MAX];
        let len = serial::encode(&self.session.with_own_sender(&request.message), &mut frame);
        let len = len.min(out.len());
        out[..len].copy_from_slice(&frame[..len]);
        len
    }

    fn counters(&self) -> Counters {
        self.session.counters
    }
}

/// Encapsulation of TML in CAN frames.
pub trait Encapsulation: core::fmt::Debug + Send + 'static {
    /// Rules of the wire.
    const WIRE: TmlWire;
    /// The frame that carries a message.
    ///
    /// # Errors
    /// The rule that forbids it.
    fn encode(message: &Message) -> Result<Frame, WireRule>;
    /// Decodes a frame, with its addressee if it has one; `None` for other protocols' frames.
    ///
    /// # Errors
    /// The error of a frame of this protocol.
    fn decode(frame: &Frame) -> Option<Result<(Option<IdCode>, Instruction), WireError>>;
}

/// 29-bit identifiers.
#[derive(Debug)]
pub enum ExtendedIds {}

/// 11-bit identifiers that CANopen leaves free.
#[derive(Debug)]
pub enum StandardIds {}

impl Encapsulation for ExtendedIds {
    const WIRE: TmlWire = TmlWire::TmlCan;

    fn encode(message: &Message) -> Result<Frame, WireRule> {
        Ok(tmlcan::encode(message))
    }

    fn decode(frame: &Frame) -> Option<Result<(Option<IdCode>, Instruction), WireError>> {
        match tmlcan::decode(frame) {
            Ok(message) => Some(Ok((Some(message.to), message.instruction))),
            Err(WireError::Identifier { .. }) => None,
            Err(error) => Some(Err(error)),
        }
    }
}

impl Encapsulation for StandardIds {
    const WIRE: TmlWire = TmlWire::TechnoCan;

    fn encode(message: &Message) -> Result<Frame, WireRule> {
        technocan::encode(message)
    }

    fn decode(frame: &Frame) -> Option<Result<(Option<IdCode>, Instruction), WireError>> {
        match technocan::decode(frame) {
            Ok(content) => Some(Ok((content.to, content.instruction))),
            Err(WireError::Identifier { .. }) => None,
            Err(error) => Some(Err(error)),
        }
    }
}

/// The host on CAN.
#[derive(Debug)]
pub struct CanHost<E> {
    session: Session,
    bit_rate: u32,
    encapsulation: PhantomData<E>,
}

impl<E: Encapsulation> CanHost<E> {
    /// Creates a host of these axes with `options`.
    #[must_use]
    pub fn new(options: &HostOptions, axes: &[u32]) -> Self {
        let waits = Timeouts::new(options, 0);
        let session = Session::new(topology_of(E::WIRE, options, axes), waits);
        Self { session, bit_rate: options.bit_rate, encapsulation: PhantomData }
    }
}

impl<E: Encapsulation> Timed for CanHost<E> {
    fn handle_timeout(&mut self, now: Instant) {
        self.session.handle_timeout(now);
    }

    fn poll_timeout(&self) -> Option<Instant> {
        self.session.poll_timeout()
    }
}

impl<E: Encapsulation> Station<Can> for CanHost<E> {
    #[inline]
    fn handle_input(&mut self, now: Instant, frame: &Frame) {
        match E::decode(frame) {
            Some(Ok((to, instruction))) => self.session.handle_message(now, to, &instruction),
            Some(Err(_)) => self.session.counters.corrupt += 1,
            None => {}
        }
    }

    fn handle_line(&mut self, now: Instant, event: LineEvent) {
        self.session.handle_line(now, event);
    }

    fn poll_transmit(&mut self, now: Instant, out: &mut Frame) -> Option<usize> {
        let Outgoing::Message(message) = self.session.transmit(now)? else { return None };
        // The session refused everything that the rules forbid, so this can only fail by mistake.
        *out = E::encode(&message).ok()?;
        Some(1)
    }

    fn line(&self) -> CanLine {
        CanLine { bit_rate: self.bit_rate }
    }
}

impl<E: Encapsulation> HostWire for CanHost<E> {
    fn can_add_drive(&self, address: u32) -> bool {
        self.session.can_add_drive(address)
    }

    fn add_drive(&mut self, _address: u32) {
        self.session.add_drive();
    }
}

impl<E: Encapsulation> HostData for CanHost<E> {}

impl<E: Encapsulation> Host<Can> for CanHost<E> {
    type Request = HostRequest;

    type Answer = Answer;

    /// On CAN no message of type A is acknowledged (TML communication manual, chapter 4).
    const CONFIRMED: bool = false;

    #[inline]
    fn submit(
        &mut self,
        now: Instant,
        ticket: Ticket,
        request: HostRequest,
    ) -> Result<(), HostRequest> {
        self.session.no_retry_ticket.take_if(|once| *once == ticket);
        self.session.submit(now, ticket, request)
    }

    fn recall(&mut self, _stop: &HostRequest) -> Option<Ticket> {
        self.session.recall()
    }

    fn disable_retries(&mut self, ticket: Ticket) {
        self.session.no_retry_ticket = Some(ticket);
    }

    #[inline]
    fn poll_event(&mut self) -> Option<&HostEvent<Answer>> {
        self.session.poll_event()
    }

    fn encode_request(&self, request: &HostRequest, out: &mut Frame) -> usize {
        let Ok(frame) = E::encode(&self.session.with_own_sender(&request.message)) else {
            return 0;
        };
        *out = frame;
        1
    }

    fn counters(&self) -> Counters {
        self.session.counters
    }
}
