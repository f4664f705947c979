//! The bench: opens links, owns them, and lets several clients read and one client control each axis. It
//! contains no HTTP.
//!
//! Each wire has a command worker and a request worker. Only the command worker sends motion, and it never
//! waits for a drive. The request worker waits for drives. So a stop never waits for a read, and one link
//! never waits for another.
//!
//! ```
//! use polepair_serve::bench::{Bench, BenchOptions};
//! use polepair_serve::message::LeaseAction;
//! use std::time::Duration;
//! # if polepair_drives::profiles().iter().any(|p| p.protocol == "tmcl") {
//! let bench = Bench::open(&["sim:tmcl?time=virtual".into()], BenchOptions::default())?;
//! let mut lease = bench.request_lease(0, &"ann".into(), LeaseAction::Take, 0);
//! bench.advance_time(Duration::from_millis(1));
//! let lease = lease.try_recv().expect("a worker answers at once")?.expect("it is given");
//! assert_eq!(bench.axis_state(0)?.lease.expect("ann has it").epoch, lease.epoch);
//! # }
//! # Ok::<(), polepair_serve::message::GatewayError>(())
//! ```

mod absent_axes;
mod append_only_vec;
mod captures;
mod changes;
mod clash_detector;
mod clock;
mod command_history;
mod command_worker;
mod commands;
mod context;
mod describe;
mod drive_log;
mod event_listener;
mod frame_view;
mod frames;
mod journal_queue;
mod journal_sink;
mod late_links;
mod lease;
mod link_scan;
mod lock;
mod open;
mod parameters;
pub(crate) mod paths;
mod pending_stop;
mod poller;
mod port_search;
mod reply;
mod request_worker;
mod scan;
mod scan_flag;
mod signals;
mod simulated_drive;
mod state;
mod telemetry;
mod thread_error;
mod threads;
mod watchdog;
mod wire;

use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::Duration;

use polepair::Connector;
use polepair::simulate::Simulation;
use polepair_core::axis::{Command, Verb};
use polepair_core::profile::Signal;
use polepair_core::time::Instant;
use polepair_drives::surroundings::GroundTruth;
use serde_json::json;
use tokio::sync::{broadcast, oneshot};

use crate::message::{
    AxisInfo, AxisState, BenchView, Clash, CommandOutcome, CommandRequest, DismissStop,
    GatewayError, JournalAction, LeaseAction, LeaseGrant, MotionLock, RawRequest, SetTimeScale,
    SimulationAction, StopReport, StopRequest,
};
use append_only_vec::AppendOnlyVec;
use captures::Captures;
use clock::{BenchClock, STEP};
use command_history::{CommandKey, CommandLookup};
use command_worker::{CommandWorker, command_outcome};
use context::BenchContext;
use event_listener::DriveEventListener;
use frames::{FrameTraffic, TrafficDecoder};
use journal_queue::{ActionSubject, JournalWriter};
use lock::lock_unpoisoned;
use open::{BenchLink, OpenedBench};
use pending_stop::StopCollector;
use poller::AxisPoller;
use port_search::BenchSearch;
use telemetry::Telemetry;
use wire::{
    BenchWire, CommandAction, CommandHeader, DismissRequest, LeaseRequest, QueuedCommand,
    StopBatch, WireRequest,
};

pub use captures::CAPTURE_MAX;
pub use context::BenchEvent;
pub use frames::FrameSubscription;
pub use journal_sink::JournalEntry;
pub use journal_sink::JournalSink;
pub use journal_sink::NullJournal;
pub use lease::SessionName;
pub use reply::PendingReply;
pub(crate) use telemetry::ChannelRequest;
pub use telemetry::{SampleGap, TelemetryChannel};
pub(crate) use wire::overtaken_error;

