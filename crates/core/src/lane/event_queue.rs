//! Queue of events of the axes.

use alloc::collections::VecDeque;
use alloc::vec::Vec;

use super::slot::AxisSlot;
use crate::axis::{AxisEvent, AxisEventKind, AxisStatus, DriveReport};
use crate::profile::{ParameterId, Signal};
use crate::station::{AxisIndex, Request};
use crate::time::Instant;

/// Most events in the queue; the oldest are dropped and counted. More than the longest piece of a
/// stream can report.
pub const AXIS_EVENTS_MAX: usize = 1024;

/// Queue of events, and the state of each axis as last reported to listeners.
pub struct EventQueue {
    queue: VecDeque<AxisEvent>,
    missed: u32,
    reported: Vec<ReportedState>,
}

/// Last state of an axis that was given to listeners: only changes are reported.
#[derive(Clone, Copy)]
struct ReportedState {
    armed: bool,
    /// The raw value of the fault signal.
    fault: i64,
}

impl ReportedState {
    fn from_status(state: &AxisStatus) -> Self {
        Self { armed: state.armed, fault: state.reading(Signal::Fault).raw }
    }
}

impl EventQueue {
    /// An empty queue. The present states are not reported as events.
    pub fn new<'a>(states: impl Iterator<Item = &'a AxisStatus>) -> Self {
        let reported = states.map(ReportedState::from_status).collect();
        Self { queue: VecDeque::with_capacity(AXIS_EVENTS_MAX), missed: 0, reported }
    }

    /// One more axis, of which this is known.
    pub fn add_axis(&mut self, state: &AxisStatus) {
        self.reported.push(ReportedState::from_status(state));
    }

    /// The next change.
    pub fn pop(&mut self, now: Instant) -> Option<AxisEvent> {
        if self.missed > 0 {
            let change = AxisEventKind::Missed(core::mem::take(&mut self.missed));
            return Some(AxisEvent { at: now, axis: AxisIndex(0), kind: change });
        }
        self.queue.pop_front()
    }

    /// Queues an event for each difference between an axis' state and the state last reported.
    pub fn compare<R: Request, A: Copy + 'static>(
        &mut self,
        now: Instant,
        slots: &[AxisSlot<R, A>],
    ) {
        for (n, slot) in slots.iter().enumerate() {
            self.compare_one(now, n, slot);
        }
    }

    fn compare_one<R: Request, A: Copy + 'static>(
        &mut self,
        now: Instant,
        n: usize,
        slot: &AxisSlot<R, A>,
    ) {
        let Some(known) = self.reported.get_mut(n) else { return };
        let (before, is) = (*known, ReportedState::from_status(&slot.state));
        *known = is;
        if before.fault != is.fault {
            let at = slot.state.reading(Signal::Fault).at.unwrap_or(now);
            let [is, before] = [is.fault, before.fault].map(|raw| slot.profile.fault_word(raw));
            for (in_one, not_in, appeared) in [(is, before, true), (before, is, false)] {
                for code in
                    fault_codes(slot, in_one).filter(|c| fault_codes(slot, not_in).all(|d| d != *c))
                {
                    self.push(at, n, AxisEventKind::Fault { code, appeared });
                }
            }
        }
        if before.armed != is.armed {
            self.push(now, n, AxisEventKind::Armed(is.armed));
        }
    }

    /// Queues the report of axis `n`'s drive, after its slot has processed it; `before` is the axis' state
    /// before that.
    pub fn push_report<R: Request, A: Copy + 'static>(
        &mut self,
        now: Instant,
        n: usize,
        slot: &AxisSlot<R, A>,
        before: &AxisStatus,
        report: DriveReport,
    ) {
        match report {
            DriveReport::Presence(presence) => self.push(now, n, AxisEventKind::Presence(presence)),
            DriveReport::Signal(signal, _) => {
                self.push(now, n, AxisEventKind::Signal(signal, slot.state.reading(signal)));
            }
            DriveReport::Address(address, raw) => {
                self.push(now, n, AxisEventKind::Address(address, raw));
            }
            DriveReport::Parameter(id, raw) => self.push_parameter(now, n, slot, before, id, raw),
            // The fault that it reports as well is the event.
            DriveReport::Emergency(_) => {}
        }
        self.compare_one(now, n, slot);
    }

    fn push_parameter<R: Request, A: Copy + 'static>(
        &mut self,
        now: Instant,
        n: usize,
        slot: &AxisSlot<R, A>,
        before: &AxisStatus,
        id: ParameterId,
        raw: i64,
    ) {
        let mut reported = false;
        for source in slot.signal_sources(id) {
            let whole = !source.is_flag() && source.mask == -1;
            let (is, was) = (slot.state.reading(source.signal), before.reading(source.signal));
            let changed = was.at.is_none() || was.raw != is.raw;
            if changed || whole && source.signal.is_measured() {
                self.push(now, n, AxisEventKind::Signal(source.signal, is));
            }
            reported |= whole;
        }
        if !reported {
            let si = slot.to_si(id, raw).unwrap_or(f64::NAN);
            self.push(now, n, AxisEventKind::Parameter(id, raw, si));
        }
    }

    fn push(&mut self, at: Instant, n: usize, change: AxisEventKind) {
        if self.queue.len() == AXIS_EVENTS_MAX {
            self.queue.pop_front();
            self.missed = self.missed.saturating_add(1);
        }
        self.queue.push_back(AxisEvent { at, axis: AxisIndex(n as u8), kind: change });
    }
}

/// The faults in a word: those of the profile, otherwise the word itself.
fn fault_codes<R, A>(slot: &AxisSlot<R, A>, word: u32) -> impl Iterator<Item = u32> {
    let mut known = slot.profile.faults_for_code(word).map(|fault| fault.code).peekable();
    let whole = (word != 0 && known.peek().is_none()).then_some(word);
    known.filter(move |_| word != 0).chain(whole)
}
