//! The device end: receives datagrams, calls the firmware, sends replies.
//!
//! The [`Firmware`] is passed to each call, so one drive object has a [`SerialEndpoint`] and a
//! [`CanEndpoint`].
//!
//! Open points of the TMCM-170/171 manual follow Trinamic's published RS-485 firmware of the stepRocker:
//! nine bytes are a datagram, a pause between two bytes starts a new one, the address is checked before the
//! checksum, a wrong checksum is answered with status 1 and opcode 0. [`Quirks`] selects the behaviour of
//! other firmware.

use super::ascii;
use super::opcode::{Opcode, Status};
use super::wire::{DATAGRAM, Instruction, Reply, Request, VersionText};
use crate::medium::{CanLine, Frame, SerialLine};
use crate::time::Instant;

/// Result of a request.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Response {
    /// The usual reply.
    Reply {
        /// Status of the reply.
        status: Status,
        /// The value; most firmware repeats the request's for what has none.
        value: i32,
    },
    /// The version as text (136 type 0): eight characters, sent without checksum.
    Text([u8; 8]),
    /// An instruction from program memory (134): sent over all fields.
    Instruction(Instruction),
    /// No reply (242).
    Silent,
}

impl Response {
    /// Status 100 with a value.
    #[must_use]
    pub const fn ok(value: i32) -> Self {
        Self::Reply { status: Status::Ok, value }
    }

    /// A refusal. It repeats the request's value, as Trinamic's firmware does.
    #[must_use]
    pub const fn refused(status: Status, request: &Request) -> Self {
        Self::Reply { status, value: request.value }
    }
}

/// A later message of the module: the second reply to opcode 138.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct DeferredEvent {
    /// The opcode that ordered it.
    pub opcode: Opcode,
    /// Value of the request: the mask of motors.
    pub value: i32,
}

/// Echo of typed characters in ASCII mode (global parameter 67, bits 4 and 5).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum AsciiEcho {
    /// 00: each character as it comes.
    Characters,
    /// 01: the line, when it is whole.
    Line,
    /// 10: nothing.
    None,
}

/// The firmware of a simulated module: settings of the wire, and the execution of requests.
pub trait Firmware {
    /// Module address on serial lines (global parameter 66).
    fn address(&self) -> u8;
    /// A second address that is obeyed too (global parameter 87). \[I\] Requests to it are
    /// executed and not answered: it is meant for groups.
    fn secondary_address(&self) -> Option<u8> {
        None
    }
    /// Host address in serial replies (global parameter 76).
    fn host_address(&self) -> u8;
    /// Pause before a serial reply, ms (global parameter 75, "telegram pause time").
    fn reply_pause_ms(&self) -> u8;
    /// Baud rate that the module now uses (global parameter 65).
    fn baud(&self) -> u32;
    /// CAN id of requests (global parameter 71), 0 to 0x7FF.
    fn can_id(&self) -> u16;
    /// CAN id of replies (global parameter 70), 0 to 0x7FF.
    fn can_reply_id(&self) -> u16;
    /// CAN bit rate that the module now uses (global parameter 69).
    fn can_bit_rate(&self) -> u32;
    /// Echo setting of a serial interface in ASCII mode; `None` in binary mode.
    fn ascii(&self) -> Option<AsciiEcho> {
        None
    }
    /// Handles opcode 139 or `BIN`.
    fn set_ascii(&mut self, on: bool) {
        let _ = on;
    }
    /// Executes a request to this module with a valid check sum.
    fn execute(&mut self, now: Instant, request: &Request) -> Response;
    /// The next later event, if one happened.
    fn poll_deferred_event(&mut self, now: Instant) -> Option<DeferredEvent> {
        let _ = now;
        None
    }
}

/// Reply to a wrong check sum.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum ChecksumErrorReply {
    /// Status 1 if the first byte is the module's address (stepRocker firmware).
    IfAddressed,
    /// Status 1 for any address, with the module and opcode of the previous reply (evaluation board
    /// firmware).
    Always,
    /// Nothing.
    Never,
}

