//! A wire that fails: it stands between a bench and the host's end of a simulated wire.
//!
//! Why: SWARM-4.

use std::borrow::{Borrow, BorrowMut};
use std::cell::RefCell;
use std::collections::VecDeque;
use std::rc::Rc;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use polepair::wire::AnyLink;
use polepair_core::medium::{Can, Frame, Medium, Stream};
use polepair_core::time::Instant;
use polepair_link::error::Cause;
use polepair_link::{Link, LinkError, Losses, Received, Waker};

/// While somebody waits for a drive, everything else goes on so often, ns.
const SLICE_NS: u64 = 1_000_000;
/// Units that are thrown away when a link is opened again.
const STALE_MAX: usize = 4096;

/// How a wire is.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Condition {
    /// What is sent arrives.
    Well,
    /// The port is gone, or nobody listens there.
    Gone,
    /// The port opens, and is lost again after so many ms.
    Drops(u32),
    /// The port stays open, and what is said does not arrive.
    Silent {
        /// What the host says.
        to_drives: bool,
        /// What drives say.
        to_host: bool,
    },
    /// What is said takes so many ms longer each way.
    Slow(u32),
}

impl std::fmt::Display for Condition {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Well => f.write_str("well"),
            Self::Gone => f.write_str("gone, and refused when opened"),
            Self::Drops(ms) => write!(f, "opens, and is dropped after {ms} ms"),
            Self::Silent { to_drives: true, to_host: true } => f.write_str("silent both ways"),
            Self::Silent { to_drives: true, .. } => f.write_str("silent towards drives"),
            Self::Silent { .. } => f.write_str("silent towards the host"),
            Self::Slow(ms) => write!(f, "slow, {ms} ms each way"),
        }
    }
}

/// What became of a unit.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Fate {
    /// It went on.
    Passed,
    /// It goes on later.
    Delayed,
    /// It was lost on the way.
    Lost,
    /// It never left: the port was gone.
    NotSent,
}

/// A unit that a host sent, or was to hear.
#[derive(Clone, Debug)]
pub struct Seen {
    /// When.
    pub at: Instant,
    /// From the host to drives, or the other way.
    pub to_drives: bool,
    /// Its bytes, those of a frame with its identifier before them.
    pub bytes: Vec<u8>,
    /// What became of it.
    pub fate: Fate,
}

/// A wire, whatever it carries.
pub trait AnyPort: Send + Sync {
    /// How it is.
    fn condition(&self) -> Condition;
    /// Since when it is well and stays so; `None` while it is not.
    fn well_since(&self) -> Option<Instant>;
    /// Changes it.
    fn set(&self, condition: Condition);
    /// Sends on what was delayed for long enough.
    fn flush(&self);
    /// How often its link was lost, how often opened again, how many units left the host.
    fn counts(&self) -> Counts;
    /// What passed since this was last called.
    fn take_seen(&self) -> Vec<Seen>;
}

/// What happened to a wire.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct Counts {
    /// Links lost.
    pub lost: u64,
    /// Links opened again.
    pub opened: u64,
    /// Attempts to open it that were refused.
    pub refused: u64,
    /// Units that left the host.
    pub sent: u64,
    /// Units lost on the way, both ways.
    pub missing: u64,
}

/// A medium whose units can be kept.
pub trait Kept: Medium<Unit: ToOwned<Owned: Send>> {
    /// Writes a unit where a link's reader wants it. Tells its length there.
    fn put(unit: &Self::Unit, out: &mut Self::Out) -> usize;
    /// Its bytes, for people and for the history.
    fn bytes(unit: &Self::Unit) -> Vec<u8>;
}

impl Kept for Stream {
    fn put(unit: &[u8], out: &mut [u8]) -> usize {
        let len = unit.len().min(out.len());
        out[..len].copy_from_slice(&unit[..len]);
        len
    }

    fn bytes(unit: &[u8]) -> Vec<u8> {
        unit.to_vec()
    }
}

impl Kept for Can {
    fn put(unit: &Frame, out: &mut Frame) -> usize {
        *out = *unit;
        1
    }

    fn bytes(unit: &Frame) -> Vec<u8> {
        format!("{unit}").into_bytes()
    }
}

type Owned<M> = <<M as Medium>::Unit as ToOwned>::Owned;

/// A wire of one medium.
struct Port<M: Kept> {
    inner: Box<dyn Link<M>>,
    inside: Mutex<Inside<M>>,
}

