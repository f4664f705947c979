//! Which protocol a CAN frame is of: found by its rules frame by frame, and kept for identifiers whose
//! frames all go the same way.

use polepair_core::drives;
use polepair_core::error::WireError;
use polepair_core::explain::{Context, Dissector};
use polepair_core::medium::Frame;
use polepair_core::profile::Profile;

use super::Wrong;
use crate::conversation::Conversation;
use crate::explained::Explained;
use crate::record::{Record, STANDARD_MAX};
use crate::rules::{Rule, Scope};
use crate::session::{Heard, Session};

/// Whose the frames of an identifier are, and by which names they are told.
#[derive(Clone, Copy)]
pub(super) struct Lane {
    pub dissector: &'static dyn Dissector,
    pub profile: Option<&'static Profile>,
    /// The profile was stated and is not a usual drive's.
    pub stated: bool,
    /// The axis, where the frame is left to its conversation to explain.
    pub left: Option<u32>,
    /// Where in a batch its voice was last.
    pub voice: u16,
}

impl Lane {
    /// A frame as its follower hears it.
    pub fn heard<'a>(
        &self,
        number: u64,
        record: &Record<'_>,
        frame: &'a Frame,
        error: Option<WireError>,
    ) -> Heard<'a> {
        Heard {
            number,
            time: record.time,
            direction: record.direction,
            raw: super::raw(frame),
            remote: frame.remote,
            echo: false,
            wrong: error.map(Wrong::Wire),
            stray: false,
            left: self.left.is_some(),
            dissector: self.dissector,
            profile: self.profile,
            stated: self.stated,
        }
    }
}

/// What was found of identifiers whose frames all go the same way, whatever they hold.
#[derive(Default)]
pub(super) struct Lanes(Vec<Option<Lane>>);

impl core::fmt::Debug for Lanes {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "{} of {}", self.0.iter().flatten().count(), self.0.len())
    }
}

impl Lanes {
    pub fn of(&self, frame: &Frame) -> Option<Lane> {
        let known = *self.0.get(frame.id as usize)?;
        known.filter(|_| !frame.extended && !frame.remote)
    }

    /// The same, to be changed, of one whose frames are left to their conversation.
    pub fn left(&mut self, frame: &Frame) -> Option<&mut Lane> {
        let known = self.0.get_mut(frame.id as usize)?.as_mut()?;
        (known.left.is_some() && !frame.extended && !frame.remote).then_some(known)
    }

    /// Keeps it for the identifier, if it has 11 bits.
    pub fn keep(&mut self, frame: &Frame, lane: Lane) {
        self.0.resize(STANDARD_MAX as usize + 1, None);
        if let Some(place) = self.0.get_mut(frame.id as usize).filter(|_| !frame.extended) {
            *place = Some(lane);
        }
    }
}

/// The profile, if it is one of the protocol's that a rule names.
pub(super) fn spoken(profile: Option<&'static Profile>, rule: &Rule) -> Option<&'static Profile> {
    profile.filter(|profile| speaks(profile, rule.dissector))
}

/// Whether drives of a profile speak a protocol.
pub(crate) fn speaks(profile: &Profile, dissector: &dyn Dissector) -> bool {
    dissector.language().starts_with(profile.protocol)
}

/// The rule of the protocol that a capture gave an identifier to which is not its own.
pub(super) fn claimant(rules: &[Rule], session: &Session, frame: &Frame) -> Option<usize> {
    let name = session.claimant(frame.id, frame.extended)?;
    rules.iter().position(|rule| rule.dissector.name() == name)
}

/// Lets rules explain a frame.
pub(super) struct Teller {
    pub judged: bool,
    /// Conversations are followed.
    pub follows: bool,
    /// The axis of a frame that was left to its conversation to explain.
    pub left: Option<u32>,
    /// Rules that were tried: by the frame's identifier alone where it is one that leaves it.
    pub tried: usize,
}

impl Teller {
    /// Lets the first rule that holds for the frame explain it, as what it asks or answers.
    pub fn explain(
        &mut self,
        rules: &[Rule],
        frame: &Frame,
        context: &Context<'_>,
        conversation: &mut Conversation,
        explained: &mut Explained,
    ) -> Option<usize> {
        let claims = |(_, rule): &(usize, &Rule)| match frame.remote {
            true => rule.dissector.claims_remote(frame.id, frame.extended),
            false => rule.dissector.claims(frame.id, frame.extended),
        };
        for (at, rule) in rules.iter().enumerate().filter(claims) {
            self.by(rule, frame, context, conversation, explained);
            // What is said to everybody is said to each axis.
            let meant = |axis| explained.axis.is_none_or(|found| found == axis);
            let shared = || rule.dissector.shares(frame.id, frame.extended);
            match rule.scope {
                Scope::Axis(axis) | Scope::AxisOn(_, axis) if !meant(axis) => {}
                Scope::Link(_) if self.judged && shared() => {}
                _ => return Some(at),
            }
        }
        explained.clear();
        self.left = None;
        let whole = |rule: &Rule| !matches!(rule.scope, Scope::Axis(_) | Scope::AxisOn(..));
        let stated = |rule: &Rule| !self.judged && !frame.remote && whole(rule);
        let at = rules.iter().position(stated)?;
        self.by(&rules[at], frame, context, conversation, explained);
        Some(at)
    }

    fn by(
        &mut self,
        rule: &Rule,
        frame: &Frame,
        context: &Context<'_>,
        conversation: &mut Conversation,
        explained: &mut Explained,
    ) {
        let raw = super::raw(frame);
        explained.clear();
        self.tried += 1;
        self.left = rule.dissector.plain(&raw).filter(|_| self.follows && !frame.remote);
        if self.left.is_some() {
            explained.axis = self.left;
            return;
        }
        let asks = rule.dissector.asks(&raw);
        let request = if asks { None } else { conversation.request(rule.dissector, &raw) };
        let stated = spoken(context.profile, rule);
        let context = Context {
            request: request.map(|request| request.bytes),
            request_id: request.and_then(|request| request.id),
            profile: stated.or_else(|| drives::assumed(rule.dissector)),
            assumed: stated.is_none(),
            ..*context
        };
        rule.dissector.explain(frame.bytes(), &context, explained);
        if asks {
            conversation.ask(&raw);
        }
    }
}
