//! The hand on one wire: it alone lets anything through that moves an axis, one thing after the
//! other, stops first. It never waits for a drive. It has a thread; whoever says a stop lends it his
//! own, too.

use std::sync::{Arc, Mutex};
use std::time::Duration;

use polepair::{Axis, Running};
use polepair_core::axis::Verb;
use polepair_core::time::Instant;
use serde_json::json;

use super::clock::Clock;
use super::desk::Desk;
use super::halt::{Halt, Report};
use super::lease::{Holder, Lost, Seat, Session};
use super::look;
use super::shared::{Event, Shared, held};
use super::state::axis_state;
use super::wire::{AskLease, Commanded, Do, Order, StopThese, Tell, Wire, overtaken};
use crate::message::{Deed, Ended, LeaseAct, LeaseGranted, LeaseTold, Outcome, Refused};

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
/// Orders that are taken before everything else is looked at again.
const ORDERS_AT_ONCE_MAX: usize = 64;

/// What looks after a wire.
pub(super) struct Hand {
    wire: Arc<Wire>,
    desk: Arc<Desk>,
    shared: Arc<Shared>,
    axes: Vec<Watched>,
    going: Vec<Going>,
    lost: bool,
    closed: bool,
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
    halt: Option<Halt>,
    /// It moved when its link was lost.
    owed: bool,
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
    tell: Tell<Outcome>,
}

impl Hand {
    pub fn new(wire: Arc<Wire>, desk: Arc<Desk>, shared: Arc<Shared>) -> Self {
        let (begun, axes) = (shared.now(), Vec::new());
        let going = Vec::new();
        let (lost, closed, brisk) = (false, false, true);
        let mut hand = Self { wire, desk, shared, axes, going, lost, closed, begun, brisk };
        hand.grow();
        hand
    }

