//! One line of a capture, of either kind, and the cutting of bytes into lines.

use polepair_core::explain::Direction;
use polepair_core::medium::Frame;

use crate::stamp::Stamp;
use crate::{candump, seriallog};

/// Bytes that a line may have at most; a longer one is damaged.
pub const LINE_MAX: usize = 1 << 16;

/// What one line of a capture says.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Line<'a> {
    /// When; `None` on lines that are data alone.
    pub time: Option<Stamp>,
    /// On which link; `-` on lines that are data alone.
    pub link: &'a str,
    /// Who sent it, where the line says so.
    pub direction: Option<Direction>,
    /// What.
    pub data: Data<'a>,
}

/// What a line carries.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Data<'a> {
    /// As many bytes of a serial line as were read at once.
    Bytes(&'a [u8]),
    /// One CAN frame.
    Frame(Frame),
}

/// Why a line could not be read.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct BadLine(pub &'static str);

impl core::fmt::Display for BadLine {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(self.0)
    }
}

/// Reads one line. `None` for an empty line or a `#` or `;` comment. The bytes of a serial line are
/// put into `scratch`.
///
/// # Errors
/// What is wrong with the line, in words.
pub fn parse<'a>(line: &'a [u8], scratch: &'a mut Vec<u8>) -> Result<Option<Line<'a>>, BadLine> {
    if line.len() > LINE_MAX {
        return Err(BadLine("it is longer than 65536 bytes"));
    }
    let line = line.trim_ascii();
    match line.first() {
        None | Some(b'#' | b';') => Ok(None),
        Some(b'(') => stamped(line, scratch).map(Some),
        Some(_) => bare(line, scratch).map(Some),
    }
}

fn stamped<'a>(line: &'a [u8], scratch: &'a mut Vec<u8>) -> Result<Line<'a>, BadLine> {
    let close = line.iter().position(|c| *c == b')').ok_or(BadLine("the time stamp has no end"))?;
    let time = Stamp::parse(line[1..close].trim_ascii())
        .ok_or(BadLine("the time stamp is not seconds with decimals"))?;
    let (link, rest) = word(&line[close + 1..]);
    let link = std::str::from_utf8(link).map_err(|_| BadLine("the link's name is not text"))?;
    if link.is_empty() {
        return Err(BadLine("no link follows the time stamp"));
    }
    let (direction, data) = body(rest, scratch)?;
    Ok(Line { time: Some(time), link, direction, data })
}

/// Data alone, as `polepair encode` prints it, or after the name of a link.
fn bare<'a>(line: &'a [u8], scratch: &'a mut Vec<u8>) -> Result<Line<'a>, BadLine> {
    let (first, after) = word(line);
    let named = match after.first() {
        Some(b'>' | b'<') => !matches!(first, b">" | b"<"),
        _ => !first.contains(&b'#') && word(after).0.contains(&b'#'),
    };
    let (link, rest) = if named { (first, after) } else { (&b"-"[..], line) };
    let link = std::str::from_utf8(link).map_err(|_| BadLine("the link's name is not text"))?;
    let (direction, data) = body(rest, scratch)?;
    Ok(Line { time: None, link, direction, data })
}

fn body<'a>(
    rest: &'a [u8],
    scratch: &'a mut Vec<u8>,
) -> Result<(Option<Direction>, Data<'a>), BadLine> {
    if rest.contains(&b'#') {
        let (frame, direction) = candump::parse(rest)?;
        return Ok((direction, Data::Frame(frame)));
    }
    let direction = seriallog::parse(rest, scratch)?;
    Ok((direction, Data::Bytes(scratch)))
}

/// The first word, and what follows it without the space between.
pub(crate) fn word(text: &[u8]) -> (&[u8], &[u8]) {
    let text = text.trim_ascii_start();
    let end = text.iter().position(u8::is_ascii_whitespace).unwrap_or(text.len());
    (&text[..end], text[end..].trim_ascii_start())
}

/// Cuts a stream of bytes into numbered lines, whatever pieces it comes in.
#[derive(Debug, Default)]
pub struct Lines {
    carry: Vec<u8>,
    number: u64,
}

impl Lines {
    /// Takes a piece and gives every line that it completes, with its number from 1.
    pub fn feed(&mut self, mut piece: &[u8], each: &mut dyn FnMut(u64, &[u8])) {
        while let Some(end) = piece.iter().position(|c| *c == b'\n') {
            self.number += 1;
            if self.carry.is_empty() {
                each(self.number, &piece[..end]);
            } else {
                self.keep(&piece[..end]);
                each(self.number, &self.carry);
                self.carry.clear();
            }
            piece = &piece[end + 1..];
        }
        self.keep(piece);
    }

    /// Gives the last line, if it has no end.
    pub fn finish(&mut self, each: &mut dyn FnMut(u64, &[u8])) {
        if !self.carry.is_empty() {
            self.number += 1;
            each(self.number, &self.carry);
            self.carry.clear();
        }
    }

    /// One byte beyond the limit tells that a line is too long.
    fn keep(&mut self, piece: &[u8]) {
        let room = (LINE_MAX + 1).saturating_sub(self.carry.len());
        self.carry.extend_from_slice(&piece[..piece.len().min(room)]);
    }
}

#[cfg(test)]
mod tests {
    use super::parse;

    #[test]
    fn a_line_needs_no_time() {
        let read = |line: &[u8]| {
            let mut scratch = Vec::new();
            let line = parse(line, &mut scratch).expect("a line").expect("not empty");
            (line.link.to_owned(), line.direction.is_some(), line.time.is_some())
        };
        let expected = |link: &str, directed: bool| (link.to_owned(), directed, false);
        assert_eq!(read(b"ttyUSB0 > 01 02"), expected("ttyUSB0", true));
        assert_eq!(read(b"> 01 02"), expected("-", true));
        assert_eq!(read(b"01 02"), expected("-", false));
        assert_eq!(read(b"can0 001#0102"), expected("can0", false));
        assert_eq!(read(b"001#0102"), expected("-", false));
    }
}
