//! A batch of decoded frames in their order, not written yet. A frame without changes has its bytes only,
//! others have their full text. A writer needs nothing else, and may run on another thread.

use std::sync::Arc;

use polepair_core::explain::Direction;

use crate::decoder::DecodedFrame;
use crate::defect::FrameDefect;
use crate::explanation::Explanation;
use crate::line_layout::LineLayout;
use crate::record::Record;
use crate::session::SessionNotice;
use crate::session::canopen::ProcessData;
use crate::timestamp::Timestamp;

/// Frames of one batch: its memory stays bounded, whatever the capture holds.
const FRAMES_MAX: usize = 1 << 15;
/// Limit of stored frames and their explanations, bytes.
const STORED_BYTES_MAX: usize = 1 << 23;
/// Templates of one batch: each mapping is one, and each frame that is repeated.
const TEMPLATES_MAX: usize = 1 << 12;

/// Frames that were decoded.
#[derive(Debug, Default)]
pub struct FrameBatch {
    pub(crate) layout: LineLayout,
    /// Frames that change nothing, in order.
    compact: Vec<CompactFrame>,
    templates: Vec<FrameTemplate>,
    stored: Vec<StoredFrame>,
    answers: Vec<AnswerFrame>,
    /// Notices of all answers.
    answer_notices: Vec<SessionNotice>,
    /// Frames that are not compact, in order, with the number of compact frames before each.
    others: Vec<(usize, OtherFrame)>,
    /// Stored frames of this batch; others keep their buffers.
    stored_count: usize,
    stored_bytes: usize,
    stopped: bool,
}

/// Frames that stand one behind the other.
#[derive(Clone, Copy, Debug)]
pub enum FrameRun<'a> {
    /// Some that change nothing.
    Compact(&'a [CompactFrame]),
    /// An answer that differs from an earlier one in its numbers.
    Answer(&'a AnswerFrame),
    /// Any other; which one.
    Stored(usize),
}

/// A frame that is not compact, by its index.
#[derive(Clone, Copy, Debug)]
enum OtherFrame {
    Stored(usize),
    Answer(usize),
}

/// An answer that has a template, with the notices of its conversation. These are values and the end of an exchange.
#[derive(Clone, Debug)]
pub struct AnswerFrame {
    /// The frame. Its data begin at the template's [`data_start`](FrameTemplate::data_start).
    pub frame: CompactFrame,
    /// Range of the notices among those of the batch.
    notices: core::ops::Range<usize>,
}

/// A frame that changes nothing.
#[derive(Clone, Copy, Debug)]
pub struct CompactFrame {
    /// Index of its [template](FrameBatch::templates).
    pub template: u16,
    /// Data, the first byte lowest.
    pub data: u64,
    /// Number in the capture.
    pub number: u64,
    /// Time of arrival.
    pub time: Timestamp,
    /// Byte of the capture at which its record begins.
    pub offset: u64,
}

/// Common properties of frames with one identifier that have one mapping, or the same bytes.
#[derive(Clone, Debug)]
pub struct FrameTemplate {
    /// Content of the frames.
    pub content: TemplateContent,
    /// On which link.
    pub link: Arc<str>,
    /// The protocol.
    pub protocol: &'static str,
    /// Sender of the frames.
    pub direction: Option<Direction>,
    /// CAN identifier of 11 bits; `None` on a serial line.
    pub id: Option<u32>,
    /// Number of bytes they have.
    pub len: u8,
    /// Bytes of frames of a serial line, which are the same up to `data_start`; empty on CAN.
    pub serial: Box<[u8]>,
    /// Byte at which the data of an answer begin; the length of frames that are all the same.
    pub data_start: u8,
}

/// Content of frames that change nothing.
#[derive(Clone, Debug)]
pub enum TemplateContent {
    /// Process data: each what its bytes are.
    ProcessData(Arc<ProcessData>),
    /// All the same, for their bytes are.
    Constant(Arc<Explanation>),
    /// Answers that differ in numbers, which this explanation of one of them names.
    Answer(Arc<Explanation>),
}

/// Content of one frame, borrowed.
#[derive(Clone, Copy)]
pub(crate) enum ContentRef<'a> {
    ProcessData(&'a Arc<ProcessData>),
    Constant(&'a Arc<Explanation>),
    Answer(&'a Arc<Explanation>),
}

/// Common properties of frames, to find their template or make it.
#[derive(Clone, Copy)]
pub(crate) struct TemplateSource<'a> {
    pub content: ContentRef<'a>,
    pub link: &'a Arc<str>,
    pub protocol: &'static str,
    /// CAN identifier of 11 bits; `None` on a serial line.
    pub id: Option<u32>,
    pub bytes: &'a [u8],
}

impl TemplateSource<'_> {
    fn matches(&self, known: &FrameTemplate, direction: Option<Direction>) -> bool {
        self.content.matches(&known.content)
            && (known.id, usize::from(known.len)) == (self.id, self.bytes.len())
            && known.direction == direction
            && Arc::ptr_eq(&known.link, self.link)
    }

    fn to_template(self, direction: Option<Direction>) -> FrameTemplate {
        let Self { content, link, protocol, id, bytes } = self;
        let len = bytes.len() as u8;
        FrameTemplate {
            content: content.to_content(),
            link: Arc::clone(link),
            protocol,
            direction,
            id,
            len,
            serial: if id.is_none() { bytes.into() } else { Box::default() },
            data_start: match (content, id) {
                // An answer's numbers are near its end.
                (ContentRef::Answer(_), None) => len.saturating_sub(DATA_MAX),
                (_, None) => len,
                (_, Some(_)) => 0,
            },
        }
    }
}

/// Bytes of the data of a compact frame.
pub(crate) const DATA_MAX: u8 = 8;

/// The data of a compact frame, the first byte lowest.
fn data_of(bytes: &[u8]) -> u64 {
    let mut data = [0; DATA_MAX as usize];
    data[..bytes.len()].copy_from_slice(bytes);
    u64::from_le_bytes(data)
}

impl ContentRef<'_> {
    #[inline]
    fn matches(self, template_content: &TemplateContent) -> bool {
        match (self, template_content) {
            (Self::ProcessData(one), TemplateContent::ProcessData(other)) => {
                Arc::ptr_eq(one, other)
            }
            (Self::Constant(one), TemplateContent::Constant(other))
            | (Self::Answer(one), TemplateContent::Answer(other)) => Arc::ptr_eq(one, other),
            _ => false,
        }
    }

    fn to_content(self) -> TemplateContent {
        match self {
            Self::ProcessData(process) => TemplateContent::ProcessData(Arc::clone(process)),
            Self::Constant(explained) => TemplateContent::Constant(Arc::clone(explained)),
            Self::Answer(explained) => TemplateContent::Answer(Arc::clone(explained)),
        }
    }
}