/// Differences between firmware versions, and values that the manuals do not state.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Quirks {
    /// Reply to a wrong check sum.
    pub checksum_error_reply: ChecksumErrorReply,
    /// A pause between two bytes that starts a new datagram, ms; `None`: bytes are only counted
    /// (evaluation board firmware). \[I\]
    pub byte_timeout_ms: Option<u32>,
    /// A change of address or host address holds for its own reply already. \[I\] Not so by default.
    pub settings_before_reply: bool,
    /// Replies on CAN have eight data bytes.
    pub eight_bytes: bool,
    /// Time for which requests are ignored after a datagram for another module, ms: the RS-485 fault
    /// of TMCM-171 firmware before 1.03 (hardware manual, firmware history).
    pub ignore_after_foreign_ms: u32,
    /// Requests to any address are its own: modules on USB are alone there (seen with TMCM-3110 and 6110).
    pub any_address: bool,
}

impl Default for Quirks {
    fn default() -> Self {
        Self {
            checksum_error_reply: ChecksumErrorReply::IfAddressed,
            byte_timeout_ms: Some(BYTE_TIMEOUT_MS),
            settings_before_reply: false,
            eight_bytes: false,
            ignore_after_foreign_ms: 0,
            any_address: false,
        }
    }
}

/// Pause between two bytes that starts a new datagram. \[I\] USB adapters and serial servers may put
/// 20 ms between two pieces of a request; one of those pieces takes up to 9 ms at 9600 baud.
pub const BYTE_TIMEOUT_MS: u32 = 30;

/// Most bytes in the queue: the echo of a line and its reply, and the replies to the pieces of a stop that is
/// sent at each byte position.
pub const OUT_MAX: usize = 2 * ascii::LINE_MAX + DATAGRAM * DATAGRAM;

/// The serial end of a module.
#[derive(Debug)]
pub struct SerialEndpoint {
    quirks: Quirks,
    datagram: [u8; DATAGRAM],
    received: usize,
    last_byte: Instant,
    ignore_until: Instant,
    ascii_line: ascii::AsciiLine,
    out: [u8; OUT_MAX],
    out_len: usize,
    reply_due: Instant,
    last_reply: Reply,
    /// 138 came in here, so its event goes out here.
    subscribed: bool,
    baud: u32,
}

impl SerialEndpoint {
    /// The end of a module that was just powered.
    #[must_use]
    pub fn new(quirks: Quirks, firmware: &impl Firmware) -> Self {
        let nothing = Reply {
            host: firmware.host_address(),
            module: 0,
            status: Status::Ok,
            opcode: Opcode::from(0),
            value: 0,
        };
        Self {
            quirks,
            datagram: [0; DATAGRAM],
            received: 0,
            last_byte: Instant::ZERO,
            ignore_until: Instant::ZERO,
            ascii_line: ascii::AsciiLine::EMPTY,
            out: [0; OUT_MAX],
            out_len: 0,
            reply_due: Instant::ZERO,
            last_reply: nothing,
            subscribed: false,
            baud: firmware.baud(),
        }
    }

    /// Takes bytes from the wire, as they come.
    pub fn handle_input(&mut self, now: Instant, bytes: &[u8], firmware: &mut impl Firmware) {
        if let Some(pause) = self.quirks.byte_timeout_ms
            && now > self.last_byte.plus_ms(pause)
        {
            self.received = 0;
        }
        for &byte in bytes {
            match firmware.ascii() {
                Some(echo) => self.handle_character(now, byte, echo, firmware),
                None => self.push_byte(now, byte, firmware),
            }
        }
        self.last_byte = now;
    }

    /// Bytes were lost or garbled on the wire: the begun datagram is dropped.
    pub fn handle_break(&mut self) {
        self.received = 0;
        self.ascii_line = ascii::AsciiLine::EMPTY;
    }

    /// Writes the next output into `out` (at least [`OUT_MAX`] bytes).
    pub fn poll_transmit(
        &mut self,
        now: Instant,
        out: &mut [u8],
        firmware: &mut impl Firmware,
    ) -> Option<usize> {
        if self.out_len == 0 {
            self.baud = firmware.baud();
            self.send_deferred_event(now, firmware);
        }
        if self.out_len == 0 || now < self.reply_due {
            return None;
        }
        let len = core::mem::take(&mut self.out_len).min(out.len());
        out[..len].copy_from_slice(&self.out[..len]);
        Some(len)
    }

    /// Time at which a delayed reply is due.
    #[must_use]
    pub fn poll_timeout(&self) -> Option<Instant> {
        (self.out_len > 0).then_some(self.reply_due)
    }

    /// Present line settings. \[I\] A new baud rate applies after the reply to its own change.
    #[must_use]
    pub fn line(&self) -> SerialLine {
        SerialLine::new_8n1(self.baud)
    }

