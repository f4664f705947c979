//! candump's log (`30B#5443000000000005` after time stamp and link) and its screen output (`123   [2]  01
//! 02`). Extended identifiers have eight digits. `#R`, optionally with a length, is a remote request. `##`
//! and a digit of flags is CAN FD. `R` or `T` at the end, or `RX` or `TX` on the screen, is the direction
//! of `candump -x`.

use polepair_core::explain::Direction;
use polepair_core::medium::Frame;

use super::ReadError;
use super::words::{parse_hex, parse_hex_digit, split_word};
use crate::record::{CanErrorFrame, CanRecord, ERROR_FLAG, STANDARD_MAX, classic_frame};

/// Bytes that a CAN FD frame may have.
const FD_MAX: usize = 64;

/// Reads one frame of a log and the direction, if it is there. Puts the data into `bytes`.
pub(crate) fn parse_log(
    rest: &[u8],
    bytes: &mut Vec<u8>,
) -> Result<(Option<Direction>, CanRecord), ReadError> {
    let (token, rest) = split_word(rest);
    let hash =
        token.iter().position(|c| *c == b'#').ok_or(ReadError("expected IDENTIFIER#DATA"))?;
    let id = CandumpId::parse(&token[..hash])?;
    bytes.clear();
    let mut after = rest;
    let data = match &token[hash + 1..] {
        [b'#', flags, data @ ..] => {
            parse_dotted_hex(data, bytes)?;
            id.to_fd_frame(parse_hex_digit(*flags)?, bytes)?
        }
        [b'#'] => return Err(ReadError("a CAN FD frame has a digit of flags")),
        [b'R' | b'r', length @ ..] => id.to_frame(true, parse_remote_length(length)?, &[])?,
        data => {
            // `_` and a digit are a length code beyond 8, which does not change the sent bytes.
            let data = data.split(|c| *c == b'_').next().unwrap_or(data);
            parse_dotted_hex(data, bytes)?;
            // People write the bytes apart: `583#4B 41 60`, `583#0x4B,0x41`.
            if bytes.len() < 2 || data.contains(&b',') {
                after = parse_separate_bytes(after, bytes)?;
            }
            id.to_frame(false, 8, bytes)?
        }
    };
    Ok((parse_direction(split_word(after).0)?, data))
}

/// Parses words of one byte each. Returns what follows them.
fn parse_separate_bytes<'t>(text: &'t [u8], bytes: &mut Vec<u8>) -> Result<&'t [u8], ReadError> {
    let mut left = text;
    loop {
        let (word, after) = split_word(left);
        let word = word.strip_suffix(b",").unwrap_or(word);
        if !matches!(word.strip_prefix(b"0x").unwrap_or(word), [_, _]) {
            return Ok(left);
        }
        parse_dotted_hex(word, bytes)?;
        left = after;
    }
}

/// Returns whether this is what candump shows on the screen: an identifier, and a length in brackets or, as with `-8`,
/// in braces.
pub(crate) fn is_screen_line(rest: &[u8]) -> bool {
    let (_, rest) = split_direction(rest);
    let (id, rest) = split_word(rest);
    matches!(id.len(), 3 | 8)
        && matches!(rest.first(), Some(b'[' | b'{'))
        && parse_length(split_word(rest).0).is_some()
}

