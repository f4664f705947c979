//! Lines of a batch: those of frames that change nothing are put together out of pieces, which for
//! process data are their mapping's words.

use polepair_core::explain::Direction;

use super::{BYTES_WIDTH, Head, Notices, Text, padded, word};
use crate::batch::{Batch, Decoded, Plain, Said, Voice};
use crate::page::{Hex, Page, Piece};
use crate::session::canopen::{Process, Wording};

/// What is the same in all lines of a voice.
struct Line<'a> {
    /// What stands between the time and the bytes.
    front: Piece,
    /// Columns from the identifier's end to the meaning.
    bytes: usize,
    /// Bytes of its frames.
    len: u8,
    words: Words<'a>,
}

/// What stands behind the bytes.
enum Words<'a> {
    Process(&'a Process, &'a Wording),
    /// The same in all lines.
    Same(Piece),
}

impl<'a> Words<'a> {
    fn new(said: &'a Said) -> Option<Self> {
        Some(match said {
            Said::Process(process) => Self::Process(process, process.wording()?),
            Said::Same(explained) => {
                let text = Some(&explained.text).filter(|text| !text.is_empty());
                let text = text.unwrap_or(&explained.kind);
                Self::Same(Piece::new(format!("{text}\n").as_bytes()))
            }
        })
    }

    /// Bytes that they take at most.
    fn room(&self) -> usize {
        match self {
            Self::Process(_, wording) => wording.room(),
            Self::Same(piece) => piece.len(),
        }
    }

    /// Puts them and the line's end down; false where they have to be put together first.
    #[inline]
    fn put(&self, data: u64, hex: (Hex, u8), page: &mut Page) -> bool {
        match self {
            Self::Process(process, wording) => wording.put(process.mapping(), data, hex, page),
            Self::Same(piece) => {
                page.piece(piece);
                true
            }
        }
    }
}

impl Text {
    /// Appends the lines of a batch. Marks of changed bytes need all batches in their order, all else
    /// needs none but this one.
    pub fn write_batch(&mut self, batch: &Batch, out: &mut Vec<u8>) {
        self.head = batch.head;
        let style = self.style;
        if style.colour || style.marks || style.notices == Notices::All {
            return batch.each(&mut |event| self.write(event, out));
        }
        let mut page = core::mem::take(&mut self.page);
        let (mut head, mut lines) = (self.head, lines(batch, self.head));
        for decoded in batch.decoded() {
            match decoded {
                Decoded::Plain(run) => {
                    for plain in run {
                        let at = usize::from(plain.voice);
                        let line = lines.get(at).and_then(Option::as_ref);
                        if !line.is_some_and(|line| line.put(plain, self.head, &mut page, out)) {
                            page.turn(out);
                            let voice = &batch.voices()[at];
                            voice.each(plain, &mut |event| self.write(event, out));
                        }
                    }
                }
                Decoded::Told(at) => {
                    page.turn(out);
                    batch.told(at, |event| self.write(event, out));
                    if self.head != head {
                        (head, lines) = (self.head, self::lines(batch, self.head));
                    }
                }
            }
        }
        page.turn(out);
        self.page = page;
    }
}

/// The lines of a batch's voices; `None` for those that are not put together so.
fn lines(batch: &Batch, head: Head) -> Vec<Option<Line<'_>>> {
    batch.voices().iter().map(|voice| Line::new(voice, head)).collect()
}

impl<'a> Line<'a> {
    fn new(voice: &'a Voice, head: Head) -> Option<Self> {
        /// Columns of an identifier of 11 bits.
        const ID: usize = 4;
        let mut front = Vec::new();
        padded(&voice.link, head.link_width, &mut front);
        front.extend_from_slice(match voice.direction {
            Some(Direction::ToDrive) => b" > ",
            Some(Direction::ToHost) => b" < ",
            None => b"   ",
        });
        padded(word(Some(voice.protocol)), head.protocol_width, &mut front);
        front.extend_from_slice(b"  ");
        front.extend_from_slice(&voice.id.to_be_bytes().map(crate::put::hex).as_flattened()[5..]);
        front.push(b'#');
        let shown = (3 * usize::from(voice.len)).saturating_sub(1);
        let bytes = (shown + ID).max(BYTES_WIDTH) + 2 - ID;
        let (front, len, words) = (Piece::new(&front), voice.len, Words::new(&voice.said)?);
        let line = Self { front, bytes, len, words };
        let room = line.front.len() + 3 * Page::NUMBER + line.words.room();
        (room <= Page::LINE_MAX).then_some(line)
    }

    /// Puts a line down; false where it has words that have to be put together first.
    #[inline]
    fn put(&self, plain: &Plain, head: Head, page: &mut Page, out: &mut Vec<u8>) -> bool {
        let Some(since) = head.first.map(|first| plain.time.since(first)) else { return false };
        if since / 1_000_000_000 > Page::SECONDS_MAX {
            return false;
        }
        let begin = page.line(out);
        let hex = Hex::new(plain.data, self.len);
        page.time(since);
        page.piece(&self.front);
        page.hex(hex, self.bytes);
        let said = self.words.put(plain.data, (hex, self.len), page);
        if !said {
            page.back(begin);
        }
        said
    }
}
