//! The obeying end: datagrams in, the firmware asked, replies out.
//!
//! The [`Firmware`] is lent to each call, so that one drive object sits behind a [`SerialEnd`] and
//! a [`CanEnd`].
//!
//! What the TMCM-170/171 manual leaves open follows Trinamic's own published RS-485 firmware for
//! the stepRocker, as it behaves: nine bytes are a datagram, a pause between two bytes starts a new
//! one, the address is checked before the sum, a wrong sum is answered with status 1 and opcode 0.
//! What other firmware does is switchable in [`Quirks`].

use super::ascii;
use super::opcode::{Opcode, Status};
use super::wire::{DATAGRAM, Instruction, Reply, Request, VersionText};
use crate::medium::{CanLine, Frame, SerialLine};
use crate::time::Instant;

/// What a module does with a request.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Response {
    /// The usual reply.
    Reply {
        /// How it ended.
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

/// What a module sends later by itself: the second reply to opcode 138.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Event {
    /// The opcode that ordered it.
    pub opcode: Opcode,
    /// Its value: the mask of motors.
    pub value: i32,
}

/// How an ASCII interface shows what is typed (global parameter 67, bits 4 and 5).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Echo {
    /// 00: each character as it comes.
    Characters,
    /// 01: the line, when it is whole.
    Line,
    /// 10: nothing.
    None,
}

/// What obeys: settings that the wire needs, and what the requests do.
pub trait Firmware {
    /// Module address on serial lines (global parameter 66).
    fn address(&self) -> u8;
    /// A second address that is obeyed too (global parameter 87). \[I\] What comes to it is
    /// carried out and not answered: it is meant for groups.
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
    /// Whether the serial interface is in ASCII mode, and how it echoes.
    fn ascii(&self) -> Option<Echo> {
        None
    }
    /// Opcode 139 came, or `BIN`.
    fn set_ascii(&mut self, on: bool) {
        let _ = on;
    }
    /// Carries out a request that is addressed to this module and whose check agrees.
    fn execute(&mut self, now: Instant, request: &Request) -> Response;
    /// The next later event, if one happened.
    fn poll_event(&mut self, now: Instant) -> Option<Event> {
        let _ = now;
        None
    }
}

/// Who is told of a wrong checksum.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum BadSum {
    /// Status 1 if the first byte is the module's address (stepRocker firmware).
    AnswerIfMine,
    /// Status 1 whatever the address, with the module and opcode of the reply before (evaluation
    /// board firmware).
    AnswerAlways,
    /// Nothing.
    Ignore,
}

/// What differs between firmware versions, or is not stated.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Quirks {
    /// Who is told of a wrong checksum.
    pub bad_sum: BadSum,
    /// A pause between two bytes that starts a new datagram, ms; `None`: bytes are only counted
    /// (evaluation board firmware). \[I\]
    pub byte_timeout_ms: Option<u32>,
    /// A change of address or host address holds for its own reply already. \[I\] Not so by default.
    pub settings_before_reply: bool,
    /// Replies on CAN have eight data bytes.
    pub eight_bytes: bool,
    /// After a datagram for another module, requests are ignored for so long, ms: the RS-485 fault
    /// of TMCM-171 firmware before 1.03 (hardware manual, firmware history).
    pub deaf_after_foreign_ms: u32,
}

impl Default for Quirks {
    fn default() -> Self {
        Self {
            bad_sum: BadSum::AnswerIfMine,
            byte_timeout_ms: Some(BYTE_TIMEOUT_MS),
            settings_before_reply: false,
            eight_bytes: false,
            deaf_after_foreign_ms: 0,
        }
    }
}

/// Pause between two bytes that starts a new datagram. \[I\] USB adapters and serial servers may put
/// 20 ms between two pieces of a request; one of those pieces takes up to 9 ms at 9600 baud.
pub const BYTE_TIMEOUT_MS: u32 = 30;

/// Bytes that wait to be sent at most: the echo of a line and its reply, and what is said of the pieces of
/// a stop that goes out at each place of the count.
pub const OUT_MAX: usize = 2 * ascii::LINE_MAX + DATAGRAM * DATAGRAM;

/// The serial end of a module.
#[derive(Debug)]
pub struct SerialEnd {
    quirks: Quirks,
    datagram: [u8; DATAGRAM],
    have: usize,
    last_byte: Instant,
    deaf_until: Instant,
    line: ascii::Line,
    out: [u8; OUT_MAX],
    len: usize,
    due: Instant,
    last: Reply,
    /// 138 came in here, so its event goes out here.
    subscribed: bool,
    baud: u32,
}

