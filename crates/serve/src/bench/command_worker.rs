//! The command worker of one wire. Only it sends motion, one request after the other, stops first. It never
//! waits for a drive. It has its own thread; a caller who requests a stop also runs it on the caller's
//! thread.
//!
//! Why: GW-1.

mod leases;
mod stops;
#[cfg(test)]
mod tests;

use std::sync::{Arc, Mutex};
use std::time::Duration;

use polepair::axis::WireAirtime;
use polepair::{LocalAxis, RunningRequest};
use polepair_core::axis::Verb;
use polepair_core::profile::Signal;
use polepair_core::time::Instant;
use polepair_link::clock;
use serde_json::json;
use tokio::sync::oneshot;

use super::clock::BenchClock;
use super::context::{BenchContext, BenchEvent};
use super::journal_sink::SERVER;
use super::lease::{EndedLease, LeaseHolder, LeaseSlot, SessionName};
use super::lock::lock_unpoisoned;
use super::pending_stop::{PendingStop, REPLY_MAX};
use super::reply::ReplySender;
use super::request_worker::RequestWorker;
use super::scan_flag::scan_error;
use super::state::axis_state;
use super::wire::{
    BenchWire, CommandAction, LeaseRequest, QueuedCommand, StopSender, WireRequest, overtaken_error,
};
use crate::message::{
    CommandOutcome, GatewayError, JournalAction, LeaseAction, LeaseGrant, LeaseView, OutcomeKind,
    StopCause, StopReport,
};

/// Advance of a command's time before the server's clock beyond which it counts as too old, ms.
const CLOCK_AHEAD_MAX_MS: f64 = 1000.0;
/// Interval between two looks at open requests: while they are fresh, and later.
const POLL_INTERVAL: Duration = Duration::from_micros(500);
const SLOW_POLL_INTERVAL: Duration = Duration::from_millis(5);
/// Time for which a request counts as fresh.
const FAST_POLL_TIME: Duration = Duration::from_millis(20);
/// Between two looks when nothing is under way: a link may be lost.
const IDLE: Duration = Duration::from_millis(100);
/// Longest time of sending a stop on the thread of its caller.
const FAST_SEND_MAX: Duration = Duration::from_millis(1);
/// Commands that wait for stops at most.
const WAITING_MAX: usize = 64;
/// Orders that are taken before everything else is looked at again.
const REQUESTS_PER_ROUND_MAX: usize = 64;

/// Worker that executes the commands of a wire.
pub(super) struct CommandWorker {
    wire: Arc<BenchWire>,
    request_worker: Arc<RequestWorker>,
    context: Arc<BenchContext>,
    /// The link's connection string, by which the journal finds its axes again.
    url: String,
    axes: Vec<WorkerAxis>,
    active: Vec<ActiveCommand>,
    /// Commands that wait until their axis is seen standing, with their places among all orders.
    deferred: Vec<(u64, Box<QueuedCommand>)>,
    /// Stops by holders of leases, and their results.
    holder_stops: Vec<(QueuedCommand, oneshot::Receiver<Result<StopReport, GatewayError>>)>,
    airtime: WireAirtime,
    lost: bool,
    /// Time at which the bench was closed.
    closed: Option<Instant>,
    /// Time at which a request was last begun.
    last_start: Instant,
    /// The last stops went out at once: the far end takes the bytes.
    fast_send: bool,
}

/// An axis, as its command worker sees it.
struct WorkerAxis {
    id: u16,
    axis: LocalAxis,
    lease: LeaseSlot,
    /// Pending stop of the axis.
    pending_stop: Option<PendingStop>,
    /// Why its last lease ended, if that was because its link went away.
    link_loss: Option<String>,
    /// Number of the last stop: motion commands that were received before it are refused.
    last_stop_number: u64,
}

/// A command under way.
struct ActiveCommand {
    axis: usize,
    session: SessionName,
    id: String,
    action: CommandAction,
    running: RunningRequest,
    /// True if faults were cleared, and the running request reads whether one remains.
    faults_cleared: bool,
    reply: ReplySender<CommandOutcome>,
}