/// Duration of a lease that is not renewed. Clients renew every 500 ms, so two renewals may be lost.
pub const LEASE_DURATION: Duration = Duration::from_millis(1500);
/// Longest validity of a command, ms.
const TTL_MAX_MS: f64 = 10_000.0;
/// Characters of a stop's reason that are kept: its record must be written, however they are spelt.
const REASON_MAX: usize = 10_000;
/// Time limit for motors to come to standstill at the end.
const CLOSE_MAX: Duration = Duration::from_secs(12);
/// Time limit for the journal's disk at the end.
const WRITE_MAX: Duration = Duration::from_secs(5);

/// Axes of a bench.
pub(super) const AXES_MAX: usize = 256;

/// Options of a bench.
pub struct BenchOptions {
    /// With which names and profiles.
    pub connector: Connector,
    /// Duration of a lease that is not renewed.
    pub lease_duration: Duration,
    /// Journal of the actions.
    pub journal: Arc<dyn JournalSink>,
    /// Highest epoch of any lease before this bench: a command of an older lease is not taken for one of its own.
    pub last_epoch: u64,
    /// Axes whose stop was pending when the previous server ended, by connection string and number: their stops are
    /// still pending.
    pub inherited_stops: Vec<(String, u32)>,
    /// Ports that may be searched for drives, besides those that the system lists: pseudo-terminals.
    pub search_ports: Vec<String>,
}

impl Default for BenchOptions {
    fn default() -> Self {
        let connector = Connector::default();
        let journal = Arc::new(NullJournal);
        Self {
            connector,
            lease_duration: LEASE_DURATION,
            journal,
            last_epoch: 0,
            inherited_stops: Vec::new(),
            search_ports: Vec::new(),
        }
    }
}

impl std::fmt::Debug for BenchOptions {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { connector, lease_duration, .. } = self;
        f.debug_struct("Options")
            .field("connector", connector)
            .field("lease", lease_duration)
            .finish()
    }
}

/// Links that are open, and their axes. Clones are the same bench.
#[derive(Clone)]
pub struct Bench(Arc<BenchInner>);

struct BenchInner {
    context: Arc<BenchContext>,
    links: Vec<BenchLink>,
    axes: AppendOnlyVec<AxisEntry>,
    /// Axes are taken in by one at a time.
    join_lock: Mutex<()>,
    opened_at: Instant,
    telemetry: Arc<Telemetry>,
    traffic: Arc<FrameTraffic>,
    captures: Captures,
    port_search: BenchSearch,
    /// Work of the threads in virtual time that waits for nothing, and work that may wait.
    non_blocking: Mutex<NonBlockingWorkers>,
    blocking: Mutex<BlockingWorkers>,
    /// Event listeners in virtual time; more are added with each drive.
    event_listeners: Mutex<Vec<DriveEventListener>>,
    threads: Mutex<Vec<JoinHandle<()>>>,
    /// Thread that writes the journal; it ends last.
    journal_thread: Mutex<Option<JoinHandle<()>>>,
}

/// Workers of a bench in virtual time that wait for no drive.
#[derive(Default)]
struct NonBlockingWorkers {
    command_workers: Vec<Arc<Mutex<CommandWorker>>>,
    journal_writer: Option<JournalWriter>,
}

/// Workers that send requests, and so let virtual time pass themselves.
#[derive(Default)]
struct BlockingWorkers {
    pollers: Vec<AxisPoller>,
    traffic_decoder: Option<TrafficDecoder>,
}

/// Link and wire of an axis.
struct AxisEntry {
    link: usize,
    local_index: usize,
    info: AxisInfo,
    drive: Option<simulated_drive::SimulatedDrive>,
}

impl std::fmt::Debug for Bench {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (links, axes) = (self.0.links.len(), self.0.axes.len());
        write!(f, "Bench of {links} links and {axes} axes")
    }
}

