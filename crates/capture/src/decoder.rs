//! Records in, explained frames out.

mod gather;
mod lane;
mod repeat;

use core::fmt;
use std::sync::Arc;

use polepair_core::drives;
use polepair_core::error::WireError;
use polepair_core::explain::{Context, Direction, Raw, Talk};
use polepair_core::medium::Frame;
use polepair_core::profile::Profile;

use crate::conversation::Conversation;
use crate::explained::{CAN_FD, ERROR_FRAME, Explained};
use crate::format::Format;
use crate::read::{Reader, Tally};
use crate::record::{Data, ERROR_FLAG, Record};
use crate::rules::{Rule, Rules};
use crate::session::{Heard, Notice, Session, reported};
use crate::stamp::Stamp;
use crate::stream::{Flow, Origin, Piece, Shape};
use crate::text::Head;
pub(crate) use lane::speaks;
use lane::{Lane, Lanes, Teller, claimant, spoken};
use repeat::Repeats;

/// Links that a capture may name; records of further ones are damaged.
pub const LINKS_MAX: usize = 256;

/// One frame of a capture, or bytes that are none.
#[derive(Clone, Copy, Debug)]
pub struct Event<'a> {
    /// Its number in the capture, from 1; 0 for what belongs to no frame.
    pub number: u64,
    /// When its first byte came.
    pub time: Option<Stamp>,
    /// On which link.
    pub link: &'a str,
    /// Who sent it.
    pub direction: Option<Direction>,
    /// The protocol that explains it; `None` where nobody can.
    pub protocol: Option<&'static str>,
    /// Its bytes.
    pub bytes: &'a [u8],
    /// CAN identifier.
    pub id: Option<u32>,
    /// True for a CAN identifier of 29 bits.
    pub extended: bool,
    /// True for a CAN remote request.
    pub remote: bool,
    /// Bytes that a CAN remote request asks for; 0 where it is none.
    pub wanted: u8,
    /// The host's own request, heard back through its adapter.
    pub echo: bool,
    /// These bytes have not the shape of a frame.
    pub stray: bool,
    /// What it says.
    pub explained: &'a Explained,
    /// What is wrong with it.
    pub wrong: Option<Wrong>,
    /// What its conversation tells at this frame.
    pub notices: &'a [Notice],
    /// Byte of the capture at which its record begins.
    pub at: u64,
}

impl<'a> Event<'a> {
    /// No frame.
    const fn none(link: &'a str, explained: &'a Explained) -> Self {
        Self {
            number: 0,
            time: None,
            link,
            direction: None,
            protocol: None,
            bytes: &[],
            id: None,
            extended: false,
            remote: false,
            wanted: 0,
            echo: false,
            stray: false,
            explained,
            wrong: None,
            notices: &[],
            at: 0,
        }
    }

    /// A CAN frame, its number, its link and protocol, and what is said of it.
    fn of_frame(
        record: &Record<'_>,
        (number, frame): (u64, &'a Frame),
        (link, protocol): (&'a str, Option<&'static str>),
        (explained, notices): (&'a Explained, &'a [Notice]),
    ) -> Self {
        Self {
            number,
            time: record.time,
            direction: record.direction,
            bytes: if frame.remote { &[] } else { frame.bytes() },
            id: Some(frame.id),
            extended: frame.extended,
            remote: frame.remote,
            wanted: if frame.remote { frame.len } else { 0 },
            protocol,
            wrong: explained.error.map(Wrong::Wire),
            notices,
            at: record.at,
            ..Self::none(link, explained)
        }
    }
}

/// What is wrong with a frame.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Wrong {
    /// It breaks its protocol.
    Wire(WireError),
    /// Its check fails.
    Broken,
    /// These bytes are no frame.
    Stray(usize),
}

impl fmt::Display for Wrong {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Wire(error) => error.fmt(f),
            Self::Broken => f.write_str("frame: its check fails"),
            Self::Stray(count) => write!(f, "stray: {}", strays(*count)),
        }
    }
}

