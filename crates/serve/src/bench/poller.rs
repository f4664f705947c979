//! The poller of one wire: a thread that reads displayed values while the request worker is idle. It reads
//! one value at a time, so a command waits for one read at most.

use std::sync::Arc;
use std::time::Duration;

use polepair::LocalAxis;
use polepair_core::error::{Failure, Outcome};
use polepair_core::profile::{ParameterId, Signal};
use polepair_core::time::Instant;
use serde_json::json;

use super::clash_detector::ClashDetector;
use super::context::{BenchContext, BenchEvent};
use super::open::BenchLink;
use super::request_worker::RequestWorker;
use super::scan::LinkScanner;
use super::telemetry::{Telemetry, WatchTarget};
use super::wire::{BenchWire, StopBatch};
use crate::message::telemetry::Sample;
use crate::message::{GatewayError, JournalAction};

/// Interval of reads of an axis' state.
const STATE_EVERY: Duration = Duration::from_millis(100);
/// Pause after an axis did not answer.
// A silent drive costs a timeout each time, which the others of its wire wait for.
const SILENT_BACKOFF: Duration = Duration::from_secs(1);
/// Time ahead by which a turning axis is kept from leaving its limits.
// Two readings of the state and the time of a stop: the axis is stopped before it reaches its limit.
const LIMIT_LOOKAHEAD: Duration = Duration::from_millis(200);
/// Between two looks whether there is anything to do.
const IDLE: Duration = Duration::from_millis(20);
/// Watched values that are asked for between two addresses of a look for drives.
// Watched values may be more than a slow wire carries; then the scan still goes on.
const DUE_AT_ONCE_MAX: usize = 16;

/// Poller of a wire.
pub(super) struct AxisPoller {
    wire: Arc<BenchWire>,
    request_worker: Arc<RequestWorker>,
    context: Arc<BenchContext>,
    telemetry: Arc<Telemetry>,
    axes: Vec<PolledAxis>,
    /// Index of the next axis.
    current: usize,
    /// Questions take half of the time at most.
    rest_until: Instant,
    clash_detector: ClashDetector,
    scanner: LinkScanner,
}

/// An axis, and its open queries.
struct PolledAxis {
    id: u16,
    axis: LocalAxis,
    /// Parameters that signals read.
    signal_parameters: Vec<ParameterId>,
    reads_left: Vec<ParameterId>,
    next: Instant,
    /// True if its drive is still to be set to watch this host.
    needs_host_watch: bool,
}

impl AxisPoller {
    pub fn new(link: &BenchLink, shared: &Arc<BenchContext>, telemetry: &Arc<Telemetry>) -> Self {
        let mut axis_poller = Self {
            axes: Vec::new(),
            wire: Arc::clone(&link.wire),
            request_worker: Arc::clone(&link.request_worker),
            context: Arc::clone(shared),
            telemetry: Arc::clone(telemetry),
            current: 0,
            rest_until: Instant::ZERO,
            clash_detector: ClashDetector::default(),
            scanner: LinkScanner::new(link, shared),
        };
        axis_poller.add_joined_axes();
        axis_poller
    }

    /// Looks at axes that joined, too.
    fn add_joined_axes(&mut self) {
        let polled = |(id, axis): &(u16, LocalAxis)| PolledAxis {
            id: *id,
            signal_parameters: polled_parameters(axis),
            axis: axis.clone(),
            reads_left: Vec::new(),
            next: Instant::ZERO,
            needs_host_watch: true,
        };
        let known = self.axes.len();
        if known < self.wire.axes.len() {
            self.axes.extend(self.wire.axes.iter().skip(known).map(polled));
        }
    }

    /// Looks until the bench closes.
    pub fn run(mut self) {
        while !self.context.is_closing() {
            if self.request_worker.run_next() {
                continue;
            }
            if self.scan_next() {
                // Between two addresses whatever is due goes on.
                for _ in 0..DUE_AT_ONCE_MAX {
                    if !self.request_worker.run_next() && !self.poll_subscribed() {
                        break;
                    }
                }
                self.poll_state();
                continue;
            }
            let watched = self.poll_subscribed();
            // Even if more is watched than the wire can carry, states are still read in between; a
            // command comes before either.
            if watched && (self.request_worker.run_next() || self.context.now() < self.rest_until) {
                continue;
            }
            let now = self.context.now();
            if now < self.rest_until {
                self.request_worker.wait(self.rest_until.since(now).min(self.idle()));
            } else if self.poll_state() {
                // As long a rest as the request took, so that states take half of a wire at most.
                self.rest_until = self.context.now() + self.context.now().since(now);
            } else if !watched {
                self.request_worker.wait(self.idle());
            }
        }
        // Remaining requests get the reply that they are too late.
        while self.request_worker.run_next() {}
    }