    fn push_byte(&mut self, now: Instant, byte: u8, firmware: &mut impl Firmware) {
        self.datagram[self.received] = byte;
        self.received += 1;
        if self.received == DATAGRAM {
            self.received = 0;
            self.handle_datagram(now, firmware);
        }
    }

    fn handle_datagram(&mut self, now: Instant, firmware: &mut impl Firmware) {
        let addressed = self.datagram[0];
        let mine = self.quirks.any_address || addressed == firmware.address();
        let group = firmware.secondary_address() == Some(addressed);
        match Request::parse(&self.datagram) {
            Ok(request) if (mine || group) && now >= self.ignore_until => {
                self.execute_request(now, &request, mine, firmware);
            }
            Ok(_) => self.ignore_until = now.plus_ms(self.quirks.ignore_after_foreign_ms),
            Err(_) => self.handle_checksum_error(now, mine, firmware),
        }
    }

    fn execute_request(
        &mut self,
        now: Instant,
        request: &Request,
        answer: bool,
        firmware: &mut impl Firmware,
    ) {
        let before = (firmware.host_address(), firmware.address());
        let response = firmware.execute(now, request);
        let after = (firmware.host_address(), firmware.address());
        let (host, module) = if self.quirks.settings_before_reply { after } else { before };
        update_subscription(request, &response, &mut self.subscribed);
        if request.opcode == Opcode::EnterAscii && is_ok(&response) {
            firmware.set_ascii(true);
        }
        let reply = match response {
            Response::Reply { status, value } => {
                Reply { host, module, status, opcode: request.opcode, value }
            }
            Response::Instruction(instruction) => instruction.into_reply(host),
            Response::Text(text) if answer => {
                return self.queue_bytes(now, &VersionText { host, text }.emit(), firmware);
            }
            Response::Text(_) | Response::Silent => return,
        };
        self.last_reply = reply;
        if answer {
            self.queue_bytes(now, &reply.emit(), firmware);
        }
    }

    fn handle_checksum_error(&mut self, now: Instant, mine: bool, firmware: &mut impl Firmware) {
        let host = firmware.host_address();
        let (module, opcode) = match self.quirks.checksum_error_reply {
            ChecksumErrorReply::IfAddressed if mine => (firmware.address(), Opcode::from(0)),
            ChecksumErrorReply::Always => (self.last_reply.module, self.last_reply.opcode),
            _ => return,
        };
        let reply = Reply { host, module, status: Status::WrongChecksum, opcode, value: 0 };
        self.queue_bytes(now, &reply.emit(), firmware);
    }

    /// The later reply of opcode 138, at a moment when nothing else waits to be sent.
    fn send_deferred_event(&mut self, now: Instant, firmware: &mut impl Firmware) {
        if !self.subscribed || firmware.ascii().is_some() {
            return;
        }
        if let Some(event) = firmware.poll_deferred_event(now) {
            self.subscribed = false;
            let (host, module) = (firmware.host_address(), firmware.address());
            let reply = deferred_event_reply(event, host, module);
            self.queue_bytes(now, &reply.emit(), firmware);
        }
    }

    fn queue_bytes(&mut self, now: Instant, bytes: &[u8], firmware: &impl Firmware) {
        let capacity = OUT_MAX - self.out_len;
        let count = bytes.len().min(capacity);
        self.out[self.out_len..self.out_len + count].copy_from_slice(&bytes[..count]);
        self.out_len += count;
        self.reply_due = now.plus_ms(firmware.reply_pause_ms().into());
    }

    fn handle_character(
        &mut self,
        now: Instant,
        byte: u8,
        echo: AsciiEcho,
        firmware: &mut impl Firmware,
    ) {
        if echo == AsciiEcho::Characters {
            self.queue_bytes(now, &[byte], firmware);
        }
        if byte != b'\r' {
            return self.ascii_line.push(byte);
        }
        let line = core::mem::replace(&mut self.ascii_line, ascii::AsciiLine::EMPTY);
        if echo == AsciiEcho::Line {
            self.queue_bytes(now, line.bytes(), firmware);
            self.queue_bytes(now, b"\r", firmware);
        }
        // [I] The manuals write the line that leaves this mode with and without the module's
        // letter; without one it can be no command for module B, which has none called `IN`.
        if line.bytes().trim_ascii().eq_ignore_ascii_case(b"BIN") {
            return self.execute_ascii(now, ascii::AsciiCommand::Binary, firmware);
        }
        match ascii::AsciiCommand::parse(line.bytes()) {
            Some((address, command)) if address == firmware.address() => {
                self.execute_ascii(now, command, firmware);
            }
            _ => {}
        }
    }

