//! A stop on its way: sent, answered, seen to stand still; and those who wait to hear it.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use polepair::axis::{Class, Stopping};
use polepair::{Axis, Running};
use polepair_core::error::{Failure, Outcome};
use polepair_core::profile::Signal;
use polepair_core::time::Instant;
use tokio::sync::oneshot;

use super::shared::held;
use super::wire::Tell;
use crate::message::{AxisStopped, Refused, StopClass, Stopped};

/// Between two looks whether the motor stands, where its drive's stop waits for nothing.
const LOOK_EVERY: Duration = Duration::from_millis(10);
/// A stop that was not answered is sent again after this.
const AGAIN_AFTER: Duration = Duration::from_millis(100);
/// So often at most.
const TRIES_MAX: u32 = 5;
/// How long a motor is watched that was told to stop.
const WATCH_MAX: Duration = Duration::from_secs(10);

/// The stop of one axis.
pub(super) struct Halt {
    stopping: Stopping,
    begun: Instant,
    tries: u32,
    /// A question after the velocity.
    look: Option<Running>,
    next: Instant,
    told: Option<AxisStopped>,
    reports: Vec<Arc<Report>>,
}

impl Halt {
    /// Sends the stop.
    pub fn begin(axis: &Axis, now: Instant, reports: Vec<Arc<Report>>) -> Self {
        let stopping = Stopping::begin(axis);
        Self { stopping, begun: now, tries: 1, look: None, next: now, told: None, reports }
    }

    /// Sends it once more, though one is on its way: whoever asked for that one hears of this one.
    pub fn again(&mut self, axis: &Axis, now: Instant, report: Option<Arc<Report>>) {
        let mut reports = std::mem::take(&mut self.reports);
        reports.extend(report);
        *self = Self::begin(axis, now, reports);
    }

    /// Whether nothing that moves may be sent yet.
    pub fn is_under_way(&self) -> bool {
        self.stopping.is_under_way()
    }

    /// Looks how far it came. Returns what is new, and whether it is over.
    pub fn look(&mut self, id: u16, axis: &Axis, now: Instant) -> (Option<AxisStopped>, bool) {
        self.stopping.look(axis, axis.connection().now());
        let over = match self.stopping.class() {
            Class::Sent => false,
            Class::Acknowledged if self.stopping.is_under_way() => false,
            Class::Acknowledged => self.watch(axis, now),
            Class::Still => true,
            Class::Failed(_) => self.try_again(axis, now),
        };
        let over = over || now.since(self.begun) >= WATCH_MAX;
        let news = self.news(id, now, over);
        if news.is_some() || over {
            self.report(id, over);
        }
        (news, over)
    }

    /// Asks for the velocity until it is none. True when nobody can tell.
    fn watch(&mut self, axis: &Axis, now: Instant) -> bool {
        let Some(source) = axis.profile().signal(Signal::Velocity) else { return true };
        match self.look.as_mut().map(Running::poll) {
            Some(Ok(None)) => return false,
            Some(Ok(Some(_))) => {
                self.look = None;
                if let (Some(false), Some(at)) =
                    (axis.turns(), axis.state().reading(Signal::Velocity).at)
                {
                    self.stopping.stands(at);
                    return *self.stopping.class() == Class::Still;
                }
            }
            Some(Err(_)) => self.look = None,
            None if now >= self.next => {
                self.look = axis.start_read(source.parameter).ok();
                self.next = now + LOOK_EVERY;
            }
            None => {}
        }
        false
    }

    /// True when there is no sense in it.
    fn try_again(&mut self, axis: &Axis, now: Instant) -> bool {
        let Class::Failed(error) = self.stopping.class() else { return true };
        if !is_of_the_wire(error) || self.tries >= TRIES_MAX {
            return true;
        }
        if self.next <= self.begun {
            self.next = now + AGAIN_AFTER;
        } else if now >= self.next {
            self.tries += 1;
            self.stopping = Stopping::begin(axis);
            self.next = now + AGAIN_AFTER;
        }
        false
    }

    fn news(&mut self, id: u16, now: Instant, over: bool) -> Option<AxisStopped> {
        let (class, error) = match self.stopping.class() {
            Class::Sent => (StopClass::Sent, None),
            Class::Acknowledged => (StopClass::Acknowledged, None),
            Class::Still => (StopClass::Standing, None),
            // It may still be answered when it is said again.
            Class::Failed(_) if !over => return None,
            Class::Failed(error) => (failed(error), Some(Refused::from(error.clone()))),
        };
        if self.told.as_ref().is_some_and(|told| told.class == class && told.error == error) {
            return None;
        }
        let ms = now.since(self.begun).as_secs_f64() * 1e3;
        let told = AxisStopped { id, class, ms, error };
        self.told = Some(told.clone());
        Some(told)
    }

    fn report(&self, id: u16, over: bool) {
        let Some(told) = &self.told else { return };
        self.reports.iter().for_each(|report| report.take(id, told.clone(), over));
    }
}

/// What is certain of a stop that ended so: it may be on the wire.
fn failed(error: &polepair::Error) -> StopClass {
    match error.executed() {
        Some(false) => StopClass::Failed,
        _ => StopClass::Sent,
    }
}

/// Whether it may be answered once it is said again.
fn is_of_the_wire(error: &polepair::Error) -> bool {
    let polepair::Error::Failed { outcome, .. } = error else { return false };
    let (Outcome::NotDone(failure) | Outcome::Unknown(failure)) = outcome else { return false };
    matches!(failure, Failure::Silent | Failure::Misbehaved | Failure::Cancelled)
}

/// What came of a stop of several axes, for whoever asked for it.
#[derive(Debug)]
pub(super) struct Report {
    axes: Mutex<BTreeMap<u16, Option<(AxisStopped, bool)>>>,
    tell: Mutex<Option<Tell<Stopped>>>,
}

impl Report {
    /// For these axes.
    pub fn of(axes: &[u16]) -> (Arc<Self>, oneshot::Receiver<Result<Stopped, Refused>>) {
        let (tell, told) = oneshot::channel();
        let axes = axes.iter().map(|id| (*id, None)).collect();
        let report = Self { axes: Mutex::new(axes), tell: Mutex::new(Some(tell)) };
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
            let _ = tell.send(Ok(Stopped { axes }));
        }
    }
}
