//! Lines of a batch. Lines of frames without changes are built from pieces; for process data these are the
//! names of their mapping.

use polepair_core::escape::EscapedText;
use polepair_core::explain::{Direction, NumberPlace, NumberStyle};

use super::{
    BYTES_WIDTH, DurationParts, DurationText, FrameTextWriter, NoticeLevel, append_padded,
    latency_of,
};
use crate::batch::{
    AnswerFrame, CompactFrame, FrameBatch, FrameBuffers, FrameRun, FrameTemplate, TemplateContent,
};
use crate::explanation::{Explanation, RESTATED_MAX};
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
    /// The first of them that is not a part of the prefix.
    data_start: u8,
    suffix: LineSuffix<'a>,
}

/// Text behind the bytes.
enum LineSuffix<'a> {
    ProcessData(&'a ProcessText),
    /// Constant text in all lines.
    Constant(TextPiece),
    /// Numbers, each with the text before it, and the text behind all.
    Answer(Vec<(TextPiece, NumberPlace, NumberStyle)>, TextPiece),
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
            TemplateContent::Answer(explained) => Self::of_answer(explained)?,
        })
    }

    fn of_answer(explained: &Explanation) -> Option<Self> {
        let text = explained.text.as_str();
        let mut numbers = Vec::new();
        let mut from = 0;
        for number in explained.text_numbers() {
            let before = text.get(from..number.start)?;
            numbers.push((escaped_piece(before), number.place, number.style));
            from = number.end;
        }
        let rest = if text.is_empty() { &explained.kind } else { text.get(from..)? };
        Some(Self::Answer(numbers, escaped_piece(rest)))
    }

    /// Bytes that they take at most.
    fn len_max(&self) -> usize {
        match self {
            Self::ProcessData(wording) => wording.len_max(),
            Self::Constant(piece) => piece.len(),
            Self::Answer(numbers, rest) => {
                let lens = numbers.iter().map(|(before, ..)| before.len() + LineBuffer::NUMBER_MAX);
                lens.sum::<usize>() + rest.len()
            }
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
            Self::Answer(..) => false,
        }
    }

    /// Puts the text of an answer down, without the line's end.
    fn append_answer(&self, frame: &[u8], page: &mut LineBuffer) -> bool {
        let Self::Answer(numbers, rest) = self else { return false };
        for (before, place, style) in numbers {
            page.push_piece(before);
            let Some(number) = place.decode(frame) else { return false };
            match style {
                NumberStyle::Whole => page.push_signed(number),
                NumberStyle::Tenths | NumberStyle::Hex(_) | NumberStyle::Scaled(_) => {
                    let Some(digits) = style.text_of(number) else { return false };
                    page.push_bytes(digits.as_bytes());
                }
            }
        }
        page.push_piece(rest);
        true
    }
}

fn escaped_piece(text: &str) -> TextPiece {
    TextPiece::new(EscapedText(text).to_string().as_bytes())
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
        let mut buffers = FrameBuffers::default();
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
                FrameRun::Answer(answer) => {
                    let latency = latency_of(batch.notices(answer));
                    let latency = latency.filter(|_| style.notices != NoticeLevel::None);
                    let line = lines.get(usize::from(answer.frame.template));
                    let line = line.and_then(Option::as_ref);
                    if !line.is_some_and(|line| {
                        line.append_answer(answer, self.layout, latency, &mut page, out)
                    }) {
                        page.flush(out);
                        batch.with_answer(answer, &mut buffers, |event| self.write(event, out));
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
        let (data_start, len) = (usize::from(voice.data_start), usize::from(voice.len));
        let begin = front.len();
        match voice.id {
            Some(id) => {
                front.extend_from_slice(
                    &id.to_be_bytes().map(crate::number_text::hex_digits).as_flattened()[5..],
                );
                front.push(b'#');
            }
            None => {
                crate::text::append_spaced_hex(&mut front, &voice.serial[..data_start]);
                front.extend_from_slice(if data_start > 0 { b" " } else { b"" });
            }
        }
        let id_width = if voice.id.is_some() { ID } else { 0 };
        let width = ((3 * len).saturating_sub(1) + id_width).max(BYTES_WIDTH) + 2;
        // Bytes that all frames have are a part of the prefix.
        let mut bytes_width = Some((begin + width).saturating_sub(front.len()));
        if data_start == len && voice.id.is_none() {
            front.resize(begin + width, b' ');
            bytes_width = None;
        }
        let suffix = LineSuffix::new(&voice.content)?;
        let (prefix, len, data_start) = (TextPiece::new(&front), voice.len, voice.data_start);
        Self { prefix, bytes_width, len, data_start, suffix }.checked()
    }

    /// The line, if a page has room for it.
    fn checked(self) -> Option<Self> {
        let capacity = self.prefix.len() + 3 * LineBuffer::NUMBER_MAX + self.suffix.len_max();
        (capacity <= LineBuffer::LINE_MAX).then_some(self)
    }

    /// Puts the line of an answer down, with the nanoseconds that it took; false where it has words that have to be put
    /// together first.
    fn append_answer(
        &self,
        answer: &AnswerFrame,
        head: LineLayout,
        latency: Option<u64>,
        page: &mut LineBuffer,
        out: &mut Vec<u8>,
    ) -> bool {
        let plain = &answer.frame;
        let Some(since) = head.first.map(|first| plain.time.since(first)) else { return false };
        if since / 1_000_000_000 > LineBuffer::SECONDS_MAX {
            return false;
        }
        let begin = page.begin_line(out);
        page.push_time(since);
        page.push_piece(&self.prefix);
        let hex = HexColumns::new(plain.data, self.len - self.data_start);
        page.push_hex(hex, self.bytes_width.unwrap_or_default());
        let mut frame = [0; RESTATED_MAX];
        let data = plain.data.to_le_bytes();
        let start = usize::from(self.data_start);
        frame[start..start + data.len()].copy_from_slice(&data);
        let matches = self.suffix.append_answer(&frame, page);
        if !matches {
            page.rewind(begin);
            return false;
        }
        if let Some(ns) = latency {
            const ZERO: u64 = b'0' as u64;
            let DurationParts { whole, rest, decimals, unit } = DurationText(ns).parts();
            page.push_word(u64::from_le_bytes(*b"  (     "), 3);
            page.push_signed(whole.cast_signed());
            if decimals > 0 {
                page.push_word(b'.'.into(), 1);
                let first = if decimals == 2 { rest / 10 } else { rest };
                page.push_word(first + ZERO, 1);
                page.push_word(rest % 10 + ZERO, decimals - 1);
            }
            page.push_bytes(unit);
            page.push_word(b')'.into(), 1);
        }
        page.push_word(b'\n'.into(), 1);
        true
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
