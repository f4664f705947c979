//! Analysis of conversations: values, requests and their results, states, faults, and anomalies.
//!
//! Each protocol of a link has one `ProtocolTracker`. It receives every frame of the protocol after the
//! frame was explained, and may add to the explanation.

pub mod canopen;
mod exchange;

use core::fmt::Debug;
use std::sync::Arc;

use polepair_core::explain::{Direction, Dissector, RawFrame};
use polepair_core::medium::Frame;
use polepair_core::profile::Profile;

use crate::defect::FrameDefect;
use crate::explanation::Explanation;
use crate::record::{CanErrorFrame, NO_LINK};
use crate::timestamp::Timestamp;
use canopen::ProcessData;

pub use crate::intern::{InternedName, intern};

/// A notice of a conversation.
#[derive(Clone, PartialEq, Debug)]
pub enum SessionNotice {
    /// A value.
    Signal(SignalNotice),
    /// A request and its outcome, given at the frame that settles it.
    Exchange(ExchangeNotice),
    /// A state changed.
    Change(ChangeNotice),
    /// A fault came or went.
    Fault(FaultNotice),
    /// Something that a healthy bus does not do.
    Anomaly(AnomalyNotice),
}

impl SessionNotice {
    /// Axis of the notice; `None` for the bus.
    #[must_use]
    pub const fn axis(&self) -> Option<u32> {
        match self {
            Self::Signal(signal) => Some(signal.axis),
            Self::Exchange(exchange) => exchange.axis,
            Self::Change(change) => change.axis,
            Self::Fault(fault) => Some(fault.axis),
            Self::Anomaly(anomaly) => anomaly.axis,
        }
    }
}

/// A value that a drive reported or was set to.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct SignalNotice {
    /// Axis of the value.
    pub axis: u32,
    /// Name of the value: `Actual/Position` and the like if it is one of an axis' signals by the profile, otherwise the
    /// parameter's or the object's own.
    pub name: InternedName,
    /// The value in `unit`.
    pub value: f64,
    /// The integer on the wire.
    pub exact: Option<i64>,
    /// Unit by the profile; empty if unknown.
    pub unit: InternedName,
    /// Quality of the value.
    pub quality: Quality,
    /// The frame that asked for it.
    pub request: Option<u64>,
}

/// Quality of a value. The numbers are those of the columns.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Debug)]
#[repr(u8)]
pub enum Quality {
    /// The value is in a valid frame.
    Good = 0,
    /// The value was too late to belong to its request for sure.
    Stale = 1,
    /// The check of its frame fails.
    BadCheck = 2,
    /// The meaning was inferred, not stated: by a usual drive's names or a default mapping.
    Inferred = 3,
}

impl Quality {
    /// Name in outputs.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Good => "good",
            Self::Stale => "stale",
            Self::BadCheck => "bad-check",
            Self::Inferred => "inferred",
        }
    }
}

/// A request, and how it ended.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct ExchangeNotice {
    /// Axis of the request; `None` for a broadcast.
    pub axis: Option<u32>,
    /// The protocol's word for it: `GAP`, `SDO read`.
    pub op: InternedName,
    /// The frame that asked first, and when.
    pub requested: (u64, Option<Timestamp>),
    /// The frame that answered last, and when.
    pub answered: Option<(u64, Option<Timestamp>)>,
    /// Outcome of the request.
    pub outcome: ExchangeOutcome,
    /// Number of repetitions.
    pub retries: u16,
}

impl ExchangeNotice {
    /// Nanoseconds from the request to its answer.
    #[must_use]
    pub fn latency(&self) -> Option<u64> {
        Some(self.answered?.1?.since(self.requested.1?))
    }
}

/// Outcome of a request.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum ExchangeOutcome {
    /// Answered: done.
    Done,
    /// Answered: refused, and not done.
    Refused,
    /// The execution is unknown.
    Unknown,
    /// Answered, after it had been given up.
    Late,
    /// Not answered.
    Unanswered,
    /// The answer's check fails.
    BadCheck,
}

impl ExchangeOutcome {
    /// The word of the columns.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Done => "done",
            Self::Refused => "notdone",
            Self::Unknown => "unknown",
            Self::Late => "stale",
            Self::Unanswered => "timeout",
            Self::BadCheck => "crc",
        }
    }
}

/// A state of an axis or a node that changed.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct ChangeNotice {
    /// Axis; `None` for the bus.
    pub axis: Option<u32>,
    /// Kind of state: `nmt`, `power`, `mode`, `presence`, `bus`.
    pub what: InternedName,
    /// Previous state; empty at first.
    pub from: InternedName,
    /// New state.
    pub to: InternedName,
}

