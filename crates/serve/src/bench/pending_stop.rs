//! The pending stop of an axis, from the stop until its standstill is confirmed: its requesters and their replies. Its
//! [`StopSupervisor`] decides the frames.
//!
//! Why: STOP-7.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use polepair::LocalAxis;
use polepair::axis::{
    Standstill, StopNotice, StopOptions, StopPersistence, StopProgress, StopResult, StopSupervisor,
    WireAirtime,
};
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

/// Time for which a command after a stop waits until the motor is at standstill.
// A motor that brakes on a ramp obeys; an alarm for each usual stop would be ignored (STOP-7).
const BRAKING_GRACE: Duration = Duration::from_secs(2);
/// Time limit of the reply to a stop.
pub(super) const REPLY_MAX: Duration = Duration::from_secs(10);
/// Pending stop of one axis.
pub(super) struct PendingStop {
    /// Time, cause and session of its beginning.
    since: Instant,
    why: StopCause,
    by: SessionName,
    /// Epoch of the lease whose holder requested it, and may move the axis again.
    holder_epoch: Option<u64>,
    /// True once it was published as an alarm.
    alarmed: bool,
    stop: StopSupervisor,
    last_report: Option<AxisStopReport>,
    waiters: Vec<StopWaiter>,
}

/// A client that waits for the result, and the time of its request.
struct StopWaiter {
    collector: Arc<StopCollector>,
    since: Instant,
}

/// End of a pending stop.
#[derive(Clone, PartialEq, Debug)]
pub(super) enum StopResolution {
    /// The motor was seen standing.
    Standing,
    /// The drive acknowledged the stop, and the state of its motor cannot be measured.
    NotKnown,
    /// The drive has no stop.
    Impossible(GatewayError),
}

/// Result of a poll.
pub(super) struct StopPoll {
    /// Progress of the stop, if it is new.
    pub report: Option<AxisStopReport>,
    /// The motor did not become slower, and a quick stop was sent.
    pub sent_quick_stop: bool,
    /// End of the pending stop, if it has ended.
    pub ended: Option<StopResolution>,
}

impl PendingStop {
    /// Creates a pending stop that is still to be sent.
    pub fn new(axis: &LocalAxis, why: StopCause, by: SessionName, now: Instant) -> Self {
        let options = StopOptions::default();
        Self {
            since: now,
            why,
            by,
            holder_epoch: None,
            alarmed: false,
            stop: StopSupervisor::pending(axis, options, StopPersistence::UntilStandstill),
            last_report: None,
            waiters: Vec::new(),
        }
    }

    /// Marks it as requested by the holder of the lease of that epoch.
    pub fn for_holder(mut self, epoch: u64) -> Self {
        self.holder_epoch = Some(epoch);
        self
    }

    /// Returns whether the holder of the lease of that epoch is the only requester.
    pub fn is_holder_stop(&self, epoch: u64) -> bool {
        self.holder_epoch == Some(epoch)
    }

    /// Adds a further requester: it is no longer the holder's alone.
    pub fn add_requester(&mut self, why: StopCause, by: &SessionName) {
        // From now on another client waits for it too, so its holder cannot end it by moving the axis again.
        if self.holder_epoch.take().is_some() {
            (self.why, self.by) = (why, by.clone());
        }
    }

    /// Sends the stop for a requester, although one may be on its way: earlier requesters get the result of this one.
    pub fn send(&mut self, since: Instant, report: Option<Arc<StopCollector>>) {
        debug_assert!(self.stop.result().is_none(), "a stop that has ended is not pending");
        self.waiters.extend(report.map(|report| StopWaiter { collector: report, since }));
        self.last_report = None;
        self.stop.send_again(true);
    }

    /// Sends it because the link is open again.
    pub fn resend(&mut self) {
        self.stop.send_again(false);
    }

    /// Returns whether it is young and goes well, so that the motor will soon be seen standing.
    pub fn is_ending(&self, now: Instant) -> bool {
        let goes_well = !self.stop.is_lost() && !self.stop.may_be_turning();
        now.since(self.since) < BRAKING_GRACE && goes_well
    }

    /// Number of times it was sent.
    pub fn attempts(&self) -> u32 {
        self.stop.attempts()
    }

    /// View of the stop for all clients.
    pub fn view(&self) -> PendingStopView {
        let (class, error) = self.progress();
        let since_ms = BenchClock::wall_ms(self.since);
        PendingStopView {
            since_ms,
            why: self.why,
            by: self.by.to_string(),
            class,
            attempts: self.stop.attempts(),
            error,
        }
    }

    /// The present view of the stop, and whether it changed. A stop by the holder of the lease is no alarm while it is
    /// young and proceeds: a braking motor obeys. An alarm lasts until the pending stop ends.
    pub fn update_alarm(&mut self, now: Instant) -> (Option<PendingStopView>, bool) {
        let goes_well = !self.stop.is_lost();
        let is_young = now.since(self.since) < BRAKING_GRACE;
        if self.holder_epoch.is_some() && !self.alarmed && goes_well && is_young {
            return (None, false);
        }
        (Some(self.view()), !std::mem::replace(&mut self.alarmed, true))
    }