impl Bench {
    /// Opens every link, and identifies its drives. Without any, a simulated rack: one drive of each
    /// family, each on a link of its own.
    ///
    /// Links in virtual time (`time=virtual`) have no threads: [`advance_time`](Self::advance_time) does it all.
    ///
    /// # Errors
    /// As [`polepair::connect_local()`]; `gateway.request` when only some links are in virtual time.
    pub fn open(urls: &[String], options: BenchOptions) -> Result<Self, GatewayError> {
        let traffic = Arc::new(FrameTraffic::default());
        let OpenedBench { links, roots, axes, clock, failed } =
            open::open_links(urls, &options.connector, &traffic)?;
        let shared = Arc::new(BenchContext::new(clock, &options));
        let connector = options.connector.clone();
        let clock = shared.clock.clone();
        let scribe = JournalWriter::new(Arc::clone(&shared.journal), options.journal, clock);
        let telemetry = Arc::new(Telemetry::new(axes.len()));
        let opened = shared.now();
        for link in &links {
            link.wire.time();
        }
        for (id, error) in &failed {
            links[usize::from(*id)].wire.set_link_error(Some((opened, error.clone())));
        }
        let bench = Self(Arc::new(BenchInner {
            context: shared,
            links,
            axes: AppendOnlyVec::new(AXES_MAX, axes),
            join_lock: Mutex::default(),
            opened_at: opened,
            telemetry,
            traffic,
            captures: Captures::default(),
            port_search: BenchSearch::new(options.connector, options.search_ports),
            non_blocking: Mutex::default(),
            blocking: Mutex::default(),
            event_listeners: Mutex::default(),
            threads: Mutex::default(),
            journal_thread: Mutex::default(),
        }));
        if bench.0.context.clock.is_real() {
            bench.start_threads(roots, scribe)?
        } else {
            bench.set_up_virtual(&roots, scribe)?
        }
        failed
            .into_iter()
            .try_for_each(|(id, error)| bench.spawn_link_opener(id, error, &connector))?;
        (0..bench.0.links.len())
            .filter(|n| !bench.0.links[*n].absent().is_empty())
            .try_for_each(|n| bench.spawn_absent_probe(n))?;
        Ok(bench)
    }

    /// Zero of `…_us`, milliseconds since 1970.
    #[must_use]
    pub fn t0_ms(&self) -> f64 {
        BenchClock::wall_ms(self.0.opened_at)
    }

    /// Now, in milliseconds since 1970.
    #[must_use]
    pub fn now_ms(&self) -> f64 {
        BenchClock::wall_ms(self.0.context.now())
    }

    /// Duration of a lease that is not renewed.
    #[must_use]
    pub fn lease_duration(&self) -> Duration {
        self.0.context.lease_duration
    }

    /// Subscribes to later events. A slow receiver loses the oldest.
    #[must_use]
    pub fn subscribe_events(&self) -> broadcast::Receiver<BenchEvent> {
        self.0.context.events.subscribe()
    }

    /// Description of links and axes. The caller fills in the scopes.
    #[must_use]
    pub fn snapshot(&self) -> BenchView {
        let BenchInner { links, axes, context, .. } = &*self.0;
        let lock = context.current_lock().clone();
        BenchView {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            server_ms: BenchClock::wall_ms(context.now()),
            scopes: Vec::new(),
            links: links.iter().map(|link| self.link_view(link)).collect(),
            axes: axes.iter().map(|entry| self.with_pushed_signals(&entry.info)).collect(),
            clashes: links.iter().filter_map(BenchLink::clash).collect(),
            looks: links.iter().filter_map(|link| link.scan.last_view()).collect(),
            search: self.0.port_search.last_view(),
            lock,
            time_scale: open::time_scale(links),
        }
    }

    /// Description of an axis, with the signals that its drive was seen to send.
    fn with_pushed_signals(&self, info: &AxisInfo) -> AxisInfo {
        let mut info = info.clone();
        for signal_info in &mut info.signals {
            let signal = Signal::from_name(&signal_info.signal);
            signal_info.pushed =
                signal.is_some_and(|signal| self.0.telemetry.is_pushed(info.id, signal));
        }
        info
    }

