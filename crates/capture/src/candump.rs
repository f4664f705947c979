//! candump's log: `30B#5443000000000005` after the time stamp and the link; extended identifiers
//! have eight digits; `#R`, or `#R` and a length, is a remote request; `R` or `T` at the end is the
//! direction that `candump -x` adds.

use polepair_core::explain::Direction;
use polepair_core::medium::Frame;

use crate::line::{BadLine, word};
use crate::seriallog::{hex_digit, hex_run};

/// Reads one frame and the direction, if it is there.
pub(crate) fn parse(rest: &[u8]) -> Result<(Frame, Option<Direction>), BadLine> {
    let (token, rest) = word(rest);
    let hash = token.iter().position(|c| *c == b'#').ok_or(BadLine("expected IDENTIFIER#DATA"))?;
    let (id, extended) = identifier(&token[..hash])?;
    let frame = frame(id, extended, &token[hash + 1..])?;
    Ok((frame, direction(word(rest).0)?))
}

fn identifier(digits: &[u8]) -> Result<(u32, bool), BadLine> {
    let extended = match digits.len() {
        3 => false,
        8 => true,
        _ => return Err(BadLine("a CAN identifier has 3 digits, or 8 when it is extended")),
    };
    let id = digits
        .iter()
        .try_fold(0u32, |id, digit| Ok(id << 4 | u32::from(hex_digit(*digit)?)))
        .map_err(|_: BadLine| BadLine("a CAN identifier is hexadecimal"))?;
    if !extended && id > 0x7FF {
        return Err(BadLine("a CAN identifier of 3 digits is at most 7FF"));
    }
    Ok((id, extended))
}

fn frame(id: u32, extended: bool, data: &[u8]) -> Result<Frame, BadLine> {
    let mut frame = Frame { id, extended, ..Frame::default() };
    match data {
        [b'#', ..] => return Err(BadLine("CAN FD frames are not read")),
        [b'R' | b'r', length @ ..] => {
            frame.remote = true;
            frame.len = remote_length(length)?;
        }
        _ => {
            let mut bytes = Vec::with_capacity(8);
            hex_run_dotted(data, &mut bytes)?;
            if bytes.len() > 8 {
                return Err(BadLine("a CAN frame has at most 8 bytes"));
            }
            frame.len = bytes.len() as u8;
            frame.data[..bytes.len()].copy_from_slice(&bytes);
        }
    }
    Ok(frame)
}

/// Data bytes, which may have dots between them.
fn hex_run_dotted(data: &[u8], bytes: &mut Vec<u8>) -> Result<(), BadLine> {
    if data.contains(&b'.') {
        return data.split(|c| *c == b'.').try_for_each(|pair| hex_run(pair, bytes));
    }
    hex_run(data, bytes)
}

fn remote_length(digits: &[u8]) -> Result<u8, BadLine> {
    match digits {
        [] => Ok(0),
        [digit @ b'0'..=b'8'] => Ok(digit - b'0'),
        _ => Err(BadLine("a remote request has a length of 0 to 8")),
    }
}

fn direction(flag: &[u8]) -> Result<Option<Direction>, BadLine> {
    match flag {
        b"" => Ok(None),
        b"T" => Ok(Some(Direction::ToDrive)),
        b"R" => Ok(Some(Direction::ToHost)),
        _ => Err(BadLine("unexpected text after the CAN frame")),
    }
}