    /// Asks the next address of a scan. False without a scan.
    pub fn scan_next(&mut self) -> bool {
        let is_scanning = self.scanner.step();
        if is_scanning && let Some(first) = self.axes.first() {
            // A late reply to a scanned address is no clash.
            let counters = first.axis.connection().with_axes(|axes, _| axes.counters());
            self.clash_detector.skip_counted(counters, self.context.now());
        }
        is_scanning
    }

    /// Reads a subscribed value that the drive does not send, once, if it is due: the longest waiting first, so that
    /// all get their turn on a wire that cannot carry all. False if none is due.
    pub fn poll_subscribed(&mut self) -> bool {
        self.add_joined_axes();
        let Some((now, zero)) = self.wire.time() else { return false };
        let now_us = now.since(zero).as_micros() as u64;
        let sources = self.axes.iter().flat_map(|polled| {
            self.telemetry.sources_of(polled.id).into_iter().map(move |source| (polled, source))
        });
        let due = sources.filter_map(|(polled, source)| {
            let due = source.poll_due(now_us)?;
            (due <= now).then_some((due, polled, source))
        });
        let Some((_, polled, source)) = due.min_by_key(|(due, ..)| *due) else { return false };
        // Before the reading: one that fails is not asked for again at once.
        source.mark_polled(now);
        if let Some((at, value)) = polled.read_target(source.target) {
            let t_us = at.since(zero).as_micros() as u64;
            source.push_polled(Sample { t_us, value });
        }
        true
    }

    /// Time until the next value is due.
    fn idle(&self) -> Duration {
        let Some((now, zero)) = self.wire.time() else { return IDLE };
        let now_us = now.since(zero).as_micros() as u64;
        let sources = self.axes.iter().flat_map(|polled| self.telemetry.sources_of(polled.id));
        let due = sources.filter_map(|source| source.poll_due(now_us)).min();
        due.map_or(IDLE, |due| due.since(now).min(IDLE))
    }

    /// Asks one thing of the axis whose turn it is. False when none is to be asked.
    fn poll_state(&mut self) -> bool {
        let now = self.context.now();
        self.check_clashes(now);
        for id in self.wire.drain_restarted() {
            let its = self.axes.iter_mut().filter(|polled| polled.id == id);
            its.for_each(|polled| polled.needs_host_watch = true);
        }
        for polled in
            self.axes.iter_mut().filter(|polled| polled.needs_host_watch && now >= polled.next)
        {
            if polled.enable_host_watch(now, &self.wire, &self.context) {
                return true;
            }
        }
        for _ in 0..self.axes.len() {
            self.current = (self.current + 1) % self.axes.len();
            let polled = &mut self.axes[self.current];
            if polled.reads_left.is_empty() && now >= polled.next {
                polled.reads_left.clone_from(&polled.signal_parameters);
                polled.next = now + STATE_EVERY;
            }
            let stale = loop {
                match polled.reads_left.pop() {
                    Some(id) if polled.is_fresh(id) => {}
                    found => break found,
                }
            };
            if let Some(id) = stale {
                polled.poll_parameter(id, now);
                self.enforce_limits();
                return true;
            }
        }
        false
    }

    /// Reports other hosts on the wire.
    fn check_clashes(&mut self, now: Instant) {
        let Some(first) = self.axes.first() else { return };
        if let Some(news) = self
            .clash_detector
            .check(|| first.axis.connection().with_axes(|axes, _| axes.counters()), now)
        {
            self.wire.set_clash(news);
            self.context.publish(BenchEvent::BenchChanged);
        }
    }