    /// Last known state of an axis; nothing is sent.
    ///
    /// # Errors
    /// `E212` where there is none.
    pub fn axis_state(&self, id: u16) -> Result<AxisState, GatewayError> {
        let (link, index) = self.find_axis(id)?;
        let lease = link.wire.lease(index);
        let panel = self.0.axes[usize::from(id)]
            .drive
            .as_ref()
            .and_then(simulated_drive::SimulatedDrive::panel);
        let pending = link.wire.pending_stop(index);
        Ok(AxisState {
            lease,
            pending_stop: pending,
            panel,
            ..state::axis_state(id, &link.wire.axes[index].1)
        })
    }

    /// Takes, keeps or gives back the lease of an axis. `None` when it was given back.
    pub fn request_lease(
        &self,
        axis: u16,
        session: &SessionName,
        act: LeaseAction,
        epoch: u64,
    ) -> PendingReply<Option<LeaseGrant>> {
        let (reply_sender, receiver) = oneshot::channel();
        let result = self.find_axis(axis).and_then(|(link, index)| {
            let session = session.clone();
            let request =
                LeaseRequest { axis: index, session, action: act, epoch, reply: reply_sender };
            link.wire.submit(WireRequest::Lease(request))
        });
        PendingReply::from_receiver(receiver, result)
    }

    /// Ends every lease of a session: its client is gone.
    pub fn end_session(&self, session: &SessionName) {
        for link in &self.0.links {
            // With such a queue the lease ends by itself before its turn comes.
            let _ = link.wire.submit(WireRequest::SessionEnded(session.clone()));
        }
    }

    /// Stops axes, also those that other clients command: their leases end. Without names all axes are stopped, and
    /// motion is locked until it is [released](Self::release).
    ///
    /// The reply comes when all axes are at standstill, or at the time limit, with the result of each stop; until then
    /// [`BenchEvent::Stopped`] reports them.
    pub fn stop(&self, session: &SessionName, request: &StopRequest) -> PendingReply<StopReport> {
        let since = self.0.context.now();
        let reason: String = request.reason.chars().take(REASON_MAX).collect();
        if request.axes.is_none() {
            self.0.links.iter().for_each(|link| link.wire.scan_flag.cancel());
            let (by, at_ms) = (session.to_string(), BenchClock::wall_ms(since));
            let lock = MotionLock { by, at_ms, reason: reason.clone() };
            self.0.context.lock_motion(lock);
        }
        let mut axes: Vec<u16> =
            request.axes.clone().unwrap_or_else(|| (0..self.0.axes.len() as u16).collect());
        // One that is not there keeps no other from being stopped.
        axes.retain(|id| usize::from(*id) < self.0.axes.len());
        // Named twice, it is stopped once.
        axes.sort_unstable();
        axes.dedup();
        let mut refused = self.refused_targets(request);
        if axes.is_empty() && request.axes.is_some() && !refused.is_empty() {
            return PendingReply::ready(Err(refused.swap_remove(0)));
        }
        let unreached = if request.axes.is_none() { self.unreached() } else { Vec::new() };
        let (report, reply) = StopCollector::for_axes(&axes, unreached, refused);
        for (n, link) in self.0.links.iter().enumerate() {
            let its = axes.iter().map(|id| &self.0.axes[usize::from(*id)]);
            let axes: Vec<_> = its.filter(|s| s.link == n).map(|s| (s.local_index, 0)).collect();
            if !axes.is_empty() {
                let (who, reason) = (session.clone(), reason.clone());
                let report = Some(Arc::clone(&report));
                link.wire.submit_stop(StopBatch {
                    axes,
                    session: who,
                    reason,
                    requested_at: since,
                    collector: report,
                });
            }
        }
        // Every worker is woken by now: none waits for the bytes of another wire.
        self.0.links.iter().for_each(|link| link.wire.send_stops());
        PendingReply::from_receiver(reply, Ok(()))
    }

