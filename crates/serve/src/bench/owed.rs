//! The stop that an axis is owed: from when it is to stand until it was seen standing. It is said
//! again until then, and those who wait to hear of it are answered.
//!
//! Why: STOP-7.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use polepair::Axis;
use polepair::axis::{Class, Stopping};
use polepair_core::error::Unsupported;
use polepair_core::time::Instant;
use tokio::sync::oneshot;

use super::clock::Clock;
use super::lease::Session;
use super::shared::held;
use super::wire::Tell;
use crate::message::{AxisStopped, OwedWhy, Refused, StopClass, StopOwed, Stopped, Unreached};

/// Between a stop that was not answered and the next, at first and at last.
const AGAIN_AFTER: Duration = Duration::from_millis(100);
const AGAIN_AFTER_MAX: Duration = Duration::from_secs(2);
/// A motor that turns on though its drive answered the stop is told again after this.
const TURNS_ON_AFTER: Duration = Duration::from_secs(2);
/// For so long what is commanded behind a stop waits for the motor to be seen standing.
const STANDS_SOON: Duration = Duration::from_secs(2);
/// Whoever asked for a stop is answered after so long.
pub(super) const ANSWERED_MAX: Duration = Duration::from_secs(10);
/// A silence that ends with an answer is at least so long.
const SILENCE_MIN: Duration = Duration::from_millis(300);
/// After a stop into silence the wire is the others' for so many times what that took: 5 % are left.
const SHARE_TIMES: u32 = 19;
/// One takes no more of that than this: so long a drive has to answer.
const TOOK_MAX: Duration = Duration::from_millis(100);

/// The stop that one axis is owed.
pub(super) struct OwedStop {
    /// Since when, why, and who said so.
    since: Instant,
    why: OwedWhy,
    by: Session,
    /// The lease whose holder said so, and may have it move again.
    of_holder: Option<u64>,
    /// Everybody was told of it.
    alarmed: bool,
    /// The one that was said last; `None` while none was.
    stopping: Option<Stopping>,
    said: u32,
    /// When it was said, and when it was known that it goes no further.
    said_at: Instant,
    ended_at: Option<Instant>,
    pause: Duration,
    /// When the axis had last told anything.
    heard: Option<Instant>,
    told: Option<AxisStopped>,
    asked: Vec<Asked>,
}

/// Somebody who waits to hear of it, and since when.
struct Asked {
    report: Arc<Report>,
    since: Instant,
}

/// What all stops that are owed on one wire share.
#[derive(Default)]
pub(super) struct Airtime {
    /// No stop into silence goes out before then.
    free_at: Instant,
    /// Answers so far, and when the last of them was seen.
    answers: (u64, Instant),
    /// The wire was silent since then, until just now.
    woke: Option<Instant>,
}

/// How a debt ended.
#[derive(Clone, PartialEq, Debug)]
pub(super) enum Ended {
    /// The motor was seen standing.
    Standing,
    /// The drive answered all of it, and nothing tells whether its motor stands.
    NotKnown,
    /// The drive has no stop.
    Impossible(Refused),
}

impl Airtime {
    /// Looks whether the wire answers again after a silence.
    pub fn look(&mut self, axis: &Axis, now: Instant) {
        let answers = axis.connection().with(|axes, _| axes.counters()).answered;
        let (before, last) = self.answers;
        self.woke = (answers != before && now.since(last) >= SILENCE_MIN).then_some(last);
        if answers != before {
            self.answers = (answers, now);
        }
    }
}

impl OwedStop {
    /// Owes a stop that is still to be said.
    pub fn new(why: OwedWhy, by: Session, now: Instant) -> Self {
        Self {
            since: now,
            why,
            by,
            of_holder: None,
            alarmed: false,
            stopping: None,
            said: 0,
            said_at: now,
            ended_at: None,
            pause: AGAIN_AFTER,
            heard: None,
            told: None,
            asked: Vec::new(),
        }
    }

    /// The same, said by whoever holds the lease of that epoch.
    pub fn of_holder(mut self, epoch: u64) -> Self {
        self.of_holder = Some(epoch);
        self
    }

    /// Whether nobody said so but who held the lease of that epoch.
    pub fn is_of_holder(&self, epoch: u64) -> bool {
        self.of_holder == Some(epoch)
    }

    /// Somebody else says so as well: it is no longer the holder's alone.
    pub fn said_by(&mut self, why: OwedWhy, by: &Session) {
        if self.of_holder.take().is_some() {
            (self.why, self.by) = (why, by.clone());
        }
    }

