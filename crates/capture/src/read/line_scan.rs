//! Finds and reads lines of candump's log and of serial logs without state of earlier lines, so pieces of a
//! capture can be read on several threads.

use super::lines::{UsualData, UsualLine};
use super::text::{LineContext, parse_usual_line};
use crate::record::Record;

/// Lines that are looked at before a piece is given up in which there are no such lines.
const TRIES: usize = 64;

/// The lines of one piece that are in their usual form. All others are for a reader.
#[derive(Debug, Default)]
pub struct LineScan {
    lines: Vec<ScannedLine>,
    links: Vec<String>,
}

/// One line.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ScannedLine {
    /// Start of the line, and of the next one.
    pub start: usize,
    pub end: usize,
    /// On which of the links.
    pub link: u8,
    time: crate::Timestamp,
    data: UsualData,
}

impl ScannedLine {
    /// Returns whether it is of a serial line.
    pub(crate) const fn is_serial(&self) -> bool {
        matches!(self.data, UsualData::Serial(..))
    }
}

impl LineScan {
    /// Limit of distinguished links of one piece.
    pub(crate) const LINKS_MAX: usize = 64;

    /// Looks through a piece that begins where a line does.
    pub fn scan(&mut self, piece: &[u8]) {
        self.lines.clear();
        self.links.clear();
        let (mut at, mut before, mut tried) = (0, LineContext::default(), 0);
        // The link of the line before, and how often it had changed by then.
        let (mut number, mut changes) = (0, 0);
        while at < piece.len() {
            let rest = &piece[at..];
            if let Some(UsualLine { time, data, bytes }) = parse_usual_line(rest, &mut before)
                && let Some(same) = if before.link_changes() == changes {
                    Some(number)
                } else {
                    link_index(&mut self.links, before.link())
                }
            {
                if self.lines.is_empty() {
                    // The other lines are likely to be as long.
                    self.lines.reserve(piece.len() / bytes + 1);
                }
                (number, changes, at) = (same, before.link_changes(), at + bytes);
                self.lines.push(ScannedLine {
                    start: at - bytes,
                    end: at,
                    link: number as u8,
                    time,
                    data,
                });
                continue;
            }
            tried += 1;
            let end = memchr::memchr(b'\n', rest);
            let Some(end) = end.filter(|_| tried < TRIES || !self.lines.is_empty()) else { return };
            at += end + 1;
        }
    }

    /// The lines in order.
    pub(crate) fn lines(&self) -> &[ScannedLine] {
        &self.lines
    }

    /// Record of a line, in a capture with `before` bytes before the piece.
    pub(crate) fn line_record<'a>(&'a self, line: &'a ScannedLine, before: u64) -> Record<'a> {
        let link = self.links.get(usize::from(line.link)).map_or("-", String::as_str);
        let (direction, data) = line.data.record_parts();
        let (time, offset) = (Some(line.time), before + line.start as u64);
        Record { time, link, direction, data, offset }
    }
}

/// Index of the link with this name, which is added if it is new.
fn link_index(links: &mut Vec<String>, link: &str) -> Option<usize> {
    let known = links.iter().position(|known| known == link);
    known.or_else(|| {
        (links.len() < LineScan::LINKS_MAX).then(|| {
            links.push(link.to_owned());
            links.len() - 1
        })
    })
}
