//! The decoder: converts records to decoded frames.

mod answer_cache;
mod batching;
mod detecting;
mod repeat_cache;
mod route;
mod serial;

use std::sync::Arc;

use polepair_core::explain::{Context, Direction, RawFrame};
use polepair_core::medium::Frame;
use polepair_core::profile::Profile;

use crate::conversation::Conversation;
use crate::defect::FrameDefect;
use crate::detection::{LinkDetection, ProtocolSource};
use crate::explanation::{CAN_FD, ERROR_FRAME, Explanation};
use crate::format::CaptureFormat;
use crate::line_layout::LineLayout;
use crate::read::{CaptureReader, ReadOptions, ReadStatistics};
use crate::record::{ERROR_FLAG, Record, RecordData};
use crate::rules::{Rule, Rules};
use crate::session::{LinkSession, SessionNotice, error_frame_notice};
use crate::stream::SerialFlow;
use crate::timestamp::Timestamp;
use answer_cache::AnswerCache;
use detecting::CoveredIds;
use repeat_cache::{CanKey, RepeatCache, SerialKey};
pub(crate) use route::profile_speaks;
use route::{FrameRoute, RouteTable, RuleExplainer, StatedProfiles, claiming_rule};

/// Links that a capture may name; records of further ones are damaged.
pub const LINKS_MAX: usize = 256;

/// One frame of a capture, or bytes that are none.
#[derive(Clone, Copy, Debug)]
pub struct DecodedFrame<'a> {
    /// Number in the capture, from 1; 0 for results without a frame.
    pub number: u64,
    /// Time at which its first byte arrived.
    pub time: Option<Timestamp>,
    /// On which link.
    pub link: &'a str,
    /// Sender of the frame.
    pub direction: Option<Direction>,
    /// Protocol that explains it; `None` for no known one.
    pub protocol: Option<&'static str>,
    /// Bytes of the frame.
    pub bytes: &'a [u8],
    /// CAN identifier.
    pub id: Option<u32>,
    /// True for a CAN identifier of 29 bits.
    pub extended: bool,
    /// True for a CAN remote request.
    pub remote: bool,
    /// Bytes that a CAN remote request asks for; 0 where it is none.
    pub remote_len: u8,
    /// True for the host's own request, returned by its adapter.
    pub echo: bool,
    /// These bytes have not the shape of a frame.
    pub stray: bool,
    /// Explanation of the frame.
    pub explanation: &'a Explanation,
    /// Defect of the frame.
    pub defect: Option<FrameDefect>,
    /// Notices of its conversation at this frame.
    pub notices: &'a [SessionNotice],
    /// Byte of the capture at which its record begins.
    pub offset: u64,
}

impl<'a> DecodedFrame<'a> {
    /// Name of its protocol; empty for no known one, as tables and filters have it.
    #[must_use]
    pub fn protocol_name(&self) -> &'static str {
        self.protocol.unwrap_or("")
    }

    /// No frame.
    const fn empty(link: &'a str, explanation: &'a Explanation) -> Self {
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
            remote_len: 0,
            echo: false,
            stray: false,
            explanation,
            defect: None,
            notices: &[],
            offset: 0,
        }
    }

    /// A CAN frame with its number, its link and protocol, and its explanation.
    fn from_frame(
        record: &Record<'_>,
        number: u64,
        frame: &'a Frame,
        link: &'a str,
        protocol: Option<&'static str>,
        content: (&'a Explanation, &'a [SessionNotice]),
    ) -> Self {
        let (explained, notices) = content;

        Self {
            number,
            time: record.time,
            direction: record.direction,
            bytes: if frame.remote { &[] } else { frame.bytes() },
            id: Some(frame.id),
            extended: frame.extended,
            remote: frame.remote,
            remote_len: if frame.remote { frame.len } else { 0 },
            protocol,
            defect: explained.error.map(FrameDefect::Wire),
            notices,
            offset: record.offset,
            ..Self::empty(link, explained)
        }
    }
}