    /// Parts of a stop request that cannot be executed.
    #[must_use]
    pub fn refused_targets(&self, request: &StopRequest) -> Vec<GatewayError> {
        let axes = request.axes.iter().flatten();
        let absent = axes
            .filter(|id| usize::from(**id) >= self.0.axes.len())
            .map(|id| GatewayError::new("gateway.missing", format!("axis {id} does not exist")));
        let unreadable = request.unreadable.iter().map(|what| {
            GatewayError::new("gateway.missing", format!("{what} is unknown in a stop"))
                .hint("`axes` is a list of axis indices; without it everything is stopped")
        });
        absent.chain(unreadable).collect()
    }

    /// Clears the pending stop of an axis without measured standstill. The journal keeps the session and the reason.
    /// Executed also without a pending stop.
    ///
    /// The reply is `gateway.lease` if the client that takes it over does not hold its lease.
    pub fn dismiss(
        &self,
        axis: u16,
        session: &SessionName,
        dismiss: DismissStop,
    ) -> PendingReply<()> {
        let (reply_sender, receiver) = oneshot::channel();
        let result = self.find_axis(axis).and_then(|(link, index)| {
            let note = dismiss.note.chars().take(REASON_MAX).collect();
            let (session, dismiss) = (session.clone(), DismissStop { note, ..dismiss });
            link.wire.submit(WireRequest::Dismiss(DismissRequest {
                axis: index,
                session,
                dismiss,
                reply: reply_sender,
            }))
        });
        PendingReply::from_receiver(receiver, result)
    }

    /// Number of stops of everything so far, for [`release`](Self::release).
    #[must_use]
    pub fn lock_count(&self) -> u64 {
        self.0.context.lock_count()
    }

    /// Allows motion again after a stop of everything. `locks` is the number of such stops that the client knows of: a
    /// later one stays in force.
    ///
    /// The reply is `gateway.expired` when everything was stopped since.
    pub fn release(&self, session: &SessionName, locks: u64) -> PendingReply<()> {
        if self.0.context.lock_count() != locks {
            return PendingReply::ready(Err(overtaken_error()));
        }
        let shared = Arc::clone(&self.0.context);
        let subject = ActionSubject::new(session, JournalAction::Release, None);
        self.run_after_journal(subject, json!({}), move || {
            if shared.unlock_motion(locks) { Ok(()) } else { Err(overtaken_error()) }
        })
    }

    /// Does something to a simulated drive: the axis of that place among those of its link.
    ///
    /// The reply is `E212` where there is no such link or axis, `gateway.simulated` where it is a real
    /// one, `gateway.request` for what cannot be done to it.
    pub fn apply_action(
        &self,
        session: &SessionName,
        link: u16,
        drive: u16,
        act: &SimulationAction,
    ) -> PendingReply<()> {
        let position = (usize::from(link), usize::from(drive));
        let entry = self.0.axes.iter().find(|entry| (entry.link, entry.local_index) == position);
        let Some(entry) = entry else {
            let what = format!("link {link} of the bench has no axis {drive}");
            let hint = "both count from 0, in the order of the bench's list";
            return PendingReply::ready(Err(GatewayError::new("E212", what).hint(hint)));
        };
        let Some(simulated) = entry.drive.clone() else {
            return PendingReply::ready(Err(simulated_drive::not_simulated_error()));
        };
        let (detail, act) = (json!({ "act": act.act, "value": act.value }), act.clone());
        let subject = ActionSubject::new(session, JournalAction::Simulation, Some(entry.info.id));
        self.run_after_journal(subject, detail, move || simulated.apply_action(&act.act, act.value))
    }

