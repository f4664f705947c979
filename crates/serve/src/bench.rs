//! The bench: it opens links, owns them, and lets several people watch and one command each axis.
//! There is no HTTP in here.
//!
//! Each wire has a hand, which alone lets through what moves and waits for nothing, and a desk, which
//! asks what has to be waited for. So a stop never waits behind a question, nor one link behind
//! another.
//!
//! ```
//! use polepair_serve::bench::{Bench, Options};
//! use polepair_serve::message::LeaseAct;
//! use std::time::Duration;
//! # if polepair_core::drives::profiles().iter().any(|p| p.protocol == "tmcl") {
//! let bench = Bench::open(&["sim:tmcl?time=virtual".into()], Options::default())?;
//! let mut lease = bench.lease(0, &"ann".into(), LeaseAct::Take, 0);
//! bench.pass(Duration::from_millis(1));
//! let lease = lease.take().expect("a hand answers at once")?.expect("it is given");
//! assert_eq!(bench.axis(0)?.lease.expect("ann has it").epoch, lease.epoch);
//! # }
//! # Ok::<(), polepair_serve::message::Refused>(())
//! ```

mod absent;
mod asked;
mod captures;
mod clash;
mod clock;
mod describe;
mod desk;
mod ears;
mod explained;
mod eyes;
mod frames;
mod grown;
mod hand;
mod later;
mod lease;
mod look;
mod notes;
mod once;
mod open;
mod owed;
mod parameters;
mod reply;
mod shared;
mod simulated;
mod state;
mod telemetry;
mod threads;
mod watchdog;
mod wire;

use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::Duration;

use polepair::Connector;
use polepair::simulate::Simulation;
use polepair_core::axis::{Command, Verb};
use polepair_core::drives::bench::Truth;
use polepair_core::profile::Signal;
use polepair_core::time::Instant;
use serde_json::json;
use tokio::sync::{broadcast, oneshot};

use crate::message::{
    Act, AxisInfo, AxisState, BenchView, Clash, CommandOrder, Deed, DismissStop, LeaseAct,
    LeaseGranted, LockTold, Outcome, Pace, RawOrder, Refused, StopOrder, Stopped,
};
use captures::Captures;
use clock::{Clock, STEP};
use ears::Ears;
use eyes::Eyes;
use frames::{Reader, Traffic};
use grown::Grown;
use hand::{Hand, outcome};
use notes::Scribe;
use once::First;
use open::{Link, Opened};
use owed::Report;
use shared::{Shared, held};
use telemetry::Telemetry;
use wire::{AskLease, Commanded, Dismiss, Do, Order, StopThese, Told, Wire};

pub use captures::CAPTURE_MAX;
pub use frames::Frames;
pub use lease::Session;
pub use reply::Reply;
pub use shared::{Event, Journal, NoJournal, Note};
pub(crate) use telemetry::Wish;
pub use telemetry::{Channel, Gap};
pub(crate) use wire::overtaken;

/// How long a lease lasts that is not renewed.
pub const LEASE: Duration = Duration::from_millis(1500);
/// How long a command may be good for, ms.
const TTL_MAX_MS: f64 = 10_000.0;
/// Characters of a stop's reason that are kept: its record must be written, however they are spelt.
const REASON_MAX: usize = 10_000;
/// How long closing waits for motors to come to rest.
const CLOSE_MAX: Duration = Duration::from_secs(12);
/// How long it waits for the journal's disk.
const WRITE_MAX: Duration = Duration::from_secs(5);

/// How a bench is opened.
pub struct Options {
    /// With which names and profiles.
    pub connector: Connector,
    /// How long a lease lasts that is not renewed.
    pub lease: Duration,
    /// Who is told what is done.
    pub journal: Arc<dyn Journal>,
    /// No lease before this bench had a higher epoch: what was said under one is not taken for its own.
    pub last_epoch: u64,
    /// Axes that the server before this one owed a stop when it ended, by connection string and number:
    /// they are owed it still.
    pub owed_before: Vec<(String, u32)>,
}