/// Reads what candump shows on the screen. Puts the data into `bytes`.
pub(crate) fn parse_screen(
    rest: &[u8],
    bytes: &mut Vec<u8>,
) -> Result<(Option<Direction>, CanRecord), ReadError> {
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
    let swapped = split_word(rest).0.contains(&b'`');
    while bytes.len() < count {
        let (word, after) = split_word(left);
        if word.is_empty() {
            return Err(ReadError("it has fewer bytes than its length says"));
        }
        for digits in word.split(|c| *c == b'`') {
            bytes.push(parse_screen_byte(digits)?);
        }
        left = after;
    }
    if bytes.len() > count {
        return Err(ReadError("it has more bytes than its length says"));
    }
    if swapped {
        bytes.reverse();
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
    // candump adds two flags: bit-rate switch and error state.
    let is_flag = |word: &[u8]| matches!(word, b"-" | b"B" | b"E");
    let (first, rest) = split_word(after);
    let (second, rest) = split_word(rest);
    (Some(direction), if is_flag(first) && is_flag(second) { rest } else { after })
}

/// Returns whether a word is the length of a frame on the screen.
pub(crate) fn is_length(word: &[u8]) -> bool {
    parse_length(word).is_some()
}

/// A byte on the screen: two hexadecimal digits, or eight binary ones as with `-i`.
fn parse_screen_byte(digits: &[u8]) -> Result<u8, ReadError> {
    match digits {
        [high, low] => Ok(parse_hex_digit(*high)? << 4 | parse_hex_digit(*low)?),
        [_, _, _, _, _, _, _, _] if digits.iter().all(|c| matches!(c, b'0' | b'1')) => {
            Ok(digits.iter().fold(0, |byte, digit| byte << 1 | (digit - b'0')))
        }
        _ => Err(ReadError("expected bytes of two hexadecimal or eight binary digits")),
    }
}

/// `[8]`, `[08]` for CAN FD, and `{8}`. In braces is the length code, which may be 9 to F for 8 bytes.
fn parse_length(brackets: &[u8]) -> Option<(usize, bool)> {
    if let [b'{', code, b'}'] = brackets {
        return Some((usize::from(parse_hex_digit(*code).ok()?).min(8), false));
    }
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
        let digits = digits.strip_prefix(b"0x").unwrap_or(digits);
        // Other programs leave zeros in front out. Then the value decides.
        if !matches!(digits.len(), 1..=8) {
            return Err(ReadError("a CAN identifier has 3 digits, or 8 when it is extended"));
        }
        let number = digits
            .iter()
            .try_fold(0u32, |id, digit| Ok(id << 4 | u32::from(parse_hex_digit(*digit)?)))
            .map_err(|_: ReadError| ReadError("a CAN identifier is hexadecimal"))?;
        let extended = match digits.len() {
            1..=3 => false,
            8 => true,
            _ => number > STANDARD_MAX,
        };
        if !extended && number > STANDARD_MAX {
            return Err(ReadError("a CAN identifier of 3 digits is at most 7FF"));
        }
        if number >= ERROR_FLAG << 1 {
            return Err(ReadError("a CAN identifier of 8 digits is at most 1FFFFFFF"));
        }
        Ok(Self { number, extended })
    }

    fn to_frame(self, remote: bool, len: u8, bytes: &[u8]) -> Result<CanRecord, ReadError> {
        if bytes.len() > 8 {
            return Err(ReadError("a CAN frame has at most 8 bytes"));
        }
        let len = if remote { len } else { bytes.len() as u8 };
        let Frame { data, .. } = classic_frame(0, false, false, len, bytes);
        Ok(if self.extended && self.number & ERROR_FLAG != 0 {
            CanRecord::Error(CanErrorFrame { class: self.number & !ERROR_FLAG, data })
        } else {
            CanRecord::Frame(classic_frame(self.number, self.extended, remote, len, bytes))
        })
    }

    fn to_fd_frame(self, flags: u8, bytes: &[u8]) -> Result<CanRecord, ReadError> {
        if bytes.len() > FD_MAX {
            return Err(ReadError("a CAN FD frame has at most 64 bytes"));
        }
        Ok(CanRecord::Fd { id: self.number, extended: self.extended, flags })
    }
}

/// Data bytes, which may have dots or commas between them, and `0x` before each.
fn parse_dotted_hex(data: &[u8], bytes: &mut Vec<u8>) -> Result<(), ReadError> {
    for part in data.split(|c| matches!(c, b'.' | b',')) {
        parse_hex(part.strip_prefix(b"0x").unwrap_or(part), bytes)?;
    }
    Ok(())
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
