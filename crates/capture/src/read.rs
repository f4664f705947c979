//! Bytes of a capture file in, records out: whatever the format, however the bytes are cut.
//!
//! ```text
//!   bytes     pieces of a file, of stdin, of a file that still grows
//!    └ unpack gzip or Zstandard, when the first bytes say so
//!       └ Source   one for each format: takes whole records off the head of what is there
//! ```
//! Damage is named by its place and skipped; reading goes on where the format lets it.

mod asc;
pub(crate) mod blf;
mod candump;
mod csv;
mod digits;
mod jsonl;
mod lines;
pub(crate) mod linktype;
mod pcap;
mod pcapng;
mod scan;
mod seriallog;
mod text;
mod trc;
mod unpack;

use core::fmt;

use crate::format::{Format, HEAD_MAX, Packing};
use crate::record::Record;
#[cfg(test)]
pub(crate) use lines::LINE_MAX;
use lines::Lines;
pub use scan::Scan;
pub use text::parse;
use unpack::Unpack;
pub use unpack::unpacked;

/// Damaged places that are remembered one by one; more are only counted.
pub const DAMAGE_MAX: usize = 100;
/// Bytes that one record, or one compressed block of records, may have.
pub(crate) const BLOCK_MAX: usize = 1 << 26;

/// Why something could not be read.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Bad(pub &'static str);

impl fmt::Display for Bad {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.0)
    }
}

/// Where in a capture.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
pub enum Place {
    /// The line of that number, from 1.
    Line(u64),
    /// The byte of that number, from 0; of what was unpacked, if the file is compressed.
    Byte(u64),
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Line(number) => write!(f, "line {number}"),
            Self::Byte(number) => write!(f, "byte {number}"),
        }
    }
}

/// A part of a capture that could not be read.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Damage {
    /// Where it begins.
    pub place: Place,
    /// What is wrong with it.
    pub reason: Bad,
}

impl fmt::Display for Damage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.place, self.reason)
    }
}

/// Takes what a capture holds.
pub(crate) trait Taker {
    /// Takes a record.
    fn record(&mut self, record: &Record<'_>);
    /// Takes note of a part that cannot be read.
    fn damage(&mut self, damage: Damage);
}

/// The reader of one format.
pub(crate) trait Source: fmt::Debug + Send {
    /// Takes what is whole off the head of `bytes` and says how many bytes that were. When the
    /// capture has `ended` no more will come: what is not whole is damage.
    fn read(&mut self, bytes: &[u8], ended: bool, taker: &mut dyn Taker) -> usize;

    /// So many lines and bytes in front of what comes next were read elsewhere. False where that
    /// cannot be: it is not between lines.
    fn pass_over(&mut self, lines: u64, bytes: u64) -> bool {
        let _ = (lines, bytes);
        false
    }
}

/// Reads a capture in pieces, cut anywhere. Memory stays bounded however long the capture is.
#[derive(Debug, Default)]
pub struct Reader {
    packing: Packed,
    plain: Plain,
}

/// Whether a capture is compressed.
#[derive(Debug)]
enum Packed {
    /// Its first bytes, too few to tell.
    Unknown(Vec<u8>),
    No,
    Yes(Box<Unpack>),
}

impl Default for Packed {
    fn default() -> Self {
        Self::Unknown(Vec::new())
    }
}

/// Uncompressed bytes, and their reader.
#[derive(Debug, Default)]
struct Plain {
    stated: Option<Format>,
    source: Option<(Format, Box<dyn Source>)>,
    /// Bytes that wait for more.
    carry: Vec<u8>,
    /// Bytes that came in all.
    came: u64,
    tally: Tally,
}

/// What was read, and what could not be.
#[derive(Clone, Debug, Default)]
pub struct Tally {
    /// Records read.
    pub records: u64,
    /// Places that could not be read.
    pub damaged: u64,
    /// The first of them.
    pub damage: Vec<Damage>,
}

/// Passes records on and counts.
struct Counting<'a> {
    tally: &'a mut Tally,
    out: &'a mut dyn FnMut(&Record<'_>),
}

impl Taker for Counting<'_> {
    fn record(&mut self, record: &Record<'_>) {
        self.tally.records += 1;
        (self.out)(record);
    }

    fn damage(&mut self, damage: Damage) {
        self.tally.note(damage);
    }
}

impl Tally {
    /// Takes note of a damaged place.
    pub(crate) fn note(&mut self, damage: Damage) {
        self.damaged += 1;
        if self.damage.len() < DAMAGE_MAX {
            self.damage.push(damage);
        }
    }
}

