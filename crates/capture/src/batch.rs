//! A batch of decoded frames in their order, not written yet. A frame without changes has its bytes only,
//! others have their full text. A writer needs nothing else, and may run on another thread.

use std::sync::Arc;

use polepair_core::explain::Direction;
use polepair_core::medium::Frame;

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
    /// Number of compact frames before each stored event.
    compact_before: Vec<usize>,
    stored_bytes: usize,
    stopped: bool,
}

/// Frames that stand one behind the other.
#[derive(Clone, Copy, Debug)]
pub enum FrameRun<'a> {
    /// Some that change nothing.
    Compact(&'a [CompactFrame]),
    /// Any other; which one.
    Stored(usize),
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
    /// Bytes of frames of a serial line, which are all the same; empty on CAN.
    pub serial: Box<[u8]>,
}

/// Content of frames that change nothing.
#[derive(Clone, Debug)]
pub enum TemplateContent {
    /// Process data: each what its bytes are.
    ProcessData(Arc<ProcessData>),
    /// All the same, for their bytes are.
    Constant(Arc<Explanation>),
}

/// Content of one frame, borrowed.
#[derive(Clone, Copy)]
pub(crate) enum ContentRef<'a> {
    ProcessData(&'a Arc<ProcessData>),
    Constant(&'a Arc<Explanation>),
}

impl ContentRef<'_> {
    #[inline]
    fn matches(self, template_content: &TemplateContent) -> bool {
        match (self, template_content) {
            (Self::ProcessData(one), TemplateContent::ProcessData(other)) => {
                Arc::ptr_eq(one, other)
            }
            (Self::Constant(one), TemplateContent::Constant(other)) => Arc::ptr_eq(one, other),
            _ => false,
        }
    }

    fn to_content(self) -> TemplateContent {
        match self {
            Self::ProcessData(process) => TemplateContent::ProcessData(Arc::clone(process)),
            Self::Constant(explained) => TemplateContent::Constant(Arc::clone(explained)),
        }
    }
}

