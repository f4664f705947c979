//! A node as far as the bus shows it: its NMT state, whether it is there, and whether it is alone.

use std::collections::HashMap;

use polepair_core::proto::canopen::nmt::{Command, State};
use polepair_core::proto::canopen::sdo::Object;

use super::beat::Beat;
use super::boot::{Boots, Circumstances, Zero};
use super::emcy::Faults;
use super::guard::Guard;
use super::power::Power;
use super::product::Product;
use super::sdo::At;
use super::{odd, odd_at};
use crate::session::{Change, Name, Notice, Oddity};
use crate::stamp::Stamp;

/// A node that was told to be quiet may still send what was on its way.
const QUIET_NS: u64 = 100_000_000;
/// A state that goes back and forth so often without an order is two nodes'.
const FLIPS_MAX: u8 = 3;
/// The same state so often is one node's.
const SAME_MAX: u8 = 4;
/// Requests to a node that was never heard, until that is told: whoever looks who is there asks less.
const UNHEARD_MAX: u8 = 4;

/// One node.
#[derive(Debug)]
pub(super) struct Node {
    pub id: u8,
    pub beat: Beat,
    pub guard: Guard,
    pub faults: Faults,
    pub power: Power,
    pub product: Product,
    /// It is a drive by CiA 402.
    pub drive: bool,
    /// What its objects were last seen to be.
    pub values: HashMap<Object, i64>,
    heard: bool,
    /// Nothing but its heartbeat was heard of it.
    only_beats: bool,
    /// It said something since it started.
    used: bool,
    unheard: u8,
    /// That it does not answer was told.
    lost: bool,
    state: Option<State>,
    before: Option<State>,
    flips: u8,
    /// How often it told the same state since the last other one.
    same: u8,
    /// What the master last ordered, and when, while the node has not told its state since.
    ordered: Option<(State, Option<Stamp>)>,
    reset: bool,
    pub boots: Boots,
    doubled: bool,
    /// It sent process data while it said that it must not.
    process: Option<Option<Stamp>>,
    accused: bool,
}

impl Node {
    /// A node of which nothing is known but whether everybody was ordered to start again.
    pub fn new(id: u8, reset: bool) -> Self {
        Self {
            id,
            beat: Beat::default(),
            guard: Guard::default(),
            faults: Faults::default(),
            power: Power::default(),
            product: Product::default(),
            drive: false,
            values: HashMap::new(),
            heard: false,
            only_beats: true,
            used: false,
            unheard: 0,
            lost: false,
            state: None,
            before: None,
            flips: 0,
            same: 0,
            ordered: None,
            reset,
            boots: Boots::default(),
            doubled: false,
            process: None,
            accused: false,
        }
    }

    /// It said something beside its state. `counts` tells that it has started by then.
    pub fn hear(&mut self, counts: bool, notices: &mut Vec<Notice>) {
        self.only_beats = false;
        self.appear(counts, notices);
    }

    fn appear(&mut self, counts: bool, notices: &mut Vec<Notice>) {
        self.used |= counts;
        if !self.heard {
            self.heard = true;
            notices.push(self.change("presence", "", "present"));
        }
    }

    /// A request had no answer, or was sent again. Whether that is told: once until it answers, and
    /// of a node that was never heard only when it was asked again and again.
    pub fn unanswered(&mut self, given_up: bool) -> bool {
        let first = !self.lost;
        if given_up {
            self.unheard = self.unheard.saturating_add(1);
            self.lost = true;
        }
        if self.heard { first } else { given_up && self.unheard == UNHEARD_MAX }
    }

    /// It answered a request.
    pub fn answered(&mut self, notices: &mut Vec<Notice>) {
        self.lost = false;
        self.hear(true, notices);
    }

    /// It is asked for its state.
    pub fn guarded(&mut self, at: At, notices: &mut Vec<Notice>) {
        self.unguarded(notices);
        self.guard.ask(at);
    }

    /// It did not tell its state.
    pub fn unguarded(&mut self, notices: &mut Vec<Notice>) {
        if self.guard.give_up(self.id, notices) && self.unanswered(true) {
            let text = "does not answer to guarding".to_owned();
            notices.push(odd(Oddity::Unanswered, self.id, text));
        }
    }

    fn change(&self, what: Name, from: Name, to: Name) -> Notice {
        Notice::Change(Change { axis: Some(self.id.into()), what, from, to })
    }

    fn enter(&mut self, state: State, notices: &mut Vec<Notice>) {
        if self.state != Some(state) {
            let from = self.state.map_or("", State::name);
            notices.push(self.change("nmt", from, state.name()));
            (self.before, self.state) = (self.state, Some(state));
        }
    }

    /// The master orders something of it.
    pub fn order(&mut self, command: Command, now: Option<Stamp>, notices: &mut Vec<Notice>) {
        (self.flips, self.process, self.accused) = (0, None, false);
        let state = match command {
            Command::Start => State::Operational,
            Command::Stop => State::Stopped,
            Command::PreOperational => State::PreOperational,
            Command::ResetNode | Command::ResetCommunication => {
                (self.reset, self.ordered) = (true, None);
                self.beat.off();
                self.guard.restart();
                return;
            }
            Command::Other(_) => return,
        };
        self.ordered = Some((state, now));
        // Who tells its state is believed, of others the order is all there is.
        if self.heard && !self.beat.is_heard() && !self.guard.is_heard() {
            self.enter(state, notices);
        }
    }