impl SerialEnd {
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
            have: 0,
            last_byte: Instant::ZERO,
            deaf_until: Instant::ZERO,
            line: ascii::Line::EMPTY,
            out: [0; OUT_MAX],
            len: 0,
            due: Instant::ZERO,
            last: nothing,
            subscribed: false,
            baud: firmware.baud(),
        }
    }

    /// Takes bytes from the wire, as they come.
    pub fn handle_input(&mut self, now: Instant, bytes: &[u8], firmware: &mut impl Firmware) {
        if let Some(pause) = self.quirks.byte_timeout_ms
            && now > self.last_byte.plus_ms(pause)
        {
            self.have = 0;
        }
        for &byte in bytes {
            match firmware.ascii() {
                Some(echo) => self.character(now, byte, echo, firmware),
                None => self.byte(now, byte, firmware),
            }
        }
        self.last_byte = now;
    }

    /// Bytes were lost or garbled on the wire: what there is of a datagram is dropped.
    pub fn handle_break(&mut self) {
        self.have = 0;
        self.line = ascii::Line::EMPTY;
    }

    /// What is to be sent now, into `out` (at least [`OUT_MAX`] bytes).
    pub fn poll_transmit(
        &mut self,
        now: Instant,
        out: &mut [u8],
        firmware: &mut impl Firmware,
    ) -> Option<usize> {
        if self.len == 0 {
            self.baud = firmware.baud();
            self.event(now, firmware);
        }
        if self.len == 0 || now < self.due {
            return None;
        }
        let len = core::mem::take(&mut self.len).min(out.len());
        out[..len].copy_from_slice(&self.out[..len]);
        Some(len)
    }

    /// When a reply that waits for its pause is due.
    #[must_use]
    pub fn poll_timeout(&self) -> Option<Instant> {
        (self.len > 0).then_some(self.due)
    }

    /// How this end now drives the wire. \[I\] A new baud rate holds once the reply to its own
    /// change is out.
    #[must_use]
    pub fn line(&self) -> SerialLine {
        SerialLine::n81(self.baud)
    }

    fn byte(&mut self, now: Instant, byte: u8, firmware: &mut impl Firmware) {
        self.datagram[self.have] = byte;
        self.have += 1;
        if self.have == DATAGRAM {
            self.have = 0;
            self.whole(now, firmware);
        }
    }

    fn whole(&mut self, now: Instant, firmware: &mut impl Firmware) {
        let addressed = self.datagram[0];
        let mine = addressed == firmware.address();
        let group = firmware.secondary_address() == Some(addressed);
        match Request::parse(&self.datagram) {
            Ok(request) if (mine || group) && now >= self.deaf_until => {
                self.execute(now, &request, mine, firmware);
            }
            Ok(_) => self.deaf_until = now.plus_ms(self.quirks.deaf_after_foreign_ms),
            Err(_) => self.bad_sum(now, mine, firmware),
        }
    }

    fn execute(
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
        note_order(request, &response, &mut self.subscribed);
        if request.opcode == Opcode::EnterAscii && is_ok(&response) {
            firmware.set_ascii(true);
        }
        let reply = match response {
            Response::Reply { status, value } => {
                Reply { host, module, status, opcode: request.opcode, value }
            }
            Response::Instruction(instruction) => instruction.into_reply(host),
            Response::Text(text) if answer => {
                return self.send(now, &VersionText { host, text }.emit(), firmware);
            }
            Response::Text(_) | Response::Silent => return,
        };
        self.last = reply;
        if answer {
            self.send(now, &reply.emit(), firmware);
        }
    }

    fn bad_sum(&mut self, now: Instant, mine: bool, firmware: &mut impl Firmware) {
        let host = firmware.host_address();
        let (module, opcode) = match self.quirks.bad_sum {
            BadSum::AnswerIfMine if mine => (firmware.address(), Opcode::from(0)),
            BadSum::AnswerAlways => (self.last.module, self.last.opcode),
            _ => return,
        };
        let reply = Reply { host, module, status: Status::WrongChecksum, opcode, value: 0 };
        self.send(now, &reply.emit(), firmware);
    }

    /// The later reply of opcode 138, at a moment when nothing else waits to be sent.
    fn event(&mut self, now: Instant, firmware: &mut impl Firmware) {
        if !self.subscribed || firmware.ascii().is_some() {
            return;
        }
        if let Some(event) = firmware.poll_event(now) {
            self.subscribed = false;
            let (host, module) = (firmware.host_address(), firmware.address());
            let reply = event_reply(event, host, module);
            self.send(now, &reply.emit(), firmware);
        }
    }

    fn send(&mut self, now: Instant, bytes: &[u8], firmware: &impl Firmware) {
        let room = OUT_MAX - self.len;
        let count = bytes.len().min(room);
        self.out[self.len..self.len + count].copy_from_slice(&bytes[..count]);
        self.len += count;
        self.due = now.plus_ms(firmware.reply_pause_ms().into());
    }

    fn character(&mut self, now: Instant, byte: u8, echo: Echo, firmware: &mut impl Firmware) {
        if echo == Echo::Characters {
            self.send(now, &[byte], firmware);
        }
        if byte != b'\r' {
            return self.line.push(byte);
        }
        let line = core::mem::replace(&mut self.line, ascii::Line::EMPTY);
        if echo == Echo::Line {
            self.send(now, line.bytes(), firmware);
            self.send(now, b"\r", firmware);
        }
        // [I] The manuals write the line that leaves this mode with and without the module's
        // letter; without one it can be no command for module B, which has none called `IN`.
        if line.bytes().trim_ascii().eq_ignore_ascii_case(b"BIN") {
            return self.obey(now, ascii::Command::Binary, firmware);
        }
        match ascii::Command::parse(line.bytes()) {
            Some((address, command)) if address == firmware.address() => {
                self.obey(now, command, firmware);
            }
            _ => {}
        }
    }

    fn obey(&mut self, now: Instant, command: ascii::Command, firmware: &mut impl Firmware) {
        let (host, module) = (firmware.host_address(), firmware.address());
        let (status, value) = match command {
            ascii::Command::Binary => {
                firmware.set_ascii(false);
                (Status::Ok, 0)
            }
            ascii::Command::Unreadable => (Status::InvalidCommand, 0),
            ascii::Command::Request(request) => match firmware.execute(now, &request) {
                Response::Reply { status, value } => (status, value),
                _ => (Status::NotAvailable, 0),
            },
        };
        let mut line = ascii::Line::EMPTY;
        ascii::write_reply(&mut line, host, module, status, value);
        self.send(now, line.bytes(), firmware);
    }
}