/// Text and values of process data, as of any other frame.
#[derive(Default)]
struct FrameBuffers {
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
        self.compact_before.clear();
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
        self.compact.len() + self.compact_before.len()
    }

    /// Returns whether it has as many frames as it should.
    pub(crate) const fn is_full(&self) -> bool {
        self.len() >= FRAMES_MAX || self.stored_bytes >= STORED_BYTES_MAX
    }

    /// Frames in order.
    pub fn runs(&self) -> impl Iterator<Item = FrameRun<'_>> {
        let (mut from, mut reported) = (0, 0);
        core::iter::from_fn(move || {
            let index = self.compact_before.get(reported).copied();
            let run = &self.compact[from..index.unwrap_or(self.compact.len())];
            if !run.is_empty() {
                from += run.len();
                return Some(FrameRun::Compact(run));
            }
            reported += 1;
            index.map(|_| FrameRun::Stored(reported - 1))
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

    /// Gives every frame as a decoder does that keeps none.
    pub fn for_each_frame(&self, each: &mut dyn FnMut(&DecodedFrame<'_>)) {
        let mut buffers = FrameBuffers::default();
        for decoded in self.runs() {
            match decoded {
                FrameRun::Compact(run) => run.iter().for_each(|plain| {
                    self.templates[usize::from(plain.template)].expand_with(
                        plain,
                        &mut buffers,
                        each,
                    );
                }),
                FrameRun::Stored(at) => self.with_stored(at, &mut *each),
            }
        }
    }

    /// Keeps an event.
    pub(crate) fn push_stored(&mut self, event: &DecodedFrame<'_>) {
        let used = self.compact_before.len();
        if used == self.stored.len() {
            self.stored.push(StoredFrame::default());
        }
        let stored_frame = &mut self.stored[used];
        // Into the buffers of an earlier frame: a batch that is used again allocates nothing.
        stored_frame.store(event);
        self.stored_bytes += stored_frame.size();
        // The order of both kinds is kept by the number of compact frames before each stored one.
        self.compact_before.push(self.compact.len());
    }

    /// Adds a frame that changes nothing. `template` is where their template may be, and is; false if
    /// there is no room for one.
    #[inline]
    pub(crate) fn push_compact(
        &mut self,
        record: &Record<'_>,
        number: u64,
        frame: &Frame,
        voice: &mut u16,
        source: (ContentRef<'_>, &Arc<str>, &'static str),
    ) -> bool {
        let (says, link, protocol) = source;
        let direction = record.direction;
        let is_same = |known: &FrameTemplate| {
            says.matches(&known.content)
                && (known.id, known.len, known.direction) == (Some(frame.id), frame.len, direction)
                && Arc::ptr_eq(&known.link, link)
        };
        let make = || FrameTemplate {
            content: says.to_content(),
            link: Arc::clone(link),
            protocol,
            direction,
            id: Some(frame.id),
            len: frame.len,
            serial: Box::default(),
        };
        self.set_template(voice, is_same, make)
            && self.push_with(record, number, *voice, u64::from_le_bytes(frame.data))
    }

    /// Adds a frame of a serial line that has the same bytes as an earlier one, as
    /// [`push_compact`](Self::push_compact) does one of CAN.
    pub(crate) fn push_serial(
        &mut self,
        record: &Record<'_>,
        number: u64,
        bytes: &[u8],
        voice: &mut u16,
        source: (&Arc<Explanation>, &Arc<str>, &'static str),
    ) -> bool {
        let (explained, link, protocol) = source;
        let says = ContentRef::Constant(explained);
        let direction = record.direction;
        let is_same = |known: &FrameTemplate| {
            says.matches(&known.content)
                && (known.id, known.direction) == (None, direction)
                && Arc::ptr_eq(&known.link, link)
        };
        let make = || FrameTemplate {
            content: says.to_content(),
            link: Arc::clone(link),
            protocol,
            direction,
            id: None,
            len: bytes.len() as u8,
            serial: bytes.into(),
        };
        self.set_template(voice, is_same, make) && self.push_with(record, number, *voice, 0)
    }

    /// Finds or adds the template of a frame; false if there is no room for one.
    #[inline]
    fn set_template(
        &mut self,
        voice: &mut u16,
        is_same: impl FnOnce(&FrameTemplate) -> bool,
        make: impl FnOnce() -> FrameTemplate,
    ) -> bool {
        // By address and not by content: equal templates are rare, comparing them is not cheap.
        if self.templates.get(usize::from(*voice)).is_some_and(is_same) {
            return true;
        }
        if self.templates.len() == TEMPLATES_MAX {
            return false;
        }
        debug_assert!(self.templates.len() < TEMPLATES_MAX);
        *voice = self.templates.len() as u16;
        self.templates.push(make());
        true
    }

    /// Adds a frame of a template; false without a time.
    #[inline]
    fn push_with(&mut self, record: &Record<'_>, number: u64, template: u16, data: u64) -> bool {
        let Some(time) = record.time else { return false };
        let offset = record.offset;
        self.compact.push(CompactFrame { template, data, number, time, offset });
        true
    }
}

impl FrameTemplate {
    /// The mapping of process data.
    #[must_use]
    pub fn process_data(&self) -> Option<&ProcessData> {
        match &self.content {
            TemplateContent::ProcessData(process) => Some(process),
            TemplateContent::Constant(_) => None,
        }
    }

    /// Gives a frame as any other.
    pub fn expand(&self, plain: &CompactFrame, each: &mut dyn FnMut(&DecodedFrame<'_>)) {
        self.expand_with(plain, &mut FrameBuffers::default(), each);
    }

    fn expand_with(
        &self,
        plain: &CompactFrame,
        buffers: &mut FrameBuffers,
        each: &mut dyn FnMut(&DecodedFrame<'_>),
    ) {
        let FrameBuffers { explanation, notices } = buffers;
        let data = plain.data.to_le_bytes();
        let bytes = if self.id.is_some() { &data[..usize::from(self.len)] } else { &self.serial };
        notices.clear();
        let explained = match &self.content {
            TemplateContent::Constant(explained) => &**explained,
            TemplateContent::ProcessData(process) => {
                explanation.clear();
                process.explain(bytes, explanation);
                process.mapping().for_each_signal(plain.data, |mapped, exact, value| {
                    notices.push(process.signal_notice(mapped, exact, value));
                });
                explanation
            }
        };
        each(&DecodedFrame {
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
            explanation: explained,
            defect: None,
            notices,
            offset: plain.offset,
        });
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