impl Wrong {
    /// Whether a check over its bytes fails.
    #[must_use]
    pub const fn is_check(self) -> bool {
        matches!(self, Self::Broken | Self::Wire(WireError::Checksum { .. }))
    }
}

/// Bytes that are no frame, in words.
pub(crate) fn strays(count: usize) -> String {
    match count {
        1 => "1 byte that belongs to no frame".to_owned(),
        _ => format!("{count} bytes that belong to no frame"),
    }
}

/// Explains a capture, record by record. Memory stays bounded however long the capture is.
#[derive(Debug)]
pub struct Decoder {
    rules: Rules,
    /// Rules came from weighing: a CAN frame that no protocol claims stays unexplained.
    judged: bool,
    profile: Option<&'static Profile>,
    echoing: Vec<String>,
    wires: Vec<Wire>,
    reader: Reader,
    explained: Explained,
    notices: Vec<Notice>,
    /// Frames that were given out.
    count: u64,
    /// Conversations are followed.
    follows: bool,
    /// Records beyond the links that are followed.
    foreign: u64,
    /// How far lines of text have come.
    head: Head,
}

/// One link of the capture.
#[derive(Debug)]
struct Wire {
    name: Arc<str>,
    rules: Vec<Rule>,
    lanes: Lanes,
    repeats: Repeats,
    flows: [Flow; 3],
    conversation: Conversation,
    session: Session,
}

