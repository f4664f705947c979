//! Earlier requests whose acknowledgement or reply may still arrive.

use crate::proto::tml::host_request::is_group_query;
use crate::proto::tml::online::OnlineMessage;
use crate::proto::tml::wire::IdCode;
use crate::time::Instant;

use super::{AAR, PROBES_MAX, SRL};

/// Axes in doubt at a time at most; one more waits for the oldest one's place.
const AXES_MAX: usize = 4;
/// Variables in doubt of one axis; one more and all of that axis are.
const VARIABLES_MAX: usize = 6;

/// Variables that are there in every firmware, to be asked for when only the answer counts: SRL,
/// AAR, MER, MCR, KPP, KIP, KDP.
const PROBES: [u16; VARIABLES_MAX + 1] = [SRL, AAR, 0x08FC, 0x0309, 0x025E, 0x0260, 0x0262];

#[derive(Clone, Copy, Debug)]
struct StaleAxis {
    axis: u8,
    variables: [u16; VARIABLES_MAX],
    variables_len: u8,
    probes: u8,
    probe_due: bool,
    until: Instant,
    /// An acknowledgement may still come.
    ack_outstanding: bool,
}

/// Answers given twice, running, after which there are two drives of one axis ID. Once or twice it
/// may be a copy that an adapter made.
const DUPLICATES_MIN: u8 = 3;

/// Everything in doubt on a line.
#[derive(Debug)]
pub struct StaleReplies {
    axes: [Option<StaleAxis>; AXES_MAX],
    /// The last answer taken, whose repetition shows a second drive of that ID.
    last_answer: Option<(u8, OnlineMessage)>,
    /// Duplicated replies in a row, by axis.
    duplicates: [u8; 256],
}

impl StaleReplies {
    pub const fn new() -> Self {
        Self { axes: [None; AXES_MAX], last_answer: None, duplicates: [0; 256] }
    }

    /// Answers about a variable may still come.
    pub fn add_answer(&mut self, axis: u8, tag: u16, until: Instant, probe: bool) {
        let doubt = self.entry_mut(axis, until);
        if let Some(index) = doubt.variables.get_mut(usize::from(doubt.variables_len)) {
            *index = tag;
            doubt.variables_len += 1;
        }
        doubt.until = doubt.until.max(until);
        doubt.probe_due = probe && doubt.probes < PROBES_MAX;
    }

    /// An acknowledgement may still come.
    pub fn add_ack(&mut self, axis: u8, until: Instant) {
        let doubt = self.entry_mut(axis, until);
        doubt.ack_outstanding = true;
        doubt.until = doubt.until.max(until);
        doubt.probe_due = doubt.probes < PROBES_MAX;
    }

    fn entry_mut(&mut self, axis: u8, until: Instant) -> &mut StaleAxis {
        let index = self.axes.iter().position(|d| d.is_some_and(|d| d.axis == axis));
        let index = index.or_else(|| self.axes.iter().position(Option::is_none));
        let fresh = StaleAxis {
            axis,
            variables: [0; VARIABLES_MAX],
            variables_len: 0,
            probes: 0,
            probe_due: false,
            until,
            ack_outstanding: false,
        };
        // A full table counts as a line in doubt: its last place represents all others.
        self.axes[index.unwrap_or(AXES_MAX - 1)].get_or_insert(fresh)
    }

    /// Returns whether a reply about this variable could be an older one.
    pub fn may_answer_be_stale(&self, axis: u8, tag: u16) -> bool {
        let full = self.axes.iter().all(Option::is_some);
        // More drives in doubt than places: every answer may be an old one until a place is free.
        full || self.axes.iter().flatten().any(|doubt| {
            let tags = &doubt.variables[..usize::from(doubt.variables_len)];
            doubt.axis == axis && (tags.len() == VARIABLES_MAX || tags.contains(&tag))
        })
    }

    /// Returns whether an acknowledgement could be an older one.
    pub fn may_ack_be_stale(&self) -> bool {
        self.axes.iter().flatten().any(|doubt| doubt.ack_outstanding)
    }

    /// Allows a probe again whose reply was lost.
    pub fn repeat_probe(&mut self, axis: u8) {
        for doubt in self.axes.iter_mut().flatten().filter(|doubt| doubt.axis == axis) {
            doubt.probe_due = doubt.probes < PROBES_MAX;
        }
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
        for stale_axis in &mut self.axes {
            let Some(doubt) = stale_axis else { continue };
            // On RS-232 one drive answers for all, so its answer comes after every acknowledgement that is still to
            // come.
            doubt.ack_outstanding &= !one_voice;
            if doubt.axis == axis || !doubt.ack_outstanding && doubt.variables_len == 0 {
                *stale_axis = None;
            }
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
    pub fn next_probe(&mut self) -> Option<(u8, u16)> {
        let doubt = self.axes.iter_mut().flatten().find(|doubt| doubt.probe_due)?;
        debug_assert!(doubt.probes < PROBES_MAX, "a probe is due while some are left");
        doubt.probe_due = false;
        let tags = &doubt.variables[..usize::from(doubt.variables_len)];
        let address = PROBES.into_iter().find(|address| !tags.contains(address))?;
        doubt.probes += 1;
        Some((doubt.axis, address))
    }

    pub fn expire(&mut self, now: Instant) {
        for stale_axis in &mut self.axes {
            if stale_axis.is_some_and(|doubt| now >= doubt.until) {
                *stale_axis = None;
            }
        }
    }

    pub fn deadline(&self) -> Option<Instant> {
        self.axes.iter().flatten().map(|doubt| doubt.until).min()
    }
}
