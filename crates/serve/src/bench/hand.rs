//! The hand on one wire: it alone lets anything through that moves an axis, one thing after the
//! other, stops first. It never waits for a drive. It has a thread; whoever says a stop lends it his
//! own, too.
//!
//! Why: GW-1.

mod owes;
#[cfg(test)]
mod tests;

use std::sync::{Arc, Mutex};
use std::time::Duration;

use polepair::{Axis, Running};
use polepair_core::axis::Verb;
use polepair_core::profile::Signal;
use polepair_core::time::Instant;
use serde_json::json;
use tokio::sync::oneshot;

use super::clock::Clock;
use super::desk::Desk;
use super::lease::{Holder, Lost, Seat, Session};
use super::look;
use super::owed::{ANSWERED_MAX, Airtime, OwedStop};
use super::shared::{Event, SERVER, Shared, held};
use super::state::axis_state;
use super::wire::{AskLease, Commanded, Do, Order, Tell, Wire, overtaken};
use crate::message::{
    Deed, Ended, LeaseAct, LeaseGranted, LeaseTold, Outcome, OwedWhy, Refused, Stopped,
};

/// A command said so far ahead of the server's clock is no better than one that is too old, ms.
const AHEAD_MAX_MS: f64 = 1000.0;
/// Between two looks at what is under way: while it is fresh, and later.
const LOOK_EVERY: Duration = Duration::from_micros(500);
const LOOK_LATER_EVERY: Duration = Duration::from_millis(5);
/// For so long it is fresh.
const FRESH: Duration = Duration::from_millis(20);
/// Between two looks when nothing is under way: a link may be lost.
const IDLE: Duration = Duration::from_millis(100);
/// Stops that took no longer to send are sent in the thread of whoever says them.
const BRISK: Duration = Duration::from_millis(1);
/// Commands that wait for stops at most.
const WAITING_MAX: usize = 64;
/// Orders that are taken before everything else is looked at again.
const ORDERS_AT_ONCE_MAX: usize = 64;

/// What looks after a wire.
pub(super) struct Hand {
    wire: Arc<Wire>,
    desk: Arc<Desk>,
    shared: Arc<Shared>,
    /// The link's connection string, by which the journal finds its axes again.
    url: String,
    axes: Vec<Watched>,
    going: Vec<Going>,
    /// Commands that wait until their axis is seen standing, with their places among all orders.
    waiting: Vec<(u64, Box<Commanded>)>,
    /// Stops that were said under a lease, and what comes of them.
    halting: Vec<(Commanded, oneshot::Receiver<Result<Stopped, Refused>>)>,
    airtime: Airtime,
    lost: bool,
    /// When the bench was closed.
    closed: Option<Instant>,
    /// When something new was last begun.
    begun: Instant,
    /// The last stops went out at once: the far end takes what is written.
    brisk: bool,
}

/// An axis, as its hand sees it.
struct Watched {
    id: u16,
    axis: Axis,
    seat: Seat,
    /// The stop that it is owed.
    owed: Option<OwedStop>,
    /// Why its last lease ended, if that was because its link went away.
    unlinked: Option<String>,
    /// What was said before the stop of that number, and would have it moved, comes too late.
    stopped: u64,
}

/// A command under way.
struct Going {
    axis: usize,
    session: Session,
    id: String,
    deed: Do,
    running: Running,
    /// Faults were cleared, and what is under way reads whether one stands.
    cleared: bool,
    tell: Tell<Outcome>,
}

impl Watched {
    /// Why nobody has its lease: where its link went away, that is not somebody who stopped it.
    fn unheld(&self, refused: Refused) -> Refused {
        let Some(why) = self.unlinked.as_ref().filter(|_| self.seat.holder().is_none()) else {
            return refused;
        };
        let label = self.axis.label();
        let what = format!("the link of {label} went away, and its lease with it: {why}");
        Refused::new("E313", what)
            .hint("cut its supply if it turns; it is told to stop as soon as the link is back")
    }
}