/// Buffers for the bytes, text and values of frames that have a template.
#[derive(Debug, Default)]
pub struct FrameBuffers {
    bytes: Vec<u8>,
    explanation: Explanation,
    notices: Vec<SessionNotice>,
}

/// An event that is kept.
#[derive(Debug, Default)]
struct StoredFrame {
    number: u64,
    time: Option<Timestamp>,
    link: String,
    direction: Option<Direction>,
    protocol: Option<&'static str>,
    bytes: Vec<u8>,
    id: Option<u32>,
    extended: bool,
    remote: bool,
    remote_len: u8,
    echo: bool,
    stray: bool,
    explanation: Explanation,
    defect: Option<FrameDefect>,
    notices: Vec<SessionNotice>,
    offset: u64,
}

impl FrameBatch {
    /// Forgets everything; `head` is how far lines have come.
    pub(crate) fn reset(&mut self, head: LineLayout) {
        self.layout = head;
        self.compact.clear();
        self.templates.clear();
        self.answers.clear();
        self.answer_notices.clear();
        self.others.clear();
        self.stored_count = 0;
        self.stored_bytes = 0;
    }

    /// No more of the piece under way is wanted.
    pub(crate) const fn stop(&mut self) {
        self.stopped = true;
    }

    /// Returns whether the batch is stopped, until a piece begins.
    pub(crate) const fn is_stopped(&self) -> bool {
        self.stopped
    }

    /// A piece begins; `head` is how far lines have come.
    pub(crate) fn begin_chunk(&mut self, head: LineLayout) {
        self.stopped = false;
        self.reset(head);
    }

    /// True without a frame.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Number of frames it has.
    #[must_use]
    pub const fn len(&self) -> usize {
        self.compact.len() + self.others.len()
    }

    /// Returns whether it has as many frames as it should.
    pub(crate) const fn is_full(&self) -> bool {
        self.len() >= FRAMES_MAX || self.stored_bytes >= STORED_BYTES_MAX
    }

