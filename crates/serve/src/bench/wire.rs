//! What is asked of a wire, and what everybody may see of it: the hand takes orders from here.

use std::collections::{BTreeSet, VecDeque};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, OnceLock, Weak};
use std::thread::Thread;

use polepair::Axis;
use polepair::axis::Prepared;
use polepair_core::axis::Command;
use polepair_core::time::Instant;
use tokio::sync::oneshot;

use super::grown::Grown;
use super::hand::Hand;
use super::lease::Session;
use super::look::{self, Looking};
use super::open::AXES_MAX;
use super::owed::Report;
use super::shared::held;
use super::state::axis_state;
use crate::message::{DismissStop, LeaseGranted, LeaseTold, Outcome, Refused, StopOwed};

/// Orders that wait for one wire; stops have places of their own.
const ORDERS_MAX: usize = 1024;
/// Stops that wait for one wire; the axes of more are added to the last.
const STOPS_MAX: usize = 64;

/// A wire and its axes.
pub(super) struct Wire {
    /// Its axes, with their numbers among all of the bench.
    pub axes: Grown<(u16, Axis)>,
    /// Whether somebody looks for drives there.
    pub looking: Looking,
    /// When the bench's time began, on its clock.
    pub zero: OnceLock<Instant>,
    /// With their numbers in the order in which they were said.
    orders: Mutex<VecDeque<(u64, Order)>>,
    stops: Mutex<VecDeque<StopThese>>,
    hand: OnceLock<(Thread, Weak<Mutex<Hand>>)>,
    leases: Mutex<Vec<Option<LeaseTold>>>,
    owed: Mutex<Vec<Option<StopOwed>>>,
    /// Axes whose drives were had to watch this host by nobody but the server.
    watching: Mutex<BTreeSet<usize>>,
    /// Axes of the bench whose drives have just started.
    restarted: Mutex<Vec<u16>>,
    lost: Mutex<Option<(Instant, Refused)>>,
    clash: Mutex<Option<String>>,
    /// Orders came since the hand last looked.
    called: AtomicBool,
    /// Orders and stops so far.
    said: AtomicU64,
    /// Stops so far.
    stops_said: AtomicU64,
}

/// What a hand is told.
pub(super) enum Order {
    /// A lease is wanted, kept, or given back.
    Lease(AskLease),
    /// An axis is to do something.
    Command(Box<Commanded>),
    /// Something is about to be written that moves nothing: `go` hears whether it may.
    Write { axis: usize, session: Session, epoch: u64, go: Go },
    /// Somebody wants to look for drives: `go` hears whether that may begin.
    Look(Go),
    /// A client has gone: its leases end.
    Gone(Session),
    /// An axis is to be owed its stop no more.
    Dismiss(Dismiss),
    /// The journal did not keep that a lease was given.
    NotKept { axis: usize, epoch: u64 },
}

/// What goes on when it is known whether it may. It must not wait.
pub(super) type Go = Box<dyn FnOnce(Result<(), Refused>) + Send>;

/// Tells what came of something.
pub(super) type Tell<T> = oneshot::Sender<Result<T, Refused>>;

/// What is wanted of a lease.
#[derive(Debug)]
pub(super) struct AskLease {
    pub axis: usize,
    pub session: Session,
    pub act: crate::message::LeaseAct,
    pub epoch: u64,
    pub tell: Tell<Option<LeaseGranted>>,
}

/// A stop that is to be owed no more.
#[derive(Debug)]
pub(super) struct Dismiss {
    pub axis: usize,
    pub session: Session,
    pub dismiss: DismissStop,
    pub tell: Tell<()>,
}

/// What every command says of itself.
#[derive(Debug)]
pub(super) struct Told {
    pub id: String,
    pub issued_ms: f64,
    pub ttl_ms: f64,
    pub epoch: u64,
}

/// A command on its way.
#[derive(Debug)]
pub(super) struct Commanded {
    pub axis: usize,
    pub session: Session,
    pub order: Told,
    pub deed: Do,
    /// Made ready, where that took a question.
    pub prepared: Option<Result<Prepared, Refused>>,
    pub tell: Tell<Outcome>,
}