impl Default for Options {
    fn default() -> Self {
        let connector = Connector::default();
        let journal = Arc::new(NoJournal);
        Self { connector, lease: LEASE, journal, last_epoch: 0, owed_before: Vec::new() }
    }
}

impl std::fmt::Debug for Options {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { connector, lease, .. } = self;
        f.debug_struct("Options").field("connector", connector).field("lease", lease).finish()
    }
}

/// Links that are open, and their axes. Clones are the same bench.
#[derive(Clone)]
pub struct Bench(Arc<Inner>);

struct Inner {
    shared: Arc<Shared>,
    links: Vec<Link>,
    axes: Grown<Seat>,
    /// Axes are taken in by one at a time.
    growing: Mutex<()>,
    opened: Instant,
    telemetry: Arc<Telemetry>,
    traffic: Arc<Traffic>,
    captures: Captures,
    /// In virtual time, what threads do otherwise: those that wait for nothing, and those that may.
    by_hand: Mutex<ByHand>,
    waiting: Mutex<Waiting>,
    /// The same of those that hear; there are more whenever drives are taken in.
    ears: Mutex<Vec<Ears>>,
    threads: Mutex<Vec<JoinHandle<()>>>,
    /// What writes the journal; it ends last.
    scribe: Mutex<Option<JoinHandle<()>>>,
}

/// What looks after a bench in virtual time and waits for no drive.
#[derive(Default)]
struct ByHand {
    hands: Vec<Arc<Mutex<Hand>>>,
    scribe: Option<Scribe>,
}

/// What asks drives, and so lets virtual time pass itself.
#[derive(Default)]
struct Waiting {
    eyes: Vec<Eyes>,
    reader: Option<Reader>,
}

/// Where an axis is found.
struct Seat {
    link: usize,
    place: usize,
    info: AxisInfo,
    drive: Option<simulated::Drive>,
}

impl std::fmt::Debug for Bench {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (links, axes) = (self.0.links.len(), self.0.axes.len());
        write!(f, "Bench of {links} links and {axes} axes")
    }
}

impl Bench {
    /// Opens every link, and finds out what is on it. Without any, a simulated rack: one drive of each
    /// family, each on a link of its own.
    ///
    /// Links in virtual time (`time=virtual`) have no threads: [`pass`](Self::pass) does it all.
    ///
    /// # Errors
    /// As [`polepair::connect()`]; `gateway.request` when only some links are in virtual time.
    pub fn open(urls: &[String], options: Options) -> Result<Self, Refused> {
        let traffic = Arc::new(Traffic::default());
        let Opened { links, roots, axes, clock, dead } =
            open::open(urls, &options.connector, &traffic)?;
        let shared = Arc::new(Shared::new(clock, &options));
        let connector = options.connector.clone();
        let clock = shared.clock.clone();
        let scribe = Scribe::new(Arc::clone(&shared.notes), options.journal, clock);
        let telemetry = Arc::new(Telemetry::new(axes.len()));
        let opened = shared.now();
        for link in &links {
            link.wire.time();
        }
        for (id, error) in &dead {
            links[usize::from(*id)].wire.show_lost(Some((opened, error.clone())));
        }
        let bench = Self(Arc::new(Inner {
            shared,
            links,
            axes: Grown::new(open::AXES_MAX, axes),
            growing: Mutex::default(),
            opened,
            telemetry,
            traffic,
            captures: Captures::default(),
            by_hand: Mutex::default(),
            waiting: Mutex::default(),
            ears: Mutex::default(),
            threads: Mutex::default(),
            scribe: Mutex::default(),
        }));
        match bench.0.shared.clock.is_real() {
            true => bench.start(roots, scribe)?,
            false => bench.look_after(&roots, scribe)?,
        }
        dead.into_iter().try_for_each(|(id, error)| bench.open_later(id, error, &connector))?;
        let absent = |n: &usize| !bench.0.links[*n].absent().is_empty();
        (0..bench.0.links.len()).filter(absent).try_for_each(|n| bench.await_absent(n))?;
        Ok(bench)
    }