    /// Certain progress of the last sent stop.
    fn progress(&self) -> (StopClass, Option<GatewayError>) {
        let trouble = self.stop.trouble().map(|error| GatewayError::from(error.clone()));
        match self.stop.progress() {
            StopProgress::Sent if self.stop.is_unsent() => (StopClass::Failed, None),
            StopProgress::Sent => (StopClass::Sent, None),
            // Drives of a group acknowledge nothing.
            StopProgress::Unobservable if self.is_unconfirmed() => (StopClass::Sent, trouble),
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

    fn is_unconfirmed(&self) -> bool {
        let ended = self.stop.result().map(|ended| &ended.standstill);
        matches!(ended, Some(Ok(Standstill::Unconfirmed)))
    }

    /// Checks its progress, and sends the requests that are due.
    pub fn poll(&mut self, id: u16, now: Instant, airtime: &mut WireAirtime) -> StopPoll {
        let notice = self.stop.poll(airtime);
        let ended = self.stop.result().map(|StopResult { standstill, .. }| match standstill {
            Ok(Standstill::Observed) => StopResolution::Standing,
            Ok(Standstill::Unobservable | Standstill::Unconfirmed) => StopResolution::NotKnown,
            Err(error) => StopResolution::Impossible(error.clone().into()),
        });
        StopPoll {
            report: self.new_report(id, now, ended.is_some()),
            sent_quick_stop: notice == Some(StopNotice::QuickStop),
            ended,
        }
    }

    fn new_report(&mut self, id: u16, now: Instant, ended: bool) -> Option<AxisStopReport> {
        let (class, error) = self.progress();
        let rises = self.last_report.as_ref().is_none_or(|last| class > last.class);
        // A failure that will be repeated is not reported.
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
        let quick = self.stop.sent_quick_stop();
        let axis_stop_report = AxisStopReport { id, class, ms: self.ms(now), quick, error };
        self.last_report = Some(axis_stop_report.clone());
        Some(axis_stop_report)
    }

    fn ms(&self, now: Instant) -> f64 {
        let since = self.waiters.last().map_or(self.since, |stop_waiter| stop_waiter.since);
        now.since(since).as_secs_f64() * 1e3
    }

    /// Replies to clients that reached their time limit or their goal; to all of them at the end of the pending stop,
    /// which all clients see by then.
    pub fn reply_to_waiters(&mut self, id: u16, axis: &LocalAxis, now: Instant, ended: bool) {
        let (class, error) = self.progress();
        // Over a link that is lost nothing comes for a while.
        let lost = axis.connection().link_error().is_some();
        let lost = lost && self.stop.is_lost();
        let quick = self.stop.sent_quick_stop();
        self.waiters.retain(|StopWaiter { collector, since }| {
            let waited = now.since(*since);
            let over = ended || lost || waited >= REPLY_MAX;
            // The reply is given up, the stop is not: it goes on, and the class states that.
            let class = if over && !ended { StopClass::Pending } else { class };
            let ms = waited.as_secs_f64() * 1e3;
            let error = error.clone();
            collector.record(id, AxisStopReport { id, class, ms, quick, error }, over);
            !over
        });
    }

    /// Replies to all waiting clients: it is dismissed, or the server ends.
    pub fn abandon(&mut self, id: u16, now: Instant, why: &GatewayError) {
        for StopWaiter { collector, since } in self.waiters.drain(..) {
            let ms = now.since(since).as_secs_f64() * 1e3;
            let (class, quick) = (StopClass::Pending, self.stop.sent_quick_stop());
            let error = Some(why.clone());
            collector.record(id, AxisStopReport { id, class, ms, quick, error }, true);
        }
    }
}

/// Results of a stop of several axes, for its requester.
#[derive(Debug)]
pub(super) struct StopCollector {
    /// Links that it does not reach.
    unreached: Vec<UnreachedTarget>,
    /// Parts of the request that could not be executed.
    refused: Vec<GatewayError>,
    axes: Mutex<BTreeMap<u16, Option<(AxisStopReport, bool)>>>,
    reply: Mutex<Option<ReplySender<StopReport>>>,
}

impl StopCollector {
    /// For these axes.
    pub fn for_axes(
        axes: &[u16],
        unreached: Vec<UnreachedTarget>,
        refused: Vec<GatewayError>,
    ) -> (Arc<Self>, oneshot::Receiver<Result<StopReport, GatewayError>>) {
        let (reply_sender, receiver) = oneshot::channel();
        let axes = axes.iter().map(|id| (*id, None)).collect();
        let (axes, reply) = (Mutex::new(axes), Mutex::new(Some(reply_sender)));
        let report = Self { unreached, refused, axes, reply };
        // A stop of no axis has its answer at once.
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
            // The requester may have disconnected.
            let (unreached, refused) = (self.unreached.clone(), self.refused.clone());
            let _ = reply_sender.send(Ok(StopReport { axes, unreached, refused }));
        }
    }
}
