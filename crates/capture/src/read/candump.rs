//! candump's log, `30B#5443000000000005` after the time stamp and the link, and what candump shows
//! on the screen, `123   [2]  01 02`. Extended identifiers have eight digits; `#R`, or `#R` and a
//! length, is a remote request; `##` and a digit of flags begins CAN FD; `R` or `T` at the end, `RX`
//! or `TX` on the screen, is the direction that `candump -x` adds.

use polepair_core::explain::Direction;
use polepair_core::medium::Frame;

use super::Bad;
use super::seriallog::{hex_digit, hex_run, hex_words};
use super::text::word;
use crate::record::{Data, ERROR_FLAG, ErrorFrame, Fd, STANDARD_MAX, classic};

/// Bytes that a CAN FD frame may have.
const FD_MAX: usize = 64;

/// Reads one frame of a log and the direction, if it is there.
pub(crate) fn parse<'a>(
    rest: &[u8],
    bytes: &'a mut Vec<u8>,
) -> Result<(Option<Direction>, Data<'a>), Bad> {
    let (token, rest) = word(rest);
    let hash = token.iter().position(|c| *c == b'#').ok_or(Bad("expected IDENTIFIER#DATA"))?;
    let direction = direction(word(rest).0)?;
    let id = Id::parse(&token[..hash])?;
    bytes.clear();
    let data = match &token[hash + 1..] {
        [b'#', flags, data @ ..] => {
            hex_run_dotted(data, bytes)?;
            id.fd(hex_digit(*flags)?, bytes)?
        }
        [b'#'] => return Err(Bad("a CAN FD frame has a digit of flags")),
        [b'R' | b'r', length @ ..] => id.frame(true, remote_length(length)?, &[])?,
        data => {
            // `_` and a digit say a length code beyond 8, which changes nothing that is sent.
            let data = data.split(|c| *c == b'_').next().unwrap_or(data);
            hex_run_dotted(data, bytes)?;
            id.frame(false, 8, bytes)?
        }
    };
    Ok((direction, data))
}

/// Whether this is what candump shows on the screen: an identifier and a length in brackets.
pub(crate) fn is_on_screen(rest: &[u8]) -> bool {
    let (_, rest) = after_direction(rest);
    let (id, rest) = word(rest);
    matches!(id.len(), 3 | 8) && rest.first() == Some(&b'[') && length(word(rest).0).is_some()
}

/// Reads what candump shows on the screen.
pub(crate) fn on_screen<'a>(
    rest: &[u8],
    bytes: &'a mut Vec<u8>,
) -> Result<(Option<Direction>, Data<'a>), Bad> {
    let (direction, rest) = after_direction(rest);
    let (id, rest) = word(rest);
    let (brackets, rest) = word(rest);
    let (count, fd) = length(brackets).ok_or(Bad("expected a length in brackets"))?;
    let id = Id::parse(id)?;
    bytes.clear();
    if rest.starts_with(b"remote") {
        return Ok((direction, id.frame(true, count as u8, &[])?));
    }
    // Behind the bytes candump may show them as text, or an error frame in words.
    let mut left = rest;
    while bytes.len() < count {
        let (pair, after) = word(left);
        hex_words(pair, bytes)?;
        if pair.is_empty() {
            return Err(Bad("it has fewer bytes than its length says"));
        }
        left = after;
    }
    let data = if fd { id.fd(0, bytes)? } else { id.frame(false, 8, bytes)? };
    Ok((direction, data))
}

fn after_direction(rest: &[u8]) -> (Option<Direction>, &[u8]) {
    let (first, after) = word(rest);
    let direction = match first {
        b"TX" => Direction::ToDrive,
        b"RX" => Direction::ToHost,
        _ => return (None, rest),
    };
    // Two flags follow: bit-rate switch and error state.
    (Some(direction), word(word(after).1).1)
}

/// `[8]`, and `[08]` for CAN FD.
fn length(brackets: &[u8]) -> Option<(usize, bool)> {
    let digits = brackets.strip_prefix(b"[")?.strip_suffix(b"]")?;
    let count = std::str::from_utf8(digits).ok()?.parse().ok()?;
    let fd = digits.len() == 2;
    (count <= if fd { FD_MAX } else { 8 }).then_some((count, fd))
}

/// An identifier as candump writes it.
#[derive(Clone, Copy)]
struct Id {
    number: u32,
    extended: bool,
}

impl Id {
    fn parse(digits: &[u8]) -> Result<Self, Bad> {
        let extended = match digits.len() {
            3 => false,
            8 => true,
            _ => return Err(Bad("a CAN identifier has 3 digits, or 8 when it is extended")),
        };
        let number = digits
            .iter()
            .try_fold(0u32, |id, digit| Ok(id << 4 | u32::from(hex_digit(*digit)?)))
            .map_err(|_: Bad| Bad("a CAN identifier is hexadecimal"))?;
        if !extended && number > STANDARD_MAX {
            return Err(Bad("a CAN identifier of 3 digits is at most 7FF"));
        }
        if number >= ERROR_FLAG << 1 {
            return Err(Bad("a CAN identifier of 8 digits is at most 1FFFFFFF"));
        }
        Ok(Self { number, extended })
    }

    fn frame(self, remote: bool, len: u8, bytes: &[u8]) -> Result<Data<'static>, Bad> {
        if bytes.len() > 8 {
            return Err(Bad("a CAN frame has at most 8 bytes"));
        }
        let len = if remote { len } else { bytes.len() as u8 };
        let Frame { data, .. } = classic(0, false, false, len, bytes);
        Ok(match self.extended && self.number & ERROR_FLAG != 0 {
            true => Data::Error(ErrorFrame { class: self.number & !ERROR_FLAG, data }),
            false => Data::Frame(classic(self.number, self.extended, remote, len, bytes)),
        })
    }

    fn fd(self, flags: u8, bytes: &[u8]) -> Result<Data<'_>, Bad> {
        if bytes.len() > FD_MAX {
            return Err(Bad("a CAN FD frame has at most 64 bytes"));
        }
        Ok(Data::Fd(Fd { id: self.number, extended: self.extended, flags, bytes }))
    }
}

/// Data bytes, which may have dots between them.
fn hex_run_dotted(data: &[u8], bytes: &mut Vec<u8>) -> Result<(), Bad> {
    if data.contains(&b'.') {
        return data.split(|c| *c == b'.').try_for_each(|pair| hex_run(pair, bytes));
    }
    hex_run(data, bytes)
}

fn remote_length(digits: &[u8]) -> Result<u8, Bad> {
    match digits {
        [] => Ok(0),
        [digit @ b'0'..=b'8'] | [digit @ b'0'..=b'8', b'_', ..] => Ok(digit - b'0'),
        _ => Err(Bad("a remote request has a length of 0 to 8")),
    }
}

fn direction(flag: &[u8]) -> Result<Option<Direction>, Bad> {
    match flag {
        b"" => Ok(None),
        b"T" => Ok(Some(Direction::ToDrive)),
        b"R" => Ok(Some(Direction::ToHost)),
        _ => Err(Bad("unexpected text after the CAN frame")),
    }
}
