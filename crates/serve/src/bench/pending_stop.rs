//! The pending stop of an axis, from the stop until its standstill is confirmed. The stop is repeated until
//! then, and its callers are answered.
//!
//! Why: STOP-7.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use polepair::LocalAxis;
use polepair::axis::{StopProgress, StopSequence};
use polepair_core::error::Unsupported;
use polepair_core::time::Instant;
use tokio::sync::oneshot;

use super::clock::BenchClock;
use super::lease::SessionName;
use super::lock::lock_unpoisoned;
use super::reply::ReplySender;
use crate::message::{
    AxisStopReport, GatewayError, PendingStopView, StopCause, StopClass, StopReport,
    UnreachedTarget,
};

/// Between a stop that was not answered and the next, at first and at last.
const RETRY_MIN: Duration = Duration::from_millis(100);
const RETRY_MAX: Duration = Duration::from_secs(2);
/// A motor that turns on though its drive answered the stop is told again after this.
const TURNING_RETRY_AFTER: Duration = Duration::from_secs(2);
/// For so long what is commanded behind a stop waits for the motor to be seen standing.
const BRAKING_GRACE: Duration = Duration::from_secs(2);
/// Whoever asked for a stop is answered after so long.
pub(super) const REPLY_MAX: Duration = Duration::from_secs(10);
/// A silence that ends with an answer is at least so long.
const SILENCE_MIN: Duration = Duration::from_millis(300);
/// After a stop into silence the wire is the others' for so many times what that took: 5 % are left.
const AIRTIME_DIVISOR: u32 = 19;
/// One takes no more of that than this: so long a drive has to answer.
const ATTEMPT_TIME_MAX: Duration = Duration::from_millis(100);

/// The stop that one axis is owed.
pub(super) struct PendingStop {
    /// Since when, why, and who said so.
    since: Instant,
    why: StopCause,
    by: SessionName,
    /// The lease whose holder said so, and may have it move again.
    holder_epoch: Option<u64>,
    /// Everybody was told of it.
    alarmed: bool,
    /// The one that was said last; `None` while none was.
    stopping: Option<StopSequence>,
    attempts: u32,
    /// When it was said, and when it was known that it goes no further.
    sent_at: Instant,
    ended_at: Option<Instant>,
    pause: Duration,
    /// When the axis had last told anything.
    last_reading: Option<Instant>,
    last_report: Option<AxisStopReport>,
    waiters: Vec<StopWaiter>,
}

/// Somebody who waits to hear of it, and since when.
struct StopWaiter {
    collector: Arc<StopCollector>,
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
    silent_since: Option<Instant>,
}

/// How a debt ended.
#[derive(Clone, PartialEq, Debug)]
pub(super) enum StopResolution {
    /// The motor was seen standing.
    Standing,
    /// The drive answered all of it, and nothing tells whether its motor stands.
    NotKnown,
    /// The drive has no stop.
    Impossible(GatewayError),
}

impl Airtime {
    /// Looks whether the wire answers again after a silence.
    pub fn update(&mut self, axis: &LocalAxis, now: Instant) {
        let answers = axis.connection().with_axes(|axes, _| axes.counters()).answered;
        let (before, last) = self.answers;
        self.silent_since = (answers != before && now.since(last) >= SILENCE_MIN).then_some(last);
        if answers != before {
            self.answers = (answers, now);
        }
    }
}

impl PendingStop {
    /// Owes a stop that is still to be said.
    pub fn new(why: StopCause, by: SessionName, now: Instant) -> Self {
        Self {
            since: now,
            why,
            by,
            holder_epoch: None,
            alarmed: false,
            stopping: None,
            attempts: 0,
            sent_at: now,
            ended_at: None,
            pause: RETRY_MIN,
            last_reading: None,
            last_report: None,
            waiters: Vec::new(),
        }
    }

    /// The same, said by whoever holds the lease of that epoch.
    pub fn for_holder(mut self, epoch: u64) -> Self {
        self.holder_epoch = Some(epoch);
        self
    }

    /// Whether nobody said so but who held the lease of that epoch.
    pub fn is_holder_stop(&self, epoch: u64) -> bool {
        self.holder_epoch == Some(epoch)
    }

    /// Somebody else says so as well: it is no longer the holder's alone.
    pub fn add_requester(&mut self, why: StopCause, by: &SessionName) {
        if self.holder_epoch.take().is_some() {
            (self.why, self.by) = (why, by.clone());
        }
    }

    /// Sends it because somebody says so, though one may be on its way: whoever asked for that one hears
    /// of this one.
    pub fn send(&mut self, axis: &LocalAxis, since: Instant, report: Option<Arc<StopCollector>>) {
        self.waiters.extend(report.map(|report| StopWaiter { collector: report, since }));
        self.pause = RETRY_MIN;
        self.last_report = None;
        self.begin_attempt(StopSequence::begin(axis), since);
    }

