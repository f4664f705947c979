//! Frames of a piece of a capture in their order, decoded and not yet written: of those that change
//! nothing their bytes alone, of others all that is said. Whoever writes them needs nothing else, and
//! may do it on another thread.

use std::sync::Arc;

use polepair_core::explain::Direction;
use polepair_core::medium::Frame;

use crate::decoder::{Event, Wrong};
use crate::explained::Explained;
use crate::record::Record;
use crate::session::Notice;
use crate::session::canopen::Process;
use crate::stamp::Stamp;
use crate::text::Head;

/// Frames of one batch: what they take of memory stays bounded, whatever the capture holds.
const FRAMES_MAX: usize = 1 << 15;
/// Bytes of frames that are kept as they were told, and of what is said of them.
const KEPT_MAX: usize = 1 << 23;
/// Voices of one batch: each mapping is one, and each frame that is repeated.
const VOICES_MAX: usize = 1 << 12;

/// Frames that were decoded.
#[derive(Debug, Default)]
pub struct Batch {
    pub(crate) head: Head,
    /// Frames that change nothing, in order.
    plain: Vec<Plain>,
    voices: Vec<Voice>,
    kept: Vec<Kept>,
    /// Of each event that is kept: how many plain frames come before it.
    places: Vec<usize>,
    size: usize,
    stopped: bool,
}

/// Frames that stand one behind the other.
#[derive(Clone, Copy, Debug)]
pub enum Decoded<'a> {
    /// Some that change nothing.
    Plain(&'a [Plain]),
    /// Any other; which one.
    Told(usize),
}

/// A frame that changes nothing.
#[derive(Clone, Copy, Debug)]
pub struct Plain {
    /// Which of the batch's [voices](Batch::voices) says it.
    pub voice: u16,
    /// Its bytes, the first lowest.
    pub data: u64,
    /// Its number in the capture.
    pub number: u64,
    /// When it came.
    pub time: Stamp,
    /// Byte of the capture at which its record begins.
    pub at: u64,
}

/// What is the same of frames with one identifier that have one mapping, or the same bytes.
#[derive(Clone, Debug)]
pub struct Voice {
    /// What they say.
    pub said: Said,
    /// On which link.
    pub link: Arc<str>,
    /// The protocol.
    pub protocol: &'static str,
    /// Who sends them.
    pub direction: Option<Direction>,
    /// CAN identifier of 11 bits.
    pub id: u32,
    /// How many bytes they have.
    pub len: u8,
}

/// What frames say that change nothing.
#[derive(Clone, Debug)]
pub enum Said {
    /// Process data: each what its bytes are.
    Process(Arc<Process>),
    /// All the same, for their bytes are.
    Same(Arc<Explained>),
}

/// The same, of one frame.
#[derive(Clone, Copy)]
pub(crate) enum Says<'a> {
    Process(&'a Arc<Process>),
    Same(&'a Arc<Explained>),
}

impl Says<'_> {
    #[inline]
    fn is(self, said: &Said) -> bool {
        match (self, said) {
            (Self::Process(one), Said::Process(other)) => Arc::ptr_eq(one, other),
            (Self::Same(one), Said::Same(other)) => Arc::ptr_eq(one, other),
            _ => false,
        }
    }

    fn kept(self) -> Said {
        match self {
            Self::Process(process) => Said::Process(Arc::clone(process)),
            Self::Same(explained) => Said::Same(Arc::clone(explained)),
        }
    }
}

/// What is said of process data, as of any other frame.
#[derive(Default)]
struct Buffers {
    explained: Explained,
    notices: Vec<Notice>,
}

/// An event that is kept.
#[derive(Debug, Default)]
struct Kept {
    number: u64,
    time: Option<Stamp>,
    link: String,
    direction: Option<Direction>,
    protocol: Option<&'static str>,
    bytes: Vec<u8>,
    id: Option<u32>,
    extended: bool,
    remote: bool,
    wanted: u8,
    echo: bool,
    stray: bool,
    explained: Explained,
    wrong: Option<Wrong>,
    notices: Vec<Notice>,
    at: u64,
}

impl Batch {
    /// Forgets everything; `head` is how far lines have come.
    pub(crate) fn begin(&mut self, head: Head) {
        self.head = head;
        self.plain.clear();
        self.voices.clear();
        self.places.clear();
        self.size = 0;
    }

    /// No more of the piece under way is wanted.
    pub(crate) const fn stop(&mut self) {
        self.stopped = true;
    }

    /// Whether that was said, until a piece begins.
    pub(crate) const fn is_stopped(&self) -> bool {
        self.stopped
    }

    /// A piece begins; `head` is how far lines have come.
    pub(crate) fn piece(&mut self, head: Head) {
        self.stopped = false;
        self.begin(head);
    }

    /// True without a frame.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// How many frames it has.
    #[must_use]
    pub const fn len(&self) -> usize {
        self.plain.len() + self.places.len()
    }

    /// It has as many frames as it should.
    pub(crate) const fn is_full(&self) -> bool {
        self.len() >= FRAMES_MAX || self.size >= KEPT_MAX
    }