    /// When `…_us` began, in milliseconds since 1970.
    #[must_use]
    pub fn t0_ms(&self) -> f64 {
        Clock::ms(self.0.opened)
    }

    /// Now, in milliseconds since 1970.
    #[must_use]
    pub fn now_ms(&self) -> f64 {
        Clock::ms(self.0.shared.now())
    }

    /// How long a lease lasts that is not renewed.
    #[must_use]
    pub fn lease_lasts(&self) -> Duration {
        self.0.shared.lease
    }

    /// Hears what happens from now on. Who listens too slowly loses the oldest.
    #[must_use]
    pub fn events(&self) -> broadcast::Receiver<Event> {
        self.0.shared.events.subscribe()
    }

    /// What there is. Scopes are the caller's to fill in.
    #[must_use]
    pub fn snapshot(&self) -> BenchView {
        let Inner { links, axes, shared, .. } = &*self.0;
        let lock = shared.lock().clone();
        BenchView {
            version: env!("CARGO_PKG_VERSION").to_owned(),
            scopes: Vec::new(),
            links: links.iter().map(|link| self.link_view(link)).collect(),
            axes: axes.iter().map(|seat| self.seen(&seat.info)).collect(),
            clashes: links.iter().filter_map(Link::clash).collect(),
            looks: links.iter().filter_map(|link| link.search.told()).collect(),
            lock,
            time_scale: open::time_scale(links),
        }
    }

    /// What is told of an axis, with what its drive was seen to send.
    fn seen(&self, info: &AxisInfo) -> AxisInfo {
        let mut info = info.clone();
        for told in &mut info.signals {
            let signal = Signal::ALL.into_iter().find(|signal| signal.name() == told.signal);
            told.pushed = signal.is_some_and(|signal| self.0.telemetry.sends(info.id, signal));
        }
        info
    }

    /// What is known of an axis; nothing is asked.
    ///
    /// # Errors
    /// `E212` where there is none.
    pub fn axis(&self, id: u16) -> Result<AxisState, Refused> {
        let (link, place) = self.seat(id)?;
        let lease = link.wire.lease(place);
        let panel = self.0.axes[usize::from(id)].drive.as_ref().and_then(simulated::Drive::panel);
        let owed = link.wire.owed(place);
        Ok(AxisState { lease, owed, panel, ..state::axis_state(id, &link.wire.axes[place].1) })
    }

    /// Takes, keeps or gives back the lease of an axis. `None` when it was given back.
    pub fn lease(
        &self,
        axis: u16,
        session: &Session,
        act: LeaseAct,
        epoch: u64,
    ) -> Reply<Option<LeaseGranted>> {
        let (tell, told) = oneshot::channel();
        let asked = self.seat(axis).and_then(|(link, place)| {
            let session = session.clone();
            let ask = AskLease { axis: place, session, act, epoch, tell };
            link.wire.order(Order::Lease(ask))
        });
        Reply::of(told, asked)
    }

    /// Ends every lease of a session: its client is gone.
    pub fn gone(&self, session: &Session) {
        for link in &self.0.links {
            // Where so much waits, the lease ends by itself before its turn comes.
            let _ = link.wire.order(Order::Gone(session.clone()));
        }
    }

    /// Has an axis do something, once, if the session's lease, the lock, the arming, the limits and the
    /// command's age let it.
    pub fn command(&self, axis: u16, session: &Session, order: CommandOrder) -> Reply<Outcome> {
        let CommandOrder { id, verb, arguments, .. } = &order;
        let detail = json!({ "id": id, "verb": verb, "arguments": arguments });
        let CommandOrder { issued_ms, ttl_ms, epoch, .. } = order;
        let told = Told { id: id.clone(), issued_ms, ttl_ms, epoch };
        self.carry_out(axis, session, told, detail, meant(&order))
    }