struct Inside<M: Kept> {
    condition: Condition,
    since: Instant,
    /// Links that were opened before the port was last lost are dead.
    generation: u64,
    opened: Instant,
    to_drives: VecDeque<(Instant, Owned<M>)>,
    to_host: VecDeque<(Instant, Owned<M>)>,
    counts: Counts,
    seen: Vec<Seen>,
}

impl<M: Kept> Inside<M> {
    fn lose(&mut self) {
        self.generation += 1;
        self.counts.lost += 1;
        self.to_drives.clear();
        self.to_host.clear();
    }

    fn note(&mut self, at: Instant, to_drives: bool, unit: &M::Unit, fate: Fate) {
        self.counts.missing += u64::from(fate == Fate::Lost);
        self.counts.sent += u64::from(to_drives && fate != Fate::NotSent);
        self.seen.push(Seen { at, to_drives, bytes: M::bytes(unit), fate });
    }

    /// Whether a link of that generation is lost by now.
    fn is_lost(&mut self, generation: u64, now: Instant) -> bool {
        if let Condition::Drops(ms) = self.condition
            && generation == self.generation
            && now >= self.opened.plus_ms(ms)
        {
            self.lose();
        }
        generation != self.generation
    }
}

impl<M: Kept> Port<M> {
    fn lock(&self) -> MutexGuard<'_, Inside<M>> {
        self.inside.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Units that arrived and that nobody is to hear any more.
    fn drain(&self) {
        let mut buffer = M::buffer();
        for _ in 0..STALE_MAX {
            match self.inner.receive(buffer.borrow_mut(), Instant::ZERO) {
                Ok(Received::TimedOut | Received::Woken) | Err(_) => break,
                Ok(_) => {}
            }
        }
    }
}

impl<M: Kept> AnyPort for Port<M> {
    fn condition(&self) -> Condition {
        self.lock().condition
    }

    fn well_since(&self) -> Option<Instant> {
        let inside = self.lock();
        let empty = inside.to_drives.is_empty() && inside.to_host.is_empty();
        (inside.condition == Condition::Well && empty).then_some(inside.since)
    }

    fn set(&self, condition: Condition) {
        let now = self.inner.now();
        let mut inside = self.lock();
        inside.condition = condition;
        inside.since = now;
        match condition {
            Condition::Gone => inside.lose(),
            // The link that is open now is dropped so long after this began.
            Condition::Drops(_) => inside.opened = now,
            _ => {}
        }
        let waker = self.inner.waker();
        drop(inside);
        waker.wake();
    }

    fn flush(&self) {
        let now = self.inner.now();
        let mut inside = self.lock();
        while inside.to_drives.front().is_some_and(|(due, _)| *due <= now) {
            if let Some((_, unit)) = inside.to_drives.pop_front() {
                // A simulated wire takes all.
                let _ = self.inner.send(unit.borrow());
                // What comes behind the last that was slow is well from then on.
                inside.since = inside.since.max(now);
            }
        }
    }

    fn counts(&self) -> Counts {
        self.lock().counts
    }

    fn take_seen(&self) -> Vec<Seen> {
        std::mem::take(&mut self.lock().seen)
    }
}

/// The host's end of a wire that fails, from one opening to the next.
struct Faulty<M: Kept> {
    port: Arc<Port<M>>,
    generation: u64,
}

impl<M: Kept> Faulty<M> {
    fn gone(&self) -> LinkError {
        LinkError::gone(&self.port.inner.describe())
    }
}

impl<M: Kept> Link<M> for Faulty<M> {
    fn now(&self) -> Instant {
        self.port.inner.now()
    }

    fn send(&self, unit: &M::Unit) -> Result<(), LinkError> {
        let now = self.now();
        let mut inside = self.port.lock();
        if inside.is_lost(self.generation, now) {
            inside.note(now, true, unit, Fate::NotSent);
            return Err(self.gone());
        }
        let last = inside.to_drives.back().map(|(due, _)| *due);
        let due = match inside.condition {
            Condition::Silent { to_drives: true, .. } => {
                inside.note(now, true, unit, Fate::Lost);
                return Ok(());
            }
            Condition::Slow(ms) => Some(now.plus_ms(ms)).max(last),
            _ => last,
        };
        let Some(due) = due else {
            inside.note(now, true, unit, Fate::Passed);
            drop(inside);
            return self.port.inner.send(unit);
        };
        inside.note(now, true, unit, Fate::Delayed);
        inside.to_drives.push_back((due, unit.to_owned()));
        Ok(())
    }

