//! The adapter's end of slcan, with a simulated bus: for `slcand`, python-can and the Linux driver.

use polepair_core::medium::{CanLine, Frame};
use polepair_core::time::Instant;

use super::codec::{self, LINE_MAX, LineEnd, LineSplitter, StatusFlags};
use crate::error::LinkError;
use crate::hub::{Hub, HubSession, SessionAction, SessionOutput};
#[cfg(unix)]
use crate::pty::Pty;

const DONE_BYTE: u8 = b'\r';
const REFUSED_BYTE: u8 = 0x07;
/// Hardware and software version, and serial number, as questions for them are answered.
const VERSION: &[u8] = b"V1013\r";
const SERIAL: &[u8] = b"NPLPR\r";
/// Time stamps begin again after a minute.
const STAMP_MS: u64 = 60_000;

/// One adapter on the bus.
#[derive(Clone, Debug)]
pub struct SlcanSession {
    bus: CanLine,
    lines: LineSplitter,
    channel: ChannelMode,
    /// Bit rate set by the client, bits per second; until then that of the bus.
    bit_rate: u32,
    timestamps: bool,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum ChannelMode {
    Closed,
    Open,
    ListenOnly,
}

/// Serves a bus of that bit rate as an adapter on `pty`. A bit rate of 0 accepts any rate that the
/// client sets; otherwise a client that sets another rate exchanges nothing, as on a real wire.
///
/// # Errors
/// [`LinkError`] when the system has no descriptors left.
#[cfg(unix)]
pub fn serve_pty(pty: Pty, line: CanLine) -> Result<Hub<SlcanSession>, LinkError> {
    Hub::serve_pty(pty, SlcanSession::new(line))
}

/// Likewise on TCP, where every client has an adapter of its own. Port 0 takes a free one; an
/// address without a host means this machine only.
///
/// # Errors
/// [`LinkError`], mostly that the port is taken.
pub fn listen(address: &str, line: CanLine) -> Result<Hub<SlcanSession>, LinkError> {
    Hub::listen(address, SlcanSession::new(line))
}

impl SlcanSession {
    pub(super) fn new(bus: CanLine) -> Self {
        Self {
            bus,
            lines: LineSplitter::default(),
            channel: ChannelMode::Closed,
            bit_rate: bus.bit_rate,
            timestamps: false,
        }
    }

    /// Without the bus's bit rate an adapter only disturbs.
    const fn has_bus_bit_rate(&self) -> bool {
        self.bus.bit_rate == 0 || self.bus.bit_rate == self.bit_rate
    }

    /// Carries out a command; CAN232 manual, "available commands".
    fn handle_command(&mut self, line: &[u8], answer: &mut SessionOutput<'_>) -> SessionAction {
        let closed = self.channel == ChannelMode::Closed;
        let done = match line {
            [] => true,
            [b't' | b'T' | b'r' | b'R', ..] => return self.transmit(line, answer),
            [b'S' | b's', ..] if closed => match codec::parse_bit_rate(line) {
                Some(rate) => {
                    self.bit_rate = rate;
                    true
                }
                None => false,
            },
            b"O" if closed => self.set_channel(ChannelMode::Open),
            b"L" if closed => self.set_channel(ChannelMode::ListenOnly),
            b"C" if !closed => self.set_channel(ChannelMode::Closed),
            [b'Z', on @ (b'0' | b'1')] if closed => {
                self.timestamps = *on == b'1';
                true
            }
            b"V" => return write_answer(answer, VERSION),
            b"N" => return write_answer(answer, SERIAL),
            b"F" if !closed => {
                answer.0.push_byte(b'F');
                answer.0.push_hex(
                    if self.has_bus_bit_rate() { 0 } else { StatusFlags::ERRORS.into() },
                    2,
                );
                true
            }
            _ => false,
        };
        answer.0.push_byte(if done { DONE_BYTE } else { REFUSED_BYTE });
        SessionAction::Nothing
    }

    fn set_channel(&mut self, to: ChannelMode) -> bool {
        self.channel = to;
        true
    }

    fn transmit(&self, line: &[u8], answer: &mut SessionOutput<'_>) -> SessionAction {
        let Some((frame, _)) = codec::parse_frame(line) else {
            answer.0.push_byte(REFUSED_BYTE);
            return SessionAction::Malformed;
        };
        if self.channel != ChannelMode::Open {
            answer.0.push_byte(REFUSED_BYTE);
            return SessionAction::Refused;
        }
        answer.0.push_byte(if frame.extended { b'Z' } else { b'z' });
        answer.0.push_byte(DONE_BYTE);
        if self.has_bus_bit_rate() { SessionAction::Frame(frame) } else { SessionAction::Refused }
    }
}

fn write_answer(answer: &mut SessionOutput<'_>, what: &[u8]) -> SessionAction {
    answer.0.push_bytes(what);
    SessionAction::Nothing
}

impl HubSession for SlcanSession {
    fn greeting(&self) -> &'static [u8] {
        b""
    }

    fn handle_byte(&mut self, byte: u8, answer: &mut SessionOutput<'_>) -> SessionAction {
        match self.lines.push(byte) {
            None | Some(LineEnd::Bell) => SessionAction::Nothing,
            Some(LineEnd::Malformed) => {
                answer.0.push_byte(REFUSED_BYTE);
                SessionAction::Malformed
            }
            Some(LineEnd::Line) => {
                let lines = self.lines.clone();
                self.handle_command(lines.line(), answer)
            }
        }
    }

    fn write_frame(&mut self, frame: &Frame, at: Instant, saying: &mut SessionOutput<'_>) {
        if self.channel == ChannelMode::Closed || !self.has_bus_bit_rate() {
            return;
        }
        let mut line = [0; LINE_MAX];
        let stamp = self.timestamps.then_some((at.0 / 1_000_000 % STAMP_MS) as u16);
        let len = codec::write_frame(frame, stamp, &mut line);
        saying.0.push_bytes(&line[..len]);
    }
}