    fn execute_ascii(
        &mut self,
        now: Instant,
        command: ascii::AsciiCommand,
        firmware: &mut impl Firmware,
    ) {
        let (host, module) = (firmware.host_address(), firmware.address());
        let (status, value) = match command {
            ascii::AsciiCommand::Binary => {
                firmware.set_ascii(false);
                (Status::Ok, 0)
            }
            ascii::AsciiCommand::Unreadable => (Status::InvalidCommand, 0),
            ascii::AsciiCommand::Request(request) => match firmware.execute(now, &request) {
                Response::Reply { status, value } => (status, value),
                _ => (Status::NotAvailable, 0),
            },
        };
        let mut line = ascii::AsciiLine::EMPTY;
        ascii::write_reply(&mut line, host, module, status, value);
        self.queue_bytes(now, line.bytes(), firmware);
    }
}

/// The CAN end of a module.
#[derive(Debug)]
pub struct CanEndpoint {
    quirks: Quirks,
    out: [Frame; CAN_OUT_MAX],
    out_len: usize,
    subscribed: bool,
    bit_rate: u32,
}

/// Most replies in the queue; a request beyond them is lost.
pub const CAN_OUT_MAX: usize = 4;

impl CanEndpoint {
    /// The end of a module that was just powered.
    #[must_use]
    pub fn new(quirks: Quirks, firmware: &impl Firmware) -> Self {
        let out = [Frame::default(); CAN_OUT_MAX];
        Self { quirks, out, out_len: 0, subscribed: false, bit_rate: firmware.can_bit_rate() }
    }

    /// Takes a frame from the bus.
    pub fn handle_input(&mut self, now: Instant, frame: &Frame, firmware: &mut impl Firmware) {
        let mine = frame.id == u32::from(firmware.can_id()) && !frame.extended && !frame.remote;
        if !mine || self.out_len == CAN_OUT_MAX {
            return;
        }
        let Ok(request) = Request::parse_can(frame.bytes(), firmware.address()) else { return };
        // [I] The first byte of a reply is the low byte of the CAN id that was asked.
        let before = (firmware.can_reply_id(), firmware.can_id() as u8);
        let response = firmware.execute(now, &request);
        let after = (firmware.can_reply_id(), firmware.can_id() as u8);
        let (id, module) = if self.quirks.settings_before_reply { after } else { before };
        update_subscription(&request, &response, &mut self.subscribed);
        let host = firmware.host_address();
        let reply = match response {
            Response::Reply { status, value } => {
                Reply { host, module, status, opcode: request.opcode, value }
            }
            Response::Instruction(instruction) => instruction.into_reply(host),
            Response::Text(text) => return self.queue_frame(Frame::standard(id, &text)),
            Response::Silent => return,
        };
        self.queue_frame(reply.emit_can(id, self.quirks.eight_bytes));
    }

    /// The next frame to send.
    pub fn poll_transmit(&mut self, now: Instant, firmware: &mut impl Firmware) -> Option<Frame> {
        if self.out_len == 0 {
            self.bit_rate = firmware.can_bit_rate();
            if self.subscribed
                && let Some(event) = firmware.poll_deferred_event(now)
            {
                self.subscribed = false;
                let reply =
                    deferred_event_reply(event, firmware.host_address(), firmware.can_id() as u8);
                self.queue_frame(reply.emit_can(firmware.can_reply_id(), self.quirks.eight_bytes));
            }
        }
        let first = *self.out[..self.out_len].first()?;
        self.out.rotate_left(1);
        self.out_len -= 1;
        Some(first)
    }

    /// Present bus settings.
    #[must_use]
    pub fn line(&self) -> CanLine {
        CanLine { bit_rate: self.bit_rate }
    }

    fn queue_frame(&mut self, frame: Frame) {
        if let Some(slot) = self.out.get_mut(self.out_len) {
            *slot = frame;
            self.out_len += 1;
        }
    }
}

fn is_ok(response: &Response) -> bool {
    matches!(response, Response::Reply { status: Status::Ok, .. })
}

fn update_subscription(request: &Request, response: &Response, subscribed: &mut bool) {
    if request.opcode == Opcode::PositionReached && is_ok(response) {
        *subscribed = request.value != 0;
    }
}

fn deferred_event_reply(event: DeferredEvent, host: u8, module: u8) -> Reply {
    Reply { host, module, status: Status::Event, opcode: event.opcode, value: event.value }
}