/// What a command's word means.
#[derive(Clone, PartialEq, Debug)]
pub(super) enum Do {
    /// Let motion commands through, or no longer.
    Arm(bool),
    /// A verb of the drive.
    Run(Command),
    /// A request in the protocol's own text: nobody here knows what it does.
    Say(String),
}

impl Do {
    /// Whether a motor may move by it.
    pub fn moves(&self) -> bool {
        match self {
            Self::Arm(armed) => *armed,
            Self::Run(command) => command.verb.needs_arming(),
            Self::Say(_) => true,
        }
    }

    /// Whether nothing moves once it is done.
    pub fn stops(&self) -> bool {
        matches!(self, Self::Run(command) if command.verb.is_stop())
    }

    /// Whether it only keeps an axis from moving: it waits for no journal.
    pub fn ends_motion(&self) -> bool {
        self.stops() || *self == Self::Arm(false)
    }
}

/// Axes that are to stop.
#[derive(Debug)]
pub(super) struct StopThese {
    /// With the number of the stop among the wire's orders and stops, which the wire gives it: axes
    /// that were added have one of their own.
    pub axes: Vec<(usize, u64)>,
    pub who: Session,
    pub reason: String,
    pub since: Instant,
    pub report: Option<Arc<Report>>,
}

impl AskLease {
    /// Whether somebody is to have it who has not.
    pub fn takes(&self) -> bool {
        use crate::message::LeaseAct::{Take, TakeOver};
        matches!(self.act, Take | TakeOver)
    }
}

/// What is said before a stop and comes behind it is not done: it might move what was stopped.
pub(crate) fn overtaken() -> Refused {
    Refused::new("gateway.expired", "a stop was said after this")
        .hint("say it again, if it still holds")
}

fn full() -> Refused {
    Refused::new("gateway.busy", "too many commands wait for this link").hint("ask less often")
}

impl StopThese {
    fn add(&mut self, other: Self) {
        for (axis, said) in other.axes {
            match self.axes.iter_mut().find(|(known, _)| *known == axis) {
                Some((_, known)) => *known = said.max(*known),
                None => self.axes.push((axis, said)),
            }
        }
    }
}

impl Wire {
    pub fn new(axes: Vec<(u16, Axis)>) -> Self {
        Self {
            leases: Mutex::new(vec![None; axes.len()]),
            owed: Mutex::new(vec![None; axes.len()]),
            watching: Mutex::default(),
            restarted: Mutex::default(),
            axes: Grown::new(AXES_MAX, axes),
            looking: Looking::default(),
            zero: OnceLock::new(),
            orders: Mutex::default(),
            stops: Mutex::default(),
            hand: OnceLock::new(),
            lost: Mutex::default(),
            clash: Mutex::default(),
            called: AtomicBool::new(false),
            said: AtomicU64::new(0),
            stops_said: AtomicU64::new(0),
        }
    }

    /// One more axis, with its number among all of the bench. Tells its place.
    pub fn join(&self, id: u16, axis: Axis) -> Option<usize> {
        held(&self.leases).push(None);
        held(&self.owed).push(None);
        self.axes.push((id, axis))
    }

    /// Its present time, and when the bench's began on it; nothing while it has no axes.
    pub fn time(&self) -> Option<(Instant, Instant)> {
        let now = self.axes.first()?.1.connection().now();
        Some((now, *self.zero.get_or_init(|| now)))
    }

    /// When the bench's time began on it.
    pub fn zero(&self) -> Instant {
        self.zero.get().copied().unwrap_or(Instant::ZERO)
    }

    /// Whose thread is called when there is something to do.
    pub fn looked_after_by(&self, thread: Thread, hand: Weak<Mutex<Hand>>) {
        let _ = self.hand.set((thread, hand));
    }

    /// Gives an order.
    pub fn order(&self, order: Order) -> Result<(), Refused> {
        {
            let mut orders = held(&self.orders);
            if orders.len() >= ORDERS_MAX {
                return Err(full());
            }
            orders.push_back((self.number(), order));
        }
        self.call();
        Ok(())
    }