    fn receive(&self, buffer: &mut M::Out, until: Instant) -> Result<Received, LinkError> {
        loop {
            let now = self.now();
            {
                let mut inside = self.port.lock();
                if inside.is_lost(self.generation, now) {
                    return Err(self.gone());
                }
                if inside.to_host.front().is_some_and(|(due, _)| *due <= now)
                    && let Some((at, unit)) = inside.to_host.pop_front()
                {
                    inside.since = inside.since.max(now);
                    return Ok(Received::Bytes { len: M::put(unit.borrow(), buffer), at });
                }
            }
            // Who waits lets time pass in slices, so that others have their turn.
            let slice = if until <= now { until } else { until.min(now.plus_ns(SLICE_NS)) };
            match self.port.inner.receive(buffer, slice)? {
                Received::Bytes { len, at } => {
                    let mut inside = self.port.lock();
                    let unit = M::unit(buffer, len);
                    let last = inside.to_host.back().map(|(due, _)| *due);
                    let due = match inside.condition {
                        Condition::Silent { to_host: true, .. } => {
                            inside.note(at, false, unit, Fate::Lost);
                            continue;
                        }
                        Condition::Slow(ms) => Some(at.plus_ms(ms)).max(last),
                        _ => last,
                    };
                    let Some(due) = due else {
                        inside.note(at, false, unit, Fate::Passed);
                        return Ok(Received::Bytes { len, at });
                    };
                    inside.note(at, false, unit, Fate::Delayed);
                    inside.to_host.push_back((due, unit.to_owned()));
                }
                Received::TimedOut if self.now() >= until => return Ok(Received::TimedOut),
                Received::TimedOut => {
                    tick();
                    if self.port.inner.waker().taken() {
                        return Ok(Received::Woken);
                    }
                }
                other => return Ok(other),
            }
        }
    }

    fn set_line(&self, line: M::Line) -> Result<(), LinkError> {
        self.port.inner.set_line(line)
    }

    fn waker(&self) -> Waker {
        self.port.inner.waker()
    }

    fn runs_by_itself(&self) -> bool {
        self.port.inner.runs_by_itself()
    }

    fn describe(&self) -> String {
        self.port.inner.describe()
    }

    fn losses(&self) -> Losses {
        self.port.inner.losses()
    }

    fn reopen(&self) -> Result<Box<dyn Link<M>>, LinkError> {
        let now = self.now();
        let mut inside = self.port.lock();
        if inside.condition == Condition::Gone {
            inside.counts.refused += 1;
            return Err(LinkError::new(&self.port.inner.describe(), Cause::Refused));
        }
        inside.counts.opened += 1;
        inside.opened = now;
        let generation = inside.generation;
        drop(inside);
        self.port.drain();
        Ok(Box::new(Self { port: Arc::clone(&self.port), generation }))
    }
}

/// Puts a wire that fails in the place of a link.
pub fn faulty(link: AnyLink) -> (AnyLink, Arc<dyn AnyPort>) {
    fn put<M: Kept>(inner: Box<dyn Link<M>>) -> (Box<dyn Link<M>>, Arc<dyn AnyPort>) {
        let now = inner.now();
        let inside = Inside {
            condition: Condition::Well,
            since: now,
            generation: 0,
            opened: now,
            to_drives: VecDeque::new(),
            to_host: VecDeque::new(),
            counts: Counts::default(),
            seen: Vec::new(),
        };
        let port = Arc::new(Port { inner, inside: Mutex::new(inside) });
        (Box::new(Faulty { port: Arc::clone(&port), generation: 0 }), port)
    }
    match link {
        AnyLink::Serial(link) => {
            let (link, port) = put(link);
            (AnyLink::Serial(link), port)
        }
        AnyLink::Can(link) => {
            let (link, port) = put(link);
            (AnyLink::Can(link), port)
        }
    }
}

thread_local! {
    static TICK: RefCell<Option<Rc<dyn Fn()>>> = const { RefCell::new(None) };
}

/// What goes on while somebody waits for a drive. `None` ends it.
pub fn set_tick(tick: Option<Rc<dyn Fn()>>) {
    TICK.with(|slot| *slot.borrow_mut() = tick);
}

fn tick() {
    let tick = TICK.with(|slot| slot.borrow().clone());
    tick.iter().for_each(|tick| tick());
}
