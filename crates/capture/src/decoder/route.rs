//! Selects the protocol of a CAN frame by the rules, and caches it for identifiers whose frames all have
//! the same protocol.

use polepair_core::error::WireError;
use polepair_core::explain::{Context, Direction, Dissector, RawFrame};
use polepair_core::medium::Frame;
use polepair_core::profile::Profile;

use super::answer_cache::AnswerKey;
use crate::conversation::Conversation;
use crate::defect::FrameDefect;
use crate::explanation::Explanation;
use crate::record::{Record, STANDARD_MAX};
use crate::rules::{Rule, RuleScope};
use crate::session::{LinkSession, ObservedFrame};
use crate::timestamp::Timestamp;

/// Protocol and axis of the frames of an identifier, with the names for them.
#[derive(Clone, Copy)]
pub(super) struct FrameRoute {
    pub dissector: &'static dyn Dissector,
    pub profile: Option<&'static Profile>,
    /// The profile was stated and is not a usual drive's.
    pub profile_stated: bool,
    /// The axis, where the frame is left to its conversation to explain.
    pub deferred_axis: Option<u32>,
    /// Index of its last template in a batch.
    pub template: u16,
}

impl FrameRoute {
    /// Converts a CAN frame for its tracker.
    pub fn observe<'a>(
        &self,
        number: u64,
        record: &Record<'_>,
        frame: &'a Frame,
        error: Option<WireError>,
    ) -> ObservedFrame<'a> {
        ObservedFrame {
            remote: frame.remote,
            defect: error.map(FrameDefect::Wire),
            deferred: self.deferred_axis.is_some(),
            ..self.observe_raw(number, record, super::raw_frame(frame))
        }
    }

    /// Converts a frame without a defect, of any medium, for its tracker.
    pub fn observe_raw<'a>(
        &self,
        number: u64,
        record: &Record<'_>,
        raw: RawFrame<'a>,
    ) -> ObservedFrame<'a> {
        ObservedFrame {
            number,
            time: record.time,
            direction: record.direction,
            raw,
            remote: false,
            echo: false,
            defect: None,
            stray: false,
            deferred: false,
            dissector: self.dissector,
            profile: self.profile,
            profile_stated: self.profile_stated,
        }
    }
}

/// Routes of identifiers whose frames all have one, with any content.
#[derive(Default)]
pub(super) struct RouteTable(Vec<Option<FrameRoute>>);

impl core::fmt::Debug for RouteTable {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "{} of {}", self.0.iter().flatten().count(), self.0.len())
    }
}

impl RouteTable {
    pub fn get(&self, frame: &Frame) -> Option<FrameRoute> {
        let known = *self.0.get(frame.id as usize)?;
        known.filter(|_| !frame.extended && !frame.remote)
    }

    /// Mutable route of a frame that is left to its conversation.
    pub fn deferred_mut(&mut self, frame: &Frame) -> Option<&mut FrameRoute> {
        let known = self.0.get_mut(frame.id as usize)?.as_mut()?;
        (known.deferred_axis.is_some() && !frame.extended && !frame.remote).then_some(known)
    }

    /// Keeps it for the identifier, if it has 11 bits.
    pub fn insert(&mut self, frame: &Frame, lane: FrameRoute) {
        self.0.resize(STANDARD_MAX as usize + 1, None);
        if let Some(frame_route) = self.0.get_mut(frame.id as usize).filter(|_| !frame.extended) {
            *frame_route = Some(lane);
        }
    }
}

/// Stated profiles by which parameters are named.
#[derive(Clone, Debug, Default)]
pub(super) struct StatedProfiles {
    /// Profile of drives without one of their own.
    pub any: Option<&'static Profile>,
    /// Profiles of drives at these addresses, if they differ.
    pub drives: Vec<(u32, &'static Profile)>,
}

impl StatedProfiles {
    /// The profile for a frame, if it is one of the protocol's that explains it.
    pub fn for_frame(
        &self,
        dissector: &'static dyn Dissector,
        frame: &RawFrame<'_>,
        direction: Option<Direction>,
    ) -> Option<&'static Profile> {
        // With one profile for all drives the frame need not be explained to find its axis.
        let own = (!self.drives.is_empty()).then(|| self.of_drive(dissector, frame, direction));
        let profile = own.flatten().or(self.any);
        profile.filter(|profile| profile_speaks(profile, dissector))
    }

    fn of_drive(
        &self,
        dissector: &'static dyn Dissector,
        frame: &RawFrame<'_>,
        direction: Option<Direction>,
    ) -> Option<&'static Profile> {
        let (id, extended) = (frame.id, frame.extended);
        let context = Context { direction, id, extended, ..Context::default() };
        let mut explained = Explanation::values_only();
        dissector.explain(frame.bytes, &context, &mut explained);
        let axis = explained.axis?;
        self.drives.iter().find(|(address, _)| *address == axis).map(|(_, profile)| *profile)
    }
}

