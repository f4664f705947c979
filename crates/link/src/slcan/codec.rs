//! The ASCII protocol of serial CAN adapters for both ends: Lawicel's CAN232 manual, and the error states
//! of the Linux driver `slcan`.

use polepair_core::medium::Frame;

use crate::hex::{self, TextWriter};

/// The longest line with its end: an extended frame with eight bytes and a time stamp.
pub const LINE_MAX: usize = 32;
/// Bit rates of `S0` to `S8`, bits per second.
const STANDARD_RATES: [u32; 9] =
    [10_000, 20_000, 50_000, 100_000, 125_000, 250_000, 500_000, 800_000, 1_000_000];
/// The clock that the bit timing registers of `s` divide: half of the SJA1000's 16 MHz.
const CLOCK_HZ: u32 = 8_000_000;
/// Time quanta of a bit that the registers can express, and their divider's range.
const QUANTA: std::ops::RangeInclusive<u32> = 8..=25;
const DIVIDER_MAX: u32 = 64;

/// Splits a stream of bytes into lines. Invalid bytes cost the line that they are in, and no more.
#[derive(Clone, Debug, Default)]
pub struct LineSplitter {
    line: [u8; LINE_MAX],
    len: usize,
    malformed: bool,
    ended: bool,
}

/// Result of a byte: the end of a line.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum LineEnd {
    /// A line, which [`LineSplitter::line`] returns until the next byte; empty if only an end arrived.
    Line,
    /// The bell: the adapter refuses.
    Bell,
    /// Something that is no line.
    Malformed,
}

impl LineSplitter {
    /// Processes one byte; returns the line that it ended, if any.
    pub fn push(&mut self, byte: u8) -> Option<LineEnd> {
        if std::mem::take(&mut self.ended) {
            (self.len, self.malformed) = (0, false);
        }
        match byte {
            b'\r' => {
                self.ended = true;
                return Some(if self.malformed { LineEnd::Malformed } else { LineEnd::Line });
            }
            0x07 => {
                self.ended = true;
                return Some(LineEnd::Bell);
            }
            // Some adapters and all terminals end lines with both.
            b'\n' if self.len == 0 => {}
            b' '..=b'~' if self.starts_next_frame(byte) => {
                self.line[0] = byte;
                (self.len, self.malformed) = (1, false);
                return Some(LineEnd::Malformed);
            }
            b' '..=b'~' if self.len < LINE_MAX && !self.malformed => {
                self.line[self.len] = byte;
                self.len += 1;
            }
            _ => self.malformed = true,
        }
        None
    }

    /// The line that has just ended.
    #[must_use]
    pub fn line(&self) -> &[u8] {
        &self.line[..self.len]
    }

    /// Returns whether this byte starts a new frame: the letter of a frame is not a digit, so inside a frame it means
    /// that the end of the previous one was lost.
    fn starts_next_frame(&self, byte: u8) -> bool {
        is_frame_letter(byte) && self.len > 0 && is_frame_letter(self.line[0])
    }
}

const fn is_frame_letter(byte: u8) -> bool {
    matches!(byte, b't' | b'T' | b'r' | b'R')
}

/// Parses a frame, with the adapter's milliseconds (0 to 59999) if it sends them.
#[must_use]
pub fn parse_frame(line: &[u8]) -> Option<(Frame, Option<u16>)> {
    let (&letter, rest) = line.split_first()?;
    if !is_frame_letter(letter) {
        return None;
    }
    let (extended, remote) = (letter.is_ascii_uppercase(), letter | 0x20 == b'r');
    let (id, rest) = rest.split_at_checked(if extended { 8 } else { 3 })?;
    let id = hex::parse_hex(id)?;
    let (&len, rest) = rest.split_first()?;
    let len = len.wrapping_sub(b'0');
    if len > 8 || id > if extended { 0x1FFF_FFFF } else { 0x7FF } {
        return None;
    }
    let mut frame = Frame { id, extended, remote, len, data: [0; 8] };
    let (digits, stamp) = rest.split_at_checked(if remote { 0 } else { 2 * usize::from(len) })?;
    for (byte, pair) in frame.data.iter_mut().zip(digits.chunks_exact(2)) {
        *byte = hex::digit_value(pair[0])? << 4 | hex::digit_value(pair[1])?;
    }
    match stamp.len() {
        0 => Some((frame, None)),
        4 => Some((frame, Some(hex::parse_hex(stamp)? as u16))),
        _ => None,
    }
}

/// Writes a frame as a line and returns its length.
pub fn write_frame(frame: &Frame, stamp_ms: Option<u16>, out: &mut [u8; LINE_MAX]) -> usize {
    let mut text = TextWriter::new(out);
    let letter = if frame.remote { b'r' } else { b't' };
    if frame.extended {
        text.push_byte(letter.to_ascii_uppercase());
        text.push_hex(frame.id, 8);
    } else {
        text.push_byte(letter);
        text.push_hex(frame.id, 3);
    }
    text.push_hex(frame.len.min(8).into(), 1);
    if !frame.remote {
        frame.bytes().iter().for_each(|&byte| text.push_hex(byte.into(), 2));
    }
    if let Some(stamp) = stamp_ms {
        text.push_hex(stamp.into(), 4);
    }
    text.push_byte(b'\r');
    text.len
}