/// The CAN end of a module.
#[derive(Debug)]
pub struct CanEnd {
    quirks: Quirks,
    out: [Frame; CAN_OUT_MAX],
    len: usize,
    subscribed: bool,
    bit_rate: u32,
}

/// Replies that wait for the bus at most; a request beyond them is not heard.
pub const CAN_OUT_MAX: usize = 4;

impl CanEnd {
    /// The end of a module that was just powered.
    #[must_use]
    pub fn new(quirks: Quirks, firmware: &impl Firmware) -> Self {
        let out = [Frame::default(); CAN_OUT_MAX];
        Self { quirks, out, len: 0, subscribed: false, bit_rate: firmware.can_bit_rate() }
    }

    /// Takes a frame from the bus.
    pub fn handle_input(&mut self, now: Instant, frame: &Frame, firmware: &mut impl Firmware) {
        let mine = frame.id == u32::from(firmware.can_id()) && !frame.extended && !frame.remote;
        if !mine || self.len == CAN_OUT_MAX {
            return;
        }
        let Ok(request) = Request::parse_can(frame.bytes(), firmware.address()) else { return };
        // [I] The first byte of a reply is the low byte of the CAN id that was asked.
        let before = (firmware.can_reply_id(), firmware.can_id() as u8);
        let response = firmware.execute(now, &request);
        let after = (firmware.can_reply_id(), firmware.can_id() as u8);
        let (id, module) = if self.quirks.settings_before_reply { after } else { before };
        note_order(&request, &response, &mut self.subscribed);
        let host = firmware.host_address();
        let reply = match response {
            Response::Reply { status, value } => {
                Reply { host, module, status, opcode: request.opcode, value }
            }
            Response::Instruction(instruction) => instruction.into_reply(host),
            Response::Text(text) => return self.send(Frame::standard(id, &text)),
            Response::Silent => return,
        };
        self.send(reply.emit_can(id, self.quirks.eight_bytes));
    }

    /// The next frame to send.
    pub fn poll_transmit(&mut self, now: Instant, firmware: &mut impl Firmware) -> Option<Frame> {
        if self.len == 0 {
            self.bit_rate = firmware.can_bit_rate();
            if self.subscribed
                && let Some(event) = firmware.poll_event(now)
            {
                self.subscribed = false;
                let reply = event_reply(event, firmware.host_address(), firmware.can_id() as u8);
                self.send(reply.emit_can(firmware.can_reply_id(), self.quirks.eight_bytes));
            }
        }
        let first = *self.out[..self.len].first()?;
        self.out.rotate_left(1);
        self.len -= 1;
        Some(first)
    }

    /// How this end now drives the bus.
    #[must_use]
    pub fn line(&self) -> CanLine {
        CanLine { bit_rate: self.bit_rate }
    }

    fn send(&mut self, frame: Frame) {
        if let Some(slot) = self.out.get_mut(self.len) {
            *slot = frame;
            self.len += 1;
        }
    }
}

fn is_ok(response: &Response) -> bool {
    matches!(response, Response::Reply { status: Status::Ok, .. })
}

fn note_order(request: &Request, response: &Response, subscribed: &mut bool) {
    if request.opcode == Opcode::PositionReached && is_ok(response) {
        *subscribed = request.value != 0;
    }
}

fn event_reply(event: Event, host: u8, module: u8) -> Reply {
    Reply { host, module, status: Status::Event, opcode: event.opcode, value: event.value }
}