impl Hand {
    /// For a link of that connection string.
    pub fn new(wire: Arc<Wire>, desk: Arc<Desk>, shared: Arc<Shared>, url: String) -> Self {
        let begun = shared.now();
        let mut hand = Self {
            wire,
            desk,
            shared,
            url,
            axes: Vec::new(),
            going: Vec::new(),
            waiting: Vec::new(),
            halting: Vec::new(),
            airtime: Airtime::default(),
            lost: false,
            closed: None,
            begun,
            brisk: true,
        };
        hand.grow();
        hand
    }

    /// Looks after axes that joined: they are on the wire's list before anything is said of them.
    fn grow(&mut self) {
        let last_epoch = self.shared.last_epoch;
        let known = self.axes.len();
        for (place, (id, axis)) in self.wire.axes.iter().enumerate().skip(known) {
            let (seat, axis) = (Seat::after(last_epoch), axis.clone());
            let before = self.shared.is_owed_before(&self.url, axis.number());
            let owed = before
                .then(|| OwedStop::new(OwedWhy::ServerBefore, SERVER.into(), self.shared.now()));
            self.wire.show_owed(place, owed.as_ref().map(OwedStop::shown));
            let unlinked = None;
            self.axes.push(Watched { id: *id, axis, seat, owed, unlinked, stopped: 0 });
        }
    }

    /// Looks after the wire until the bench closes and all that moved was told to stop.
    pub fn run(this: &Mutex<Self>) {
        let wire = Arc::clone(&held(this).wire);
        loop {
            let next = {
                let mut hand = held(this);
                let next = hand.turn();
                if hand.is_over() {
                    return hand.leave();
                }
                next
            };
            if !wire.was_called() {
                std::thread::park_timeout(next);
            }
        }
    }

    /// Whether a stop can be sent without waiting, as far as is known: to open a lost link again may
    /// take seconds.
    pub fn is_brisk(&self) -> bool {
        let first = self.axes.first().map(|watched| watched.axis.connection());
        self.brisk && first.is_some_and(|connection| connection.trouble().is_none())
    }

    /// Whether the bench is closed and all that moved was seen standing, or waited for long enough.
    pub fn is_over(&self) -> bool {
        let now = self.shared.now();
        let waited = self.closed.is_some_and(|closed| now.since(closed) >= ANSWERED_MAX);
        waited || self.closed.is_some() && self.axes.iter().all(|watched| watched.owed.is_none())
    }

    /// Does all that is to be done now, and waits for nothing. Returns when to look again.
    pub fn turn(&mut self) -> Duration {
        self.grow();
        self.take_stops();
        self.look_at_link();
        self.expire();
        for _ in 0..ORDERS_AT_ONCE_MAX {
            let Some((said, order)) = self.wire.next_order() else { break };
            self.obey(said, order);
            self.take_stops();
        }
        if self.shared.is_closing() && self.closed.is_none() {
            self.close();
        }
        self.look_at_commands();
        self.look_at_owed();
        self.answer_holders();
        for (said, commanded) in std::mem::take(&mut self.waiting) {
            self.obey(said, Order::Command(commanded));
        }
        self.pause()
    }

    fn pause(&self) -> Duration {
        let now = self.shared.now();
        let busy = !self.going.is_empty() || self.axes.iter().any(|w| w.owed.is_some());
        let look = match now.since(self.begun) < FRESH {
            _ if !busy => IDLE,
            true => LOOK_EVERY,
            false => LOOK_LATER_EVERY,
        };
        let ends = self.axes.iter().filter_map(|watched| Some(watched.seat.holder()?.until));
        ends.map(|until| until.since(now)).min().map_or(look, |left| left.min(look))
    }

    /// A lease ended: what it set in motion stops, and nothing moves before it is armed anew.
    fn lose(&mut self, axis: usize, lost: Lost, why: &str) {
        let moved = self.moved(axis, &lost);
        self.axes[axis].axis.arm(false);
        if moved {
            self.halt_unasked(axis, OwedWhy::LeaseEnded, why);
        }
        self.ended(axis, &lost.holder, why);
    }

    /// Whether something was set in motion under a lease, or is about to be.
    fn moved(&self, axis: usize, lost: &Lost) -> bool {
        let powers = |going: &Going| going.axis == axis && going.deed.moves();
        lost.moved || self.going.iter().any(powers)
    }