/// Writes the command that sets a bit rate and returns its length; `None` when the registers
/// cannot express it exactly.
pub fn write_bit_rate(bit_rate: u32, out: &mut [u8; LINE_MAX]) -> Option<usize> {
    let mut text = TextWriter::new(out);
    if let Some(n) = STANDARD_RATES.iter().position(|&rate| rate == bit_rate) {
        text.push_byte(b'S');
        text.push_hex(n as u32, 1);
    } else {
        text.push_byte(b's');
        text.push_hex(timing_registers(bit_rate)?.into(), 4);
    }
    text.push_byte(b'\r');
    Some(text.len)
}

/// `BTR0` and `BTR1` of an SJA1000: the most quanta a bit that divide evenly, sampled as near to
/// 87.5 % as they allow (CiA 301), one quantum of resynchronisation.
fn timing_registers(bit_rate: u32) -> Option<u16> {
    let ratio = CLOCK_HZ.checked_div(bit_rate).filter(|ratio| ratio * bit_rate == CLOCK_HZ)?;
    let quanta = QUANTA.rev().find(|q| ratio % q == 0 && ratio / q <= DIVIDER_MAX)?;
    let second = (quanta / 8).max(quanta.saturating_sub(17)).clamp(1, 8);
    let first = quanta - 1 - second;
    let divider = ratio / quanta;
    u16::try_from((divider - 1) << 8 | (second - 1) << 4 | (first - 1)).ok()
}

/// The bit rate that a command sets, bits per second.
#[must_use]
pub fn parse_bit_rate(line: &[u8]) -> Option<u32> {
    match line {
        [b'S', n] => STANDARD_RATES.get(usize::from(n.wrapping_sub(b'0'))).copied(),
        [b's', registers @ ..] if registers.len() == 4 => {
            let registers = hex::parse_hex(registers)?;
            let divider = (registers >> 8 & 0x3F) + 1;
            let quanta = 1 + (registers & 0xF) + 1 + (registers >> 4 & 7) + 1;
            Some(CLOCK_HZ / (divider * quanta))
        }
        _ => None,
    }
}

/// A reply of an adapter.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum AdapterReply {
    /// A frame from the bus.
    Frame(Frame),
    /// A command was carried out, or a frame was taken for sending (`z`, `Z`).
    Done,
    /// The controller's error state, of the Linux driver's dialect.
    State(ErrorState),
    /// The controller saw errors on the wire, likewise.
    BusError,
    /// Status flags since the last request: the reply to `F`.
    Flags(StatusFlags),
    /// Version, serial number: the answer to a question.
    Info,
    /// Not a valid reply.
    Unknown,
}

/// Status flags of a controller; they go with the answer (CAN232 manual, command F).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct StatusFlags(pub u8);

impl StatusFlags {
    /// Error warning, error passive, bus error.
    pub const ERRORS: u8 = 1 << 2 | 1 << 5 | 1 << 7;
    /// Receive queue full, data overrun.
    pub const OVERRUN: u8 = 1 << 0 | 1 << 3;

    /// Returns whether any of these is set.
    #[must_use]
    pub const fn any(self, of: u8) -> bool {
        self.0 & of != 0
    }
}

/// Error state of a controller.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum ErrorState {
    /// The controller sends and receives.
    Active,
    /// An error counter has reached 96.
    Warning,
    /// 128: it no longer destroys others' frames.
    Passive,
    /// Error count of 256: the controller is disconnected from the bus.
    BusOff,
}

impl AdapterReply {
    /// Reads one line of an adapter.
    #[must_use]
    pub fn parse(line: &[u8]) -> Self {
        match line {
            [] | [b'z' | b'Z'] => Self::Done,
            [b't' | b'T' | b'r' | b'R', ..] => {
                parse_frame(line).map_or(Self::Unknown, |(frame, _)| Self::Frame(frame))
            }
            [b's', state, counters @ ..]
                if counters.len() == 6 && counters.iter().all(u8::is_ascii_digit) =>
            {
                match state {
                    b'a' => Self::State(ErrorState::Active),
                    b'w' => Self::State(ErrorState::Warning),
                    b'p' => Self::State(ErrorState::Passive),
                    b'b' => Self::State(ErrorState::BusOff),
                    _ => Self::Unknown,
                }
            }
            [b'e', count @ b'1'..=b'9', kinds @ ..] if kinds.len() == usize::from(count - b'0') => {
                Self::BusError
            }
            [b'F', high, low] => match (hex::digit_value(*high), hex::digit_value(*low)) {
                (Some(high), Some(low)) => Self::Flags(StatusFlags(high << 4 | low)),
                _ => Self::Unknown,
            },
            [b'V' | b'v' | b'N', ..] => Self::Info,
            _ => Self::Unknown,
        }
    }
}