    /// Its frames in order.
    pub fn decoded(&self) -> impl Iterator<Item = Decoded<'_>> {
        let (mut from, mut told) = (0, 0);
        core::iter::from_fn(move || {
            let place = self.places.get(told).copied();
            let run = &self.plain[from..place.unwrap_or(self.plain.len())];
            if !run.is_empty() {
                from += run.len();
                return Some(Decoded::Plain(run));
            }
            told += 1;
            place.map(|_| Decoded::Told(told - 1))
        })
    }

    /// Who says its frames that change nothing.
    #[must_use]
    pub fn voices(&self) -> &[Voice] {
        &self.voices
    }

    /// Gives a frame that is not plain.
    pub fn told(&self, at: usize, each: impl FnOnce(&Event<'_>)) {
        if let Some(kept) = self.kept.get(at) {
            each(&kept.event());
        }
    }

    /// Gives every frame as a decoder does that keeps none.
    pub fn each(&self, each: &mut dyn FnMut(&Event<'_>)) {
        let mut buffers = Buffers::default();
        for decoded in self.decoded() {
            match decoded {
                Decoded::Plain(run) => run.iter().for_each(|plain| {
                    self.voices[usize::from(plain.voice)].event(plain, &mut buffers, each);
                }),
                Decoded::Told(at) => self.told(at, &mut *each),
            }
        }
    }

    /// Keeps an event.
    pub(crate) fn keep(&mut self, event: &Event<'_>) {
        let used = self.places.len();
        if used == self.kept.len() {
            self.kept.push(Kept::default());
        }
        let kept = &mut self.kept[used];
        kept.take(event);
        self.size += kept.size();
        self.places.push(self.plain.len());
    }

    /// Adds a frame that changes nothing. `voice` is where their voice may be, and is; false if
    /// there is no room for one.
    #[inline]
    pub(crate) fn add(
        &mut self,
        record: &Record<'_>,
        (number, frame): (u64, &Frame),
        voice: &mut u16,
        (says, link, protocol): (Says<'_>, &Arc<str>, &'static str),
    ) -> bool {
        let Some(time) = record.time else { return false };
        let direction = record.direction;
        let same = |known: &Voice| {
            says.is(&known.said)
                && (known.id, known.len, known.direction) == (frame.id, frame.len, direction)
                && Arc::ptr_eq(&known.link, link)
        };
        if !self.voices.get(usize::from(*voice)).is_some_and(same) {
            if self.voices.len() == VOICES_MAX {
                return false;
            }
            *voice = self.voices.len() as u16;
            let (said, link) = (says.kept(), Arc::clone(link));
            let Frame { id, len, .. } = *frame;
            self.voices.push(Voice { said, link, protocol, direction, id, len });
        }
        let (voice, data) = (*voice, u64::from_le_bytes(frame.data));
        self.plain.push(Plain { voice, data, number, time, at: record.at });
        true
    }
}

impl Voice {
    /// The mapping of process data.
    #[must_use]
    pub fn process(&self) -> Option<&Process> {
        match &self.said {
            Said::Process(process) => Some(process),
            Said::Same(_) => None,
        }
    }

    /// Gives a frame as any other.
    pub(crate) fn each(&self, plain: &Plain, each: &mut dyn FnMut(&Event<'_>)) {
        self.event(plain, &mut Buffers::default(), each);
    }

    fn event(&self, plain: &Plain, buffers: &mut Buffers, each: &mut dyn FnMut(&Event<'_>)) {
        let Buffers { explained, notices } = buffers;
        let data = plain.data.to_le_bytes();
        let bytes = &data[..usize::from(self.len)];
        notices.clear();
        let explained = match &self.said {
            Said::Same(explained) => &**explained,
            Said::Process(process) => {
                explained.clear();
                process.say(bytes, explained);
                process.mapping().signals(plain.data, |place, exact, value| {
                    notices.push(process.signal(place, exact, value));
                });
                explained
            }
        };
        each(&Event {
            number: plain.number,
            time: Some(plain.time),
            link: &self.link,
            direction: self.direction,
            protocol: Some(self.protocol),
            bytes,
            id: Some(self.id),
            extended: false,
            remote: false,
            wanted: 0,
            echo: false,
            stray: false,
            explained,
            wrong: None,
            notices,
            at: plain.at,
        });
    }
}

impl Kept {
    fn take(&mut self, event: &Event<'_>) {
        let Event { number, time, link, direction, protocol, bytes, id, extended, .. } = *event;
        (self.number, self.time, self.direction) = (number, time, direction);
        link.clone_into(&mut self.link);
        bytes.clone_into(&mut self.bytes);
        (self.protocol, self.id, self.extended) = (protocol, id, extended);
        (self.remote, self.echo, self.stray) = (event.remote, event.echo, event.stray);
        self.explained.copy(event.explained);
        event.notices.clone_into(&mut self.notices);
        (self.wrong, self.wanted, self.at) = (event.wrong, event.wanted, event.at);
    }

    /// Bytes that it takes, nearly.
    fn size(&self) -> usize {
        let said = self.explained.text.len() + self.explained.items().len() * size_of::<u64>();
        size_of::<Self>() + said + self.bytes.len() + self.notices.len() * size_of::<Notice>()
    }

    fn event(&self) -> Event<'_> {
        Event {
            number: self.number,
            time: self.time,
            link: &self.link,
            direction: self.direction,
            protocol: self.protocol,
            bytes: &self.bytes,
            id: self.id,
            extended: self.extended,
            remote: self.remote,
            wanted: self.wanted,
            echo: self.echo,
            stray: self.stray,
            explained: &self.explained,
            wrong: self.wrong,
            notices: &self.notices,
            at: self.at,
        }
    }
}