    /// Tells that a lease ended.
    fn ended(&mut self, axis: usize, holder: &Holder, why: &str) {
        let id = self.axes[axis].id;
        let detail = json!({ "epoch": holder.epoch, "reason": why });
        self.shared.noted(&holder.session, Deed::LeaseEnded, Some(id), detail);
        self.show(axis);
    }

    /// Shows everybody who has the lease now.
    fn show(&self, axis: usize) {
        let watched = &self.axes[axis];
        let lease = watched.seat.holder().map(|holder| LeaseTold {
            owner: holder.session.to_string(),
            epoch: holder.epoch,
            expires_ms: Clock::ms(holder.until),
        });
        self.wire.show_lease(axis, lease.clone());
        self.shared.tell(Event::Lease { axis: watched.id, lease });
    }

    fn expire(&mut self) {
        let now = self.shared.now();
        for axis in 0..self.axes.len() {
            if let Some(lost) = self.axes[axis].seat.expire(now) {
                self.lose(axis, lost, "not renewed");
            }
        }
    }

    /// A link that is lost takes its leases with it. What moved then is stopped when it is back.
    fn look_at_link(&mut self) {
        let Some(watched) = self.axes.first() else { return };
        let trouble = watched.axis.connection().trouble();
        if trouble.is_some() == self.lost {
            return;
        }
        self.lost = trouble.is_some();
        let why = trouble.as_ref().map(ToString::to_string);
        let error = trouble.map(|error| Refused::from(polepair::Error::from(error)));
        self.wire.show_lost(error.map(|error| (self.shared.now(), error)));
        for axis in 0..self.axes.len() {
            let now = self.shared.now();
            if !self.lost {
                let watched = &mut self.axes[axis];
                if let Some(owed) = &mut watched.owed {
                    owed.link_opened(&watched.axis, now);
                    self.begun = now;
                }
                continue;
            }
            self.axes[axis].axis.arm(false);
            let Some(lost) = self.axes[axis].seat.end() else { continue };
            let is_new = self.axes[axis].owed.is_none() && self.moved(axis, &lost);
            if is_new {
                self.axes[axis].owed = Some(OwedStop::new(OwedWhy::LinkLost, SERVER.into(), now));
            }
            self.note_owed(axis, is_new);
            self.axes[axis].unlinked.clone_from(&why);
            self.ended(axis, &lost.holder, "the link is lost");
        }
        self.shared.tell(Event::Bench);
    }

    /// The bench closes: whatever may move is stopped.
    fn close(&mut self) {
        self.closed = Some(self.shared.now());
        for axis in 0..self.axes.len() {
            let watched = &mut self.axes[axis];
            let armed = watched.axis.state().armed || watched.axis.turns() == Some(true);
            let lost = watched.seat.end();
            let moved = armed || lost.as_ref().is_some_and(|lost| self.moved(axis, lost));
            if moved && self.axes[axis].owed.is_none() {
                self.halt_unasked(axis, OwedWhy::ServerEnds, "the server ends");
            }
            if let Some(lost) = lost {
                self.ended(axis, &lost.holder, "the server ends");
            }
        }
    }

    fn obey(&mut self, said: u64, order: Order) {
        self.grow();
        let late = |axis: usize| said < self.axes[axis].stopped;
        match order {
            Order::Lease(ask) if ask.takes() && late(ask.axis) => {
                // Who has gone does not want to know.
                let _ = ask.tell.send(Err(overtaken()));
            }
            Order::Look(begin) if (0..self.axes.len()).any(late) => begin(Err(overtaken())),
            Order::Dismiss(dismiss) if late(dismiss.axis) => {
                // Who has gone does not want to know.
                let _ = dismiss.tell.send(Err(overtaken()));
            }
            Order::Command(commanded) if late(commanded.axis) => {
                self.tell(*commanded, Some(overtaken()));
            }
            Order::Lease(ask) => self.lease(ask),
            Order::Command(commanded) if self.waits_for_stop(&commanded) => {
                self.waiting.push((said, commanded));
            }
            Order::Command(commanded) => self.command(said, *commanded),
            Order::Write { axis, session, epoch, go } => go(self.may(axis, &session, epoch, false)),
            Order::Gone(session) => self.gone(&session),
            Order::NotKept { axis, epoch } => self.not_kept(axis, epoch),
            Order::Dismiss(dismiss) => self.dismiss(dismiss),
            Order::Look(go) => {
                let may = self.may_look();
                if may.is_ok() {
                    // Before anybody else has a turn: what is commanded now would wait for it.
                    self.wire.looking.begin();
                }
                go(may);
            }
        }
    }