impl Reader {
    /// A reader that holds to a format, or tells it by the first bytes.
    #[must_use]
    pub fn new(stated: Option<Format>) -> Self {
        let plain = Plain { stated, ..Plain::default() };
        Self { plain, ..Self::default() }
    }

    /// The format, once it is told.
    #[must_use]
    pub fn format(&self) -> Option<Format> {
        self.plain.source.as_ref().map(|(format, _)| *format)
    }

    /// What was read so far, and what could not be.
    #[must_use]
    pub fn tally(&self) -> &Tally {
        &self.plain.tally
    }

    /// Takes a piece of the capture and gives every record that it completes.
    pub fn feed(&mut self, piece: &[u8], out: &mut dyn FnMut(&Record<'_>)) {
        match &mut self.packing {
            Packed::No => self.plain.feed(piece, false, out),
            Packed::Yes(unpack) => {
                unpack.feed(piece, &mut |piece| self.plain.feed(piece, false, out));
            }
            Packed::Unknown(head) => {
                head.extend_from_slice(piece);
                if head.len() >= Packing::HEAD {
                    self.open(out);
                }
            }
        }
    }

    /// Takes note that so many lines, each a record, were read elsewhere. False where that cannot be:
    /// it is not between lines of a log.
    pub(crate) fn pass_over(&mut self, lines: u64, bytes: u64) -> bool {
        let plain = &mut self.plain;
        let whole = matches!(self.packing, Packed::No) && plain.carry.is_empty();
        let Some((Format::Text, source)) = plain.source.as_mut().filter(|_| whole) else {
            return false;
        };
        let between = source.pass_over(lines, bytes);
        if between {
            plain.came += bytes;
            plain.tally.records += lines;
        }
        between
    }

    /// Bytes that came so far, unpacked.
    pub(crate) const fn came(&self) -> u64 {
        self.plain.came
    }

    /// Ends the capture: what waits for more is damage.
    pub fn finish(&mut self, out: &mut dyn FnMut(&Record<'_>)) {
        if matches!(self.packing, Packed::Unknown(_)) {
            self.open(out);
        }
        if let Packed::Yes(unpack) = &mut self.packing {
            let ended = unpack.finish(&mut |piece| self.plain.feed(piece, false, out));
            if let Err(reason) = ended {
                let place = Place::Byte(self.plain.came);
                self.plain.tally.note(Damage { place, reason });
            }
        }
        self.plain.feed(&[], true, out);
    }

    /// Goes on with the first bytes, now that there are enough of them.
    fn open(&mut self, out: &mut dyn FnMut(&Record<'_>)) {
        let Packed::Unknown(head) = core::mem::take(&mut self.packing) else { return };
        self.packing = Packing::of_head(&head)
            .map_or(Packed::No, |packing| Packed::Yes(Box::new(Unpack::new(packing))));
        self.feed(&head, out);
    }
}

impl Plain {
    fn feed(&mut self, piece: &[u8], ended: bool, out: &mut dyn FnMut(&Record<'_>)) {
        self.came += piece.len() as u64;
        let Self { stated, source, carry, tally, .. } = self;
        let mut taker = Counting { tally, out };
        if let (Some((_, source)), true) = (&mut *source, carry.is_empty()) {
            let used = source.read(piece, ended, &mut taker);
            carry.extend_from_slice(&piece[used..]);
            return;
        }
        carry.extend_from_slice(piece);
        if source.is_none() {
            let head = &carry[..carry.len().min(HEAD_MAX)];
            let Some(format) = stated.or_else(|| Format::of_head(head, ended)) else { return };
            *source = Some((format, open(format)));
        }
        if let Some((_, source)) = source {
            let used = source.read(carry, ended, &mut taker);
            carry.drain(..used);
        }
    }
}

fn open(format: Format) -> Box<dyn Source> {
    match format {
        Format::Text => Box::new(Lines::new(text::Text::default())),
        Format::Asc => Box::new(Lines::new(asc::Asc::default())),
        Format::Trc => Box::new(Lines::new(trc::Trc::default())),
        Format::Csv => Box::new(Lines::new(csv::Csv::default())),
        Format::Jsonl => Box::new(Lines::new(jsonl::Jsonl::default())),
        Format::Pcap => Box::new(pcap::Pcap::default()),
        Format::Pcapng => Box::new(pcapng::Pcapng::default()),
        Format::Blf => Box::new(blf::Blf::default()),
    }
}

#[cfg(test)]
mod tests;