impl WorkerAxis {
    /// Reason that the axis has no lease: after a lost link that is not a stop by a client.
    fn lease_error(&self, refused: GatewayError) -> GatewayError {
        let Some(why) = self.link_loss.as_ref().filter(|_| self.lease.holder().is_none()) else {
            return refused;
        };
        let label = self.axis.label();
        let what = format!("the link of {label} was lost, and its lease ended: {why}");
        GatewayError::new("E313", what)
            .hint("cut its supply if it turns; the stop is sent as soon as the link is back")
    }
}

impl CommandWorker {
    /// Sends pending stops on the calling thread, unless the worker runs, or its last stop took long to write.
    pub fn stop_sender(worker: &Arc<Mutex<Self>>) -> StopSender {
        let worker = Arc::downgrade(worker);
        Box::new(move || {
            if let Some(worker) = worker.upgrade()
                && let Ok(mut worker) = worker.try_lock()
                && worker.can_send_fast()
            {
                worker.process_stops();
            }
        })
    }

    /// For a link of that connection string.
    pub fn new(
        wire: Arc<BenchWire>,
        worker: Arc<RequestWorker>,
        shared: Arc<BenchContext>,
        url: String,
    ) -> Self {
        let started_at = shared.now();
        let mut command_worker = Self {
            wire,
            request_worker: worker,
            context: shared,
            url,
            axes: Vec::new(),
            active: Vec::new(),
            deferred: Vec::new(),
            holder_stops: Vec::new(),
            airtime: WireAirtime::default(),
            lost: false,
            closed: None,
            last_start: started_at,
            fast_send: true,
        };
        command_worker.add_joined_axes();
        command_worker
    }

    /// Adds axes that joined: they are on the wire's list before they are reported.
    fn add_joined_axes(&mut self) {
        let last_epoch = self.context.last_epoch;
        let known = self.axes.len();
        for (index, (id, axis)) in self.wire.axes.iter().enumerate().skip(known) {
            let (slot, axis) = (LeaseSlot::after_epoch(last_epoch), axis.clone());
            let pending = self.context.inherited_stop(&self.url, &axis);
            self.wire.set_pending_stop(index, pending.as_ref().map(PendingStop::view));
            let unlinked = None;
            self.axes.push(WorkerAxis {
                id: *id,
                axis,
                lease: slot,
                pending_stop: pending,
                link_loss: unlinked,
                last_stop_number: 0,
            });
        }
    }

    /// Serves the wire until the bench closes and all moving axes were stopped.
    pub fn run(this: &Mutex<Self>) {
        let wire = Arc::clone(&lock_unpoisoned(this).wire);
        loop {
            let next = {
                let mut worker = lock_unpoisoned(this);
                let next = worker.run_once();
                if worker.is_over() {
                    return worker.abandon_pending_stops();
                }
                next
            };
            if !wire.clear_wakeup() {
                std::thread::park_timeout(next);
            }
        }
    }

    /// Returns whether a stop can be sent without waiting, as far as is known: to open a lost link again may take
    /// seconds.
    pub fn can_send_fast(&self) -> bool {
        let first = self.axes.first().map(|watched| watched.axis.connection());
        self.fast_send && first.is_some_and(|connection| connection.link_error().is_none())
    }

    /// Returns whether the bench is closed and all that moved was seen standing, or waited for long enough.
    pub fn is_over(&self) -> bool {
        let now = self.context.now();
        let waited = self.closed.is_some_and(|closed| now.since(closed) >= REPLY_MAX);
        waited
            || self.closed.is_some()
                && self.axes.iter().all(|watched| watched.pending_stop.is_none())
    }

    /// Does all that is to be done now, and waits for nothing. Returns when to look again.
    pub fn run_once(&mut self) -> Duration {
        self.add_joined_axes();
        self.process_stops();
        self.check_link();
        self.expire();
        for _ in 0..REQUESTS_PER_ROUND_MAX {
            let Some((sequence, request)) = self.wire.next_request() else { break };
            self.handle_request(sequence, request);
            self.process_stops();
        }
        if self.context.is_closing() && self.closed.is_none() {
            self.close();
        }
        self.poll_commands();
        self.poll_pending_stops();
        self.reply_to_holders();
        for (sequence, commanded) in std::mem::take(&mut self.deferred) {
            self.handle_request(sequence, WireRequest::Command(commanded));
        }
        self.next_wakeup()
    }