    /// Sends it because somebody says so, though one may be on its way: whoever asked for that one hears
    /// of this one.
    pub fn say(&mut self, axis: &Axis, since: Instant, report: Option<Arc<Report>>) {
        self.asked.extend(report.map(|report| Asked { report, since }));
        self.pause = AGAIN_AFTER;
        self.told = None;
        self.sent(Stopping::begin(axis), since);
    }

    /// Sends it because the link is open again.
    pub fn link_opened(&mut self, axis: &Axis, now: Instant) {
        self.pause = AGAIN_AFTER;
        self.sent(Stopping::again(axis), now);
    }

    fn sent(&mut self, stopping: Stopping, now: Instant) {
        self.stopping = Some(stopping);
        self.said += 1;
        (self.said_at, self.ended_at) = (now, None);
    }

    /// Whether it is young and goes well, so that the motor will soon be seen standing.
    pub fn is_ending(&self, now: Instant) -> bool {
        let goes_well = |stopping: &Stopping| !stopping.has_ended() && !stopping.is_seen_turning();
        now.since(self.since) < STANDS_SOON && self.stopping.as_ref().is_some_and(goes_well)
    }

    /// How often it was said.
    pub fn said(&self) -> u32 {
        self.said
    }

    /// What everybody is told of it.
    pub fn shown(&self) -> StopOwed {
        let (class, error) = self.certain();
        let since_ms = Clock::ms(self.since);
        StopOwed { since_ms, why: self.why, by: self.by.to_string(), class, said: self.said, error }
    }

    /// What everybody is told of it now, and whether that is news. A stop that the holder of the lease
    /// said is no alarm while it is young and goes well: a motor that brakes obeys. Once it is one, it
    /// is until the debt ends.
    pub fn alarm(&mut self, now: Instant) -> (Option<StopOwed>, bool) {
        let goes_well = self.stopping.as_ref().is_some_and(|stopping| !stopping.has_ended());
        let is_young = now.since(self.since) < STANDS_SOON;
        if self.of_holder.is_some() && !self.alarmed && goes_well && is_young {
            return (None, false);
        }
        (Some(self.shown()), !std::mem::replace(&mut self.alarmed, true))
    }

    /// What is certain of the one that was said last.
    fn certain(&self) -> (StopClass, Option<Refused>) {
        let Some(stopping) = &self.stopping else { return (StopClass::Failed, None) };
        let trouble = stopping.trouble().map(|error| Refused::from(error.clone()));
        match stopping.class() {
            Class::Sent if stopping.is_held_back() => (StopClass::Failed, None),
            Class::Sent => (StopClass::Sent, None),
            Class::Acknowledged | Class::Unseen => (StopClass::Acknowledged, trouble),
            Class::Still => (StopClass::Standing, None),
            Class::Failed(error) if error.executed() == Some(false) => {
                (StopClass::Failed, Some(Refused::from(error.clone())))
            }
            Class::Failed(error) => (StopClass::Sent, Some(Refused::from(error.clone()))),
        }
    }

    /// Looks how far it came, and says it again when it is time to. Returns what is new, and how the
    /// debt ended when it did.
    pub fn look(
        &mut self,
        id: u16,
        axis: &Axis,
        now: Instant,
        airtime: &mut Airtime,
    ) -> (Option<AxisStopped>, Option<Ended>) {
        let ended = match &mut self.stopping {
            None => None,
            Some(stopping) => {
                stopping.look(axis, axis.connection().now());
                match stopping.class() {
                    Class::Still => Some(Ended::Standing),
                    Class::Unseen => Some(Ended::NotKnown),
                    Class::Failed(error) if is_impossible(error) => {
                        Some(Ended::Impossible(error.clone().into()))
                    }
                    _ => None,
                }
            }
        };
        if ended.is_none() && axis.connection().trouble().is_none() {
            self.repeat(axis, now, airtime);
        }
        (self.news(id, now, ended.is_some()), ended)
    }

    fn repeat(&mut self, axis: &Axis, now: Instant, airtime: &mut Airtime) {
        let before = std::mem::replace(&mut self.heard, newest(axis));
        let answers = match (before, self.heard) {
            (Some(before), Some(newest)) => newest.since(before) >= SILENCE_MIN,
            (before, newest) => before.is_none() && newest.is_some(),
        };
        let Some(stopping) = &self.stopping else {
            return self.sent(Stopping::again(axis), now);
        };
        if !stopping.has_ended() {
            let turns_on = stopping.is_seen_turning() && now.since(self.said_at) >= TURNS_ON_AFTER;
            if turns_on {
                self.sent(Stopping::again(axis), now);
            }
            return;
        }
        let took = now.since(self.said_at).min(TOOK_MAX);
        let ended_at = *self.ended_at.get_or_insert_with(|| {
            airtime.free_at = now + took * SHARE_TIMES;
            now
        });
        let woke = airtime.woke.is_some_and(|since| ended_at > since);
        // The second goes out soon, whoever else is not answered: one answer may just have been lost.
        let is_free = self.said == 1 || now >= airtime.free_at;
        if answers || woke || is_free && now >= ended_at + self.pause {
            self.pause = (self.pause * 2).min(AGAIN_AFTER_MAX);
            self.sent(Stopping::again(axis), now);
        }
    }

