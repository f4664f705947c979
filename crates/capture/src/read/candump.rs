//! candump's log (`30B#5443000000000005` after time stamp and link) and its screen output (`123   [2]  01
//! 02`). Extended identifiers have eight digits. `#R`, optionally with a length, is a remote request. `##`
//! and a digit of flags is CAN FD. `R` or `T` at the end, or `RX` or `TX` on the screen, is the direction
//! of `candump -x`.

use polepair_core::explain::Direction;
use polepair_core::medium::Frame;

use super::ReadError;
use super::serial_log::{parse_hex, parse_hex_digit, parse_hex_words};
use super::text::split_word;
use crate::record::{CanErrorFrame, ERROR_FLAG, FdFrame, RecordData, STANDARD_MAX, classic_frame};

/// Bytes that a CAN FD frame may have.
const FD_MAX: usize = 64;

/// Reads one frame of a log and the direction, if it is there.
pub(crate) fn parse_log<'a>(
    rest: &[u8],
    bytes: &'a mut Vec<u8>,
) -> Result<(Option<Direction>, RecordData<'a>), ReadError> {
    let (token, rest) = split_word(rest);
    let hash =
        token.iter().position(|c| *c == b'#').ok_or(ReadError("expected IDENTIFIER#DATA"))?;
    let direction = parse_direction(split_word(rest).0)?;
    let id = CandumpId::parse(&token[..hash])?;
    bytes.clear();
    let data = match &token[hash + 1..] {
        [b'#', flags, data @ ..] => {
            parse_dotted_hex(data, bytes)?;
            id.to_fd_frame(parse_hex_digit(*flags)?, bytes)?
        }
        [b'#'] => return Err(ReadError("a CAN FD frame has a digit of flags")),
        [b'R' | b'r', length @ ..] => id.to_frame(true, parse_remote_length(length)?, &[])?,
        data => {
            // `_` and a digit say a length code beyond 8, which changes nothing that is sent.
            let data = data.split(|c| *c == b'_').next().unwrap_or(data);
            parse_dotted_hex(data, bytes)?;
            id.to_frame(false, 8, bytes)?
        }
    };
    Ok((direction, data))
}

/// Whether this is what candump shows on the screen: an identifier and a length in brackets.
pub(crate) fn is_screen_line(rest: &[u8]) -> bool {
    let (_, rest) = split_direction(rest);
    let (id, rest) = split_word(rest);
    matches!(id.len(), 3 | 8)
        && rest.first() == Some(&b'[')
        && parse_length(split_word(rest).0).is_some()
}

/// Reads what candump shows on the screen.
pub(crate) fn parse_screen<'a>(
    rest: &[u8],
    bytes: &'a mut Vec<u8>,
) -> Result<(Option<Direction>, RecordData<'a>), ReadError> {
    let (direction, rest) = split_direction(rest);
    let (id, rest) = split_word(rest);
    let (brackets, rest) = split_word(rest);
    let (count, fd) = parse_length(brackets).ok_or(ReadError("expected a length in brackets"))?;
    let id = CandumpId::parse(id)?;
    bytes.clear();
    if rest.starts_with(b"remote") {
        return Ok((direction, id.to_frame(true, count as u8, &[])?));
    }
    // Behind the bytes candump may show them as text, or an error frame in words.
    let mut left = rest;
    while bytes.len() < count {
        let (pair, after) = split_word(left);
        parse_hex_words(pair, bytes)?;
        if pair.is_empty() {
            return Err(ReadError("it has fewer bytes than its length says"));
        }
        left = after;
    }
    let data = if fd { id.to_fd_frame(0, bytes)? } else { id.to_frame(false, 8, bytes)? };
    Ok((direction, data))
}

fn split_direction(rest: &[u8]) -> (Option<Direction>, &[u8]) {
    let (first, after) = split_word(rest);
    let direction = match first {
        b"TX" => Direction::ToDrive,
        b"RX" => Direction::ToHost,
        _ => return (None, rest),
    };
    // Two flags follow: bit-rate switch and error state.
    (Some(direction), split_word(split_word(after).1).1)
}

/// `[8]`, and `[08]` for CAN FD.
fn parse_length(brackets: &[u8]) -> Option<(usize, bool)> {
    let digits = brackets.strip_prefix(b"[")?.strip_suffix(b"]")?;
    let count = std::str::from_utf8(digits).ok()?.parse().ok()?;
    let fd = digits.len() == 2;
    (count <= if fd { FD_MAX } else { 8 }).then_some((count, fd))
}

/// An identifier as candump writes it.
#[derive(Clone, Copy)]
struct CandumpId {
    number: u32,
    extended: bool,
}

impl CandumpId {
    fn parse(digits: &[u8]) -> Result<Self, ReadError> {
        let extended = match digits.len() {
            3 => false,
            8 => true,
            _ => return Err(ReadError("a CAN identifier has 3 digits, or 8 when it is extended")),
        };
        let number = digits
            .iter()
            .try_fold(0u32, |id, digit| Ok(id << 4 | u32::from(parse_hex_digit(*digit)?)))
            .map_err(|_: ReadError| ReadError("a CAN identifier is hexadecimal"))?;
        if !extended && number > STANDARD_MAX {
            return Err(ReadError("a CAN identifier of 3 digits is at most 7FF"));
        }
        if number >= ERROR_FLAG << 1 {
            return Err(ReadError("a CAN identifier of 8 digits is at most 1FFFFFFF"));
        }
        Ok(Self { number, extended })
    }

    fn to_frame(
        self,
        remote: bool,
        len: u8,
        bytes: &[u8],
    ) -> Result<RecordData<'static>, ReadError> {
        if bytes.len() > 8 {
            return Err(ReadError("a CAN frame has at most 8 bytes"));
        }
        let len = if remote { len } else { bytes.len() as u8 };
        let Frame { data, .. } = classic_frame(0, false, false, len, bytes);
        Ok(match self.extended && self.number & ERROR_FLAG != 0 {
            true => RecordData::Error(CanErrorFrame { class: self.number & !ERROR_FLAG, data }),
            false => {
                RecordData::Frame(classic_frame(self.number, self.extended, remote, len, bytes))
            }
        })
    }

    fn to_fd_frame(self, flags: u8, bytes: &[u8]) -> Result<RecordData<'_>, ReadError> {
        if bytes.len() > FD_MAX {
            return Err(ReadError("a CAN FD frame has at most 64 bytes"));
        }
        Ok(RecordData::Fd(FdFrame { id: self.number, extended: self.extended, flags, bytes }))
    }
}

/// Data bytes, which may have dots between them.
fn parse_dotted_hex(data: &[u8], bytes: &mut Vec<u8>) -> Result<(), ReadError> {
    if data.contains(&b'.') {
        return data.split(|c| *c == b'.').try_for_each(|pair| parse_hex(pair, bytes));
    }
    parse_hex(data, bytes)
}

fn parse_remote_length(digits: &[u8]) -> Result<u8, ReadError> {
    match digits {
        [] => Ok(0),
        [digit @ b'0'..=b'8'] | [digit @ b'0'..=b'8', b'_', ..] => Ok(digit - b'0'),
        _ => Err(ReadError("a remote request has a length of 0 to 8")),
    }
}

fn parse_direction(flag: &[u8]) -> Result<Option<Direction>, ReadError> {
    match flag {
        b"" => Ok(None),
        b"T" => Ok(Some(Direction::ToDrive)),
        b"R" => Ok(Some(Direction::ToHost)),
        _ => Err(ReadError("unexpected text after the CAN frame")),
    }
}
