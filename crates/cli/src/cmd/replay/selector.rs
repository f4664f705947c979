//! Selects the frames of a capture that are sent, their wire, and their effect on the drive.

use polepair_capture::{CAN_FD, DecodedFrame, FrameFilter};
use polepair_core::explain::{
    ConversationContext, Direction, Dissector, Effect, FrameRole, Impact, RawFrame,
    ReplyExpectation,
};
use polepair_core::medium::{Frame, MediumKind};
use polepair_core::profile::Profile;
use polepair_core::proto;

use crate::tap_queue::UnitBuf;

/// Identifiers of frames end here; above are a controller's reports of errors.
const ID_MAX: u32 = 0x1FFF_FFFF;

/// Frames to send, by their sender.
#[derive(Clone, Copy, PartialEq, Eq, Debug, clap::ValueEnum)]
pub enum SendDirection {
    /// Frames of the host
    Tx,
    /// Frames of the drives
    Rx,
    /// All frames, including those with unknown sender
    Both,
}

/// A wire, and the link of the capture that is played there.
#[derive(Clone, Debug)]
pub struct ReplayRoute {
    /// The capture's name for it; `None` is whatever link there is.
    pub link: Option<String>,
    pub medium: MediumKind,
}

/// A frame that is to be sent.
pub struct ReplayFrame {
    pub wire: usize,
    /// Nanoseconds since the first one that is sent.
    pub at: u64,
    pub unit: UnitBuf,
    pub axis: Option<u32>,
    pub effect: Effect,
    /// Protocol that knows its reply, if it has one.
    pub answer_dissector: Option<&'static dyn Dissector>,
}

/// Reason why a frame is not sent.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum SkipReason {
    /// A frame of the other direction, or an echo of the host's own.
    OtherDirection,
    /// A frame of an unknown sender.
    UnknownSender,
    /// The filter does not want it.
    Filtered,
    /// A frame of a link that is not replayed.
    UnroutedLink,
    /// The wire has no such frames: CAN FD, or bytes on a bus.
    UnfitForWire,
    /// A controller's report, which has no sender.
    ErrorReport,
}

/// Chooses frames.
#[derive(Clone, Debug)]
pub struct FrameSelector {
    pub direction: SendDirection,
    pub filter: Option<FrameFilter>,
    pub routes: Vec<ReplayRoute>,
    pub profile: Option<&'static Profile>,
    /// The last request of serial links that nothing followed yet.
    open_requests: Vec<(String, Vec<u8>)>,
    first_time: Option<u64>,
    last_time: u64,
}

impl FrameSelector {
    pub fn new(
        direction: SendDirection,
        filter: Option<FrameFilter>,
        routes: Vec<ReplayRoute>,
    ) -> Self {
        Self {
            direction,
            filter,
            routes,
            profile: None,
            open_requests: Vec::new(),
            first_time: None,
            last_time: 0,
        }
    }

    /// The unit to send for a frame, or the reason to skip it.
    pub fn select(&mut self, event: &DecodedFrame<'_>) -> Result<ReplayFrame, SkipReason> {
        // Asked of every frame: times of a filter count from the first.
        let wanted = self.filter.as_mut().is_none_or(|filter| filter.matches(event));
        let dissector = event.protocol.and_then(proto::find_dissector);
        let raw = RawFrame { bytes: event.bytes, id: event.id, extended: event.extended };
        let speaker = self.speaker(event, &raw, dissector);
        let played =
            |route: &ReplayRoute| route.link.as_deref().is_none_or(|link| link == event.link);
        let wire = self.routes.iter().position(played).ok_or(SkipReason::UnroutedLink)?;
        if event.id.is_some_and(|id| id > ID_MAX) {
            return Err(SkipReason::ErrorReport);
        }
        let medium = if event.id.is_some() { MediumKind::Can } else { MediumKind::Serial };
        if medium != self.routes[wire].medium || event.explanation.kind == CAN_FD {
            return Err(SkipReason::UnfitForWire);
        }
        match (self.direction, speaker) {
            _ if event.echo => return Err(SkipReason::OtherDirection),
            (SendDirection::Both, _) => {}
            (_, None) => return Err(SkipReason::UnknownSender),
            (SendDirection::Tx, Some(Direction::ToDrive))
            | (SendDirection::Rx, Some(Direction::ToHost)) => {}
            _ => return Err(SkipReason::OtherDirection),
        }
        if !wanted {
            return Err(SkipReason::Filtered);
        }
        Ok(ReplayFrame {
            wire,
            at: self.time_since_first(event),
            unit: to_unit(event),
            axis: event.explanation.axis,
            effect: self.effect(event, &raw, dissector),
            answer_dissector: dissector.filter(|dissector| expects_answer(*dissector, &raw)),
        })
    }

