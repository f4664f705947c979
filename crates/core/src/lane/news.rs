//! What happens to axes unasked, kept for those who listen.

use alloc::collections::VecDeque;
use alloc::vec::Vec;

use super::slot::Slot;
use crate::axis::{Change, News, State, Told};
use crate::profile::{ParameterId, Signal};
use crate::station::{AxisIndex, Request};
use crate::time::Instant;

/// Changes that wait to be taken at most; the oldest go first, and are counted. More than the
/// longest piece of a stream can tell.
pub const NEWS_MAX: usize = 1024;

/// Changes that nobody has taken yet, and what listeners know of each axis.
pub struct Tidings {
    waiting: VecDeque<News>,
    missed: u32,
    known: Vec<Known>,
}

/// What listeners know of an axis: the next time, only what differs is told.
#[derive(Clone, Copy)]
struct Known {
    armed: bool,
    fault: u32,
}

impl Known {
    fn of(state: &State) -> Self {
        Self { armed: state.armed, fault: state.reading(Signal::Fault).raw as u32 }
    }
}

impl Tidings {
    /// Nothing yet; what is so already is no news.
    pub fn new<'a>(states: impl Iterator<Item = &'a State>) -> Self {
        let known = states.map(Known::of).collect();
        Self { waiting: VecDeque::with_capacity(NEWS_MAX), missed: 0, known }
    }

    /// One more axis, of which this is known.
    pub fn know(&mut self, state: &State) {
        self.known.push(Known::of(state));
    }

    /// The next change.
    pub fn take(&mut self, now: Instant) -> Option<News> {
        if self.missed > 0 {
            let change = Change::Missed(core::mem::take(&mut self.missed));
            return Some(News { at: now, axis: AxisIndex(0), change });
        }
        self.waiting.pop_front()
    }

    /// Tells of axes what differs from what listeners know.
    pub fn compare<R: Request, A: Copy + 'static>(&mut self, now: Instant, slots: &[Slot<R, A>]) {
        for (n, slot) in slots.iter().enumerate() {
            self.compare_one(now, n, slot);
        }
    }

    fn compare_one<R: Request, A: Copy + 'static>(
        &mut self,
        now: Instant,
        n: usize,
        slot: &Slot<R, A>,
    ) {
        let Some(known) = self.known.get_mut(n) else { return };
        let (before, is) = (*known, Known::of(&slot.state));
        *known = is;
        if before.fault != is.fault {
            let at = slot.state.reading(Signal::Fault).at.unwrap_or(now);
            for (in_one, not_in, appeared) in
                [(is.fault, before.fault, true), (before.fault, is.fault, false)]
            {
                for code in codes(slot, in_one).filter(|c| codes(slot, not_in).all(|d| d != *c)) {
                    self.push(at, n, Change::Fault { code, appeared });
                }
            }
        }
        if before.armed != is.armed {
            self.push(now, n, Change::Armed(is.armed));
        }
    }

    /// Tells what the drive of axis `n` said, once its slot has taken it; `before` is its state
    /// before that.
    pub fn told<R: Request, A: Copy + 'static>(
        &mut self,
        now: Instant,
        n: usize,
        (slot, before): (&Slot<R, A>, &State),
        told: Told,
    ) {
        match told {
            Told::Presence(presence) => self.push(now, n, Change::Presence(presence)),
            Told::Signal(signal, _) => {
                self.push(now, n, Change::Signal(signal, slot.state.reading(signal)));
            }
            Told::Parameter(id, raw) => self.parameter(now, n, (slot, before), (id, raw)),
        }
        self.compare_one(now, n, slot);
    }

    fn parameter<R: Request, A: Copy + 'static>(
        &mut self,
        now: Instant,
        n: usize,
        (slot, before): (&Slot<R, A>, &State),
        (id, raw): (ParameterId, i64),
    ) {
        let mut told = false;
        for source in slot.sources(id) {
            let whole = source.equals.is_none() && source.mask == -1;
            let (is, was) = (slot.state.reading(source.signal), before.reading(source.signal));
            let changed = was.at.is_none() || was.raw != is.raw;
            if changed || whole && source.signal.is_measured() {
                self.push(now, n, Change::Signal(source.signal, is));
            }
            told |= whole;
        }
        if !told {
            let si = slot.to_si(id, raw).unwrap_or(f64::NAN);
            self.push(now, n, Change::Parameter(id, raw, si));
        }
    }

    fn push(&mut self, at: Instant, n: usize, change: Change) {
        if self.waiting.len() == NEWS_MAX {
            self.waiting.pop_front();
            self.missed = self.missed.saturating_add(1);
        }
        self.waiting.push_back(News { at, axis: AxisIndex(n as u8), change });
    }
}

/// The faults in a word: those that the profile knows, else the word itself.
fn codes<R, A>(slot: &Slot<R, A>, word: u32) -> impl Iterator<Item = u32> {
    let mut known = slot.profile.faults_of(word).map(|fault| fault.code).peekable();
    let whole = (word != 0 && known.peek().is_none()).then_some(word);
    known.filter(move |_| word != 0).chain(whole)
}
