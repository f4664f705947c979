//! Boot-ups: a start, a node that sends state 0 with every heartbeat, or two devices.
//!
//! By the standard, one boot-up follows each start. Some nodes (python canopen) send state 0 with every
//! heartbeat until a master starts them. Therefore a second boot-up is reported only if no more follow at
//! the same period.

use super::heartbeat::LONGEST_NS;
use crate::session::AnomalyKind;
use crate::timestamp::Timestamp;

/// The longest period that a heartbeat can be set to, ns.
const PERIOD_MAX_NS: u64 = 65_535_000_000;
/// How long a suspicion waits for the next one at most, ns.
const WAIT_MAX_NS: u64 = 10_000_000_000;
/// Two boot-ups so long after one order are both by it.
const BY_ORDER_NS: u64 = 2_000_000_000;

/// What a node's boot-ups were.
#[derive(Debug, Default)]
pub(super) struct BootMonitor {
    last: Option<Timestamp>,
    /// The last start was by an order.
    by_command: bool,
    /// It says 0 every so often.
    zero_period: Option<u64>,
    suspicion: Option<Suspicion>,
}

/// What a boot-up may be a sign of.
#[derive(Clone, Copy, Debug)]
pub(super) struct Suspicion {
    pub kind: AnomalyKind,
    /// When it came, and how long after the one before.
    pub when: Option<Timestamp>,
    pub after: u64,
    due: Option<Timestamp>,
}

/// What is known of the node when it says 0.
pub(super) struct BootContext {
    /// It says nothing but 0 since its last start.
    pub only_zero: bool,
    /// It said something else, but not its state.
    pub in_use: bool,
    /// It was ordered to start again.
    pub reset_ordered: bool,
    /// Its heartbeat is being switched on.
    pub heartbeat_starting: bool,
    /// The period of its heartbeat, where one is known.
    pub period: Option<u64>,
}

/// What a 0 is.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum ZeroMeaning {
    /// A start.
    Start,
    /// A start that nobody ordered, of a node that is in use.
    Restart,
    /// A heartbeat, or nobody knows yet.
    Heartbeat,
}

impl BootMonitor {
    /// A node says 0.
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
        let kind = match used {
            true => AnomalyKind::Restart,
            false if self.by_command && after <= BY_ORDER_NS => AnomalyKind::DuplicateAddress,
            false => return None,
        };
        let wait = (after / 2).saturating_mul(5).min(WAIT_MAX_NS);
        let due = now.map(|now| Timestamp(now.0.saturating_add(wait)));
        Some(Suspicion { kind, when: now, after, due })
    }

    /// When a suspicion is confirmed if no other 0 comes.
    pub fn due(&self) -> Option<Timestamp> {
        self.suspicion?.due
    }

    /// A suspicion that is confirmed by `now`; at the end, or when the node says something else of
    /// its state, whatever the time is.
    pub fn take_confirmed(&mut self, now: Option<Timestamp>) -> Option<Suspicion> {
        let over = |due: Option<Timestamp>| now.is_none_or(|now| due.is_none_or(|due| due < now));
        self.suspicion.take_if(|suspicion| over(suspicion.due))
    }
}

fn is_near(pace: u64, after: u64) -> bool {
    pace.abs_diff(after) * 5 <= pace
}