    fn news(&mut self, id: u16, now: Instant, ended: bool) -> Option<AxisStopped> {
        let (class, error) = self.certain();
        let rises = self.told.as_ref().is_none_or(|told| class > told.class);
        // What may still be said again is no news while it fails.
        let fails = error.is_some() && !ended;
        if fails || (!rises && !ended) || (class == StopClass::Failed && !ended) {
            return None;
        }
        if !rises && self.told.as_ref().is_some_and(|told| told.class == class) {
            return None;
        }
        let told = AxisStopped { id, class, ms: self.ms(now), error };
        self.told = Some(told.clone());
        Some(told)
    }

    fn ms(&self, now: Instant) -> f64 {
        let since = self.asked.last().map_or(self.since, |asked| asked.since);
        now.since(since).as_secs_f64() * 1e3
    }

    /// Answers whoever waited long enough, or for nothing more; all of them when the debt has ended,
    /// which everybody sees by then.
    pub fn answer(&mut self, id: u16, axis: &Axis, now: Instant, ended: bool) {
        let (class, error) = self.certain();
        // Over a link that is lost nothing comes for a while.
        let lost = axis.connection().trouble().is_some();
        let lost = lost && self.stopping.as_ref().is_some_and(Stopping::has_ended);
        self.asked.retain(|Asked { report, since }| {
            let waited = now.since(*since);
            let over = ended || lost || waited >= ANSWERED_MAX;
            let class = if over && !ended { StopClass::Owed } else { class };
            let ms = waited.as_secs_f64() * 1e3;
            report.take(id, AxisStopped { id, class, ms, error: error.clone() }, over);
            !over
        });
    }

    /// Answers whoever waits: it is dismissed, or the server ends.
    pub fn give_up(&mut self, id: u16, now: Instant, why: &Refused) {
        for Asked { report, since } in self.asked.drain(..) {
            let ms = now.since(since).as_secs_f64() * 1e3;
            let class = StopClass::Owed;
            report.take(id, AxisStopped { id, class, ms, error: Some(why.clone()) }, true);
        }
    }
}

/// Whether the drive has no stop: to say it again is of no use.
fn is_impossible(error: &polepair::Error) -> bool {
    matches!(error, polepair::Error::Unsupported { why, .. } if *why != Unsupported::Busy)
}

/// When an axis last told anything.
fn newest(axis: &Axis) -> Option<Instant> {
    let state = axis.state();
    axis.profile().signals.iter().filter_map(|source| state.reading(source.signal).at).max()
}

/// What came of a stop of several axes, for whoever asked for it.
#[derive(Debug)]
pub(super) struct Report {
    /// Links that it does not reach.
    unreached: Vec<Unreached>,
    axes: Mutex<BTreeMap<u16, Option<(AxisStopped, bool)>>>,
    tell: Mutex<Option<Tell<Stopped>>>,
}

impl Report {
    /// For these axes.
    pub fn of(
        axes: &[u16],
        unreached: Vec<Unreached>,
    ) -> (Arc<Self>, oneshot::Receiver<Result<Stopped, Refused>>) {
        let (tell, told) = oneshot::channel();
        let axes = axes.iter().map(|id| (*id, None)).collect();
        let report = Self { unreached, axes: Mutex::new(axes), tell: Mutex::new(Some(tell)) };
        report.tell_if_over();
        (Arc::new(report), told)
    }

    fn take(&self, id: u16, stopped: AxisStopped, over: bool) {
        if let Some(axis) = held(&self.axes).get_mut(&id) {
            *axis = Some((stopped, over));
        }
        self.tell_if_over();
    }

    fn tell_if_over(&self) {
        let axes = held(&self.axes);
        if !axes.values().all(|axis| matches!(axis, Some((_, true)))) {
            return;
        }
        let axes = axes.values().flatten().map(|(stopped, _)| stopped.clone()).collect();
        if let Some(tell) = held(&self.tell).take() {
            // Whoever asked may have gone.
            let unreached = self.unreached.clone();
            let _ = tell.send(Ok(Stopped { axes, unreached }));
        }
    }
}
