//! Boot-ups: starts, heartbeats of a node that says 0 until it is started, or two devices.
//!
//! The standard has one boot-up after each start. Some nodes (python canopen's) tell state 0 with
//! every heartbeat until a master starts them, so a second one is only a suspicion until it is seen
//! whether more come at the same pace.

use super::beat::LONGEST_NS;
use crate::session::Oddity;
use crate::stamp::Stamp;

/// The longest period that a heartbeat can be set to, ns.
const PERIOD_MAX_NS: u64 = 65_535_000_000;
/// How long a suspicion waits for the next one at most, ns.
const WAIT_MAX_NS: u64 = 10_000_000_000;
/// Two boot-ups so long after one order are both by it.
const BY_ORDER_NS: u64 = 2_000_000_000;

/// What a node's boot-ups were.
#[derive(Debug, Default)]
pub(super) struct Boots {
    last: Option<Stamp>,
    /// The last start was by an order.
    by_order: bool,
    /// It says 0 every so often.
    pace: Option<u64>,
    suspicion: Option<Suspicion>,
}

/// What a boot-up may be a sign of.
#[derive(Clone, Copy, Debug)]
pub(super) struct Suspicion {
    pub kind: Oddity,
    /// When it came, and how long after the one before.
    pub when: Option<Stamp>,
    pub after: u64,
    due: Option<Stamp>,
}

/// What is known of the node when it says 0.
pub(super) struct Circumstances {
    /// It says nothing but 0 since its last start.
    pub still: bool,
    /// It said something else, but not its state.
    pub used: bool,
    /// It was ordered to start again.
    pub asked: bool,
    /// Its heartbeat is being switched on.
    pub beginning: bool,
    /// The period of its heartbeat, where one is known.
    pub period: Option<u64>,
}

/// What a 0 is.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Zero {
    /// A start.
    Start,
    /// A start that nobody ordered, of a node that is in use.
    Restart,
    /// A heartbeat, or nobody knows yet.
    Beat,
}

impl Boots {
    /// A node says 0.
    pub fn take(&mut self, now: Option<Stamp>, about: &Circumstances) -> Zero {
        let again = self.last.is_some();
        let after = self.last.zip(now).map(|(last, now)| now.since(last).min(LONGEST_NS));
        self.last = now.or(self.last);
        if about.asked || !about.still {
            let restart = !about.asked && (again || about.used);
            (self.by_order, self.suspicion) = (about.asked, None);
            return if restart { Zero::Restart } else { Zero::Start };
        }
        let Some(after) = after.filter(|after| *after <= PERIOD_MAX_NS) else {
            return if about.used { Zero::Restart } else { Zero::Beat };
        };
        let doubted = self.suspicion.take().map(|suspicion| suspicion.after);
        let paces = [self.pace, about.period, doubted];
        if about.beginning || paces.into_iter().flatten().any(|pace| near(pace, after)) {
            self.pace = Some(after);
            return Zero::Beat;
        }
        self.suspicion = self.suspect(now, after, about.used);
        Zero::Beat
    }

    fn suspect(&self, now: Option<Stamp>, after: u64, used: bool) -> Option<Suspicion> {
        let kind = match used {
            true => Oddity::Restart,
            false if self.by_order && after <= BY_ORDER_NS => Oddity::DuplicateAddress,
            false => return None,
        };
        let wait = (after / 2).saturating_mul(5).min(WAIT_MAX_NS);
        let due = now.map(|now| Stamp(now.0.saturating_add(wait)));
        Some(Suspicion { kind, when: now, after, due })
    }

    /// When a suspicion is confirmed if no other 0 comes.
    pub fn due(&self) -> Option<Stamp> {
        self.suspicion?.due
    }

    /// A suspicion that is confirmed by `now`; at the end, or when the node says something else of
    /// its state, whatever the time is.
    pub fn confirmed(&mut self, now: Option<Stamp>) -> Option<Suspicion> {
        let over = |due: Option<Stamp>| now.is_none_or(|now| due.is_none_or(|due| due < now));
        self.suspicion.take_if(|suspicion| over(suspicion.due))
    }
}

fn near(pace: u64, after: u64) -> bool {
    pace.abs_diff(after) * 5 <= pace
}
