//! A wire that fails, between a bench and the host's end of a simulated wire.
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
use polepair_link::{LinkError, LinkIo, LinkWaker, Losses, Received};

/// Step of the world's time while the bench waits for a drive, ns.
const SLICE_NS: u64 = 1_000_000;
/// Units that are thrown away when a link is opened again.
const STALE_MAX: usize = 4096;

/// Condition of a wire.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum WireCondition {
    /// All units arrive.
    Working,
    /// The port is gone, or no server listens there.
    Gone,
    /// The port opens, and is lost again after this time, ms.
    Drops(u32),
    /// The port stays open, and units are lost.
    Silent {
        /// True if units of the host are lost.
        to_drives: bool,
        /// True if units of drives are lost.
        to_host: bool,
    },
    /// Units take this much longer each way, ms.
    Slow(u32),
    /// CANopen nodes refuse reads of speed and position in their present state.
    Busy,
}

impl std::fmt::Display for WireCondition {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Working => f.write_str("well"),
            Self::Gone => f.write_str("gone, and refused when opened"),
            Self::Drops(ms) => write!(f, "opens, and is dropped after {ms} ms"),
            Self::Silent { to_drives: true, to_host: true } => f.write_str("silent both ways"),
            Self::Silent { to_drives: true, .. } => f.write_str("silent towards drives"),
            Self::Silent { .. } => f.write_str("silent towards the host"),
            Self::Slow(ms) => write!(f, "slow, {ms} ms each way"),
            Self::Busy => f.write_str("of nodes that do not tell where they are"),
        }
    }
}

/// Fate of a unit.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum UnitOutcome {
    /// The unit was forwarded.
    Forwarded,
    /// The unit is forwarded later.
    Delayed,
    /// The unit was lost on the way.
    Lost,
    /// The unit was never sent: the port was gone.
    NotSent,
}

/// A unit that a host sent, or was to hear.
#[derive(Clone, Debug)]
pub struct ObservedUnit {
    /// Time.
    pub at: Instant,
    /// From the host to drives, or the other way.
    pub to_drives: bool,
    /// Bytes of the unit, those of a frame with its identifier before them.
    pub bytes: Vec<u8>,
    /// Fate of the unit.
    pub outcome: UnitOutcome,
}

/// A wire, whatever it carries.
pub trait AnyPort: Send + Sync {
    /// Present condition.
    fn condition(&self) -> WireCondition;
    /// Since when it is well and stays so; `None` while it is not.
    fn working_since(&self) -> Option<Instant>;
    /// Changes it.
    fn set_condition(&self, condition: WireCondition);
    /// Sends bytes of another host; false on a bus, where there is none.
    fn send_foreign(&self, bytes: &[u8]) -> bool;
    /// Sends on what was delayed for long enough.
    fn forward_due(&self);
    /// Numbers of losses and openings of its link, and of sent units.
    fn counts(&self) -> WireCounts;
    /// Takes the units that passed since the last call.
    fn take_observed(&self) -> Vec<ObservedUnit>;
}

/// Counted events of a wire.
#[derive(Clone, Copy, PartialEq, Eq, Debug, Default)]
pub struct WireCounts {
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
pub trait OwnedMedium: Medium<Unit: ToOwned<Owned: Send>> {
    /// Writes a unit into the buffer of a link's reader. Returns its length there.
    fn write_unit(unit: &Self::Unit, out: &mut Self::Out) -> usize;
    /// Bytes of a unit, for people and for the history.
    fn unit_bytes(unit: &Self::Unit) -> Vec<u8>;
    /// The unit that these bytes are, on a line.
    fn foreign_unit(bytes: &[u8]) -> Option<&Self::Unit>;
    /// The refusal in place of a node's speed or position.
    fn busy_reply(unit: &Self::Unit) -> Option<<Self::Unit as ToOwned>::Owned>;
}

/// "Data cannot be transferred because of the present device state" (CiA 301).
const BUSY_ABORT: u32 = 0x0800_0022;

impl OwnedMedium for Stream {
    fn write_unit(unit: &[u8], out: &mut [u8]) -> usize {
        let len = unit.len().min(out.len());
        out[..len].copy_from_slice(&unit[..len]);
        len
    }

