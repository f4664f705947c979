//! Boot-ups: a start, a node that sends state 0 with every heartbeat, or two devices.
//!
//! The standard has one boot-up for each start. Some nodes (python canopen) send state 0 with every heartbeat until a
//! master starts them. Therefore a second boot-up is reported only if no more follow at the same period.

use super::heartbeat::LONGEST_NS;
use crate::session::AnomalyKind;
use crate::timestamp::Timestamp;

/// The longest period that a heartbeat can be set to, ns.
const PERIOD_MAX_NS: u64 = 65_535_000_000;
/// Longest time that a suspicion waits for the next one, ns.
const WAIT_MAX_NS: u64 = 10_000_000_000;
/// Time after an NMT order in which two boot-ups count as its effect.
const BY_ORDER_NS: u64 = 2_000_000_000;

/// Boot-up messages of a node.
#[derive(Debug, Default)]
pub(super) struct BootMonitor {
    last: Option<Timestamp>,
    /// The last start was by an order.
    by_command: bool,
    /// Period of state 0, if it is regular.
    zero_period: Option<u64>,
    suspicion: Option<Suspicion>,
}

/// Possible meaning of a boot-up.
#[derive(Clone, Copy, Debug)]
pub(super) struct Suspicion {
    pub kind: AnomalyKind,
    /// Time of arrival.
    pub when: Option<Timestamp>,
    /// Interval to the message before, ns.
    pub after: u64,
    /// Time at which it is confirmed.
    due: Option<Timestamp>,
}

/// State of the node at a 0.
pub(super) struct BootContext {
    /// True if it has sent only 0 since its last start.
    pub only_zero: bool,
    /// True if it has sent something else, but not its state.
    pub in_use: bool,
    /// True if a reset was commanded.
    pub reset_ordered: bool,
    /// True if its heartbeat is being enabled.
    pub heartbeat_starting: bool,
    /// The period of its heartbeat, where one is known.
    pub period: Option<u64>,
}

/// Meaning of a 0.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum ZeroMeaning {
    /// A start.
    Start,
    /// A start without a command, of a node in use.
    Restart,
    /// A heartbeat, or undecided yet.
    Heartbeat,
}

impl BootMonitor {
    /// Classifies a 0 of a node.
    pub fn classify(&mut self, now: Option<Timestamp>, about: &BootContext) -> ZeroMeaning {
        let again = self.last.is_some();
        let after = self.last.zip(now).map(|(last, now)| now.since(last).min(LONGEST_NS));
        self.last = now.or(self.last);
        if about.reset_ordered || !about.only_zero {
            let restart = !about.reset_ordered && (again || about.in_use);
            (self.by_command, self.suspicion) = (about.reset_ordered, None);
            return if restart { ZeroMeaning::Restart } else { ZeroMeaning::Start };
        }
        let Some(after) = after.filter(|after| *after <= PERIOD_MAX_NS) else {
            return if about.in_use { ZeroMeaning::Restart } else { ZeroMeaning::Heartbeat };
        };
        let doubted = self.suspicion.take().map(|suspicion| suspicion.after);
        let paces = [self.zero_period, about.period, doubted];
        if about.heartbeat_starting || paces.into_iter().flatten().any(|pace| is_near(pace, after))
        {
            self.zero_period = Some(after);
            return ZeroMeaning::Heartbeat;
        }
        self.suspicion = self.suspect(now, after, about.in_use);
        ZeroMeaning::Heartbeat
    }

    fn suspect(&self, now: Option<Timestamp>, after: u64, used: bool) -> Option<Suspicion> {
        let kind = if used {
            AnomalyKind::Restart
        } else if self.by_command && after <= BY_ORDER_NS {
            AnomalyKind::DuplicateAddress
        } else {
            return None;
        };
        let wait = (after / 2).saturating_mul(5).min(WAIT_MAX_NS);
        let due = now.map(|now| Timestamp(now.0.saturating_add(wait)));
        Some(Suspicion { kind, when: now, after, due })
    }

    /// Time at which a suspicion is confirmed unless another 0 arrives.
    pub fn due(&self) -> Option<Timestamp> {
        self.suspicion?.due
    }

    /// Takes a suspicion that is confirmed by `now`; at the end, or when the node sends another state, at any time.
    pub fn take_confirmed(&mut self, now: Option<Timestamp>) -> Option<Suspicion> {
        self.suspicion.take_if(|suspicion| is_over(suspicion.due, now))
    }
}

fn is_over(due: Option<Timestamp>, now: Option<Timestamp>) -> bool {
    now.is_none_or(|now| due.is_none_or(|due| due < now))
}

fn is_near(pace: u64, after: u64) -> bool {
    pace.abs_diff(after) * 5 <= pace
}