    /// Looks after axes that joined: they are on the wire's list before anything is said of them.
    fn grow(&mut self) {
        let last_epoch = self.shared.last_epoch;
        let watched = |(id, axis): &(u16, Axis)| Watched {
            id: *id,
            axis: axis.clone(),
            seat: Seat::after(last_epoch),
            halt: None,
            owed: false,
            stopped: 0,
        };
        let known = self.axes.len();
        if known < self.wire.axes.len() {
            self.axes.extend(self.wire.axes.iter().skip(known).map(watched));
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
                    return;
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

    /// Whether the bench is closed and nothing is left to stop.
    pub fn is_over(&self) -> bool {
        self.closed && self.axes.iter().all(|watched| watched.halt.is_none())
    }

    /// Does all that is to be done now, and waits for nothing. Returns when to look again.
    pub fn turn(&mut self) -> Duration {
        self.take_stops();
        self.look_at_link();
        self.expire();
        for _ in 0..ORDERS_AT_ONCE_MAX {
            let Some((said, order)) = self.wire.next_order() else { break };
            self.obey(said, order);
            self.take_stops();
        }
        if self.shared.is_closing() && !self.closed {
            self.close();
        }
        self.look_at_commands();
        self.look_at_halts();
        self.pause()
    }

    fn pause(&self) -> Duration {
        let now = self.shared.now();
        let busy = !self.going.is_empty() || self.axes.iter().any(|w| w.halt.is_some());
        let look = match now.since(self.begun) < FRESH {
            _ if !busy => IDLE,
            true => LOOK_EVERY,
            false => LOOK_LATER_EVERY,
        };
        let ends = self.axes.iter().filter_map(|watched| Some(watched.seat.holder()?.until));
        ends.map(|until| until.since(now)).min().map_or(look, |left| left.min(look))
    }

    /// Sends what stops; what there is to write about it comes when all of them are on the wire.
    pub fn take_stops(&mut self) {
        while let Some(StopThese { axes, who, reason, since, report }) = self.wire.next_stop() {
            self.grow();
            self.wire.looking.break_off();
            let began = self.shared.now();
            let mut ended = Vec::with_capacity(axes.len());
            for (axis, said) in axes {
                self.axes[axis].stopped = said.max(self.axes[axis].stopped);
                let lost = self.axes[axis].seat.end();
                self.halt(axis, since, report.clone());
                ended.push((axis, lost));
            }
            self.brisk = self.shared.now().since(began) <= BRISK;
            for (axis, lost) in ended {
                if let Some(Lost { holder, .. }) = lost {
                    self.ended(axis, &holder, "stopped");
                }
                let (id, detail) = (self.axes[axis].id, json!({ "reason": reason }));
                self.shared.noted(&who, Deed::Stop, Some(id), detail);
            }
        }
    }

    /// Sends a stop, and disarms the axis.
    fn halt(&mut self, axis: usize, since: Instant, report: Option<Arc<Report>>) {
        let watched = &mut self.axes[axis];
        watched.axis.arm(false);
        match &mut watched.halt {
            Some(halt) => halt.again(&watched.axis, since, report),
            None => {
                let reports = report.into_iter().collect();
                watched.halt = Some(Halt::begin(&watched.axis, since, reports));
            }
        }
        watched.owed = false;
        self.begun = self.shared.now();
    }

    /// A lease ended: what it set in motion stops, and nothing moves before it is armed anew.
    fn lose(&mut self, axis: usize, lost: Lost, why: &str) {
        let powers = |going: &Going| going.axis == axis && going.deed.moves();
        let moved = lost.moved || self.going.iter().any(powers);
        self.axes[axis].axis.arm(false);
        if moved {
            self.halt(axis, self.shared.now(), None);
            let (id, detail) = (self.axes[axis].id, json!({ "reason": why }));
            self.shared.noted_by_server(Deed::Stop, id, detail);
        }
        self.ended(axis, &lost.holder, why);
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
        self.wire.show_lost(trouble.as_ref().map(ToString::to_string));
        for axis in 0..self.axes.len() {
            let watched = &mut self.axes[axis];
            if self.lost {
                watched.axis.arm(false);
                if let Some(lost) = watched.seat.end() {
                    watched.owed |= lost.moved;
                    self.ended(axis, &lost.holder, "the link is lost");
                }
            } else if watched.owed {
                self.halt(axis, self.shared.now(), None);
            }
        }
        self.shared.tell(Event::Bench);
    }

    /// The bench closes: whatever may move is stopped.
    fn close(&mut self) {
        self.closed = true;
        for axis in 0..self.axes.len() {
            let watched = &mut self.axes[axis];
            let armed = watched.axis.state().armed || watched.axis.turns() == Some(true);
            let lost = watched.seat.end();
            if armed || lost.as_ref().is_some_and(|lost| lost.moved) {
                self.halt(axis, self.shared.now(), None);
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
            Order::Command(commanded) if late(commanded.axis) => {
                self.tell(*commanded, Some(overtaken()));
            }
            Order::Lease(ask) => self.lease(ask),
            Order::Command(commanded) => self.command(said, *commanded),
            Order::Write { axis, session, epoch, go } => go(self.may(axis, &session, epoch, false)),
            Order::Gone(session) => self.gone(&session),
            Order::NotKept { axis, epoch } => self.not_kept(axis, epoch),
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
        let refused = |what: String, hint: &str| Err(look::refused(what).hint(hint));
        for watched in &self.axes {
            let (label, state) = (watched.axis.label(), axis_state(watched.id, &watched.axis));
            if let Some(holder) = watched.seat.holder() {
                let what = format!("{} commands {label}", holder.session);
                return refused(what, "wait until it is given back: it could not be commanded");
            }
            if watched.halt.is_some() {
                return refused(format!("{label} is being stopped"), "wait until it stands");
            }
            if state.armed || state.moving == Some(true) {
                return refused(format!("{label} is armed or turns"), "stop and disarm it first");
            }
            if state.enabled == Some(true) {
                return refused(format!("{label} is powered"), "disable it first");
            }
        }
        Ok(())
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
        let held = self.axes[axis].seat.renew(session, epoch, now, lasts)?;
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
            return Err(Refused::new("gateway.locked", what).hint("release it first"));
        }
        watched.seat.held(session, epoch, self.shared.now())?;
        if moves && watched.halt.as_ref().is_some_and(Halt::is_under_way) {
            return Err(Refused::new("gateway.busy", "the axis is being stopped")
                .hint("wait until it stands, arm it again"));
        }
        Ok(())
    }

    fn command(&mut self, said: u64, commanded: Commanded) {
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
                    self.axes[axis].seat.moves();
                }
                self.begun = self.shared.now();
                let (id, running) = (order.id, *running);
                self.going.push(Going { axis, session, id, deed, running, tell });
            }
            Ok(Started::Done) => self.tell(commanded, None),
            Ok(Started::ToBePrepared) => {
                // Where the limits depend on where it stands, that is asked first, not here.
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
        let stops = matches!(deed, Do::Run(c) if matches!(c.verb, Verb::Stop | Verb::QuickStop));
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
            None if moves && watched.axis.has_ends() => return Ok(Started::ToBePrepared),
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
                Err(error) => (None, Some(Refused::from(error))),
            };
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

    fn look_at_halts(&mut self) {
        let now = self.shared.now();
        for watched in &mut self.axes {
            let Some(halt) = &mut watched.halt else { continue };
            let (news, over) = halt.look(watched.id, &watched.axis, now);
            if let Some(stopped) = news {
                let detail = json!({ "class": stopped.class, "ms": stopped.ms });
                self.shared.noted_by_server(Deed::Outcome, watched.id, detail);
                self.shared.tell(Event::Stopped(stopped));
            }
            if over {
                watched.halt = None;
            }
        }
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::Options;

    /// The wire of a link's first axis, with a hand whose thread never looks.
    fn wire_of(link: &polepair::Link) -> (Arc<Wire>, Arc<Mutex<Hand>>) {
        let wire = Arc::new(Wire::new(vec![(7, link.axes()[0].clone())]));
        let desk = Arc::new(Desk::new(&wire));
        let clock = Clock::of(link.simulation().into_iter());
        let shared = Arc::new(Shared::new(clock, &Options::default()));
        let hand = Arc::new(Mutex::new(Hand::new(Arc::clone(&wire), desk, shared)));
        wire.looked_after_by(std::thread::current(), Arc::downgrade(&hand));
        (wire, hand)
    }

    fn say_stop(wire: &Wire) {
        let (axes, who, reason) = (vec![(0, 0)], Session::from("ann"), String::new());
        wire.stop(StopThese { axes, who, reason, since: Instant::ZERO, report: None });
        wire.send_stops();
    }

    #[test]
    fn a_stop_is_sent_by_whoever_says_it_unless_the_hand_is_at_work() {
        let link = polepair::connect("sim:tmcl?time=virtual").unwrap();
        let (wire, hand) = wire_of(&link);
        let sent = || link.counters(&link.axes()[0]).sent;
        let before = sent();
        say_stop(&wire);
        assert!(sent() > before && held(&hand).axes[0].halt.is_some());
        let before = sent();
        let at_work = held(&hand);
        say_stop(&wire);
        assert_eq!(sent(), before);
        assert!(at_work.wire.next_stop().is_some(), "the hand finds it");
        drop(at_work);
        held(&hand).brisk = false;
        say_stop(&wire);
        assert_eq!(sent(), before, "it may be long, and others are to be stopped as well");
    }

    #[test]
    fn a_lost_link_is_opened_again_by_no_one_who_says_a_stop() {
        let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        let url = format!("tmcl+tcp://{address}?profile=tmcm-171#1");
        let link = polepair::connect(&url).unwrap();
        let (wire, _hand) = wire_of(&link);
        drop(listener.accept().unwrap());
        let connection = link.axes()[0].connection();
        while connection.trouble().is_none() {
            connection.catch_up();
        }
        say_stop(&wire);
        assert!(wire.next_stop().is_some(), "it is its hand's");
    }
}