/// Explains a capture, record by record. Memory stays bounded however long the capture is.
#[derive(Debug)]
pub struct CaptureDecoder {
    rules: Rules,
    /// Rules came from weighing: a CAN frame that no protocol claims stays unexplained.
    detected: bool,
    /// Detects while frames are decoded; `None` when all is detected or stated.
    protocol_source: Option<Box<dyn ProtocolSource>>,
    detections: Vec<LinkDetection>,
    /// Detections before the first frame was decoded.
    first_detections: Vec<LinkDetection>,
    profiles: StatedProfiles,
    echo_links: Vec<String>,
    links: Vec<LinkDecoder>,
    /// The link of the last frame of a batch.
    last_link: usize,
    reader: CaptureReader,
    explanation: Explanation,
    notices: Vec<SessionNotice>,
    /// Bytes of the serial frame that is decoded.
    piece: Vec<u8>,
    /// Frames that were given out.
    frame_count: u64,
    /// Conversations are followed.
    tracks_sessions: bool,
    skips_signals: bool,
    /// Records beyond the links that are followed.
    untracked: u64,
    time_reversal: Option<TimeReversal>,
    /// Column layout of printed lines.
    layout: LineLayout,
}

/// A place at which the times of a link go back.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct TimeReversal {
    /// The link.
    pub link: String,
    /// Time of the earlier record.
    pub before: Timestamp,
    /// Time of the record after it.
    pub after: Timestamp,
}

/// One link of the capture.
#[derive(Debug)]
struct LinkDecoder {
    name: Arc<str>,
    last_time: Timestamp,
    /// The capture has a frame that its own side sent.
    has_sent: bool,
    rules: Vec<Rule>,
    covered: CoveredIds,
    routes: RouteTable,
    repeats: RepeatCache<CanKey>,
    serial_repeats: RepeatCache<SerialKey>,
    answers: AnswerCache,
    flows: [SerialFlow; 3],
    conversation: Conversation,
    session: LinkSession,
}