    /// Sends a request in the protocol's own text, for which no limits stand: once, under a lease and
    /// while motion is not locked, because it may move the motor.
    pub fn raw(&self, axis: u16, session: &Session, order: RawOrder) -> Reply<Outcome> {
        let RawOrder { id, issued_ms, ttl_ms, epoch, text } = order;
        let detail = json!({ "id": id, "raw": text });
        let told = Told { id, issued_ms, ttl_ms, epoch };
        self.carry_out(axis, session, told, detail, Ok(Do::Say(text)))
    }

    /// Announces a command, and gives the order once that is kept. What ends motion waits for nothing.
    fn carry_out(
        &self,
        axis: u16,
        session: &Session,
        order: Told,
        detail: serde_json::Value,
        deed: Result<Do, Refused>,
    ) -> Reply<Outcome> {
        let id = order.id.clone();
        let refused = |error| Reply::ready(Ok(outcome(id, Some(error))));
        let (wire, place, said) = match self.first(axis, &order) {
            Ok((First::Yes, wire, place, said)) => (Arc::clone(wire), place, said),
            Ok((First::Ended(outcome), ..)) => return Reply::ready(Ok(outcome)),
            Ok((First::UnderWay(told), ..)) => return Reply::of(told, Ok(())),
            Err(error) => return refused(error),
        };
        let (tell, told) = oneshot::channel();
        let (shared, session) = (Arc::clone(&self.0.shared), session.clone());
        let ends_motion = deed.as_ref().is_ok_and(Do::ends_motion);
        let now = shared.now();
        let go = {
            let (shared, session) = (Arc::clone(&shared), session.clone());
            move |kept: Result<(), Refused>| match (kept, deed) {
                (Ok(()), Ok(deed)) => {
                    let prepared = None;
                    let commanded = Commanded { axis: place, session, order, deed, prepared, tell };
                    wire.order_announced(said, Order::Command(Box::new(commanded)));
                }
                (Ok(()), Err(error)) => {
                    let outcome = outcome(order.id, Some(error));
                    shared.ended((&session, axis), outcome, false, tell);
                }
                (Err(error), _) => {
                    // Nothing was sent, and nothing will be: also for whoever says it again.
                    let outcome = outcome(order.id, Some(error));
                    shared.once().ended(&outcome);
                    // Who has gone does not want to know.
                    let _ = tell.send(Ok(outcome));
                }
            }
        };
        let what = (&session, Deed::Command, Some(axis));
        if ends_motion {
            shared.notes.done(what, detail, now, None);
            go(Ok(()));
        } else {
            shared.notes.announce(what, detail, now, Box::new(go));
        }
        Reply::of(told, Ok(()))
    }

    /// Whether a command was seen, and the number that it has on its wire if not.
    fn first(&self, axis: u16, order: &Told) -> Result<(First, &Arc<Wire>, usize, u64), Refused> {
        let (link, place) = self.seat(axis)?;
        let Told { id, issued_ms, ttl_ms, .. } = order;
        if !issued_ms.is_finite() || !(0.0..=TTL_MAX_MS).contains(ttl_ms) {
            let what = format!("a command is good for 0 to {TTL_MAX_MS} ms");
            return Err(Refused::new("gateway.request", what));
        }
        let said = link.wire.announced()?;
        let now = self.0.shared.now();
        // However far ahead its clock is, within what is let through.
        let stale = now + Duration::from_secs_f64((ttl_ms + 1000.0) / 1e3);
        Ok((self.0.shared.once().first(id, stale, now)?, &link.wire, place, said))
    }