    /// True state of a simulated motor, independent of the reports of its drive.
    #[must_use]
    pub fn truth(&self, axis: u16) -> Option<GroundTruth> {
        self.0.axes.get(usize::from(axis))?.drive.as_ref()?.truth()
    }

    /// Sets how many times faster than real motors the simulated ones live.
    ///
    /// The reply is `gateway.simulated` where none is simulated, `gateway.request` for a scale that is
    /// none.
    pub fn set_time_scale(&self, session: &SessionName, pace: SetTimeScale) -> PendingReply<()> {
        if open::time_scale(&self.0.links).is_none() {
            return PendingReply::ready(Err(simulated_drive::not_simulated_error()));
        }
        let detail = json!({ "time_scale": pace.time_scale });
        let set = open::set_time_scale(&self.0.links, pace.time_scale);
        let shared = Arc::clone(&self.0.context);
        let subject = ActionSubject::new(session, JournalAction::Simulation, None);
        self.run_after_journal(subject, detail, move || {
            set()?;
            shared.publish(BenchEvent::BenchChanged);
            Ok(())
        })
    }

    /// The simulation of a link, where it is simulated.
    #[must_use]
    pub fn simulation(&self, link: u16) -> Option<Simulation> {
        let link = self.0.links.get(usize::from(link))?;
        link.simulation().map(|(simulation, _)| simulation.clone())
    }

    /// Runs the work of workers and event listeners in virtual time, without waiting. For callers that let time pass in
    /// a link of their own during a request: the threads of a bench in real time do not wait for each other either.
    /// [`advance_time`](Self::advance_time) does this, too.
    pub fn run_non_blocking(&self) {
        lock_unpoisoned(&self.0.non_blocking).run_once();
        lock_unpoisoned(&self.0.event_listeners)
            .iter_mut()
            .for_each(DriveEventListener::poll_events);
    }

    /// Lets time pass: in virtual time everything that is due meanwhile is done, else it sleeps.
    pub fn advance_time(&self, span: Duration) {
        let BenchClock::Virtual(_) = &self.0.context.clock else {
            return polepair_link::clock::sleep_until(polepair_link::clock::now() + span);
        };
        let end = self.0.context.now() + span;
        loop {
            self.0.links.iter().for_each(|link| while link.request_worker.run_next() {});
            lock_unpoisoned(&self.0.non_blocking).run_once();
            lock_unpoisoned(&self.0.blocking).run_once();
            lock_unpoisoned(&self.0.event_listeners)
                .iter_mut()
                .for_each(DriveEventListener::poll_events);
            let left = end.since(self.0.context.now()).min(STEP);
            if left.is_zero() {
                return;
            }
            open::advance_time(&self.0.links, left);
        }
    }

    /// Stops all moving axes, and ends. Commands are refused from now on; the journal is still written, until it is
    /// [closed](Self::close_journal). Returns the axes without measured standstill after 10 s: their stops stay
    /// pending, and their supply is to be cut.
    pub fn shutdown(&self) -> Vec<String> {
        self.0.context.close();
        self.0.links.iter().for_each(|link| link.wire.wake_worker());
        if !self.0.context.clock.is_real() {
            let end = self.0.context.now() + CLOSE_MAX;
            while self.0.context.now() < end
                && !lock_unpoisoned(&self.0.non_blocking)
                    .command_workers
                    .iter()
                    .all(|worker| lock_unpoisoned(worker).is_over())
            {
                self.advance_time(STEP);
            }
            lock_unpoisoned(&self.0.non_blocking)
                .command_workers
                .iter()
                .for_each(|worker| lock_unpoisoned(worker).abandon_pending_stops());
        }
        let threads = std::mem::take(&mut *lock_unpoisoned(&self.0.threads));
        let own = std::thread::current().id();
        threads.into_iter().filter(|thread| thread.thread().id() != own).for_each(|thread| {
            // One that panicked is over as well.
            let _ = thread.join();
        });
        self.0.links.iter().for_each(|link| self.close_link(link));
        self.0.context.drain_not_standing()
    }