/// A fault that came, or went.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct FaultNotice {
    /// Axis.
    pub axis: u32,
    /// The drive's code, or the bits of its fault word.
    pub code: u32,
    /// Description.
    pub text: InternedName,
    /// Usual cause; empty if no profile has it.
    pub cause: InternedName,
    /// Remedy; empty if no profile has it.
    pub remedy: InternedName,
    /// True if it is gone.
    pub gone: bool,
}

/// Something that a healthy bus does not do.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct AnomalyNotice {
    /// Kind of the anomaly.
    pub kind: AnomalyKind,
    /// Axis, if it concerns one.
    pub axis: Option<u32>,
    /// Time, if that is before the frame of the notice.
    pub time: Option<Timestamp>,
    /// One sentence, with numbers.
    pub text: String,
}

macro_rules! anomaly_kinds {
    ($($(#[$doc:meta])* $name:ident = $word:literal, $weight:literal;)*) => {
        /// Sorts of things that a healthy bus does not do.
        #[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Debug)]
        pub enum AnomalyKind { $($(#[$doc])* $name,)* }

        impl AnomalyKind {
            /// All of them.
            pub const ALL: &'static [Self] = &[$(Self::$name),*];

            /// Name in outputs and filters.
            #[must_use]
            pub const fn as_str(self) -> &'static str {
                match self { $(Self::$name => $word,)* }
            }

            /// Weight of one of them, 1 to 9; a rarer one counts more than its weight.
            #[must_use]
            pub const fn severity(self) -> u8 {
                match self { $(Self::$name => $weight,)* }
            }
        }
    };
}

anomaly_kinds! {
    /// A request had no answer in time.
    Unanswered = "unanswered", 6;
    /// A message was not acknowledged where its protocol does.
    MissingAck = "missing-ack", 6;
    /// A repetition of the request before its reply.
    Retry = "retry", 4;
    /// An answer to a request that had been given up.
    LateReply = "late-reply", 7;
    /// A reply without a request.
    ForeignReply = "foreign-reply", 7;
    /// A duplicated reply.
    DuplicateReply = "duplicate-reply", 6;
    /// A drive refused.
    Refused = "refused", 5;
    /// A frame's check fails.
    BadCheck = "bad-check", 5;
    /// Bytes that belong to no frame.
    Stray = "stray", 3;
    /// A frame that breaks its protocol.
    Malformed = "malformed", 5;
    /// Two devices have one address.
    DuplicateAddress = "duplicate-address", 9;
    /// A drive started again while it was in use.
    Restart = "restart", 9;
    /// A drive that spoke regularly fell silent.
    Silent = "silent", 8;
    /// A transfer in several parts was broken off.
    Incomplete = "incomplete", 6;
    /// A counter or toggle that should go on by one did not.
    Sequence = "sequence", 7;
    /// Mapped data of another length than its mapping.
    Length = "length", 6;
    /// A reported fault.
    Fault = "fault", 8;
    /// Faults in quick succession.
    Storm = "storm", 8;
    /// A controller reported an error of the bus.
    BusError = "bus-error", 6;
    /// A controller left the bus.
    BusOff = "bus-off", 9;
    /// Something that comes at a steady rate came much too early or too late.
    Jitter = "jitter", 3;
}

/// A frame for a tracker.
#[derive(Clone, Copy)]
pub(crate) struct ObservedFrame<'a> {
    /// Number in the capture, from 1.
    pub number: u64,
    /// Time at which its first byte arrived.
    pub time: Option<Timestamp>,
    /// Sender, if the capture names it.
    pub direction: Option<Direction>,
    /// Bytes, and the CAN identifier.
    pub raw: RawFrame<'a>,
    /// A CAN remote request.
    pub remote: bool,
    /// True for the host's own request, returned by its adapter.
    pub echo: bool,
    /// Defect of the frame.
    pub defect: Option<FrameDefect>,
    /// These bytes have not the shape of a frame.
    pub stray: bool,
    /// True if it is not explained yet: [`Dissector::process_data_axis`] leaves that to the tracker.
    pub deferred: bool,
    /// Dissector that explained it.
    pub dissector: &'static dyn Dissector,
    /// The drive whose names are used.
    pub profile: Option<&'static Profile>,
    /// The profile was stated and is not a usual drive's.
    pub profile_stated: bool,
}

/// Follows one protocol on one link.
pub(crate) trait ProtocolTracker: Debug + Send {
    /// Handles a frame. May extend its explanation, and adds its notices.
    fn handle_frame(
        &mut self,
        observed: &ObservedFrame<'_>,
        explanation: &mut Explanation,
        notices: &mut Vec<SessionNotice>,
    );

    /// The request under way that `answer` belongs to, if it comes now.
    fn awaited_request(
        &self,
        dissector: &dyn Dissector,
        answer: &RawFrame<'_>,
        now: Option<Timestamp>,
    ) -> Option<RawFrame<'_>> {
        let _ = (dissector, answer, now);
        None
    }

    /// Advances the time to `now`: whatever was due by then is missing.
    fn advance_time(&mut self, now: Timestamp, notices: &mut Vec<SessionNotice>) {
        let _ = (now, notices);
    }

    /// Meaning of a frame of 11 bits that changes nothing, now; `None` if it has to be [handled](Self::handle_frame).
    fn unchanged_process_data(
        &mut self,
        frame: &Frame,
        now: Timestamp,
    ) -> Option<&Arc<ProcessData>> {
        let _ = (frame, now);
        None
    }

    /// Returns whether the meaning of frames with that identifier of 11 bits depends on their bytes alone.
    fn is_repeatable(&self, id: u32) -> bool {
        let _ = id;
        false
    }

    /// Returns whether it would leave the explanation of a frame without a defect as it is, and not look at its text.
    fn keeps_explanation(&self, frame: &RawFrame<'_>) -> bool {
        let _ = frame;
        false
    }

    /// Returns whether the capture gave that CAN identifier to this protocol, which is not its own otherwise.
    fn claims_id(&self, id: u32, extended: bool) -> bool {
        let _ = (id, extended);
        false
    }

    /// The capture ends.
    fn finish(&mut self, notices: &mut Vec<SessionNotice>);
}

/// The trackers of one link, by protocol.
#[derive(Debug, Default)]
pub(crate) struct LinkSession {
    trackers: Vec<(InternedName, Box<dyn ProtocolTracker>)>,
    /// Values are left out, states and faults are not.
    skips_signals: bool,
    /// Doubts on a link of which no frame of a drive has been seen, where that proves nothing.
    one_sided: Option<OneSidedLink>,
}

/// A link whose capture may hold the host's side alone: a line of another program's log names no link, and many of them
/// print what they send and nothing else.
#[derive(Debug, Default)]
struct OneSidedLink {
    /// Missing answers, until a drive's frame shows that answers are recorded.
    held: Vec<SessionNotice>,
}

/// Missing answers that are kept.
const HELD_MAX: usize = 64;

impl OneSidedLink {
    /// Keeps the notices of missing answers back.
    fn hold(&mut self, time: Option<Timestamp>, notices: &mut Vec<SessionNotice>) {
        let is_doubt = |notice: &mut SessionNotice| {
            let kinds = [AnomalyKind::Unanswered, AnomalyKind::Retry, AnomalyKind::Silent];
            matches!(notice, SessionNotice::Anomaly(anomaly) if kinds.contains(&anomaly.kind))
        };
        for notice in notices.iter_mut() {
            if let SessionNotice::Exchange(exchange) = notice
                && exchange.outcome == ExchangeOutcome::Unanswered
            {
                exchange.outcome = ExchangeOutcome::Unknown;
            }
        }
        for mut notice in notices.extract_if(.., is_doubt) {
            if let SessionNotice::Anomaly(anomaly) = &mut notice {
                anomaly.time = anomaly.time.or(time);
            }
            if self.held.len() < HELD_MAX {
                self.held.push(notice);
            }
        }
    }
}

/// Returns whether a notice shows a frame of a drive.
fn shows_drive(notice: &SessionNotice) -> bool {
    match notice {
        SessionNotice::Exchange(exchange) => exchange.answered.is_some(),
        SessionNotice::Fault(_) => true,
        SessionNotice::Signal(_) | SessionNotice::Change(_) | SessionNotice::Anomaly(_) => false,
    }
}

impl LinkSession {
    /// The session of a link, without notices of values if `skips_signals`.
    pub fn new(link: &str, skips_signals: bool) -> Self {
        let one_sided = (link == NO_LINK).then(OneSidedLink::default);
        Self { one_sided, skips_signals, ..Self::default() }
    }

    /// Returns whether answers are missing on a link whose capture may have none.
    pub fn has_requests_only(&self) -> bool {
        self.one_sided.as_ref().is_some_and(|link| !link.held.is_empty())
    }

    /// The request under way that `answer` belongs to, if it comes now.
    pub fn awaited_request(
        &self,
        dissector: &dyn Dissector,
        answer: &RawFrame<'_>,
        now: Option<Timestamp>,
    ) -> Option<RawFrame<'_>> {
        let protocol = dissector.name();
        let tracker = self.trackers.iter().find(|(name, _)| is_same_protocol(name, protocol));
        tracker?.1.awaited_request(dissector, answer, now)
    }

    /// Handles a frame in its conversation.
    pub fn handle_frame(
        &mut self,
        observed: &ObservedFrame<'_>,
        explanation: &mut Explanation,
        notices: &mut Vec<SessionNotice>,
    ) {
        if let Some(now) = observed.time {
            // All of the link, so that a node that fell silent is noticed at the frames of the others.
            self.trackers.iter_mut().for_each(|(_, follower)| follower.advance_time(now, notices));
        }
        let protocol = observed.dissector.name();
        let at = self.trackers.iter().position(|(name, _)| is_same_protocol(name, protocol));
        let at = at.unwrap_or_else(|| {
            self.trackers.push((protocol, new_tracker(observed.dissector, self.skips_signals)));
            self.trackers.len() - 1
        });
        self.trackers[at].1.handle_frame(observed, explanation, notices);
        let is_received = observed.direction == Some(Direction::ToHost);
        if let Some(link) = &mut self.one_sided {
            if is_received || notices.iter().any(shows_drive) {
                notices.splice(0..0, core::mem::take(&mut link.held));
                self.one_sided = None;
            } else {
                link.hold(observed.time, notices);
            }
        }
    }

    /// Meaning of a frame that changes nothing, on a link with one protocol.
    #[inline]
    pub fn unchanged_process_data(
        &mut self,
        frame: &Frame,
        now: Timestamp,
    ) -> Option<&Arc<ProcessData>> {
        match &mut self.trackers[..] {
            [(_, only)] => only.unchanged_process_data(frame, now),
            _ => None,
        }
    }

    /// Returns whether the meaning of a frame with an identifier of 11 bits depends on its bytes alone, on a link with
    /// its protocol alone.
    pub fn is_repeatable(&self, dissector: &dyn Dissector, frame: &Frame) -> bool {
        let [(name, only)] = &self.trackers[..] else { return false };
        let raw = RawFrame { bytes: frame.bytes(), id: Some(frame.id), extended: frame.extended };
        is_same_protocol(name, dissector.name())
            && (only.is_repeatable(frame.id) || dissector.is_plain_request(&raw))
    }

    /// Returns whether the explanation of a frame would stay as it is, on a link with its protocol alone.
    pub fn keeps_explanation(&self, dissector: &dyn Dissector, frame: &RawFrame<'_>) -> bool {
        let [(name, only)] = &self.trackers[..] else { return false };
        is_same_protocol(name, dissector.name()) && only.keeps_explanation(frame)
    }

    /// The protocol that the capture gave a CAN identifier to, beside those that are its own.
    pub fn claiming_protocol(&self, id: u32, extended: bool) -> Option<InternedName> {
        let mut claims = self.trackers.iter().filter(|(_, it)| it.claims_id(id, extended));
        claims.next().map(|(name, _)| *name)
    }

    /// Reports open ends at the end, with their protocol.
    pub fn finish(&mut self, report_line: &mut dyn FnMut(InternedName, &SessionNotice)) {
        for (protocol, follower) in &mut self.trackers {
            let mut notices = Vec::new();
            follower.finish(&mut notices);
            if let Some(link) = &mut self.one_sided {
                link.hold(None, &mut notices);
            }
            notices.iter().for_each(|notice| report_line(protocol, notice));
        }
    }
}

fn is_same_protocol(name: InternedName, protocol: &str) -> bool {
    // The same word is the same place of memory, mostly.
    core::ptr::eq(name, protocol) || name == protocol
}

/// Returns whether a notice describes a defect of a single frame.
pub(crate) fn is_frame_anomaly(notice: &SessionNotice) -> bool {
    let kinds = [AnomalyKind::BadCheck, AnomalyKind::Malformed, AnomalyKind::Stray];
    matches!(notice, SessionNotice::Anomaly(anomaly) if kinds.contains(&anomaly.kind))
}

/// Notice of a controller's report; `None` for reports that a healthy bus has too.
pub(crate) fn error_frame_notice(error: &CanErrorFrame, text: &str) -> Option<SessionNotice> {
    const HEALTHY: [&str; 4] =
        ["arbitration lost", "restarted", "error counters", "error active again"];
    let kind = match error.descriptions().find(|word| !HEALTHY.contains(word))? {
        _ if error.descriptions().any(|word| word == "bus-off") => AnomalyKind::BusOff,
        _ => AnomalyKind::BusError,
    };
    Some(SessionNotice::Anomaly(AnomalyNotice {
        kind,
        axis: None,
        time: None,
        text: text.to_owned(),
    }))
}

/// Tracker of a protocol's conversations.
fn new_tracker(protocol: &'static dyn Dissector, skips_signals: bool) -> Box<dyn ProtocolTracker> {
    match protocol.name() {
        "canopen" => Box::new(canopen::CanopenTracker::new(skips_signals)),
        _ => Box::new(exchange::ExchangeTracker::new(skips_signals)),
    }
}