    /// Whether nobody would have to wait for a look, and nothing moves that it may not delay.
    fn may_look(&self) -> Result<(), Refused> {
        if self.shared.is_closing() || self.lost {
            return Err(closing(self.lost));
        }
        if let Some((_, error)) = self.wire.lost() {
            return Err(error);
        }
        self.wire.at_rest()?;
        let powered =
            |watched: &&Watched| axis_state(watched.id, &watched.axis).enabled == Some(true);
        match self.axes.iter().find(powered) {
            None => Ok(()),
            Some(watched) => {
                let what = format!("{} is powered", watched.axis.label());
                Err(look::refused(what).hint("disable it first"))
            }
        }
    }

    fn gone(&mut self, session: &Session) {
        for axis in 0..self.axes.len() {
            let seat = &mut self.axes[axis].seat;
            let its = seat.holder().is_some_and(|holder| holder.session == *session);
            if let Some(lost) = its.then(|| seat.end()).flatten() {
                self.lose(axis, lost, "its client is gone");
            }
        }
    }

    fn lease(&mut self, ask: AskLease) {
        let AskLease { axis, session, act, epoch, tell } = ask;
        let granted = match act {
            LeaseAct::Take | LeaseAct::TakeOver => {
                return self.take(axis, &session, act == LeaseAct::TakeOver, tell);
            }
            LeaseAct::Renew => self.renew(axis, &session, epoch).map(Some),
            LeaseAct::Drop => {
                let given_back = self.axes[axis].seat.give_back(&session, epoch, self.shared.now());
                given_back.map(|lost| {
                    lost.into_iter().for_each(|lost| self.lose(axis, lost, "given back"));
                    None
                })
            }
        };
        // Who has gone does not want to know, here and below.
        let _ = tell.send(granted);
    }

    fn renew(
        &mut self,
        axis: usize,
        session: &Session,
        epoch: u64,
    ) -> Result<LeaseGranted, Refused> {
        let (now, lasts) = (self.shared.now(), self.shared.lease);
        let watched = &mut self.axes[axis];
        let held = watched.seat.renew(session, epoch, now, lasts);
        let held = held.map_err(|refused| watched.unheld(refused))?;
        self.show(axis);
        Ok(granted(&held))
    }

    /// Gives a lease, and tells so once the journal has it: its epoch is never given again.
    fn take(
        &mut self,
        axis: usize,
        session: &Session,
        over: bool,
        tell: Tell<Option<LeaseGranted>>,
    ) {
        let (now, lasts) = (self.shared.now(), self.shared.lease);
        let closes = self.shared.is_closing() || self.lost;
        let may = match self.wire.looking.is_on() {
            _ if closes => Err(closing(self.lost)),
            true => {
                let what = "somebody looks for drives on this link";
                Err(look::refused(what).hint("wait for the end of the look, or break it off"))
            }
            false => self.shared.notes.takes(now),
        };
        let seat = &mut self.axes[axis].seat;
        let before = seat.holder().map(|holder| holder.epoch);
        let (held, lost) = match may.and_then(|()| seat.take(session, over, now, lasts)) {
            Ok(taken) => taken,
            Err(refused) => return drop(tell.send(Err(refused))),
        };
        self.axes[axis].unlinked = None;
        let over = lost.is_some();
        lost.into_iter().for_each(|lost| self.lose(axis, lost, "taken over"));
        self.show(axis);
        if before == Some(held.epoch) {
            return drop(tell.send(Ok(Some(granted(&held)))));
        }
        let (wire, epoch) = (Arc::clone(&self.wire), held.epoch);
        let then = move |kept: Result<(), Refused>| {
            if kept.is_err() {
                wire.order_next(0, Order::NotKept { axis, epoch });
            }
            let _ = tell.send(kept.map(|()| Some(granted(&held))));
        };
        let (id, deed) = (self.axes[axis].id, if over { Deed::TakeOver } else { Deed::Lease });
        let (what, detail) = ((session, deed, Some(id)), json!({ "epoch": epoch }));
        self.shared.notes.announce(what, detail, now, Box::new(then));
    }