    /// Frames in order.
    pub fn runs(&self) -> impl Iterator<Item = FrameRun<'_>> {
        let (mut from, mut reported) = (0, 0);
        core::iter::from_fn(move || {
            let next = self.others.get(reported).copied();
            let run = &self.compact[from..next.map_or(self.compact.len(), |(before, _)| before)];
            if !run.is_empty() {
                from += run.len();
                return Some(FrameRun::Compact(run));
            }
            reported += 1;
            Some(match next?.1 {
                OtherFrame::Stored(at) => FrameRun::Stored(at),
                OtherFrame::Answer(at) => FrameRun::Answer(&self.answers[at]),
            })
        })
    }

    /// Templates of its frames that change nothing.
    #[must_use]
    pub fn templates(&self) -> &[FrameTemplate] {
        &self.templates
    }

    /// Gives a frame that is not plain.
    pub fn with_stored(&self, at: usize, each: impl FnOnce(&DecodedFrame<'_>)) {
        if let Some(stored_frame) = self.stored.get(at) {
            each(&stored_frame.as_frame());
        }
    }

    /// Gives an answer as any other frame.
    pub fn with_answer(
        &self,
        answer: &AnswerFrame,
        buffers: &mut FrameBuffers,
        each: impl FnOnce(&DecodedFrame<'_>),
    ) {
        if let Some(template) = self.templates.get(usize::from(answer.frame.template)) {
            template.expand_with(&answer.frame, self.notices(answer), buffers, each);
        }
    }

    /// The notices of an answer.
    #[must_use]
    pub fn notices(&self, answer: &AnswerFrame) -> &[SessionNotice] {
        &self.answer_notices[answer.notices.clone()]
    }

    /// Gives every frame as a decoder does that keeps none.
    pub fn for_each_frame(&self, each: &mut dyn FnMut(&DecodedFrame<'_>)) {
        let mut buffers = FrameBuffers::default();
        for decoded in self.runs() {
            match decoded {
                FrameRun::Compact(run) => run.iter().for_each(|plain| {
                    self.templates[usize::from(plain.template)].expand_with(
                        plain,
                        &[],
                        &mut buffers,
                        &mut *each,
                    );
                }),
                FrameRun::Answer(answer) => self.with_answer(answer, &mut buffers, &mut *each),
                FrameRun::Stored(at) => self.with_stored(at, &mut *each),
            }
        }
    }

    /// Keeps an event.
    pub(crate) fn push_stored(&mut self, event: &DecodedFrame<'_>) {
        let used = self.stored_count;
        if used == self.stored.len() {
            self.stored.push(StoredFrame::default());
        }
        let stored_frame = &mut self.stored[used];
        // Into the buffers of an earlier frame: a batch that is used again allocates nothing.
        stored_frame.store(event);
        self.stored_bytes += stored_frame.size();
        self.stored_count += 1;
        self.push_other(OtherFrame::Stored(used));
    }

    fn push_other(&mut self, frame: OtherFrame) {
        // The order of all kinds is kept by the number of compact frames before each other one.
        self.others.push((self.compact.len(), frame));
    }

    /// Adds a frame that changes nothing. `template` is where their template may be, and is; false if
    /// there is no room for one.
    #[inline]
    pub(crate) fn push_compact(
        &mut self,
        record: &Record<'_>,
        number: u64,
        template: &mut u16,
        source: TemplateSource<'_>,
    ) -> bool {
        let Some(time) = record.time else { return false };
        if !self.set_template(template, record.direction, source) {
            return false;
        }
        // On a serial line these are the template's own bytes.
        let data = if source.id.is_some() { data_of(source.bytes) } else { 0 };
        let (template, offset) = (*template, record.offset);
        self.compact.push(CompactFrame { template, data, number, time, offset });
        true
    }

    /// Adds an answer with the notices of its conversation, as [`push_compact`](Self::push_compact) does a frame that
    /// changes nothing.
    pub(crate) fn push_answer(
        &mut self,
        record: &Record<'_>,
        number: u64,
        template: &mut u16,
        source: TemplateSource<'_>,
        notices: &mut Vec<SessionNotice>,
    ) -> bool {
        let Some(time) = record.time else { return false };
        if !self.set_template(template, record.direction, source) {
            return false;
        }
        let start = source.bytes.len().saturating_sub(DATA_MAX.into());
        let data = data_of(&source.bytes[start..]);
        let (template, offset) = (*template, record.offset);
        let frame = CompactFrame { template, data, number, time, offset };
        let before = self.answer_notices.len();
        self.answer_notices.append(notices);
        self.push_other(OtherFrame::Answer(self.answers.len()));
        self.answers.push(AnswerFrame { frame, notices: before..self.answer_notices.len() });
        true
    }

    /// Finds or adds the template of a frame; false if there is no room for one.
    #[inline]
    fn set_template(
        &mut self,
        template: &mut u16,
        direction: Option<Direction>,
        source: TemplateSource<'_>,
    ) -> bool {
        // By address and not by content: equal templates are rare, comparing them is not cheap.
        let known = self.templates.get(usize::from(*template));
        if known.is_some_and(|known| source.matches(known, direction)) {
            return true;
        }
        if self.templates.len() == TEMPLATES_MAX {
            return false;
        }
        *template = self.templates.len() as u16;
        self.templates.push(source.to_template(direction));
        true
    }
}

impl FrameTemplate {
    /// The mapping of process data.
    #[must_use]
    pub fn process_data(&self) -> Option<&ProcessData> {
        match &self.content {
            TemplateContent::ProcessData(process) => Some(process),
            TemplateContent::Constant(_) | TemplateContent::Answer(_) => None,
        }
    }

    /// Gives a frame as any other.
    pub fn expand(&self, plain: &CompactFrame, each: &mut dyn FnMut(&DecodedFrame<'_>)) {
        self.expand_with(plain, &[], &mut FrameBuffers::default(), each);
    }

    /// Gives a frame with these notices, or with the values of process data.
    fn expand_with(
        &self,
        plain: &CompactFrame,
        notices: &[SessionNotice],
        buffers: &mut FrameBuffers,
        each: impl FnOnce(&DecodedFrame<'_>),
    ) {
        let FrameBuffers { bytes, explanation, notices: values } = buffers;
        self.write_bytes(plain, bytes);
        let mut notices = notices;
        let explained = match &self.content {
            TemplateContent::Constant(explained) => &**explained,
            TemplateContent::Answer(known) => {
                explanation.restate_values(known, bytes);
                explanation.restate_text(known, bytes);
                explanation
            }
            TemplateContent::ProcessData(process) => {
                explanation.clear();
                process.explain(bytes, explanation);
                values.clear();
                process.mapping().for_each_signal(plain.data, |mapped, exact, value| {
                    values.push(process.signal_notice(mapped, exact, value));
                });
                notices = values;
                explanation
            }
        };
        each(&self.frame(plain, bytes, explained, notices));
    }

    /// Writes the bytes of a frame.
    fn write_bytes(&self, plain: &CompactFrame, bytes: &mut Vec<u8>) {
        bytes.clear();
        let (start, len) = (usize::from(self.data_start), usize::from(self.len));
        bytes.extend_from_slice(self.serial.get(..start).unwrap_or_default());
        bytes.extend_from_slice(&plain.data.to_le_bytes()[..len.saturating_sub(start)]);
    }

    fn frame<'a>(
        &'a self,
        plain: &CompactFrame,
        bytes: &'a [u8],
        explanation: &'a Explanation,
        notices: &'a [SessionNotice],
    ) -> DecodedFrame<'a> {
        DecodedFrame {
            number: plain.number,
            time: Some(plain.time),
            link: &self.link,
            direction: self.direction,
            protocol: Some(self.protocol),
            bytes,
            id: self.id,
            extended: false,
            remote: false,
            remote_len: 0,
            echo: false,
            stray: false,
            explanation,
            defect: None,
            notices,
            offset: plain.offset,
        }
    }
}

impl StoredFrame {
    fn store(&mut self, event: &DecodedFrame<'_>) {
        let DecodedFrame { number, time, link, direction, protocol, bytes, id, extended, .. } =
            *event;
        (self.number, self.time, self.direction) = (number, time, direction);
        link.clone_into(&mut self.link);
        bytes.clone_into(&mut self.bytes);
        (self.protocol, self.id, self.extended) = (protocol, id, extended);
        (self.remote, self.echo, self.stray) = (event.remote, event.echo, event.stray);
        self.explanation.copy_from(event.explanation);
        event.notices.clone_into(&mut self.notices);
        (self.defect, self.remote_len, self.offset) =
            (event.defect, event.remote_len, event.offset);
    }

    /// Bytes that it takes, nearly.
    fn size(&self) -> usize {
        let said = self.explanation.text.len() + self.explanation.fields().len() * size_of::<u64>();
        size_of::<Self>()
            + said
            + self.bytes.len()
            + self.notices.len() * size_of::<SessionNotice>()
    }

    fn as_frame(&self) -> DecodedFrame<'_> {
        DecodedFrame {
            number: self.number,
            time: self.time,
            link: &self.link,
            direction: self.direction,
            protocol: self.protocol,
            bytes: &self.bytes,
            id: self.id,
            extended: self.extended,
            remote: self.remote,
            remote_len: self.remote_len,
            echo: self.echo,
            stray: self.stray,
            explanation: &self.explanation,
            defect: self.defect,
            notices: &self.notices,
            offset: self.offset,
        }
    }
}