    /// Has all that was noted written, and ends the journal. Waits for its disk, but not for ever.
    ///
    /// # Errors
    /// `gateway.journal` when the disk takes nothing: what waits is lost.
    pub fn close_journal(&self) -> Result<(), GatewayError> {
        self.0.context.journal.close();
        if let Some(mut scribe) = lock_unpoisoned(&self.0.non_blocking).journal_writer.take() {
            scribe.write_queued();
        }
        let Some(scribe) = lock_unpoisoned(&self.0.journal_thread).take() else { return Ok(()) };
        let end = polepair_link::clock::now() + WRITE_MAX;
        while !scribe.is_finished() {
            if polepair_link::clock::now() >= end {
                return Err(journal_queue::stalled_error());
            }
            polepair_link::clock::sleep_until(polepair_link::clock::now() + STEP);
        }
        // One that panicked is over as well.
        let _ = scribe.join();
        Ok(())
    }

    fn find_axis(&self, id: u16) -> Result<(&BenchLink, usize), GatewayError> {
        let entry = self.0.axes.get(usize::from(id)).ok_or_else(|| {
            GatewayError::new("E212", format!("the bench has no axis {id}"))
                .hint("axes count from 0, in the order of the bench's list")
        })?;
        Ok((&self.0.links[entry.link], entry.local_index))
    }
}

impl NonBlockingWorkers {
    /// Processes the requests that are due.
    fn run_once(&mut self) {
        // Journal entries are written before the workers run, and their outcomes after.
        self.journal_writer.iter_mut().for_each(JournalWriter::write_queued);
        for worker in &self.command_workers {
            lock_unpoisoned(worker).run_once();
        }
        self.journal_writer.iter_mut().for_each(JournalWriter::write_queued);
    }
}

impl BlockingWorkers {
    /// Sends the queries that are due.
    fn run_once(&mut self) {
        for axis_poller in &mut self.pollers {
            axis_poller.poll_subscribed();
            axis_poller.scan_next();
        }
        self.traffic_decoder.iter_mut().for_each(|reader| reader.decode_tapped(Duration::ZERO));
    }
}

impl Drop for BenchInner {
    fn drop(&mut self) {
        // Threads hold their data, and end by themselves once all moving axes were stopped.
        self.context.close();
        self.links.iter().for_each(|link| link.wire.wake_worker());
    }
}

/// Parses the words of a command.
fn parse_action(request: &CommandRequest) -> Result<CommandAction, GatewayError> {
    let a = &request.arguments;
    let given = [a.target, a.velocity, a.acceleration, a.deceleration, a.torque, a.jerk_time];
    let all = given.into_iter().chain([a.period, a.path]);
    if all.flatten().any(|value| !value.is_finite()) {
        return Err(GatewayError::new("gateway.request", "arguments are finite numbers"));
    }
    match &*request.verb {
        describe::ARM => return Ok(CommandAction::Arm(true)),
        describe::DISARM => return Ok(CommandAction::Arm(false)),
        _ => {}
    }
    let mut offered = Verb::ALL.into_iter().filter(|verb| describe::is_offered(*verb));
    let verb = offered.find(|verb| verb.name() == request.verb).ok_or_else(|| {
        GatewayError::new("gateway.request", format!("`{}` is not a command", request.verb))
            .hint("the list of axes has the commands of each")
    })?;
    Ok(CommandAction::Run(Command {
        verb,
        target: a.target,
        velocity: a.velocity,
        acceleration: a.acceleration,
        deceleration: a.deceleration,
        torque: a.torque,
        jerk_time: a.jerk_time,
        period: a.period,
        path: a.path,
        limit_ms: None,
        raw: false,
        keep_program: false,
    }))
}

impl BenchLink {
    fn clash(&self) -> Option<Clash> {
        self.wire.clash().map(|message| Clash { link: self.id, message })
    }
}