    /// Announces what is not for a hand, and does it once that is kept.
    fn announce<T: Send + 'static>(
        &self,
        what: (&Session, Deed, Option<u16>),
        detail: serde_json::Value,
        then: impl FnOnce() -> Result<T, Refused> + Send + 'static,
    ) -> Reply<T> {
        let (tell, told) = oneshot::channel();
        let go = move |kept: Result<(), Refused>| {
            // Who has gone does not want to know.
            let _ = tell.send(kept.and_then(|()| then()));
        };
        let Shared { notes, .. } = &*self.0.shared;
        notes.announce(what, detail, self.0.shared.now(), Box::new(go));
        Reply::of(told, Ok(()))
    }

    /// Has the journal keep what is no matter of links. The reply tells when it does.
    pub fn note(&self, who: &str, deed: Deed, detail: serde_json::Value) -> Reply<()> {
        self.announce((&who.into(), deed, None), detail, || Ok(()))
    }

    /// Stops axes, whoever commands them: their leases end. All of them where none is named, and then
    /// motion is locked until it is [released](Self::release).
    ///
    /// The reply tells, when nothing is left to be seen, how far each stop came; until then
    /// [`Event::Stopped`] does.
    pub fn stop(&self, session: &Session, order: &StopOrder) -> Reply<Stopped> {
        let since = self.0.shared.now();
        let reason: String = order.reason.chars().take(REASON_MAX).collect();
        if order.axes.is_none() {
            self.0.links.iter().for_each(|link| link.wire.looking.break_off());
            let (by, at_ms) = (session.to_string(), Clock::ms(since));
            let lock = LockTold { by, at_ms, reason: reason.clone() };
            self.0.shared.lock_motion(lock);
        }
        let every = || (0..self.0.axes.len() as u16).collect();
        let mut axes: Vec<u16> = order.axes.clone().unwrap_or_else(every);
        // One that is not there keeps no other from being stopped.
        axes.retain(|id| usize::from(*id) < self.0.axes.len());
        // Named twice, it is stopped once.
        axes.sort_unstable();
        axes.dedup();
        let unreached = if order.axes.is_none() { self.unreached() } else { Vec::new() };
        let (report, told) = Report::of(&axes, unreached);
        for (n, link) in self.0.links.iter().enumerate() {
            let its = axes.iter().map(|id| &self.0.axes[usize::from(*id)]);
            let axes: Vec<_> = its.filter(|s| s.link == n).map(|s| (s.place, 0)).collect();
            if !axes.is_empty() {
                let (who, reason) = (session.clone(), reason.clone());
                let report = Some(Arc::clone(&report));
                link.wire.stop(StopThese { axes, who, reason, since, report });
            }
        }
        // Every hand is called by now: none waits for the bytes of another's wire.
        self.0.links.iter().for_each(|link| link.wire.send_stops());
        Reply::of(told, Ok(()))
    }

    /// Owes an axis its stop no more, though nobody saw it stand. The journal keeps who said so, and why.
    /// Done as well where it is owed none.
    ///
    /// The reply is `gateway.lease` when whoever takes it over does not hold its lease.
    pub fn dismiss(&self, axis: u16, session: &Session, dismiss: DismissStop) -> Reply<()> {
        let (tell, told) = oneshot::channel();
        let asked = self.seat(axis).and_then(|(link, place)| {
            let note = dismiss.note.chars().take(REASON_MAX).collect();
            let (session, dismiss) = (session.clone(), DismissStop { note, ..dismiss });
            link.wire.order(Order::Dismiss(Dismiss { axis: place, session, dismiss, tell }))
        });
        Reply::of(told, asked)
    }

    /// How often everything was stopped so far, for [`release`](Self::release).
    #[must_use]
    pub fn locks(&self) -> u64 {
        self.0.shared.locks()
    }

    /// Lets motion again after a stop of everything. `locks` is how often everything had been stopped
    /// when this was said: whoever says it knows of no later stop.
    ///
    /// The reply is `gateway.expired` when everything was stopped since.
    pub fn release(&self, session: &Session, locks: u64) -> Reply<()> {
        if self.0.shared.locks() != locks {
            return Reply::ready(Err(overtaken()));
        }
        let shared = Arc::clone(&self.0.shared);
        self.announce((session, Deed::Release, None), json!({}), move || {
            if shared.unlock_motion(locks) { Ok(()) } else { Err(overtaken()) }
        })
    }

    /// Does something to a simulated drive: the axis of that place among those of its link.
    ///
    /// The reply is `E212` where there is no such link or axis, `gateway.simulated` where it is a real
    /// one, `gateway.request` for what cannot be done to it.
    pub fn act(&self, session: &Session, link: u16, drive: u16, act: &Act) -> Reply<()> {
        let place = (usize::from(link), usize::from(drive));
        let seat = self.0.axes.iter().find(|seat| (seat.link, seat.place) == place);
        let Some(seat) = seat else {
            let what = format!("link {link} of the bench has no axis {drive}");
            let hint = "both count from 0, in the order of the bench's list";
            return Reply::ready(Err(Refused::new("E212", what).hint(hint)));
        };
        let Some(simulated) = seat.drive.clone() else {
            return Reply::ready(Err(not_simulated()));
        };
        let (detail, act) = (json!({ "act": act.act, "value": act.value }), act.clone());
        self.announce((session, Deed::Simulation, Some(seat.info.id)), detail, move || {
            simulated.act(&act.act, act.value)
        })
    }

    /// What is true of a simulated motor, whatever its drive reports.
    #[must_use]
    pub fn truth(&self, axis: u16) -> Option<Truth> {
        self.0.axes.get(usize::from(axis))?.drive.as_ref()?.truth()
    }

    /// Sets how many times faster than real motors the simulated ones live.
    ///
    /// The reply is `gateway.simulated` where none is simulated, `gateway.request` for a scale that is
    /// none.
    pub fn pace(&self, session: &Session, pace: Pace) -> Reply<()> {
        if open::time_scale(&self.0.links).is_none() {
            return Reply::ready(Err(not_simulated()));
        }
        let detail = json!({ "time_scale": pace.time_scale });
        let set = open::set_time_scale(&self.0.links, pace.time_scale);
        let shared = Arc::clone(&self.0.shared);
        self.announce((session, Deed::Simulation, None), detail, move || {
            set()?;
            shared.tell(Event::Bench);
            Ok(())
        })
    }

    /// The simulation of a link, where it is simulated.
    #[must_use]
    pub fn simulation(&self, link: u16) -> Option<Simulation> {
        let link = self.0.links.get(usize::from(link))?;
        link.simulation().map(|(simulation, _)| simulation.clone())
    }

    /// Does in virtual time what hands and ears have to do now, which waits for nothing. For whoever
    /// lets time pass in a link of his own while a question waits for its answer there: the threads of
    /// a bench in real time do not wait for each other either. [`pass`](Self::pass) does this, too.
    pub fn tend(&self) {
        held(&self.0.by_hand).turn();
        held(&self.0.ears).iter_mut().for_each(Ears::turn);
    }

    /// Lets time pass: in virtual time everything that is due meanwhile is done, else it sleeps.
    pub fn pass(&self, span: Duration) {
        let Clock::Virtual(_) = &self.0.shared.clock else {
            return polepair_link::clock::sleep_until(polepair_link::clock::now() + span);
        };
        let end = self.0.shared.now() + span;
        loop {
            self.0.links.iter().for_each(|link| while link.desk.work() {});
            held(&self.0.by_hand).turn();
            held(&self.0.waiting).turn();
            held(&self.0.ears).iter_mut().for_each(Ears::turn);
            let left = end.since(self.0.shared.now()).min(STEP);
            if left.is_zero() {
                return;
            }
            open::pass(&self.0.links, left);
        }
    }

    /// Stops what moves, and ends. Commands are refused from now on; the journal is still kept, until
    /// it is [closed](Self::close_journal). Returns who was not seen standing within 10 s: they are
    /// still owed a stop, and their supply is to be cut.
    pub fn shutdown(&self) -> Vec<String> {
        self.0.shared.close();
        self.0.links.iter().for_each(|link| link.wire.call());
        if !self.0.shared.clock.is_real() {
            let end = self.0.shared.now() + CLOSE_MAX;
            while self.0.shared.now() < end
                && !held(&self.0.by_hand).hands.iter().all(|hand| held(hand).is_over())
            {
                self.pass(STEP);
            }
            held(&self.0.by_hand).hands.iter().for_each(|hand| held(hand).leave());
        }
        let threads = std::mem::take(&mut *held(&self.0.threads));
        let own = std::thread::current().id();
        threads.into_iter().filter(|thread| thread.thread().id() != own).for_each(|thread| {
            // One that panicked is over as well.
            let _ = thread.join();
        });
        self.0.links.iter().for_each(|link| self.leave_link(link));
        self.0.shared.left()
    }

    /// Has all that was noted written, and ends the journal. Waits for its disk, but not for ever.
    ///
    /// # Errors
    /// `gateway.journal` when the disk takes nothing: what waits is lost.
    pub fn close_journal(&self) -> Result<(), Refused> {
        self.0.shared.notes.close();
        if let Some(mut scribe) = held(&self.0.by_hand).scribe.take() {
            scribe.turn();
        }
        let Some(scribe) = held(&self.0.scribe).take() else { return Ok(()) };
        let end = polepair_link::clock::now() + WRITE_MAX;
        while !scribe.is_finished() {
            if polepair_link::clock::now() >= end {
                return Err(notes::stalled());
            }
            polepair_link::clock::sleep_until(polepair_link::clock::now() + STEP);
        }
        // One that panicked is over as well.
        let _ = scribe.join();
        Ok(())
    }

    fn seat(&self, id: u16) -> Result<(&Link, usize), Refused> {
        let seat = self.0.axes.get(usize::from(id)).ok_or_else(|| {
            Refused::new("E212", format!("the bench has no axis {id}"))
                .hint("axes count from 0, in the order of the bench's list")
        })?;
        Ok((&self.0.links[seat.link], seat.place))
    }
}