    /// It says 0: that it has started, mostly. `beginning` tells that its heartbeat is being switched
    /// on. True if it has started for sure.
    pub fn boot(&mut self, now: Option<Stamp>, beginning: bool, notices: &mut Vec<Notice>) -> bool {
        let about = Circumstances {
            still: self.state == Some(State::BootUp),
            used: self.used,
            asked: core::mem::take(&mut self.reset),
            beginning,
            period: self.beat.former(),
        };
        let zero = self.boots.take(now, &about);
        if zero == Zero::Beat {
            return false;
        }
        if zero == Zero::Restart {
            self.restarted(None, notices);
        }
        self.appear(false, notices);
        (self.used, self.ordered, self.process) = (false, None, None);
        self.beat.off();
        self.guard.restart();
        self.enter(State::BootUp, notices);
        self.flips = 0;
        true
    }

    fn restarted(&self, when: Option<Stamp>, notices: &mut Vec<Notice>) {
        if !self.doubled {
            let text = "started again by no order, while it was in use".to_owned();
            notices.push(odd_at(Oddity::Restart, self.id, when, text));
        }
    }

    /// What was suspected of its boot-ups is so: by `now`, or in any case.
    pub fn confirm(&mut self, now: Option<Stamp>, notices: &mut Vec<Notice>) {
        let Some(suspicion) = self.boots.confirmed(now) else { return };
        if suspicion.kind == Oddity::Restart {
            return self.restarted(suspicion.when, notices);
        }
        let ms = suspicion.after / 1_000_000;
        self.double(&format!("started twice within {ms} ms, by one order"), notices);
    }

    /// Two devices have its number.
    pub fn double(&mut self, why: &str, notices: &mut Vec<Notice>) {
        if !core::mem::replace(&mut self.doubled, true) {
            let text = format!("two devices may have this node-ID: {why}");
            notices.push(odd(Oddity::DuplicateAddress, self.id, text));
        }
    }

    /// It tells its state by itself.
    pub fn tell(&mut self, state: State, now: Option<Stamp>, notices: &mut Vec<Notice>) {
        self.state_told(state, now, notices);
        if self.beat.take(now) {
            notices.push(self.change("presence", "silent", "present"));
        }
        if let Some(why) = self.beat.is_two() {
            self.double(why, notices);
        }
    }

    /// It tells its state, by itself or because it was asked.
    pub fn state_told(&mut self, state: State, now: Option<Stamp>, notices: &mut Vec<Notice>) {
        self.appear(true, notices);
        self.reset = false;
        if matches!(state, State::Other(_)) {
            return;
        }
        self.confirm(None, notices);
        if let (Some((ordered, when)), true) = (self.ordered, self.state != Some(state)) {
            // A state told at once may be that of before.
            let soon = when.zip(now).is_none_or(|(when, now)| now.since(when) < QUIET_NS);
            if ordered != state && soon {
                return;
            }
        }
        self.flip(state, notices);
        self.accuse_process(state, notices);
        self.ordered = None;
        self.enter(state, notices);
    }

    /// Looks whether its state goes back and forth by no order, as two nodes' would.
    fn flip(&mut self, state: State, notices: &mut Vec<Notice>) {
        if self.state == Some(state) {
            self.same = self.same.saturating_add(1);
            return;
        }
        let back = self.ordered.is_none() && self.before == Some(state) && self.same < SAME_MAX;
        (self.flips, self.same) = (if back { self.flips + 1 } else { 0 }, 0);
        if self.flips == FLIPS_MAX {
            let other = self.state.map_or("", State::name);
            let why = format!("it is {} and {other} by turns, by no order", state.name());
            self.double(&why, notices);
        }
    }

    /// It sent process data, said before and says now that it must not, and nobody ordered anything.
    fn accuse_process(&mut self, state: State, notices: &mut Vec<Notice>) {
        let Some(when) = self.process.take() else { return };
        let quiet = matches!(state, State::PreOperational | State::Stopped);
        if quiet && self.state == Some(state) && self.ordered.is_none() && !self.accused {
            self.accused = true;
            let text = format!("sends process data although it is {}", state.name());
            notices.push(odd_at(Oddity::Malformed, self.id, when, text));
        }
    }

    /// Process data of it change nothing: it is there, and may send them.
    pub const fn may_process(&self) -> bool {
        let free = !matches!(self.state, Some(State::PreOperational | State::Stopped))
            && !matches!(self.ordered, Some((State::PreOperational | State::Stopped, _)));
        free && self.heard && self.used && !self.only_beats
    }

    /// It sent process data.
    pub fn processes(&mut self, now: Option<Stamp>, notices: &mut Vec<Notice>) {
        self.hear(true, notices);
        let told = matches!(self.state, Some(State::PreOperational | State::Stopped));
        if told && self.ordered.is_none() && self.beat.is_heard() {
            self.process.get_or_insert(now);
        }
        // Without a heartbeat the order is what it was told to be.
        if let Some((state @ (State::PreOperational | State::Stopped), Some(when))) = self.ordered
            && now.is_some_and(|now| now.since(when) > QUIET_NS)
            && !core::mem::replace(&mut self.accused, true)
        {
            let text = format!("sends process data although it was told to be {}", state.name());
            notices.push(odd(Oddity::Malformed, self.id, text));
        }
    }

    /// Its heartbeat stays out.
    pub fn silent(&mut self, now: Stamp, commanded: Option<Stamp>, notices: &mut Vec<Notice>) {
        let last = self.beat.last();
        let Some((period, since)) = self.beat.stays_out(now) else { return };
        notices.push(self.change("presence", "present", "silent"));
        // A master that has ended asks nothing any more either.
        if self.only_beats && commanded < last {
            return;
        }
        let (ms, every) = (since / 1_000_000, period / 1_000_000);
        let text = format!("no heartbeat for {ms} ms, which came every {every} ms");
        notices.push(odd(Oddity::Silent, self.id, text));
    }
}