    /// Sends it because the link is open again.
    pub fn resend(&mut self, axis: &LocalAxis, now: Instant) {
        self.pause = RETRY_MIN;
        self.begin_attempt(StopSequence::resend(axis), now);
    }

    fn begin_attempt(&mut self, stopping: StopSequence, now: Instant) {
        self.stopping = Some(stopping);
        self.attempts += 1;
        (self.sent_at, self.ended_at) = (now, None);
    }

    /// Whether it is young and goes well, so that the motor will soon be seen standing.
    pub fn is_ending(&self, now: Instant) -> bool {
        let goes_well =
            |stopping: &StopSequence| !stopping.has_ended() && !stopping.is_seen_turning();
        now.since(self.since) < BRAKING_GRACE && self.stopping.as_ref().is_some_and(goes_well)
    }

    /// How often it was said.
    pub fn attempts(&self) -> u32 {
        self.attempts
    }

    /// What everybody is told of it.
    pub fn view(&self) -> PendingStopView {
        let (class, error) = self.progress();
        let since_ms = BenchClock::wall_ms(self.since);
        PendingStopView {
            since_ms,
            why: self.why,
            by: self.by.to_string(),
            class,
            said: self.attempts,
            error,
        }
    }

    /// What everybody is told of it now, and whether that is news. A stop that the holder of the lease
    /// said is no alarm while it is young and goes well: a motor that brakes obeys. Once it is one, it
    /// is until the debt ends.
    pub fn update_alarm(&mut self, now: Instant) -> (Option<PendingStopView>, bool) {
        let goes_well = self.stopping.as_ref().is_some_and(|stopping| !stopping.has_ended());
        let is_young = now.since(self.since) < BRAKING_GRACE;
        if self.holder_epoch.is_some() && !self.alarmed && goes_well && is_young {
            return (None, false);
        }
        (Some(self.view()), !std::mem::replace(&mut self.alarmed, true))
    }

    /// What is certain of the one that was said last.
    fn progress(&self) -> (StopClass, Option<GatewayError>) {
        let Some(stopping) = &self.stopping else { return (StopClass::Failed, None) };
        let trouble = stopping.trouble().map(|error| GatewayError::from(error.clone()));
        match stopping.progress() {
            StopProgress::Sent if stopping.is_held_back() => (StopClass::Failed, None),
            StopProgress::Sent => (StopClass::Sent, None),
            StopProgress::Acknowledged | StopProgress::Unobservable => {
                (StopClass::Acknowledged, trouble)
            }
            StopProgress::Standstill => (StopClass::Standing, None),
            StopProgress::Failed(error) if error.executed() == Some(false) => {
                (StopClass::Failed, Some(GatewayError::from(error.clone())))
            }
            StopProgress::Failed(error) => {
                (StopClass::Sent, Some(GatewayError::from(error.clone())))
            }
        }
    }

    /// Looks how far it came, and says it again when it is time to. Returns what is new, and how the
    /// debt ended when it did.
    pub fn poll(
        &mut self,
        id: u16,
        axis: &LocalAxis,
        now: Instant,
        airtime: &mut Airtime,
    ) -> (Option<AxisStopReport>, Option<StopResolution>) {
        let ended = match &mut self.stopping {
            None => None,
            Some(stopping) => {
                stopping.poll(axis, axis.connection().now());
                match stopping.progress() {
                    StopProgress::Standstill => Some(StopResolution::Standing),
                    StopProgress::Unobservable => Some(StopResolution::NotKnown),
                    StopProgress::Failed(error) if is_impossible(error) => {
                        Some(StopResolution::Impossible(error.clone().into()))
                    }
                    _ => None,
                }
            }
        };
        if ended.is_none() && axis.connection().link_error().is_none() {
            self.repeat(axis, now, airtime);
        }
        (self.new_report(id, now, ended.is_some()), ended)
    }

    fn repeat(&mut self, axis: &LocalAxis, now: Instant, airtime: &mut Airtime) {
        let before = std::mem::replace(&mut self.last_reading, newest_reading(axis));
        let answers = match (before, self.last_reading) {
            (Some(before), Some(newest)) => newest.since(before) >= SILENCE_MIN,
            (before, newest) => before.is_none() && newest.is_some(),
        };
        let Some(stopping) = &self.stopping else {
            return self.begin_attempt(StopSequence::resend(axis), now);
        };
        if !stopping.has_ended() {
            let turns_on =
                stopping.is_seen_turning() && now.since(self.sent_at) >= TURNING_RETRY_AFTER;
            if turns_on {
                self.begin_attempt(StopSequence::resend(axis), now);
            }
            return;
        }
        let took = now.since(self.sent_at).min(ATTEMPT_TIME_MAX);
        let ended_at = *self.ended_at.get_or_insert_with(|| {
            airtime.free_at = now + took * AIRTIME_DIVISOR;
            now
        });
        let woke = airtime.silent_since.is_some_and(|since| ended_at > since);
        // The second goes out soon, whoever else is not answered: one answer may just have been lost.
        let is_free = self.attempts == 1 || now >= airtime.free_at;
        if answers || woke || is_free && now >= ended_at + self.pause {
            self.pause = (self.pause * 2).min(RETRY_MAX);
            self.begin_attempt(StopSequence::resend(axis), now);
        }
    }