impl ByHand {
    /// Does what is due.
    fn turn(&mut self) {
        // What is announced is kept before hands look, what they did after.
        self.scribe.iter_mut().for_each(Scribe::turn);
        for hand in &self.hands {
            held(hand).turn();
        }
        self.scribe.iter_mut().for_each(Scribe::turn);
    }
}

impl Waiting {
    /// Asks what is due.
    fn turn(&mut self) {
        for eyes in &mut self.eyes {
            eyes.sample();
            eyes.look();
        }
        self.reader.iter_mut().for_each(|reader| reader.turn(Duration::ZERO));
    }
}

impl Drop for Inner {
    fn drop(&mut self) {
        // Threads hold what they need, and end by themselves once all that moved was told to stop.
        self.shared.close();
        self.links.iter().for_each(|link| link.wire.call());
    }
}

/// What a command's words mean.
fn meant(order: &CommandOrder) -> Result<Do, Refused> {
    let a = &order.arguments;
    let all = [a.target, a.velocity, a.acceleration, a.torque, a.jerk_time, a.period];
    if all.into_iter().flatten().any(|value| !value.is_finite()) {
        return Err(Refused::new("gateway.request", "arguments are finite numbers"));
    }
    match &*order.verb {
        describe::ARM => return Ok(Do::Arm(true)),
        describe::DISARM => return Ok(Do::Arm(false)),
        _ => {}
    }
    let mut offered = Verb::ALL.into_iter().filter(|verb| describe::is_offered(*verb));
    let verb = offered.find(|verb| verb.name() == order.verb).ok_or_else(|| {
        Refused::new("gateway.request", format!("`{}` is nothing to command", order.verb))
            .hint("the bench's list has what each axis can be told")
    })?;
    let [target, velocity, acceleration, torque, jerk_time, period] = all;
    Ok(Do::Run(Command { verb, target, velocity, acceleration, torque, jerk_time, period }))
}

fn not_simulated() -> Refused {
    Refused::new("gateway.simulated", "this is no simulation").hint("only simulated drives can")
}

impl Link {
    fn clash(&self) -> Option<Clash> {
        self.wire.clash().map(|message| Clash { link: self.id, message })
    }
}