    /// Nobody was told that this lease was given.
    fn not_kept(&mut self, axis: usize, epoch: u64) {
        let seat = &mut self.axes[axis].seat;
        let its = seat.holder().is_some_and(|holder| holder.epoch == epoch);
        if let Some(lost) = its.then(|| seat.end()).flatten() {
            self.lose(axis, lost, "the journal does not keep it");
        }
    }

    /// Whether a session may have an axis do something now.
    fn may(&self, axis: usize, session: &Session, epoch: u64, moves: bool) -> Result<(), Refused> {
        let watched = &self.axes[axis];
        if self.shared.is_closing() {
            return Err(closing(false));
        }
        if let Some(lock) = self.shared.lock().as_ref().filter(|_| moves) {
            let what = format!("motion is locked since {} stopped everything", lock.by);
            let hint =
                "release it first: on the server's page, or by `polepair --server URL release`";
            return Err(Refused::new("gateway.locked", what).hint(hint));
        }
        let held = watched.seat.held(session, epoch, self.shared.now());
        held.map_err(|refused| watched.unheld(refused))?;
        let owes = |stop: &OwedStop| !stop.is_of_holder(epoch);
        if moves && watched.owed.as_ref().is_some_and(owes) {
            return Err(owed());
        }
        Ok(())
    }

    /// Whether what moves an axis waits a moment, because its stop is just about to be over.
    fn waits_for_stop(&self, commanded: &Commanded) -> bool {
        let owed = self.axes[commanded.axis].owed.as_ref();
        let owed = owed.filter(|owed| !owed.is_of_holder(commanded.order.epoch));
        let is_ending = owed.is_some_and(|owed| owed.is_ending(self.shared.now()));
        is_ending && commanded.deed.moves() && self.waiting.len() < WAITING_MAX
    }

    fn command(&mut self, said: u64, commanded: Commanded) {
        if matches!(commanded.deed, Do::Run(command) if command.verb == Verb::Stop) {
            return self.halt_for_holder(said, commanded);
        }
        let started = self.start(&commanded);
        let Commanded { axis, session, order, deed, .. } = &commanded;
        if deed.ends_motion() && self.may(*axis, session, order.epoch, false).is_ok() {
            // It did not wait for the journal, as what was said before it may still do: that is not
            // done any more, whatever became of this.
            let stopped = &mut self.axes[commanded.axis].stopped;
            *stopped = said.max(*stopped);
        }
        match started {
            Ok(Started::Running(running)) => {
                let Commanded { axis, session, order, deed, tell, .. } = commanded;
                let enables = matches!(deed, Do::Run(command) if command.verb == Verb::Enable);
                if deed.moves() && !enables {
                    self.holder_goes_on(axis, &session, order.epoch);
                    self.axes[axis].seat.moves();
                }
                self.begun = self.shared.now();
                let (id, running) = (order.id, *running);
                let cleared = false;
                self.going.push(Going { axis, session, id, deed, running, cleared, tell });
            }
            Ok(Started::Done) => self.tell(commanded, None),
            Ok(Started::ToBePrepared) => {
                // Where the limits depend on where it stands, that is asked first, and so is what
                // scales the arguments. Not here: a hand waits for nothing.
                self.desk.prepare(said, commanded);
            }
            Err(error) => self.tell(commanded, Some(error)),
        }
    }

    fn tell(&self, commanded: Commanded, error: Option<Refused>) {
        let Commanded { axis, session, order, deed, tell, .. } = commanded;
        let (whose, outcome) = ((&session, self.axes[axis].id), outcome(order.id, error));
        self.shared.ended(whose, outcome, deed.ends_motion(), tell);
    }