    fn next_wakeup(&self) -> Duration {
        let now = self.context.now();
        let busy = !self.active.is_empty() || self.axes.iter().any(|w| w.pending_stop.is_some());
        let scan = if !busy {
            IDLE
        } else if now.since(self.last_start) < FAST_POLL_TIME {
            POLL_INTERVAL
        } else {
            SLOW_POLL_INTERVAL
        };
        let ends = self.axes.iter().filter_map(|watched| Some(watched.lease.holder()?.until));
        ends.map(|until| until.since(now)).min().map_or(scan, |left| left.min(scan))
    }

    /// A lease ended: its motions stop, and nothing moves before it is armed anew.
    fn end_lease(&mut self, axis: usize, lost: EndedLease, why: &str) {
        let moved = self.has_moved(axis, &lost);
        self.axes[axis].axis.arm(false);
        if moved {
            self.stop_unrequested(axis, StopCause::LeaseEnded, why);
        }
        self.record_lease_end(axis, &lost.holder, why);
    }

    /// Returns whether something was set in motion under a lease, or is about to be.
    fn has_moved(&self, axis: usize, lost: &EndedLease) -> bool {
        lost.moved || self.active.iter().any(|going| going.axis == axis && going.action.may_move())
    }

    /// Reports the end of a lease.
    fn record_lease_end(&mut self, axis: usize, holder: &LeaseHolder, why: &str) {
        let id = self.axes[axis].id;
        let detail = json!({ "epoch": holder.epoch, "reason": why });
        self.context.record(&holder.session, JournalAction::LeaseEnded, Some(id), detail);
        self.publish_lease(axis);
    }

    /// Shows everybody who has the lease now.
    fn publish_lease(&self, axis: usize) {
        let watched = &self.axes[axis];
        let lease = watched.lease.holder().map(|holder| LeaseView {
            owner: holder.session.to_string(),
            epoch: holder.epoch,
            expires_ms: BenchClock::wall_ms(holder.until),
        });
        self.wire.set_lease(axis, lease.clone());
        self.context.publish(BenchEvent::Lease { axis: watched.id, lease });
    }

    fn expire(&mut self) {
        let now = self.context.now();
        for axis in 0..self.axes.len() {
            if let Some(lost) = self.axes[axis].lease.expire(now) {
                self.end_lease(axis, lost, "not renewed");
            }
        }
    }

    /// A link that is lost takes its leases with it. What moved then is stopped when it is back.
    fn check_link(&mut self) {
        let Some(watched) = self.axes.first() else { return };
        let trouble = watched.axis.connection().link_error();
        if trouble.is_some() == self.lost {
            return;
        }
        self.lost = trouble.is_some();
        let why = trouble.as_ref().map(ToString::to_string);
        let error = trouble.map(|error| GatewayError::from(polepair::Error::from(error)));
        self.wire.set_link_error(error.map(|error| (self.context.now(), error)));
        for axis in 0..self.axes.len() {
            let now = self.context.now();
            if !self.lost {
                let watched = &mut self.axes[axis];
                if let Some(pending) = &mut watched.pending_stop {
                    pending.resend();
                    self.last_start = now;
                }
                continue;
            }
            self.axes[axis].axis.arm(false);
            let Some(lost) = self.axes[axis].lease.end() else { continue };
            let is_new = self.axes[axis].pending_stop.is_none() && self.has_moved(axis, &lost);
            if is_new {
                let watched = &mut self.axes[axis];
                let why = StopCause::LinkLost;
                watched.pending_stop =
                    Some(PendingStop::new(&watched.axis, why, SERVER.into(), now));
            }
            self.publish_pending_stop(axis, is_new);
            self.axes[axis].link_loss.clone_from(&why);
            self.record_lease_end(axis, &lost.holder, "the link is lost");
        }
        self.context.publish(BenchEvent::BenchChanged);
    }

    /// The bench closes: whatever may move is stopped.
    fn close(&mut self) {
        self.closed = Some(self.context.now());
        for axis in 0..self.axes.len() {
            let watched = &mut self.axes[axis];
            let armed = watched.axis.state().armed || watched.axis.is_turning() == Some(true);
            let lost = watched.lease.end();
            let moved = armed || lost.as_ref().is_some_and(|lost| self.has_moved(axis, lost));
            if moved && self.axes[axis].pending_stop.is_none() {
                self.stop_unrequested(axis, StopCause::ServerEnds, "the server ends");
            }
            if let Some(lost) = lost {
                self.record_lease_end(axis, &lost.holder, "the server ends");
            }
        }
    }