    /// Sender of a frame: by the capture, otherwise by the frame.
    fn speaker(
        &mut self,
        event: &DecodedFrame<'_>,
        raw: &RawFrame<'_>,
        dissector: Option<&'static dyn Dissector>,
    ) -> Option<Direction> {
        let at = self.open_requests.iter().position(|(link, _)| link == event.link);
        let open =
            at.map(|at| RawFrame { bytes: &self.open_requests[at].1, ..RawFrame::default() });
        let open = open.filter(|open| raw.id.is_none() && !open.bytes.is_empty());
        let by_itself = || dissector?.direction(raw, open);
        // On CAN the protocol knows better than a logger, which receives the frames of both sides.
        let speaker = match raw.id {
            Some(_) => by_itself().or(event.direction),
            None => event.direction.or_else(by_itself),
        };
        if raw.id.is_none() {
            let at = at.unwrap_or_else(|| {
                self.open_requests.push((event.link.to_owned(), Vec::new()));
                self.open_requests.len() - 1
            });
            self.open_requests[at].1.clear();
            if speaker == Some(Direction::ToDrive) {
                self.open_requests[at].1.extend_from_slice(raw.bytes);
            }
        }
        speaker
    }

    /// Time since the first frame; without a time, or with an earlier one, that of the last.
    fn time_since_first(&mut self, event: &DecodedFrame<'_>) -> u64 {
        if let Some(time) = event.time {
            let first = *self.first_time.get_or_insert(time.0);
            self.last_time = self.last_time.max(time.0.saturating_sub(first));
        }
        self.last_time
    }

    fn effect(
        &self,
        event: &DecodedFrame<'_>,
        raw: &RawFrame<'_>,
        dissector: Option<&'static dyn Dissector>,
    ) -> Effect {
        let Some(dissector) = dissector else { return Effect::UNKNOWN };
        if event.remote {
            return Effect::NOTHING;
        }
        match self.profile.filter(|p| dissector.language() == p.protocol) {
            Some(stated) => dissector.effect(raw, Some(stated)),
            // A usual drive's table warns of what it knows; it vouches for no other drive.
            None => dissector
                .effect(raw, None)
                .combine(dissector.effect(raw, polepair_drives::assumed_profile(dissector))),
        }
    }
}

/// Returns whether a request needs a reply.
fn expects_answer(dissector: &dyn Dissector, raw: &RawFrame<'_>) -> bool {
    let talk = ConversationContext {
        direction: Some(Direction::ToDrive),
        ..ConversationContext::default()
    };
    match dissector.role(raw, &talk) {
        FrameRole::Request(awaits) => awaits != ReplyExpectation::NONE,
        _ => dissector.is_request(raw),
    }
}

fn to_unit(event: &DecodedFrame<'_>) -> UnitBuf {
    let Some(id) = event.id else { return UnitBuf::Bytes(event.bytes.to_vec()) };
    let mut frame =
        Frame { id, extended: event.extended, remote: event.remote, ..Frame::default() };
    let bytes = &event.bytes[..event.bytes.len().min(8)];
    frame.len = if event.remote { event.remote_len } else { bytes.len() as u8 };
    frame.data[..bytes.len()].copy_from_slice(bytes);
    UnitBuf::Frame(frame)
}

/// One word for what a frame may do.
pub const fn effect_word(effect: Effect) -> &'static str {
    match (effect.persistent, effect.impact) {
        (true, _) => "keeps",
        (false, Impact::Nothing) => "asks",
        (false, Impact::Settings) => "sets",
        (false, Impact::Motion) => "moves",
        (false, Impact::Unknown) => "?",
    }
}