    /// Takes a number for an order that is given when the journal has it: a stop that comes between
    /// goes before.
    pub fn announced(&self) -> Result<u64, Refused> {
        match held(&self.orders).len() < ORDERS_MAX {
            true => Ok(self.number()),
            false => Err(full()),
        }
    }

    /// Gives an order that was announced. There is room: no more are announced at once than notes wait.
    pub fn order_announced(&self, said: u64, order: Order) {
        held(&self.orders).push_back((said, order));
        self.call();
    }

    /// Gives an order that had its place already, with the number that it had.
    pub fn order_next(&self, said: u64, order: Order) {
        held(&self.orders).push_front((said, order));
        self.call();
    }

    fn number(&self) -> u64 {
        self.said.fetch_add(1, Ordering::SeqCst)
    }

    /// Orders a stop: there is always room for one.
    pub fn stop(&self, mut stop: StopThese) {
        self.looking.break_off();
        self.stops_said.fetch_add(1, Ordering::SeqCst);
        {
            let mut stops = held(&self.stops);
            // Numbered where it is queued: no later stop comes before an earlier one.
            let said = self.number();
            stop.axes.iter_mut().for_each(|(_, its)| *its = said);
            let stops_full = stops.len() == STOPS_MAX;
            match stops.back_mut().filter(|_| stops_full) {
                // The stop itself is not lost, only the word of how far it came.
                Some(last) => last.add(stop),
                None => stops.push_back(stop),
            }
        }
        self.call();
    }

    /// How often one was ordered so far.
    pub fn stops(&self) -> u64 {
        self.stops_said.load(Ordering::SeqCst)
    }

    /// Whether no axis of it is commanded, owed a stop, armed or turning: then nobody waits for what is
    /// asked of others there.
    pub fn at_rest(&self) -> Result<(), Refused> {
        let refused = |what: String, hint: &str| Err(look::refused(what).hint(hint));
        for (place, (id, axis)) in self.axes.iter().enumerate() {
            let (label, state) = (axis.label(), axis_state(*id, axis));
            if let Some(lease) = self.lease(place) {
                let what = format!("{} commands {label}", lease.owner);
                return refused(what, "wait until it is given back: it could not be commanded");
            }
            if self.owed(place).is_some() {
                return refused(format!("{label} is being stopped"), "wait until it stands");
            }
            if state.armed || state.moving == Some(true) {
                return refused(format!("{label} is armed or turns"), "stop and disarm it first");
            }
        }
        Ok(())
    }

    /// The next stop.
    pub fn next_stop(&self) -> Option<StopThese> {
        held(&self.stops).pop_front()
    }

    /// The next order.
    pub fn next_order(&self) -> Option<(u64, Order)> {
        held(&self.orders).pop_front()
    }

    /// Has the hand look now.
    pub fn call(&self) {
        self.called.store(true, Ordering::SeqCst);
        if let Some((thread, _)) = self.hand.get() {
            thread.unpark();
        }
    }

    /// Does here and now what the hand was called for, as far as it stops: its thread may be a while
    /// in waking. Where the hand is at work, or a stop's bytes were long in going out, it is left to
    /// that thread.
    pub fn send_stops(&self) {
        let hand = self.hand.get().and_then(|(_, hand)| hand.upgrade());
        if let Some(hand) = hand
            && let Ok(mut hand) = hand.try_lock()
            && hand.is_brisk()
        {
            hand.take_stops();
        }
    }

    /// Whether somebody called since this was last asked.
    pub fn was_called(&self) -> bool {
        self.called.swap(false, Ordering::SeqCst)
    }

    /// Who commands an axis.
    pub fn lease(&self, axis: usize) -> Option<LeaseTold> {
        held(&self.leases).get(axis).cloned().flatten()
    }

    pub fn show_lease(&self, axis: usize, lease: Option<LeaseTold>) {
        if let Some(shown) = held(&self.leases).get_mut(axis) {
            *shown = lease;
        }
    }