    fn start(&self, commanded: &Commanded) -> Result<Started, Refused> {
        let Commanded { axis, session, order, deed, prepared, .. } = commanded;
        let moves = deed.moves();
        self.may(*axis, session, order.epoch, moves)?;
        let stops = matches!(deed, Do::Run(command) if command.verb == Verb::QuickStop);
        if !stops && *deed != Do::Arm(false) {
            fresh(order.issued_ms, order.ttl_ms, Clock::ms(self.shared.now()))?;
        }
        let watched = &self.axes[*axis];
        let command = match deed {
            Do::Arm(armed) => {
                watched.axis.arm(*armed);
                return Ok(Started::Done);
            }
            Do::Say(text) => {
                return Ok(Started::Running(Box::new(watched.axis.start_raw(text)?)));
            }
            Do::Run(command) => *command,
        };
        let started = match prepared {
            Some(prepared) => prepared.as_ref().map_err(Clone::clone)?.start(),
            None if moves && watched.axis.has_ends()
                || watched.axis.has_unread_scales(&command) =>
            {
                return Ok(Started::ToBePrepared);
            }
            None => watched.axis.start(command),
        };
        Ok(Started::Running(Box::new(started?)))
    }

    fn look_at_commands(&mut self) {
        let mut at = 0;
        while at < self.going.len() {
            let (value, error) = match self.going[at].running.poll() {
                Ok(None) => {
                    at += 1;
                    continue;
                }
                Ok(value) => (value, None),
                // The faults were cleared, whatever became of the question after them.
                Err(_) if self.going[at].cleared => (None, None),
                Err(error) => (None, Some(Refused::from(error))),
            };
            if error.is_none() && self.reads_fault(at) {
                at += 1;
                continue;
            }
            let Going { axis, session, id, deed, tell, .. } = self.going.swap_remove(at);
            if error.is_none() && deed.stops() {
                self.axes[axis].seat.stopped();
            }
            let value = value.filter(|_| matches!(deed, Do::Say(_)));
            let outcome = Outcome { value, ..outcome(id, error) };
            let whose = (&session, self.axes[axis].id);
            self.shared.ended(whose, outcome, deed.ends_motion(), tell);
        }
    }
}

impl Hand {
    /// Reads whether a fault stands after faults were cleared: what is told of the axis afterwards was
    /// read afterwards. False where there is nothing to read.
    fn reads_fault(&mut self, at: usize) -> bool {
        let going = &mut self.going[at];
        let clears = matches!(&going.deed, Do::Run(command) if command.verb == Verb::Clear);
        if !clears || going.cleared {
            return false;
        }
        let axis = &self.axes[going.axis].axis;
        let source = axis.profile().signal(Signal::Fault);
        let Some(running) = source.and_then(|source| axis.start_read(source.parameter).ok()) else {
            return false;
        };
        (going.running, going.cleared) = (running, true);
        true
    }
}

/// What became of a command that was let through.
enum Started {
    Running(Box<Running>),
    Done,
    /// Something must be asked first.
    ToBePrepared,
}

/// Whether a command is still good.
fn fresh(issued_ms: f64, ttl_ms: f64, now_ms: f64) -> Result<(), Refused> {
    let age = now_ms - issued_ms;
    if age > ttl_ms {
        let what = format!("said {age:.0} ms ago, and good for {ttl_ms:.0} ms");
        return Err(Refused::new("gateway.expired", what).hint("say it again, if it still holds"));
    }
    if age < -AHEAD_MAX_MS {
        let what = format!("said {:.0} ms from now", -age);
        let hint = "take the server's time, as `pong` tells it";
        return Err(Refused::new("gateway.expired", what).hint(hint));
    }
    Ok(())
}

fn owed() -> Refused {
    let what = "the axis is owed a stop: it was not seen standing, and may be turning";
    Refused::new("gateway.owed", what).hint(
        "wait until it stands; if you see that it may go on, dismiss the stop, then arm it again",
    )
}

fn granted(held: &Holder) -> LeaseGranted {
    LeaseGranted { epoch: held.epoch, expires_ms: Clock::ms(held.until) }
}

fn closing(lost: bool) -> Refused {
    match lost {
        true => Refused::new("gateway.busy", "the link is lost").hint("see to its cable and power"),
        false => Refused::new("gateway.busy", "the server ends").hint("start it again"),
    }
}

/// The outcome that an error means.
pub(super) fn outcome(id: String, error: Option<Refused>) -> Outcome {
    let ended = match error.as_ref().map(|error| error.executed) {
        None | Some(Some(true)) => Ended::Done,
        Some(Some(false)) => Ended::NotDone,
        Some(None) => Ended::Unknown,
    };
    Outcome { id, outcome: ended, value: None, error, replayed: false }
}