/// Returns whether drives of a profile speak a protocol.
pub(crate) fn profile_speaks(profile: &Profile, dissector: &dyn Dissector) -> bool {
    dissector.language() == profile.protocol
}

/// The rule of the protocol that a capture gave an identifier to which is not its own.
pub(super) fn claiming_rule(rules: &[Rule], session: &LinkSession, frame: &Frame) -> Option<usize> {
    let name = session.claiming_protocol(frame.id, frame.extended)?;
    rules.iter().position(|rule| rule.dissector.name() == name)
}

/// Lets rules explain a frame.
pub(super) struct RuleExplainer {
    pub detected: bool,
    /// Conversations are followed.
    pub tracks_sessions: bool,
    /// Time of the frame.
    pub time: Option<Timestamp>,
    /// The axis of a frame that was left to its conversation to explain.
    pub deferred_axis: Option<u32>,
    /// True if a rule was rejected by the frame's content: other frames with its identifier may follow that rule.
    pub rejected_by_content: bool,
    /// Key of the frame among answers, if it is one.
    pub answer_key: Option<AnswerKey>,
}

impl RuleExplainer {
    /// Explains the frame by the first rule that applies to it, as a request or a reply.
    pub fn explain(
        &mut self,
        rules: &[Rule],
        frame: &Frame,
        context: &Context<'_>,
        conversation: &mut Conversation,
        session: &LinkSession,
        explained: &mut Explanation,
    ) -> Option<usize> {
        let detected = self.detected;
        let claims = |(_, rule): &(usize, &Rule)| {
            let claims = if frame.remote {
                rule.dissector.claims_remote(frame.id, frame.extended)
            } else {
                rule.dissector.claims_id(frame.id, frame.extended)
            };
            // The protocol detected for an axis decides identifiers that several protocols use; the
            // one detected for the link decides the others.
            let shared = || rule.dissector.shares_id(frame.id, frame.extended);
            claims
                && match rule.scope {
                    RuleScope::AxisOn(..) => shared(),
                    RuleScope::Link(_) => !(detected && shared()),
                    _ => true,
                }
        };
        for (at, rule) in rules.iter().enumerate().filter(claims) {
            self.apply_rule(rule, frame, context, conversation, session, explained);
            match rule.scope {
                RuleScope::Axis(axis) | RuleScope::AxisOn(_, axis)
                    if !matches_axis(axis, explained.axis) =>
                {
                    self.rejected_by_content |= self.deferred_axis.is_none();
                }
                _ => return Some(at),
            }
        }
        explained.clear();
        self.deferred_axis = None;
        let at =
            rules.iter().position(|rule| !self.detected && !frame.remote && is_whole_rule(rule))?;
        self.apply_rule(&rules[at], frame, context, conversation, session, explained);
        Some(at)
    }

    fn apply_rule(
        &mut self,
        rule: &Rule,
        frame: &Frame,
        context: &Context<'_>,
        conversation: &mut Conversation,
        session: &LinkSession,
        explained: &mut Explanation,
    ) {
        let raw = super::raw_frame(frame);
        explained.clear();
        let process_data_axis = rule.dissector.process_data_axis(&raw);
        self.deferred_axis = process_data_axis.filter(|_| self.tracks_sessions && !frame.remote);
        if self.deferred_axis.is_some() {
            explained.axis = self.deferred_axis;
            return;
        }
        let asks = rule.dissector.is_request(&raw);
        let request = if asks || process_data_axis.is_some() {
            None
        } else {
            let awaited = session.awaited_request(rule.dissector, &raw, self.time);
            awaited.or_else(|| conversation.find_request(rule.dissector, &raw))
        };
        self.answer_key =
            request.and_then(|request| AnswerKey::new(&request, &raw, context.direction));
        let stated = context.profile.filter(|profile| profile_speaks(profile, rule.dissector));
        let context = Context {
            request: request.map(|request| request.bytes),
            request_id: request.and_then(|request| request.id),
            profile: stated.or_else(|| polepair_drives::assumed_profile(rule.dissector)),
            profile_assumed: stated.is_none(),
            ..*context
        };
        rule.dissector.explain(frame.bytes(), &context, explained);
        if asks {
            conversation.push_request(&raw);
        }
    }
}

fn is_whole_rule(rule: &Rule) -> bool {
    !matches!(rule.scope, RuleScope::Axis(_) | RuleScope::AxisOn(..))
}

fn matches_axis(axis: u32, explained_axis: Option<u32>) -> bool {
    // A broadcast concerns each axis.
    explained_axis.is_none_or(|found| found == axis)
}