type FrameCallback<'a> = &'a mut dyn FnMut(&DecodedFrame<'_>);

impl CaptureDecoder {
    /// A decoder that holds to `rules`, as a person stated them.
    #[must_use]
    pub fn new(rules: Rules) -> Self {
        Self {
            rules,
            detected: false,
            protocol_source: None,
            detections: Vec::new(),
            first_detections: Vec::new(),
            profiles: StatedProfiles::default(),
            echo_links: Vec::new(),
            links: Vec::new(),
            last_link: 0,
            reader: CaptureReader::default(),
            explanation: Explanation::default(),
            notices: Vec::new(),
            piece: Vec::new(),
            frame_count: 0,
            tracks_sessions: true,
            skips_signals: false,
            untracked: 0,
            time_reversal: None,
            layout: LineLayout::default(),
        }
    }

    /// A decoder that looks at each frame by itself, to see what `rules` make of it.
    pub(crate) fn for_detection(rules: Rules) -> Self {
        let explanation = Explanation::kind_only();
        Self { detected: true, tracks_sessions: false, explanation, ..Self::new(rules) }
    }

    /// A decoder with the protocols that a [`ProtocolDetector`](crate::ProtocolDetector) found.
    pub(crate) fn from_detection(rules: Rules, echo_links: Vec<String>) -> Self {
        Self { detected: true, echo_links, ..Self::new(rules) }
    }

    /// Skips texts and fields of frames: their texts stay empty. Values, states, faults and defects stay the same, at
    /// less cost.
    #[must_use]
    pub fn without_text(mut self) -> Self {
        self.explanation = Explanation::values_only();
        self
    }

    /// Leaves notices of values out where that saves time. States, faults, exchanges and anomalies stay the same.
    #[must_use]
    pub fn without_signals(mut self) -> Self {
        self.skips_signals = true;
        self
    }

    /// Names parameters as `profile` does.
    #[must_use]
    pub fn with_profile(mut self, profile: Option<&'static Profile>) -> Self {
        self.profiles.any = profile;
        self
    }

    /// Names the parameters of the drives at these addresses as their own profiles do.
    #[must_use]
    pub fn with_drive_profiles(mut self, drives: Vec<(u32, &'static Profile)>) -> Self {
        self.set_drive_profiles(drives);
        self
    }

    /// Names the parameters of these drives by these profiles from now on.
    pub fn set_drive_profiles(&mut self, drives: Vec<(u32, &'static Profile)>) {
        let first = drives.first().map(|(_, profile)| *profile);
        let differ = !drives
            .iter()
            .all(|(_, profile)| first.is_some_and(|first| core::ptr::eq(first, *profile)));
        let drives = if differ { drives } else { Vec::new() };
        // The routes hold profiles; throwing them away for the same drives would cost every frame its short
        // cut.
        if self.profiles.drives.len() == drives.len() && self.profiles.any.is_some() {
            return;
        }
        self.profiles = StatedProfiles { any: first, drives };
        self.forget_routes();
    }

    /// Names parameters as `profile` does from now on: the drives may be identified during the decode.
    pub fn set_profile(&mut self, profile: &'static Profile) {
        self.profiles.any = Some(profile);
        self.forget_routes();
    }

    fn forget_routes(&mut self) {
        for wire in &mut self.links {
            wire.routes = RouteTable::default();
            (wire.repeats, wire.serial_repeats, wire.answers) = Default::default();
        }
    }

    /// Reads the capture with these options.
    #[must_use]
    pub fn with_read_options(mut self, options: ReadOptions) -> Self {
        self.reader = CaptureReader::new(options);
        self
    }

    /// The first place where the times of a link go back, if there is one.
    #[must_use]
    pub const fn time_reversal(&self) -> Option<&TimeReversal> {
        self.time_reversal.as_ref()
    }

    /// Takes a piece of the capture, cut anywhere.
    pub fn feed(&mut self, piece: &[u8], out: FrameCallback<'_>) {
        let mut reader = core::mem::take(&mut self.reader);
        reader.feed(piece, &mut |record| self.decode_read_record(record, out));
        self.reader = reader;
    }

    /// Takes one record of a capture file.
    fn decode_read_record(&mut self, record: &Record<'_>, out: FrameCallback<'_>) {
        let trusted =
            self.link_index(record.link).is_none_or(|at| self.trusts_direction(at, record));
        let direction = record.direction.filter(|_| trusted);
        self.decode_record(&Record { direction, ..*record }, out);
    }

    /// Returns whether the direction of a record proves who sent it: a passive logger receives the frames of both
    /// sides. Received CAN frames count as a drive's once the link has sent one itself.
    #[inline]
    fn trusts_direction(&mut self, at: usize, record: &Record<'_>) -> bool {
        let link = &mut self.links[at];
        match record.direction {
            Some(Direction::ToDrive) => {
                // A logger that only listens marks every frame as received.
                link.has_sent = true;
                true
            }
            Some(Direction::ToHost) => link.has_sent || matches!(record.data, RecordData::Bytes(_)),
            None => true,
        }
    }

    /// Takes one record. Its direction, if it has one, is taken as known.
    pub fn decode_record(&mut self, record: &Record<'_>, out: FrameCallback<'_>) {
        let Some(at) = self.link_index(record.link) else {
            self.untracked += 1;
            return;
        };
        self.check_time(at, record);
        match record.data {
            RecordData::Bytes(bytes) => self.decode_serial(at, record, bytes, out),
            RecordData::Frame(frame) => self.decode_can_frame(at, record, &frame, out),
            RecordData::Fd(fd) => {
                self.explanation.set_text(CAN_FD, format_args!("{} bytes", fd.bytes.len()));
                self.notices.clear();
                let id = Some((fd.id, fd.extended));
                out(&self.bus_frame(at, record, id, fd.bytes));
            }
            RecordData::Error(error) => {
                let words: Vec<&str> = error.descriptions().collect();
                self.explanation.set_text(ERROR_FRAME, format_args!("{}", words.join(", ")));
                self.notices.clear();
                self.notices.extend(error_frame_notice(&error, &self.explanation.text));
                let id = Some((ERROR_FLAG | error.class, true));
                out(&self.bus_frame(at, record, id, &error.data));
            }
        }
    }

    /// Notes the first time that is earlier than the one before.
    #[inline]
    fn check_time(&mut self, at: usize, record: &Record<'_>) {
        let Some(after) = record.time else { return };
        let link = &mut self.links[at];
        let before = core::mem::replace(&mut link.last_time, after);
        if after < before && self.time_reversal.is_none() {
            self.time_reversal = Some(TimeReversal { link: link.name.to_string(), before, after });
        }
    }

    /// A frame of the bus that belongs to no protocol.
    fn bus_frame<'a>(
        &'a mut self,
        at: usize,
        record: &Record<'_>,
        id: Option<(u32, bool)>,
        bytes: &'a [u8],
    ) -> DecodedFrame<'a> {
        self.frame_count += 1;
        DecodedFrame {
            number: self.frame_count,
            time: record.time,
            direction: record.direction,
            bytes,
            id: id.map(|(id, _)| id),
            extended: id.is_some_and(|(_, extended)| extended),
            notices: &self.notices,
            offset: record.offset,
            ..DecodedFrame::empty(&self.links[at].name, &self.explanation)
        }
    }

    /// Takes bytes of a serial line as they were read or written.
    pub fn decode_bytes(
        &mut self,
        time: Option<Timestamp>,
        link: &str,
        direction: Option<Direction>,
        bytes: &[u8],
        out: FrameCallback<'_>,
    ) {
        self.decode_record(
            &Record { time, link, direction, data: RecordData::Bytes(bytes), offset: 0 },
            out,
        );
    }

    /// Takes a CAN frame as it was sent or received.
    pub fn decode_frame(
        &mut self,
        time: Option<Timestamp>,
        link: &str,
        direction: Option<Direction>,
        frame: &Frame,
        out: FrameCallback<'_>,
    ) {
        self.decode_record(
            &Record { time, link, direction, data: RecordData::Frame(*frame), offset: 0 },
            out,
        );
    }

    /// Ends the capture: what waits for more is given out as it is.
    pub fn finish(&mut self, out: FrameCallback<'_>) {
        let mut reader = core::mem::take(&mut self.reader);
        reader.finish(&mut |record| self.decode_read_record(record, out));
        self.reader = reader;
        for at in 0..self.links.len() {
            for direction in DIRECTIONS {
                self.drain_flow(at, direction, true, out);
            }
        }
    }

    /// After [`finish`](Self::finish): what conversations leave open, each as an event that is no
    /// frame: its number is 0, and it has a link, a protocol, an axis and one notice.
    pub fn finish_sessions(&mut self, out: FrameCallback<'_>) {
        for wire in &mut self.links {
            let (explained, link) = (&mut self.explanation, &*wire.name);
            wire.session.finish(&mut |protocol, notice| {
                explained.clear();
                explained.axis = notice.axis();
                let notices = core::slice::from_ref(notice);
                out(&DecodedFrame {
                    protocol: Some(protocol),
                    notices,
                    ..DecodedFrame::empty(link, explained)
                });
            });
        }
    }

    /// Returns whether requests have no answers on a link without a name, of which no drive's frame was seen: the log
    /// of a program that may print what it sends and nothing else.
    #[must_use]
    pub fn has_requests_only(&self) -> bool {
        self.links.iter().any(|wire| wire.session.has_requests_only())
    }

    /// Statistics of the read and unreadable records.
    #[must_use]
    pub fn statistics(&self) -> &ReadStatistics {
        self.reader.statistics()
    }

    /// Protocols, as they were stated or found.
    #[must_use]
    pub const fn rules(&self) -> &Rules {
        &self.rules
    }

    /// Format of the capture, once it is detected.
    #[must_use]
    pub fn format(&self) -> Option<CaptureFormat> {
        self.reader.format()
    }

    /// Records of more links than are followed at once, which are left out.
    #[must_use]
    pub const fn untracked_records(&self) -> u64 {
        self.untracked
    }

    /// Links on which the host was seen to hear itself.
    pub(crate) fn echo_links(&self) -> impl Iterator<Item = &str> {
        self.links.iter().filter(|wire| wire.conversation.has_echo()).map(|wire| &*wire.name)
    }

    fn link_index(&mut self, name: &str) -> Option<usize> {
        if let Some(at) = self.links.iter().position(|wire| *wire.name == *name) {
            return Some(at);
        }
        self.detect_for(name, None);
        let echoes = self.echo_links.iter().any(|link| link == name);
        (self.links.len() < LINKS_MAX).then(|| {
            self.links.push(LinkDecoder {
                name: name.into(),
                last_time: Timestamp(0),
                has_sent: false,
                rules: self.rules.for_link(name),
                covered: CoveredIds::default(),
                routes: RouteTable::default(),
                repeats: RepeatCache::default(),
                serial_repeats: RepeatCache::default(),
                answers: AnswerCache::default(),
                flows: Default::default(),
                conversation: Conversation::with_echo(echoes),
                session: LinkSession::new(name, self.skips_signals),
            });
            self.links.len() - 1
        })
    }

    fn decode_can_frame(
        &mut self,
        at: usize,
        record: &Record<'_>,
        frame: &Frame,
        out: FrameCallback<'_>,
    ) {
        self.frame_count += 1;
        self.detect_for_frame(at, frame);
        let LinkDecoder { name, rules, routes, repeats, answers, conversation, session, .. } =
            &mut self.links[at];
        self.explanation.clear();
        self.notices.clear();
        // Most frames of a bus are of identifiers that were explained before, which need no rules.
        let known = routes.get(frame);
        let raw = raw_frame(frame);
        let stated_by =
            |rule: &Rule| self.profiles.for_frame(rule.dissector, &raw, record.direction);
        let lane = known.or_else(|| {
            let profile_of_frame = if self.profiles.drives.is_empty() {
                self.profiles.any
            } else {
                rules.iter().find_map(stated_by)
            };
            let context = Context {
                direction: record.direction,
                profile: profile_of_frame,
                id: Some(frame.id),
                extended: frame.extended,
                remote: frame.remote,
                ..Context::default()
            };
            let (judged, follows) = (self.detected, self.tracks_sessions);
            let mut teller = RuleExplainer {
                detected: judged,
                tracks_sessions: follows,
                time: record.time,
                deferred_axis: None,
                rejected_by_content: false,
                answer_key: None,
            };
            let explained = &mut self.explanation;
            let reported = teller.explain(rules, frame, &context, conversation, session, explained);
            let rule = reported.or_else(|| claiming_rule(rules, session, frame))?;
            let (dissector, stated) = (rules[rule].dissector, stated_by(&rules[rule]));
            let profile = stated.or_else(|| polepair_drives::assumed_profile(dissector));
            let left = teller.deferred_axis;
            let lane = FrameRoute {
                dissector,
                profile,
                profile_stated: stated.is_some(),
                deferred_axis: left,
                template: 0,
            };
            // The protocol that its bytes show holds for this one frame only.
            let by_id = reported.is_some() && !teller.rejected_by_content;
            if left.is_some() && by_id {
                routes.insert(frame, lane);
            } else if by_id && follows && self.explanation.error.is_none() {
                if session.is_repeatable(dissector, frame)
                    && let Some(key) = repeat_cache::can_key(frame, record.direction)
                {
                    repeats.record(key, &raw, lane, &self.explanation);
                } else if session.keeps_explanation(dissector, &raw)
                    && let Some(key) = teller.answer_key
                {
                    answers.record(key, &raw, lane, &self.explanation);
                }
            }
            Some(lane)
        });
        if let Some(axis) = known.and_then(|lane| lane.deferred_axis) {
            self.explanation.axis = Some(axis);
        }
        if let Some(lane) = lane.filter(|_| self.tracks_sessions) {
            let observed = lane.observe(self.frame_count, record, frame, self.explanation.error);
            debug_assert!(self.notices.is_empty());
            session.handle_frame(&observed, &mut self.explanation, &mut self.notices);
        }
        let protocol = lane.map(|lane| lane.dissector.name());
        // A conversation may show that a frame has another meaning than it seems.
        let statement = (&self.explanation, &*self.notices);
        out(&DecodedFrame::from_frame(record, self.frame_count, frame, name, protocol, statement));
    }
}

/// A frame's bytes and identifier.
fn raw_frame(frame: &Frame) -> RawFrame<'_> {
    RawFrame { bytes: frame.bytes(), id: Some(frame.id), extended: frame.extended }
}

const DIRECTIONS: [Option<Direction>; 3] =
    [Some(Direction::ToDrive), Some(Direction::ToHost), None];

#[cfg(test)]
mod batch_tests;
#[cfg(test)]
mod tests;