    fn unit_bytes(unit: &[u8]) -> Vec<u8> {
        unit.to_vec()
    }

    fn foreign_unit(bytes: &[u8]) -> Option<&[u8]> {
        Some(bytes)
    }

    fn busy_reply(_: &[u8]) -> Option<Vec<u8>> {
        None
    }
}

impl OwnedMedium for Can {
    fn write_unit(unit: &Frame, out: &mut Frame) -> usize {
        *out = *unit;
        1
    }

    fn unit_bytes(unit: &Frame) -> Vec<u8> {
        format!("{unit}").into_bytes()
    }

    fn foreign_unit(_: &[u8]) -> Option<&Frame> {
        None
    }

    fn busy_reply(unit: &Frame) -> Option<Frame> {
        let is_reply = !unit.extended && (0x581..=0x5FF).contains(&unit.id);
        let [command, low, high, sub, ..] = unit.data;
        let is_value = command >> 5 == 2;
        let measured = [0x606C, 0x6064].contains(&u16::from_le_bytes([low, high]));
        (is_reply && is_value && measured).then(|| {
            let [a, b, c, d] = BUSY_ABORT.to_le_bytes();
            Frame::standard(unit.id as u16, &[0x80, low, high, sub, a, b, c, d])
        })
    }
}

type OwnedUnit<M> = <<M as Medium>::Unit as ToOwned>::Owned;

/// A wire of one medium.
struct FaultyWire<M: OwnedMedium> {
    inner: Box<dyn LinkIo<M>>,
    state: Mutex<WireState<M>>,
}

struct WireState<M: OwnedMedium> {
    condition: WireCondition,
    condition_since: Instant,
    /// Links that were opened before the port was last lost are dead.
    generation: u64,
    opened_at: Instant,
    to_drives: VecDeque<(Instant, OwnedUnit<M>)>,
    to_host: VecDeque<(Instant, OwnedUnit<M>)>,
    counts: WireCounts,
    observed: Vec<ObservedUnit>,
}

impl<M: OwnedMedium> WireState<M> {
    fn drop_links(&mut self) {
        self.generation += 1;
        self.counts.lost += 1;
        self.to_drives.clear();
        self.to_host.clear();
    }

    fn record_unit(&mut self, at: Instant, to_drives: bool, unit: &M::Unit, fate: UnitOutcome) {
        self.counts.missing += u64::from(fate == UnitOutcome::Lost);
        self.counts.sent += u64::from(to_drives && fate != UnitOutcome::NotSent);
        self.observed.push(ObservedUnit {
            at,
            to_drives,
            bytes: M::unit_bytes(unit),
            outcome: fate,
        });
    }

    /// Returns whether a link of that generation is lost by now.
    fn is_lost(&mut self, generation: u64, now: Instant) -> bool {
        if let WireCondition::Drops(ms) = self.condition
            && generation == self.generation
            && now >= self.opened_at.plus_ms(ms)
        {
            self.drop_links();
        }
        generation != self.generation
    }
}

impl<M: OwnedMedium> FaultyWire<M> {
    fn lock(&self) -> MutexGuard<'_, WireState<M>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Drops units that arrived too late for any reader.
    fn discard_stale(&self) {
        let mut buffer = M::buffer();
        for _ in 0..STALE_MAX {
            match self.inner.receive(buffer.borrow_mut(), Instant::ZERO) {
                Ok(Received::TimedOut | Received::Woken) | Err(_) => break,
                Ok(_) => {}
            }
        }
    }
}

impl<M: OwnedMedium> AnyPort for FaultyWire<M> {
    fn condition(&self) -> WireCondition {
        self.lock().condition
    }