type Out<'a> = &'a mut dyn FnMut(&Event<'_>);

impl Decoder {
    /// A decoder that holds to `rules`, as a person stated them.
    #[must_use]
    pub fn new(rules: Rules) -> Self {
        Self {
            rules,
            judged: false,
            profile: None,
            echoing: Vec::new(),
            wires: Vec::new(),
            reader: Reader::default(),
            explained: Explained::default(),
            notices: Vec::new(),
            count: 0,
            follows: true,
            foreign: 0,
            head: Head::default(),
        }
    }

    /// A decoder that looks at each frame by itself, to see what `rules` make of it.
    pub(crate) fn weighing(rules: Rules) -> Self {
        let explained = Explained::brief();
        Self { judged: true, follows: false, explained, ..Self::new(rules) }
    }

    /// A decoder by what a [`Judge`](crate::Judge) found.
    pub(crate) fn judged(rules: Rules, echoing: Vec<String>) -> Self {
        Self { judged: true, echoing, ..Self::new(rules) }
    }

    /// Leaves out what frames say in words and fields: their texts stay empty. What they tell as
    /// values, states and faults, and what is wrong with them, stays the same, and costs less.
    #[must_use]
    pub fn without_words(mut self) -> Self {
        self.explained = Explained::bare();
        self
    }

    /// Names parameters as `profile` does.
    #[must_use]
    pub fn with_profile(mut self, profile: Option<&'static Profile>) -> Self {
        self.profile = profile;
        self
    }

    /// Names parameters as `profile` does from now on: who speaks may be learnt on the way.
    pub fn name_by(&mut self, profile: &'static Profile) {
        self.profile = Some(profile);
        for wire in &mut self.wires {
            (wire.lanes, wire.repeats) = (Lanes::default(), Repeats::default());
        }
    }

    /// Reads the capture as that format, or tells it by the first bytes.
    #[must_use]
    pub fn with_format(mut self, format: Option<Format>) -> Self {
        self.reader = Reader::new(format);
        self
    }

    /// Takes a piece of the capture, cut anywhere.
    pub fn feed(&mut self, piece: &[u8], out: Out<'_>) {
        let mut reader = core::mem::take(&mut self.reader);
        reader.feed(piece, &mut |record| self.record(record, out));
        self.reader = reader;
    }

    /// Takes one record.
    pub fn record(&mut self, record: &Record<'_>, out: Out<'_>) {
        let Some(at) = self.wire(record.link) else {
            self.foreign += 1;
            return;
        };
        match record.data {
            Data::Bytes(bytes) => self.bytes(at, record, bytes, out),
            Data::Frame(frame) => self.take_frame(at, record, &frame, out),
            Data::Fd(fd) => {
                self.explained.say(CAN_FD, format_args!("{} bytes", fd.bytes.len()));
                self.notices.clear();
                let id = Some((fd.id, fd.extended));
                out(&self.unexplained(at, record, id, fd.bytes));
            }
            Data::Error(error) => {
                let words: Vec<&str> = error.words().collect();
                self.explained.say(ERROR_FRAME, format_args!("{}", words.join(", ")));
                self.notices.clear();
                self.notices.extend(reported(&error, &self.explained.text));
                let id = Some((ERROR_FLAG | error.class, true));
                out(&self.unexplained(at, record, id, &error.data));
            }
        }
    }

    /// What belongs to the bus and not to a protocol.
    fn unexplained<'a>(
        &'a mut self,
        at: usize,
        record: &Record<'_>,
        id: Option<(u32, bool)>,
        bytes: &'a [u8],
    ) -> Event<'a> {
        self.count += 1;
        Event {
            number: self.count,
            time: record.time,
            direction: record.direction,
            bytes,
            id: id.map(|(id, _)| id),
            extended: id.is_some_and(|(_, extended)| extended),
            notices: &self.notices,
            at: record.at,
            ..Event::none(&self.wires[at].name, &self.explained)
        }
    }

    /// Takes bytes of a serial line as they were read or written.
    pub fn chunk(
        &mut self,
        time: Option<Stamp>,
        link: &str,
        direction: Option<Direction>,
        bytes: &[u8],
        out: Out<'_>,
    ) {
        self.record(&Record { time, link, direction, data: Data::Bytes(bytes), at: 0 }, out);
    }

    /// Takes a CAN frame as it was sent or received.
    pub fn frame(
        &mut self,
        time: Option<Stamp>,
        link: &str,
        direction: Option<Direction>,
        frame: &Frame,
        out: Out<'_>,
    ) {
        self.record(&Record { time, link, direction, data: Data::Frame(*frame), at: 0 }, out);
    }

    /// Ends the capture: what waits for more is given out as it is.
    pub fn finish(&mut self, out: Out<'_>) {
        let mut reader = core::mem::take(&mut self.reader);
        reader.finish(&mut |record| self.record(record, out));
        self.reader = reader;
        for at in 0..self.wires.len() {
            for direction in DIRECTIONS {
                self.drain(at, direction, true, out);
            }
        }
    }

    /// After [`finish`](Self::finish): what conversations leave open, each as an event that is no
    /// frame: its number is 0, and it has a link, a protocol, an axis and one notice.
    pub fn ending(&mut self, out: Out<'_>) {
        for wire in &mut self.wires {
            let (explained, link) = (&mut self.explained, &*wire.name);
            wire.session.end(&mut |protocol, notice| {
                explained.clear();
                explained.axis = notice.axis();
                let notices = core::slice::from_ref(notice);
                out(&Event { protocol: Some(protocol), notices, ..Event::none(link, explained) });
            });
        }
    }

    /// What was read, and what could not be.
    #[must_use]
    pub fn tally(&self) -> &Tally {
        self.reader.tally()
    }

    /// What is spoken, as it was stated or found.
    #[must_use]
    pub const fn rules(&self) -> &Rules {
        &self.rules
    }

    /// The form of the capture, once it is told.
    #[must_use]
    pub fn format(&self) -> Option<Format> {
        self.reader.format()
    }

    /// Records of more links than are followed at once, which are left out.
    #[must_use]
    pub const fn left_out(&self) -> u64 {
        self.foreign
    }

    /// Links on which the host was seen to hear itself.
    pub(crate) fn echoing(&self) -> impl Iterator<Item = &str> {
        self.wires.iter().filter(|wire| wire.conversation.echoes()).map(|wire| &*wire.name)
    }

    fn wire(&mut self, name: &str) -> Option<usize> {
        if let Some(at) = self.wires.iter().position(|wire| *wire.name == *name) {
            return Some(at);
        }
        let echoes = self.echoing.iter().any(|link| link == name);
        (self.wires.len() < LINKS_MAX).then(|| {
            self.wires.push(Wire {
                name: name.into(),
                rules: self.rules.on(name),
                lanes: Lanes::default(),
                repeats: Repeats::default(),
                flows: Default::default(),
                conversation: Conversation::with_echo(echoes),
                session: Session::default(),
            });
            self.wires.len() - 1
        })
    }

    fn bytes(&mut self, at: usize, record: &Record<'_>, bytes: &[u8], out: Out<'_>) {
        for other in DIRECTIONS {
            let wire = &self.wires[at];
            let flow = &wire.flows[index(other)];
            let ended = other != record.direction
                || flow.breaks_off(&wire.rules, other, record.time, bytes);
            if ended && !flow.pending().is_empty() {
                self.drain(at, other, true, out);
            }
        }
        let origin = Origin { time: record.time, at: record.at };
        self.wires[at].flows[index(record.direction)].push(origin, bytes);
        // Data alone on a line stands for itself: nothing more of it follows.
        self.drain(at, record.direction, record.time.is_none(), out);
    }

    /// Gives out what one direction holds.
    fn drain(&mut self, at: usize, direction: Option<Direction>, ended: bool, out: Out<'_>) {
        loop {
            let wire = &mut self.wires[at];
            let flow = &mut wire.flows[index(direction)];
            let Some(piece) = flow.next(&wire.rules, direction, ended) else { return };
            let origin = flow.origin();
            let bytes = flow.take(piece.len).to_vec();
            let glued = !flow.pending().is_empty();
            self.piece(at, &bytes, &piece, Place { origin, direction, glued }, out);
        }
    }

    fn piece(&mut self, at: usize, bytes: &[u8], piece: &Piece, place: Place, out: Out<'_>) {
        self.count += 1;
        let Wire { name, rules, conversation, session, .. } = &mut self.wires[at];
        let Place { origin: Origin { time, at }, direction, glued } = place;
        let rule = rules.get(piece.rule);
        let whole = piece.shape == Shape::Frame;
        let raw = Raw { bytes, ..Raw::default() };
        // Where the capture does not say who speaks, the frame may.
        let direction = direction.or_else(|| {
            let talk = Talk { open: conversation.open(), ..Talk::default() };
            rule.filter(|_| whole)?.dissector.turn(&raw, &talk).speaker()
        });
        let reply = direction == Some(Direction::ToHost);
        let echo = whole && reply && conversation.is_echo(bytes, glued);
        let speaker = if echo { Some(Direction::ToDrive) } else { direction };
        let answered = rule.filter(|_| reply && !echo);
        let request = answered.and_then(|rule| conversation.request(rule.dissector, &raw));
        let stated = rule.and_then(|rule| spoken(self.profile, rule));
        let usual = || drives::assumed(rule?.dissector);
        let profile = stated.or_else(usual);
        let context = Context {
            direction: speaker,
            request: request.map(|request| request.bytes),
            profile,
            assumed: stated.is_none(),
            ..Context::default()
        };
        self.explained.clear();
        if let Some(rule) = rule {
            rule.dissector.explain(bytes, &context, &mut self.explained);
        }
        let wrong = rule.and_then(|_| wrong(self.explained.error, piece));
        let asks = rule.is_none_or(|rule| rule.dissector.asks(&raw));
        if whole && direction == Some(Direction::ToDrive) && asks {
            conversation.ask(&raw);
        }
        self.notices.clear();
        if let Some(rule) = rule.filter(|_| self.follows) {
            let heard = Heard {
                number: self.count,
                time,
                direction,
                raw,
                remote: false,
                echo,
                wrong,
                stray: piece.shape == Shape::Junk,
                left: false,
                dissector: rule.dissector,
                profile,
                stated: stated.is_some(),
            };
            session.take(&heard, &mut self.explained, &mut self.notices);
        }
        out(&Event {
            number: self.count,
            time,
            link: name,
            direction: place.direction,
            protocol: rule.map(|rule| rule.dissector.name()),
            bytes,
            id: None,
            extended: false,
            remote: false,
            wanted: 0,
            echo,
            stray: piece.shape == Shape::Junk,
            explained: &self.explained,
            wrong,
            notices: &self.notices,
            at,
        });
    }

    fn take_frame(&mut self, at: usize, record: &Record<'_>, frame: &Frame, out: Out<'_>) {
        self.count += 1;
        let Wire { name, rules, lanes, repeats, conversation, session, .. } = &mut self.wires[at];
        self.explained.clear();
        self.notices.clear();
        let known = lanes.of(frame);
        let lane = known.or_else(|| {
            let context = Context {
                direction: record.direction,
                profile: self.profile,
                id: Some(frame.id),
                extended: frame.extended,
                remote: frame.remote,
                ..Context::default()
            };
            let (judged, follows) = (self.judged, self.follows);
            let mut teller = Teller { judged, follows, left: None, tried: 0 };
            let told = teller.explain(rules, frame, &context, conversation, &mut self.explained);
            let rule = told.or_else(|| claimant(rules, session, frame))?;
            let (dissector, stated) = (rules[rule].dissector, spoken(self.profile, &rules[rule]));
            let profile = stated.or_else(|| drives::assumed(dissector));
            let left = teller.left;
            let lane = Lane { dissector, profile, stated: stated.is_some(), left, voice: 0 };
            let by_id = told.is_some() && teller.tried == 1;
            if left.is_some() && by_id {
                lanes.keep(frame, lane);
            } else if by_id
                && follows
                && self.explained.error.is_none()
                && is_short(frame)
                && session.repeats(dissector.name(), frame.id)
            {
                repeats.note(frame, record.direction, lane, &self.explained);
            }
            Some(lane)
        });
        if let Some(axis) = known.and_then(|lane| lane.left) {
            self.explained.axis = Some(axis);
        }
        if let Some(lane) = lane.filter(|_| self.follows) {
            let heard = lane.heard(self.count, record, frame, self.explained.error);
            session.take(&heard, &mut self.explained, &mut self.notices);
        }
        let protocol = lane.map(|lane| lane.dissector.name());
        // A conversation may tell that a frame is another than it looks like.
        let said = (&self.explained, &*self.notices);
        out(&Event::of_frame(record, (self.count, frame), (name, protocol), said));
    }
}

/// A frame's bytes and identifier.
fn raw(frame: &Frame) -> Raw<'_> {
    Raw { bytes: frame.bytes(), id: Some(frame.id), extended: frame.extended }
}

/// It has an identifier of 11 bits, and bytes.
const fn is_short(frame: &Frame) -> bool {
    !frame.extended && !frame.remote
}

/// Where in the capture a piece stands.
#[derive(Clone, Copy)]
struct Place {
    origin: Origin,
    direction: Option<Direction>,
    /// More bytes follow it in the same chunk.
    glued: bool,
}

const DIRECTIONS: [Option<Direction>; 3] =
    [Some(Direction::ToDrive), Some(Direction::ToHost), None];

const fn index(direction: Option<Direction>) -> usize {
    match direction {
        Some(Direction::ToDrive) => 0,
        Some(Direction::ToHost) => 1,
        None => 2,
    }
}

fn wrong(error: Option<WireError>, piece: &Piece) -> Option<Wrong> {
    error.map(Wrong::Wire).or(match piece.shape {
        Shape::Frame => None,
        Shape::Broken => Some(Wrong::Broken),
        Shape::Junk => Some(Wrong::Stray(piece.len)),
    })
}

#[cfg(test)]
mod tests;
