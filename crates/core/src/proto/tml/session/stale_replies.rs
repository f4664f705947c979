//! Earlier requests whose acknowledgement or reply may still arrive.

use crate::proto::tml::host_request::is_group_query;
use crate::proto::tml::online::OnlineMessage;
use crate::proto::tml::wire::IdCode;
use crate::time::Instant;

use super::{AAR, SRL};
use crate::proto::reply_ledger::ReplyLedger;

/// Axes in doubt at a time at most; one more puts the whole line in doubt.
const AXES_MAX: usize = 4;
/// Replies in doubt of one axis at most.
const REPLIES_MAX: usize = 8;

/// Variables that are there in every firmware, to be asked for when only the answer counts: SRL,
/// AAR, MER, MCR, KPP, KIP, KDP.
const PROBES: [ReplyKind; 7] = [
    ReplyKind::Answer(SRL),
    ReplyKind::Answer(AAR),
    ReplyKind::Answer(0x08FC),
    ReplyKind::Answer(0x0309),
    ReplyKind::Answer(0x025E),
    ReplyKind::Answer(0x0260),
    ReplyKind::Answer(0x0262),
];

/// Kind of a drive's reply.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum ReplyKind {
    /// An acknowledgement, which names neither its axis nor its message.
    Ack,
    /// The answer about a variable.
    Answer(u16),
}

/// Answers given twice, running, after which there are two drives of one axis ID. Once or twice it
/// may be a copy that an adapter made.
const DUPLICATES_MIN: u8 = 3;

/// Everything in doubt on a line.
#[derive(Debug)]
pub struct StaleReplies {
    axes: ReplyLedger<ReplyKind, AXES_MAX, REPLIES_MAX>,
    /// The last answer taken, whose repetition shows a second drive of that ID.
    last_answer: Option<(u8, OnlineMessage)>,
    /// Duplicated replies in a row, by axis.
    duplicates: [u8; 256],
}

impl StaleReplies {
    pub const fn new() -> Self {
        Self { axes: ReplyLedger::new(), last_answer: None, duplicates: [0; 256] }
    }

    /// Answers about a variable may still come.
    pub fn add_answer(&mut self, axis: u8, tag: u16, until: Instant, probe: bool) {
        self.axes.add(axis, ReplyKind::Answer(tag), until);
        self.axes.set_probe_due(axis, probe);
    }

    /// An acknowledgement may still come.
    pub fn add_ack(&mut self, axis: u8, until: Instant) {
        self.axes.add(axis, ReplyKind::Ack, until);
        self.axes.set_probe_due(axis, true);
    }

    /// Returns whether a reply about this variable could be an older one.
    pub fn may_answer_be_stale(&self, now: Instant, axis: u8, tag: u16) -> bool {
        self.axes.may_include(now, axis, ReplyKind::Answer(tag))
    }

    /// Returns whether an acknowledgement could be an older one.
    pub fn may_ack_be_stale(&self, now: Instant) -> bool {
        self.axes.may_any_include(now, ReplyKind::Ack)
    }

    /// Allows a probe again whose reply was lost.
    pub fn repeat_probe(&mut self, axis: u8) {
        self.axes.set_probe_due(axis, true);
    }

    /// An axis answered a question that no older answer fits: nothing older comes behind it. On
    /// RS-232 all bytes come from one drive, so that no acknowledgement is on its way either.
    pub fn clear_answered(
        &mut self,
        axis: u8,
        question: OnlineMessage,
        one_voice: bool,
        asked_once: bool,
    ) {
        self.axes.settle(axis);
        if one_voice {
            // One drive answers for all, so its answer comes after every acknowledgement that is still to come.
            self.axes.settle_kind(ReplyKind::Ack);
        }
        if let Some((before, _)) = self.last_answer.take() {
            self.duplicates[usize::from(before)] = 0;
        }
        // A request that was sent twice may be answered twice by one drive.
        self.last_answer = asked_once.then_some((axis, question));
    }

    /// Returns whether this repeats the last reply.
    pub fn note_duplicate(&mut self, message: &OnlineMessage) -> bool {
        let Some((axis, question)) = self.last_answer else { return false };
        let same =
            message.answers(&question, IdCode::axis(axis)) && message.answered_by().is_some();
        if !same || is_group_query(&question) {
            return false;
        }
        self.last_answer = None;
        self.count_duplicate(axis);
        true
    }

    /// Counts a reply of an axis that was not requested.
    pub fn count_duplicate(&mut self, axis: u8) {
        let twice = &mut self.duplicates[usize::from(axis)];
        *twice = twice.saturating_add(1);
    }

    /// Returns whether two drives reply as this axis.
    pub fn has_duplicate_axis(&self, axis: u8) -> bool {
        self.duplicates[usize::from(axis)] >= DUPLICATES_MIN
    }

    /// A question that would end a doubt: axis and variable.
    pub fn next_probe(&mut self, now: Instant) -> Option<(u8, u16)> {
        match self.axes.next_probe(now, &PROBES)? {
            (axis, ReplyKind::Answer(variable)) => Some((axis, variable)),
            (_, ReplyKind::Ack) => None,
        }
    }

    pub fn expire(&mut self, now: Instant) {
        while self.axes.pop_expired(now, None).is_some() {}
    }

    pub fn deadline(&self) -> Option<Instant> {
        self.axes.deadline()
    }
}