    fn working_since(&self) -> Option<Instant> {
        let inside = self.lock();
        let empty = inside.to_drives.is_empty() && inside.to_host.is_empty();
        (inside.condition == WireCondition::Working && empty).then_some(inside.condition_since)
    }

    fn set_condition(&self, condition: WireCondition) {
        let now = self.inner.now();
        let mut inside = self.lock();
        inside.condition = condition;
        inside.condition_since = now;
        match condition {
            WireCondition::Gone => inside.drop_links(),
            // The link that is open now is dropped so long after this began.
            WireCondition::Drops(_) => inside.opened_at = now,
            _ => {}
        }
        let waker = self.inner.waker();
        drop(inside);
        waker.wake();
    }

    fn send_foreign(&self, bytes: &[u8]) -> bool {
        let Some(unit) = M::foreign_unit(bytes) else { return false };
        // A simulated wire takes all.
        let _ = self.inner.send(unit);
        true
    }

    fn forward_due(&self) {
        let now = self.inner.now();
        let mut inside = self.lock();
        while inside.to_drives.front().is_some_and(|(due, _)| *due <= now) {
            if let Some((_, unit)) = inside.to_drives.pop_front() {
                // A simulated wire takes all.
                let _ = self.inner.send(unit.borrow());
                // Frames behind the last slow one arrive in time again.
                inside.condition_since = inside.condition_since.max(now);
            }
        }
    }

    fn counts(&self) -> WireCounts {
        self.lock().counts
    }

    fn take_observed(&self) -> Vec<ObservedUnit> {
        std::mem::take(&mut self.lock().observed)
    }
}

/// The host's end of a wire that fails, from one opening to the next.
struct FaultyLink<M: OwnedMedium> {
    port: Arc<FaultyWire<M>>,
    generation: u64,
}

impl<M: OwnedMedium> FaultyLink<M> {
    fn gone_error(&self) -> LinkError {
        LinkError::gone(&self.port.inner.describe())
    }
}

impl<M: OwnedMedium> LinkIo<M> for FaultyLink<M> {
    fn now(&self) -> Instant {
        self.port.inner.now()
    }

    fn send(&self, unit: &M::Unit) -> Result<(), LinkError> {
        let now = self.now();
        let mut inside = self.port.lock();
        if inside.is_lost(self.generation, now) {
            inside.record_unit(now, true, unit, UnitOutcome::NotSent);
            return Err(self.gone_error());
        }
        let last = inside.to_drives.back().map(|(due, _)| *due);
        let due = match inside.condition {
            WireCondition::Silent { to_drives: true, .. } => {
                inside.record_unit(now, true, unit, UnitOutcome::Lost);
                return Ok(());
            }
            WireCondition::Slow(ms) => Some(now.plus_ms(ms)).max(last),
            _ => last,
        };
        let Some(due) = due else {
            inside.record_unit(now, true, unit, UnitOutcome::Forwarded);
            drop(inside);
            return self.port.inner.send(unit);
        };
        inside.record_unit(now, true, unit, UnitOutcome::Delayed);
        inside.to_drives.push_back((due, unit.to_owned()));
        Ok(())
    }