    /// The stop that an axis is owed.
    pub fn owed(&self, axis: usize) -> Option<StopOwed> {
        held(&self.owed).get(axis).cloned().flatten()
    }

    pub fn show_owed(&self, axis: usize, owed: Option<StopOwed>) {
        if let Some(shown) = held(&self.owed).get_mut(axis) {
            *shown = owed;
        }
    }

    /// Notes whether the drive of an axis watches this host because the server had it do so, and nobody
    /// else said anything since.
    pub fn note_watch(&self, axis: usize, own: bool) {
        let mut watching = held(&self.watching);
        if own {
            watching.insert(axis)
        } else {
            watching.remove(&axis)
        };
    }

    /// Nobody speaks from here any more: drives that were had to watch this host do so no more, those
    /// that are owed a stop excepted.
    pub fn end_watch(&self) {
        let own = std::mem::take(&mut *held(&self.watching));
        for axis in own.into_iter().filter(|axis| self.owed(*axis).is_none()) {
            let (id, axis) = &self.axes[axis];
            let ended = match axis.connection().trouble() {
                Some(error) => Err(error.into()),
                None => axis.set_watchdog(None),
            };
            if let Err(error) = ended {
                tracing::warn!(axis = id, %error, "its drive will miss this server's heartbeat");
            }
        }
    }

    /// Notes that the drive of an axis has just started: what was set in its memory is gone.
    pub fn note_restart(&self, id: u16) {
        held(&self.restarted).push(id);
    }

    /// Those that have since this was last asked.
    pub fn take_restarted(&self) -> Vec<u16> {
        std::mem::take(&mut *held(&self.restarted))
    }

    /// Why the link is not open, and since when, if it is not.
    pub fn lost(&self) -> Option<(Instant, Refused)> {
        held(&self.lost).clone()
    }

    pub fn show_lost(&self, why: Option<(Instant, Refused)>) {
        *held(&self.lost) = why;
    }

    /// Who else seems to be on the wire, if somebody does.
    pub fn clash(&self) -> Option<String> {
        held(&self.clash).clone()
    }

    pub fn show_clash(&self, what: Option<String>) {
        *held(&self.clash) = what;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stop(wire: &Wire, axes: &[usize]) {
        let axes = axes.iter().map(|axis| (*axis, 0)).collect();
        let (who, reason, since) = ("ann".into(), String::new(), Instant::ZERO);
        wire.stop(StopThese { axes, who, reason, since, report: None });
    }

    #[test]
    fn stops_come_in_the_order_of_their_numbers_whoever_says_them() {
        let wire = Wire::new(Vec::new());
        let last = std::thread::scope(|scope| {
            let two = [0, 1].map(|axis| {
                let wire = &wire;
                scope.spawn(move || (0..20_000).for_each(|_| stop(wire, &[axis])))
            });
            let (mut last, mut ended) = (0, false);
            loop {
                while let Some(stop) = wire.next_stop() {
                    let first = stop.axes.iter().map(|(_, said)| *said).min().unwrap();
                    assert!(first >= last, "{first} behind {last}");
                    last = stop.axes.iter().map(|(_, said)| *said).max().unwrap();
                }
                if ended {
                    return last;
                }
                ended = two.iter().all(std::thread::ScopedJoinHandle::is_finished);
            }
        });
        assert_eq!(last, 39_999);
    }

    #[test]
    fn axes_of_stops_that_are_put_together_keep_their_numbers() {
        let wire = Wire::new(Vec::new());
        (0..STOPS_MAX).for_each(|_| stop(&wire, &[0]));
        stop(&wire, &[1]);
        stop(&wire, &[0, 2]);
        let stops: Vec<_> = std::iter::from_fn(|| wire.next_stop()).collect();
        let n = STOPS_MAX as u64;
        assert_eq!(stops.len(), STOPS_MAX);
        assert_eq!(stops[STOPS_MAX - 1].axes, [(0, n + 1), (1, n), (2, n + 1)]);
    }
}
