//! Lines of a batch. Lines of frames without changes are built from pieces; for process data these are the
//! names of their mapping.

use polepair_core::escape::EscapedText;
use polepair_core::explain::Direction;

use super::{BYTES_WIDTH, FrameTextWriter, NoticeLevel, append_padded};
use crate::batch::{CompactFrame, FrameBatch, FrameRun, FrameTemplate, TemplateContent};
use crate::line_buffer::{HexColumns, LineBuffer, TextPiece};
use crate::line_layout::{LineLayout, protocol_word};
use crate::session::canopen::ProcessText;

/// Constant parts of all lines of a template.
struct LineTemplate<'a> {
    /// Text between the time and the bytes.
    prefix: TextPiece,
    /// Columns from the identifier's end to the meaning; `None` where they are a part of the prefix.
    bytes_width: Option<usize>,
    /// Bytes of its frames.
    len: u8,
    suffix: LineSuffix<'a>,
}

/// Text behind the bytes.
enum LineSuffix<'a> {
    ProcessData(&'a ProcessText),
    /// Constant text in all lines.
    Constant(TextPiece),
}

impl<'a> LineSuffix<'a> {
    fn new(template_content: &'a TemplateContent) -> Option<Self> {
        Some(match template_content {
            TemplateContent::ProcessData(process) => Self::ProcessData(process.text()?),
            TemplateContent::Constant(explained) => {
                let text = Some(&explained.text).filter(|text| !text.is_empty());
                let text = text.unwrap_or(&explained.kind);
                Self::Constant(TextPiece::new(format!("{}\n", EscapedText(text)).as_bytes()))
            }
        })
    }

    /// Bytes that they take at most.
    fn len_max(&self) -> usize {
        match self {
            Self::ProcessData(wording) => wording.len_max(),
            Self::Constant(piece) => piece.len(),
        }
    }

    /// Puts them and the line's end down; false where they have to be put together first.
    #[inline]
    fn append(&self, data: u64, hex: HexColumns, page: &mut LineBuffer) -> bool {
        match self {
            Self::ProcessData(wording) => wording.append_line(data, hex, page),
            Self::Constant(piece) => {
                page.push_piece(piece);
                true
            }
        }
    }
}

impl FrameTextWriter {
    /// Appends the lines of a batch. Marks of changed bytes need all batches in their order, all else
    /// needs none but this one.
    pub fn write_batch(&mut self, batch: &FrameBatch, out: &mut Vec<u8>) {
        self.layout = batch.layout;
        let style = self.style;
        if style.colour || style.marks || style.notices == NoticeLevel::All {
            return batch.for_each_frame(&mut |event| self.write(event, out));
        }
        let mut page = core::mem::take(&mut self.buffer);
        let (mut head, mut lines) = (self.layout, line_templates(batch, self.layout));
        for decoded in batch.runs() {
            match decoded {
                FrameRun::Compact(run) => {
                    for plain in run {
                        let at = usize::from(plain.template);
                        let line = lines.get(at).and_then(Option::as_ref);
                        if !line.is_some_and(|line| line.append(plain, self.layout, &mut page, out))
                        {
                            page.flush(out);
                            let voice = &batch.templates()[at];
                            voice.expand(plain, &mut |event| self.write(event, out));
                        }
                    }
                }
                FrameRun::Stored(at) => {
                    page.flush(out);
                    batch.with_stored(at, |event| self.write(event, out));
                    if self.layout != head {
                        (head, lines) = (self.layout, self::line_templates(batch, self.layout));
                    }
                }
            }
        }
        page.flush(out);
        self.buffer = page;
    }
}

/// The lines of a batch's templates; `None` for those that are not put together so.
fn line_templates(batch: &FrameBatch, head: LineLayout) -> Vec<Option<LineTemplate<'_>>> {
    batch.templates().iter().map(|voice| LineTemplate::new(voice, head)).collect()
}

impl<'a> LineTemplate<'a> {
    fn new(voice: &'a FrameTemplate, head: LineLayout) -> Option<Self> {
        /// Columns of an identifier of 11 bits.
        const ID: usize = 4;
        let mut front = Vec::new();
        append_padded(&voice.link, head.link_width, &mut front);
        front.extend_from_slice(match voice.direction {
            Some(Direction::ToDrive) => b" > ",
            Some(Direction::ToHost) => b" < ",
            None => b"   ",
        });
        append_padded(protocol_word(Some(voice.protocol)), head.protocol_width, &mut front);
        front.extend_from_slice(b"  ");
        let Some(id) = voice.id else { return Self::of_serial(voice, front) };
        front.extend_from_slice(
            &id.to_be_bytes().map(crate::number_text::hex_digits).as_flattened()[5..],
        );
        front.push(b'#');
        let shown = (3 * usize::from(voice.len)).saturating_sub(1);
        let bytes = (shown + ID).max(BYTES_WIDTH) + 2 - ID;
        let (front, len, words) =
            (TextPiece::new(&front), voice.len, LineSuffix::new(&voice.content)?);
        Self { prefix: front, bytes_width: Some(bytes), len, suffix: words }.checked()
    }

    /// The line of frames of a serial line: all of it is the same.
    fn of_serial(voice: &'a FrameTemplate, mut front: Vec<u8>) -> Option<Self> {
        let begin = front.len();
        crate::text::append_spaced_hex(&mut front, &voice.serial);
        let width = (front.len() - begin).max(BYTES_WIDTH) + 2;
        front.resize(begin + width, b' ');
        let suffix = LineSuffix::new(&voice.content)?;
        Self { prefix: TextPiece::new(&front), bytes_width: None, len: voice.len, suffix }.checked()
    }

    /// The line, if a page has room for it.
    fn checked(self) -> Option<Self> {
        let capacity = self.prefix.len() + 3 * LineBuffer::NUMBER_MAX + self.suffix.len_max();
        (capacity <= LineBuffer::LINE_MAX).then_some(self)
    }

    /// Puts a line down; false where it has words that have to be put together first.
    #[inline]
    fn append(
        &self,
        plain: &CompactFrame,
        head: LineLayout,
        page: &mut LineBuffer,
        out: &mut Vec<u8>,
    ) -> bool {
        let Some(since) = head.first.map(|first| plain.time.since(first)) else { return false };
        if since / 1_000_000_000 > LineBuffer::SECONDS_MAX {
            return false;
        }
        let begin = page.begin_line(out);
        let hex = HexColumns::new(plain.data, self.len);
        page.push_time(since);
        page.push_piece(&self.prefix);
        if let Some(width) = self.bytes_width {
            page.push_hex(hex, width);
        }
        let matches = self.suffix.append(plain.data, hex, page);
        if !matches {
            page.rewind(begin);
        }
        matches
    }
}