    fn new_report(&mut self, id: u16, now: Instant, ended: bool) -> Option<AxisStopReport> {
        let (class, error) = self.progress();
        let rises = self.last_report.as_ref().is_none_or(|last| class > last.class);
        // What may still be said again is no news while it fails.
        let fails = error.is_some() && !ended;
        if fails || (!rises && !ended) || (class == StopClass::Failed && !ended) {
            return None;
        }
        if !rises
            && self
                .last_report
                .as_ref()
                .is_some_and(|axis_stop_report| axis_stop_report.class == class)
        {
            return None;
        }
        let axis_stop_report = AxisStopReport { id, class, ms: self.ms(now), error };
        self.last_report = Some(axis_stop_report.clone());
        Some(axis_stop_report)
    }

    fn ms(&self, now: Instant) -> f64 {
        let since = self.waiters.last().map_or(self.since, |stop_waiter| stop_waiter.since);
        now.since(since).as_secs_f64() * 1e3
    }

    /// Answers whoever waited long enough, or for nothing more; all of them when the debt has ended,
    /// which everybody sees by then.
    pub fn reply_to_waiters(&mut self, id: u16, axis: &LocalAxis, now: Instant, ended: bool) {
        let (class, error) = self.progress();
        // Over a link that is lost nothing comes for a while.
        let lost = axis.connection().link_error().is_some();
        let lost = lost && self.stopping.as_ref().is_some_and(StopSequence::has_ended);
        self.waiters.retain(|StopWaiter { collector, since }| {
            let waited = now.since(*since);
            let over = ended || lost || waited >= REPLY_MAX;
            let class = if over && !ended { StopClass::Owed } else { class };
            let ms = waited.as_secs_f64() * 1e3;
            collector.record(id, AxisStopReport { id, class, ms, error: error.clone() }, over);
            !over
        });
    }

    /// Answers whoever waits: it is dismissed, or the server ends.
    pub fn abandon(&mut self, id: u16, now: Instant, why: &GatewayError) {
        for StopWaiter { collector, since } in self.waiters.drain(..) {
            let ms = now.since(since).as_secs_f64() * 1e3;
            let class = StopClass::Owed;
            collector.record(id, AxisStopReport { id, class, ms, error: Some(why.clone()) }, true);
        }
    }
}

/// Whether the drive has no stop: to say it again is of no use.
fn is_impossible(error: &polepair::Error) -> bool {
    matches!(error, polepair::Error::Unsupported { why, .. } if *why != Unsupported::Busy)
}

/// When an axis last told anything.
fn newest_reading(axis: &LocalAxis) -> Option<Instant> {
    let state = axis.state();
    axis.profile().signals.iter().filter_map(|source| state.reading(source.signal).at).max()
}

/// What came of a stop of several axes, for whoever asked for it.
#[derive(Debug)]
pub(super) struct StopCollector {
    /// Links that it does not reach.
    unreached: Vec<UnreachedTarget>,
    axes: Mutex<BTreeMap<u16, Option<(AxisStopReport, bool)>>>,
    reply: Mutex<Option<ReplySender<StopReport>>>,
}

impl StopCollector {
    /// For these axes.
    pub fn for_axes(
        axes: &[u16],
        unreached: Vec<UnreachedTarget>,
    ) -> (Arc<Self>, oneshot::Receiver<Result<StopReport, GatewayError>>) {
        let (reply_sender, receiver) = oneshot::channel();
        let axes = axes.iter().map(|id| (*id, None)).collect();
        let report =
            Self { unreached, axes: Mutex::new(axes), reply: Mutex::new(Some(reply_sender)) };
        report.reply_if_complete();
        (Arc::new(report), receiver)
    }

    fn record(&self, id: u16, stopped: AxisStopReport, over: bool) {
        if let Some(axis) = lock_unpoisoned(&self.axes).get_mut(&id) {
            *axis = Some((stopped, over));
        }
        self.reply_if_complete();
    }

    fn reply_if_complete(&self) {
        let axes = lock_unpoisoned(&self.axes);
        if !axes.values().all(|axis| matches!(axis, Some((_, true)))) {
            return;
        }
        let axes = axes.values().flatten().map(|(stopped, _)| stopped.clone()).collect();
        if let Some(reply_sender) = lock_unpoisoned(&self.reply).take() {
            // Whoever asked may have gone.
            let unreached = self.unreached.clone();
            let _ = reply_sender.send(Ok(StopReport { axes, unreached }));
        }
    }
}