    fn handle_request(&mut self, sequence: u64, wire_request: WireRequest) {
        self.add_joined_axes();
        let late = |axis: usize| sequence < self.axes[axis].last_stop_number;
        match wire_request {
            WireRequest::Lease(request) if request.is_acquire() && late(request.axis) => {
                // The receiver may have been dropped.
                let _ = request.reply.send(Err(overtaken_error()));
            }
            WireRequest::Scan(begin) if (0..self.axes.len()).any(late) => {
                begin(Err(overtaken_error()))
            }
            WireRequest::Dismiss(dismiss) if late(dismiss.axis) => {
                // The receiver may have been dropped.
                let _ = dismiss.reply.send(Err(overtaken_error()));
            }
            WireRequest::Command(commanded) if late(commanded.axis) => {
                self.finish_command(*commanded, Some(overtaken_error()));
            }
            WireRequest::Lease(request) => self.handle_lease(request),
            WireRequest::Command(commanded) if self.must_wait_for_stop(&commanded) => {
                self.deferred.push((sequence, commanded));
            }
            WireRequest::Command(commanded) => self.handle_command(sequence, *commanded),
            WireRequest::Write { axis, session, epoch, then } => {
                then(self.check_allowed(axis, &session, epoch, false))
            }
            WireRequest::SessionEnded(session) => self.end_session(&session),
            WireRequest::LeaseNotRecorded { axis, epoch } => {
                self.revoke_unrecorded_lease(axis, epoch)
            }
            WireRequest::Dismiss(dismiss) => self.handle_dismiss(dismiss),
            WireRequest::Scan(go) => {
                let may = self.check_scan_allowed();
                if may.is_ok() {
                    // Before anybody else has a turn: what is commanded now would wait for it.
                    self.wire.scan_flag.begin();
                }
                go(may);
            }
        }
    }

    /// Checks that a scan would delay no client, and nothing moves that it may not delay.
    fn check_scan_allowed(&self) -> Result<(), GatewayError> {
        if self.context.is_closing() || self.lost {
            return Err(unavailable_error(self.lost));
        }
        if let Some((_, error)) = self.wire.link_error() {
            return Err(error);
        }
        self.wire.check_at_rest()?;
        let powered =
            |watched: &&WorkerAxis| axis_state(watched.id, &watched.axis).enabled == Some(true);
        match self.axes.iter().find(powered) {
            None => Ok(()),
            Some(watched) => {
                let what = format!("{} is powered", watched.axis.label());
                Err(scan_error(what).hint("disable it first"))
            }
        }
    }

    fn end_session(&mut self, session: &SessionName) {
        for axis in 0..self.axes.len() {
            let slot = &mut self.axes[axis].lease;
            let its = slot.holder().is_some_and(|holder| holder.session == *session);
            if let Some(lost) = its.then(|| slot.end()).flatten() {
                self.end_lease(axis, lost, "its client is disconnected");
            }
        }
    }

    /// Checks that a session may command an axis now.
    fn check_allowed(
        &self,
        axis: usize,
        session: &SessionName,
        epoch: u64,
        moves: bool,
    ) -> Result<(), GatewayError> {
        let watched = &self.axes[axis];
        if self.context.is_closing() {
            return Err(unavailable_error(false));
        }
        if let Some(lock) = self.context.current_lock().as_ref().filter(|_| moves) {
            let what = format!("motion is locked since {} stopped all axes", lock.by);
            let hint =
                "release it first: on the server's page, or by `polepair --server URL release`";
            return Err(GatewayError::new("gateway.locked", what).hint(hint));
        }
        let held = watched.lease.check_holder(session, epoch, self.context.now());
        held.map_err(|refused| watched.lease_error(refused))?;
        if moves && watched.pending_stop.as_ref().is_some_and(|stop| !stop.is_holder_stop(epoch)) {
            return Err(stop_pending_error());
        }
        Ok(())
    }