    fn receive(&self, buffer: &mut M::Out, until: Instant) -> Result<Received, LinkError> {
        loop {
            let now = self.now();
            {
                let mut inside = self.port.lock();
                if inside.is_lost(self.generation, now) {
                    return Err(self.gone_error());
                }
                if inside.to_host.front().is_some_and(|(due, _)| *due <= now)
                    && let Some((at, unit)) = inside.to_host.pop_front()
                {
                    inside.condition_since = inside.condition_since.max(now);
                    return Ok(Received::Bytes { len: M::write_unit(unit.borrow(), buffer), at });
                }
            }
            // Waiting lets time pass in slices, so that others have their turn.
            let slice = if until <= now { until } else { until.min(now.plus_ns(SLICE_NS)) };
            match self.port.inner.receive(buffer, slice)? {
                Received::Bytes { len, at } => {
                    let mut inside = self.port.lock();
                    let unit = M::unit(buffer, len);
                    let last = inside.to_host.back().map(|(due, _)| *due);
                    if inside.condition == WireCondition::Busy
                        && let Some(reply) = M::busy_reply(unit)
                    {
                        inside.record_unit(at, false, reply.borrow(), UnitOutcome::Forwarded);
                        return Ok(Received::Bytes {
                            len: M::write_unit(reply.borrow(), buffer),
                            at,
                        });
                    }
                    let due = match inside.condition {
                        WireCondition::Silent { to_host: true, .. } => {
                            inside.record_unit(at, false, unit, UnitOutcome::Lost);
                            continue;
                        }
                        WireCondition::Slow(ms) => Some(at.plus_ms(ms)).max(last),
                        _ => last,
                    };
                    let Some(due) = due else {
                        inside.record_unit(at, false, unit, UnitOutcome::Forwarded);
                        return Ok(Received::Bytes { len, at });
                    };
                    inside.record_unit(at, false, unit, UnitOutcome::Delayed);
                    inside.to_host.push_back((due, unit.to_owned()));
                }
                Received::TimedOut if self.now() >= until => return Ok(Received::TimedOut),
                Received::TimedOut => {
                    run_wait_hook();
                    if self.port.inner.waker().take_wakeup() {
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

    fn waker(&self) -> LinkWaker {
        self.port.inner.waker()
    }

    fn is_real_time(&self) -> bool {
        self.port.inner.is_real_time()
    }

    fn describe(&self) -> String {
        self.port.inner.describe()
    }

    fn losses(&self) -> Losses {
        self.port.inner.losses()
    }

    fn reopen(&self) -> Result<Box<dyn LinkIo<M>>, LinkError> {
        let now = self.now();
        let mut inside = self.port.lock();
        if inside.condition == WireCondition::Gone {
            inside.counts.refused += 1;
            return Err(LinkError::new(&self.port.inner.describe(), Cause::Refused));
        }
        inside.counts.opened += 1;
        inside.opened_at = now;
        let generation = inside.generation;
        drop(inside);
        self.port.discard_stale();
        Ok(Box::new(Self { port: Arc::clone(&self.port), generation }))
    }
}

/// Puts a wire that fails in the place of a link.
pub fn wrap_link(link: AnyLink) -> (AnyLink, Arc<dyn AnyPort>) {
    fn wrap_medium<M: OwnedMedium>(
        inner: Box<dyn LinkIo<M>>,
    ) -> (Box<dyn LinkIo<M>>, Arc<dyn AnyPort>) {
        let now = inner.now();
        let inside = WireState {
            condition: WireCondition::Working,
            condition_since: now,
            generation: 0,
            opened_at: now,
            to_drives: VecDeque::new(),
            to_host: VecDeque::new(),
            counts: WireCounts::default(),
            observed: Vec::new(),
        };
        let port = Arc::new(FaultyWire { inner, state: Mutex::new(inside) });
        (Box::new(FaultyLink { port: Arc::clone(&port), generation: 0 }), port)
    }
    match link {
        AnyLink::Serial(link) => {
            let (link, port) = wrap_medium(link);
            (AnyLink::Serial(link), port)
        }
        AnyLink::Can(link) => {
            let (link, port) = wrap_medium(link);
            (AnyLink::Can(link), port)
        }
    }
}

thread_local! {
    static TICK: RefCell<Option<Rc<dyn Fn()>>> = const { RefCell::new(None) };
}

/// Sets the function that runs while the bench waits for a drive. `None` removes it.
pub fn set_wait_hook(tick: Option<Rc<dyn Fn()>>) {
    TICK.with(|slot| *slot.borrow_mut() = tick);
}

fn run_wait_hook() {
    let tick = TICK.with(|slot| slot.borrow().clone());
    tick.iter().for_each(|tick| tick());
}