    /// Stops an axis that is about to leave the limits that a file sets it.
    fn enforce_limits(&self) {
        let axis = &self.axes[self.current].axis;
        // Only motions under this server are its own to end.
        if !axis.has_position_limits() || !axis.state().armed || axis.is_turning() != Some(true) {
            return;
        }
        let reason = match axis.predict_limit_violation(LIMIT_LOOKAHEAD) {
            Ok(None) => return,
            Ok(Some(reason)) => reason,
            Err(error) => error.to_string(),
        };
        let (axes, since, report) = (vec![(self.current, 0)], self.context.now(), None);
        let who = super::journal_sink::SERVER.into();
        self.wire.submit_stop(StopBatch {
            axes,
            session: who,
            reason,
            requested_at: since,
            collector: report,
        });
    }
}

/// Parameters of the signals, each once; the last one is asked first, being the most important.
fn polled_parameters(axis: &LocalAxis) -> Vec<ParameterId> {
    let mut ids = Vec::new();
    let plain = axis.profile().signals.iter().filter(|source| source.signal != Signal::Time);
    for source in plain {
        if !ids.contains(&source.parameter) {
            ids.push(source.parameter);
        }
    }
    // Taken from the end, so that the profile's first signals are read first.
    ids.reverse();
    ids
}

impl PolledAxis {
    /// Present value of a subscribed target; `None` if it is unknown.
    fn read_target(&self, what: WatchTarget) -> Option<(Instant, f64)> {
        let (at, value) = match what {
            WatchTarget::Signal(signal) => {
                let reading = self.axis.signals(&[signal]).ok()?[0];
                (reading.at?, reading.value)
            }
            WatchTarget::Parameter(id) => {
                let raw = self.axis.read(id).ok()?;
                (self.axis.connection().now(), self.axis.value(id, raw).ok()?.value)
            }
        };
        value.is_finite().then_some((at, value))
    }

    /// Returns whether all values of a parameter were received just now.
    fn is_fresh(&self, id: ParameterId) -> bool {
        let (state, now) = (self.axis.state(), self.axis.connection().now());
        let mut its = self.axis.profile().signals.iter().filter(|s| s.parameter == id);
        its.all(|s| state.reading(s.signal).at.is_some_and(|at| now.since(at) < STATE_EVERY / 2))
    }

    /// Has its drive watch this host's heartbeat, where the link sends one. False where nothing was
    /// asked.
    fn enable_host_watch(&mut self, now: Instant, wire: &BenchWire, shared: &BenchContext) -> bool {
        let (watched, failed) = match self.axis.watch_host() {
            Ok(None) => {
                self.needs_host_watch = false;
                return false;
            }
            Ok(Some(watched)) => (Ok(watched), false),
            Err(error) => {
                let silent = matches!(&error, polepair::Error::Failed { outcome, .. }
                    if matches!(outcome.failure(), Some(Failure::Silent | Failure::LinkDown)));
                (Err(error), silent)
            }
        };
        if failed {
            self.next = now + SILENT_BACKOFF;
            return true;
        }
        self.needs_host_watch = false;
        let (output, own, detail) = match watched {
            Ok([found, is]) => {
                let detail = json!({ "was": found.to_string(), "is": is.to_string() });
                (is.to_string(), found != is, detail)
            }
            Err(error) => {
                let output = format!("not known: {error}");
                (output, false, json!({ "error": GatewayError::from(error) }))
            }
        };
        tracing::info!(axis = self.id, "{}: drive watchdog: {output}", self.axis.label());
        shared.record_by_server(JournalAction::Watchdog, self.id, detail);
        let index = wire.axes.iter().position(|(id, _)| *id == self.id);
        index.filter(|_| own).into_iter().for_each(|index| wire.set_host_watched(index, true));
        true
    }

    fn poll_parameter(&mut self, id: ParameterId, now: Instant) {
        let Err(error) = self.axis.read(id) else { return };
        let polepair::Error::Failed { outcome, .. } = error else {
            return self.signal_parameters.retain(|other| *other != id);
        };
        match outcome {
            Outcome::NotDone(Failure::Refused { .. } | Failure::Impossible(_)) => {
                self.signal_parameters.retain(|other| *other != id);
            }
            _ if matches!(outcome.failure(), Some(Failure::Silent | Failure::LinkDown)) => {
                // The rest of its signals would take a timeout each.
                self.reads_left.clear();
                self.next = now + SILENT_BACKOFF;
            }
            _ => {}
        }
    }
}