    /// Returns whether what moves an axis waits a moment, because its stop is just about to be over.
    fn must_wait_for_stop(&self, commanded: &QueuedCommand) -> bool {
        let pending = self.axes[commanded.axis].pending_stop.as_ref();
        let pending = pending.filter(|pending| !pending.is_holder_stop(commanded.header.epoch));
        let is_ending = pending.is_some_and(|pending| pending.is_ending(self.context.now()));
        is_ending && commanded.action.may_move() && self.deferred.len() < WAITING_MAX
    }

    fn handle_command(&mut self, sequence: u64, commanded: QueuedCommand) {
        if matches!(commanded.action, CommandAction::Run(command) if command.verb == Verb::Stop) {
            return self.stop_for_holder(sequence, commanded);
        }
        let started = self.start_command(&commanded);
        let QueuedCommand { axis, session, header, action, .. } = &commanded;
        if action.ends_motion() && self.check_allowed(*axis, session, header.epoch, false).is_ok() {
            // A stop does not wait for the journal, as commands before it may still do: these are not executed any
            // more, whatever the stop's result.
            let stopped = &mut self.axes[commanded.axis].last_stop_number;
            *stopped = sequence.max(*stopped);
        }
        match started {
            Ok(StartResult::Running(running)) => {
                let QueuedCommand { axis, session, header, action, reply, .. } = commanded;
                let enables =
                    matches!(action, CommandAction::Run(command) if command.verb == Verb::Enable);
                if action.may_move() && !enables {
                    self.cancel_holder_stop(axis, &session, header.epoch);
                    self.axes[axis].lease.mark_moved();
                }
                self.last_start = self.context.now();
                let (id, running) = (header.id, *running);
                let cleared = false;
                self.active.push(ActiveCommand {
                    axis,
                    session,
                    id,
                    action,
                    running,
                    faults_cleared: cleared,
                    reply,
                });
            }
            Ok(StartResult::Done) => self.finish_command(commanded, None),
            Ok(StartResult::NeedsPreparation) => {
                // Limits that depend on the position need a read first, and so do the scales of the arguments. Not
                // here: a command worker never waits.
                self.request_worker.prepare_command(sequence, commanded);
            }
            Err(error) => self.finish_command(commanded, Some(error)),
        }
    }

    fn finish_command(&self, commanded: QueuedCommand, error: Option<GatewayError>) {
        let QueuedCommand { axis, session, header, action, reply, .. } = commanded;
        let (whose, outcome) = ((&session, self.axes[axis].id), command_outcome(header.id, error));
        self.context.report_outcome(whose, outcome, action.ends_motion(), reply);
    }

    fn start_command(&self, commanded: &QueuedCommand) -> Result<StartResult, GatewayError> {
        let QueuedCommand { axis, session, header, action, prepared, .. } = commanded;
        let moves = action.may_move();
        self.check_allowed(*axis, session, header.epoch, moves)?;
        let stops =
            matches!(action, CommandAction::Run(command) if command.verb == Verb::QuickStop);
        if !stops && *action != CommandAction::Arm(false) {
            check_age(header.issued_ms, header.ttl_ms, BenchClock::wall_ms(self.context.now()))?;
        }
        let watched = &self.axes[*axis];
        let command = match action {
            CommandAction::Arm(armed) => {
                watched.axis.arm(*armed);
                return Ok(StartResult::Done);
            }
            CommandAction::Raw(text) => {
                return Ok(StartResult::Running(Box::new(watched.axis.start_raw(text)?)));
            }
            CommandAction::Run(command) => *command,
        };
        let started = match prepared {
            Some(prepared) => prepared.as_ref().map_err(Clone::clone)?.start(),
            None if moves && watched.axis.has_position_limits()
                || watched.axis.has_unread_scales(&command) =>
            {
                return Ok(StartResult::NeedsPreparation);
            }
            None => watched.axis.start(command),
        };
        Ok(StartResult::Running(Box::new(started?)))
    }

    fn poll_commands(&mut self) {
        let mut at = 0;
        while at < self.active.len() {
            let (value, error) = match self.active[at].running.poll() {
                Ok(None) => {
                    at += 1;
                    continue;
                }
                Ok(value) => (value, None),
                // The faults were cleared, whatever became of the question after them.
                Err(_) if self.active[at].faults_cleared => (None, None),
                Err(error) => (None, Some(GatewayError::from(error))),
            };
            if error.is_none() && self.start_fault_read(at) {
                at += 1;
                continue;
            }
            let ActiveCommand { axis, session, id, action, reply, .. } =
                self.active.swap_remove(at);
            if error.is_none() && action.is_stop() {
                self.axes[axis].lease.mark_stopped();
            }
            let value = value.filter(|_| matches!(action, CommandAction::Raw(_)));
            let outcome = CommandOutcome { value, ..command_outcome(id, error) };
            let whose = (&session, self.axes[axis].id);
            self.context.report_outcome(whose, outcome, action.ends_motion(), reply);
        }
    }
}

