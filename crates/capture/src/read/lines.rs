//! Formats that have a line for each record.

use super::{Bad, Damage, Place, Source, Taker};
use crate::record::Record;

/// Bytes that a line may have at most; a longer one is damaged.
pub(crate) const LINE_MAX: usize = 1 << 16;
pub(super) const TOO_LONG: Bad = Bad("it is longer than 65536 bytes");

/// Reads one line of a format.
pub(super) trait Line: core::fmt::Debug + Send {
    /// What the line says; `None` for headers, comments and what is not traffic.
    fn line<'a>(&'a mut self, line: &'a [u8]) -> Result<Option<Record<'a>>, Bad>;

    /// What the line at the head of these bytes says and how long it is with its end, where it has
    /// the form that nearly all have.
    fn usual<'a>(&'a mut self, bytes: &'a [u8]) -> Option<(Record<'a>, usize)> {
        let _ = bytes;
        None
    }
}

/// Cuts bytes into numbered lines.
#[derive(Debug)]
pub(super) struct Lines<L> {
    format: L,
    number: u64,
    /// Bytes in front of the line.
    taken: u64,
    /// The rest of this line is left out.
    skipping: bool,
}

impl<L: Line> Lines<L> {
    pub(super) fn new(format: L) -> Self {
        Self { format, number: 0, taken: 0, skipping: false }
    }

    fn take(&mut self, line: &[u8], taker: &mut dyn Taker) {
        self.number += 1;
        let read = if line.len() > LINE_MAX { Err(TOO_LONG) } else { self.format.line(line) };
        match read {
            Ok(None) => {}
            Ok(Some(record)) => taker.record(&Record { at: self.taken, ..record }),
            Err(reason) => taker.damage(Damage { place: Place::Line(self.number), reason }),
        }
    }
}

impl<L: Line> Source for Lines<L> {
    fn read(&mut self, bytes: &[u8], ended: bool, taker: &mut dyn Taker) -> usize {
        let mut used = 0;
        loop {
            let rest = &bytes[used..];
            let usual = if self.skipping { None } else { self.format.usual(rest) };
            let len = if let Some((record, len)) = usual {
                self.number += 1;
                taker.record(&Record { at: self.taken, ..record });
                len
            } else {
                let Some(end) = memchr::memchr(b'\n', rest) else { break };
                match core::mem::take(&mut self.skipping) {
                    true => {}
                    false => self.take(&rest[..end], taker),
                }
                end + 1
            };
            self.taken += len as u64;
            used += len;
        }
        let rest = &bytes[used..];
        if ended && !rest.is_empty() && !self.skipping {
            self.take(rest, taker);
        } else if rest.len() > LINE_MAX && !self.skipping {
            self.take(rest, taker);
            self.skipping = true;
        }
        if ended || self.skipping {
            self.taken += rest.len() as u64;
            return bytes.len();
        }
        used
    }

    fn pass_over(&mut self, lines: u64, bytes: u64) -> bool {
        let between = !self.skipping;
        if between {
            self.number += lines;
            self.taken += bytes;
        }
        between
    }
}
