//! The adapter's end: what `slcand`, python-can and the Linux driver attach to, with a simulated
//! bus behind it.

use polepair_core::medium::{CanLine, Frame};
use polepair_core::time::Instant;

use super::codec::{self, End, Flags, LINE_MAX, Lines};
use crate::error::LinkError;
use crate::hub::{Hub, Saying, Session, Taken};
use crate::pty::Pty;

const DONE: u8 = b'\r';
const REFUSED: u8 = 0x07;
/// Hardware and software version, and serial number, as questions for them are answered.
const VERSION: &[u8] = b"V1013\r";
const SERIAL: &[u8] = b"NPLPR\r";
/// Time stamps begin again after a minute.
const STAMP_MS: u64 = 60_000;

/// One adapter on the bus.
#[derive(Clone, Debug)]
pub struct Adapter {
    bus: CanLine,
    lines: Lines,
    channel: Channel,
    /// What the client has set, bits per second; until then the bus's.
    bit_rate: u32,
    stamps: bool,
}

#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Channel {
    Closed,
    Open,
    Listening,
}

/// Serves a bus of that bit rate as an adapter on `pty`. A bit rate of 0 goes with any that the
/// client sets; otherwise a client that sets another hears nothing and is not heard, as on a wire.
///
/// # Errors
/// [`LinkError`] when the system has no descriptors left.
pub fn on_pty(pty: Pty, line: CanLine) -> Result<Hub<Adapter>, LinkError> {
    Hub::on_pty(pty, Adapter::new(line))
}

/// Likewise on TCP, where every client has an adapter of its own. Port 0 takes a free one; an
/// address without a host means this machine only.
///
/// # Errors
/// [`LinkError`], mostly that the port is taken.
pub fn listen(address: &str, line: CanLine) -> Result<Hub<Adapter>, LinkError> {
    Hub::listen(address, Adapter::new(line))
}

impl Adapter {
    pub(super) fn new(bus: CanLine) -> Self {
        Self {
            bus,
            lines: Lines::default(),
            channel: Channel::Closed,
            bit_rate: bus.bit_rate,
            stamps: false,
        }
    }

    /// Without the bus's bit rate an adapter only disturbs.
    const fn is_in_tune(&self) -> bool {
        self.bus.bit_rate == 0 || self.bus.bit_rate == self.bit_rate
    }

    /// Carries out a command; CAN232 manual, "available commands".
    fn command(&mut self, line: &[u8], answer: &mut Saying<'_>) -> Taken {
        let closed = self.channel == Channel::Closed;
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
            b"O" if closed => self.switch(Channel::Open),
            b"L" if closed => self.switch(Channel::Listening),
            b"C" if !closed => self.switch(Channel::Closed),
            [b'Z', on @ (b'0' | b'1')] if closed => {
                self.stamps = *on == b'1';
                true
            }
            b"V" => return say(answer, VERSION),
            b"N" => return say(answer, SERIAL),
            b"F" if !closed => {
                answer.0.byte(b'F');
                answer.0.number(if self.is_in_tune() { 0 } else { Flags::ERRORS.into() }, 2);
                true
            }
            _ => false,
        };
        answer.0.byte(if done { DONE } else { REFUSED });
        Taken::Nothing
    }

    fn switch(&mut self, to: Channel) -> bool {
        self.channel = to;
        true
    }

    fn transmit(&self, line: &[u8], answer: &mut Saying<'_>) -> Taken {
        let Some((frame, _)) = codec::parse_frame(line) else {
            answer.0.byte(REFUSED);
            return Taken::Junk;
        };
        if self.channel != Channel::Open {
            answer.0.byte(REFUSED);
            return Taken::Refused;
        }
        answer.0.byte(if frame.extended { b'Z' } else { b'z' });
        answer.0.byte(DONE);
        if self.is_in_tune() { Taken::Frame(frame) } else { Taken::Refused }
    }
}

fn say(answer: &mut Saying<'_>, what: &[u8]) -> Taken {
    answer.0.bytes(what);
    Taken::Nothing
}

impl Session for Adapter {
    fn greeting(&self) -> &'static [u8] {
        b""
    }

    fn take(&mut self, byte: u8, answer: &mut Saying<'_>) -> Taken {
        match self.lines.push(byte) {
            None | Some(End::Bell) => Taken::Nothing,
            Some(End::Spoilt) => {
                answer.0.byte(REFUSED);
                Taken::Junk
            }
            Some(End::Line) => {
                let lines = self.lines.clone();
                self.command(lines.line(), answer)
            }
        }
    }

    fn show(&mut self, frame: &Frame, at: Instant, saying: &mut Saying<'_>) {
        if self.channel == Channel::Closed || !self.is_in_tune() {
            return;
        }
        let mut line = [0; LINE_MAX];
        let stamp = self.stamps.then_some((at.0 / 1_000_000 % STAMP_MS) as u16);
        let len = codec::write_frame(frame, stamp, &mut line);
        saying.0.bytes(&line[..len]);
    }
}