impl CommandWorker {
    /// Reads whether a fault remains after faults were cleared: later reports of the axis use later readings. False if
    /// there is nothing to read.
    fn start_fault_read(&mut self, at: usize) -> bool {
        let going = &mut self.active[at];
        let clears =
            matches!(&going.action, CommandAction::Run(command) if command.verb == Verb::Clear);
        if !clears || going.faults_cleared {
            return false;
        }
        let axis = &self.axes[going.axis].axis;
        let source = axis.profile().signal(Signal::Fault);
        let Some(running) = source.and_then(|source| axis.start_read(source.parameter).ok()) else {
            return false;
        };
        (going.running, going.faults_cleared) = (running, true);
        true
    }
}

/// Result of the start of an allowed command.
enum StartResult {
    Running(Box<RunningRequest>),
    Done,
    /// Something must be asked first.
    NeedsPreparation,
}

/// Validity of a command, ms.
pub(super) fn scaled_ttl_ms(ttl_ms: f64) -> f64 {
    ttl_ms * f64::from(clock::timeout_scale())
}

/// Checks that a command is still valid.
fn check_age(issued_ms: f64, ttl_ms: f64, now_ms: f64) -> Result<(), GatewayError> {
    let (age, ttl_ms) = (now_ms - issued_ms, scaled_ttl_ms(ttl_ms));
    if age > ttl_ms {
        let what = format!(
            "by the server's clock the command was sent {age:.0} ms ago; it is valid for {ttl_ms:.0} ms"
        );
        let hint = format!(
            "if the client's clock is behind: set `issued_ms` by the server's time ({now_ms:.0}, \
             `server_ms` of the lease). Otherwise the command was delayed: send it again with a new \
             `id`, if it is still wanted"
        );
        let error = GatewayError::new("gateway.expired", what).hint(hint);
        return Err(GatewayError { server_ms: Some(now_ms), ..error });
    }
    if age < -CLOCK_AHEAD_MAX_MS {
        let what =
            format!("by the server's clock the command was sent {:.0} ms in the future", -age);
        let hint = format!(
            "the client's clock is ahead: set `issued_ms` by the server's time ({now_ms:.0}, \
             `server_ms` of the lease)"
        );
        let error = GatewayError::new("gateway.expired", what).hint(hint);
        return Err(GatewayError { server_ms: Some(now_ms), ..error });
    }
    Ok(())
}

fn stop_pending_error() -> GatewayError {
    let what = "the axis has a pending stop: its standstill is not confirmed, and it may be \
     turning";
    GatewayError::new("gateway.pending", what).hint(
        "wait until it is at standstill; if motion is safe, dismiss the stop, then arm the axis \
         again",
    )
}

fn lease_grant(held: &LeaseHolder, now: Instant) -> LeaseGrant {
    let (expires_ms, server_ms) = (BenchClock::wall_ms(held.until), BenchClock::wall_ms(now));
    LeaseGrant { epoch: held.epoch, expires_ms, server_ms }
}

fn unavailable_error(lost: bool) -> GatewayError {
    if lost {
        GatewayError::new("gateway.busy", "the link is lost").hint("check its cable and power")
    } else {
        GatewayError::new("gateway.busy", "the server ends").hint("start it again")
    }
}

/// The outcome that an error means. A command that was executed and ended in an error has not reached its goal: a
/// motion that stopped elsewhere.
pub(super) fn command_outcome(id: String, error: Option<GatewayError>) -> CommandOutcome {
    let ended = match error.as_ref().map(|error| error.executed) {
        None => OutcomeKind::Done,
        Some(Some(false)) => OutcomeKind::NotDone,
        Some(Some(true) | None) => OutcomeKind::Unknown,
    };
    CommandOutcome { id, outcome: ended, value: None, error, replayed: false }
}
