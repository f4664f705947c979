//! Lines that belong to the one before: bytes below socat's and jpnevulator's times, or below the identifier that a CAN
//! library for Arduino prints, and lines of a hexadecimal dump.
//!
//! ```text
//! > 2026/11/27 12:34:56.000123456  length=8 from=0 to=7
//!  01 03 00 33 00 01 74 05                          ...3..t.
//! 2026-11-27 12:34:56.123456: ttyS0
//! 01 03 00 33 00 01 74 05                           ...3..t.
//! Get data from ID: 0x601
//! 40      41      60      0       0       0       0       0
//! ```

use polepair_core::explain::Direction;

use super::ReadError;
use super::hex_dump::{self, DumpLine, HexDump};
use super::line_time::split_time;
use super::printed_frame::{parse_byte, parse_id};
use super::text::RawLine;
use crate::record::{CanRecord, classic_frame};
use crate::timestamp::Timestamp;

/// Space before the lines of a dump with the second side's bytes (Wireshark's "Follow TCP Stream").
pub(super) const INDENTATION: &[u8] = b"    ";

/// State of the lines before.
#[derive(Debug, Default)]
pub(super) struct AttachedLines {
    header: Option<LineHeader>,
    /// Positions in the dumps of either side.
    dumps: [HexDump; 2],
    /// Bytes of the dump so far, of the side of the last line. Frames are not cut where its lines are.
    block: Vec<u8>,
    is_answer: bool,
}

/// Bytes of a dump that are kept together.
const BLOCK_MAX: usize = 1 << 16;

/// A line that belongs to others.
pub(super) enum AttachedLine {
    Nothing,
    Bytes(RawLine<'static>),
}

impl AttachedLines {
    /// Returns whether bytes of a dump wait for the next line.
    pub fn has_pending(&self) -> bool {
        !self.block.is_empty()
    }

    /// Parses such a line, and puts its bytes into `bytes`. `None` for all other lines.
    ///
    /// # Errors
    /// A dump leaves repeated lines out.
    pub fn parse(
        &mut self,
        line: &[u8],
        bytes: &mut Vec<u8>,
    ) -> Result<Option<AttachedLine>, ReadError> {
        // The time in parentheses of candump's log begins no such line.
        if line.starts_with(b"(") {
            return Ok(None);
        }
        if let Some(header) = LineHeader::parse(line) {
            self.header = Some(header);
            return Ok(Some(AttachedLine::Nothing));
        }
        if let Some(header) = self.header {
            if line.trim_ascii() == b"--" {
                self.header = None;
                return Ok(Some(AttachedLine::Nothing));
            }
            if let Some(raw) = header.parse_bytes(line, bytes) {
                self.header = Some(header).filter(|header| header.id.is_none());
                return Ok(Some(AttachedLine::Bytes(raw)));
            }
        }
        let is_answer = line.starts_with(INDENTATION);
        Ok(match self.dumps[usize::from(is_answer)].parse(line, bytes).transpose()? {
            None => None,
            Some(DumpLine::End) => Some(AttachedLine::Nothing),
            Some(DumpLine::Bytes) => {
                debug_assert!(self.block.is_empty() || self.is_answer == is_answer);
                self.is_answer = is_answer;
                self.block.extend_from_slice(bytes);
                Some(AttachedLine::Nothing)
            }
        })
    }

    /// The bytes of a dump that end before the next line, or at the end of the file. They are put into `bytes`.
    pub fn take_block(
        &mut self,
        next: Option<&[u8]>,
        bytes: &mut Vec<u8>,
    ) -> Option<RawLine<'static>> {
        if self.block.is_empty() {
            return None;
        }
        let dump = &self.dumps[usize::from(self.is_answer)];
        let goes_on = next.is_some_and(|line| {
            line.starts_with(INDENTATION) == self.is_answer && dump.continues(line)
        });
        if goes_on && self.block.len() < BLOCK_MAX {
            return None;
        }
        core::mem::swap(bytes, &mut self.block);
        self.block.clear();
        let direction = if self.is_answer { Direction::ToHost } else { Direction::ToDrive };
        Some(RawLine { direction: Some(direction), ..RawLine::default() })
    }
}

/// A line above bytes.
#[derive(Clone, Copy, Debug)]
struct LineHeader {
    time: Option<Timestamp>,
    direction: Option<Direction>,
    /// Identifier of a CAN frame, and whether it is extended.
    id: Option<(u32, bool)>,
}

impl LineHeader {
    /// Parses a line above bytes. `None` for all other lines.
    fn parse(line: &[u8]) -> Option<Self> {
        let line = std::str::from_utf8(line).ok()?.trim();
        let (direction, text) = match line.split_at_checked(2)? {
            ("> ", text) => (Some(Direction::ToDrive), text),
            ("< ", text) => (Some(Direction::ToHost), text),
            _ => (None, line),
        };
        if let Some((time, rest)) = split_time(text) {
            let is_socat = direction.is_some() && rest.starts_with("length=");
            // jpnevulator's port is a name that a user chose, so it states no direction.
            let port = rest.strip_prefix(": ").filter(|_| direction.is_none());
            let is_port = port.is_some_and(|name| !name.is_empty() && !name.contains(' '));
            return (is_socat || is_port).then_some(Self { time: Some(time), direction, id: None });
        }
        let lower = line.to_ascii_lowercase();
        let (_, id) = lower.split_once("data from id:")?;
        Some(Self { time: None, direction: None, id: Some(parse_id(id.trim())?) })
    }

    /// Parses the bytes below it. They are put into `bytes`.
    fn parse_bytes(self, line: &[u8], bytes: &mut Vec<u8>) -> Option<RawLine<'static>> {
        bytes.clear();
        let can = match self.id {
            None => {
                hex_dump::parse_bytes(line.trim_ascii(), bytes)?;
                None
            }
            Some((id, extended)) => {
                let text = std::str::from_utf8(line).ok()?;
                for word in text.split([' ', '\t', ',', '\r']).filter(|word| !word.is_empty()) {
                    bytes.push(parse_byte(word)?);
                }
                let len = u8::try_from(bytes.len()).ok().filter(|len| (1..=8).contains(len))?;
                Some(CanRecord::Frame(classic_frame(id, extended, false, len, bytes)))
            }
        };
        Some(RawLine { time: self.time, direction: self.direction, can, ..RawLine::default() })
    }
}
