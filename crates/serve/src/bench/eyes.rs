//! The eyes on one wire: a thread that asks for what is shown, whenever the desk has nothing to do.
//! It asks one thing at a time, so that a command waits behind one question at most.

use std::sync::Arc;
use std::time::Duration;

use polepair::Axis;
use polepair_core::error::{Failure, Outcome};
use polepair_core::profile::{ParameterId, Signal};
use polepair_core::time::Instant;

use super::desk::Desk;
use super::open::Link;
use super::shared::Shared;
use super::wire::{StopThese, Wire};

/// How often an axis is asked for its state.
const STATE_EVERY: Duration = Duration::from_millis(100);
/// How long an axis that does not answer is left alone.
const PATIENCE: Duration = Duration::from_secs(1);
/// How far ahead an axis that turns is kept from leaving its limits.
const AHEAD: Duration = Duration::from_millis(200);
/// Between two looks whether there is anything to do.
const IDLE: Duration = Duration::from_millis(20);

/// What looks at a wire.
pub(super) struct Eyes {
    wire: Arc<Wire>,
    desk: Arc<Desk>,
    shared: Arc<Shared>,
    axes: Vec<Looked>,
    /// Whose turn it is.
    turn: usize,
    /// Questions take half of the time at most.
    rest_until: Instant,
}

/// An axis, and what is still to be asked of it.
struct Looked {
    axis: Axis,
    /// Parameters that signals read.
    ids: Vec<ParameterId>,
    to_ask: Vec<ParameterId>,
    next: Instant,
}

impl Eyes {
    pub fn new(link: &Link, shared: &Arc<Shared>) -> Self {
        let looked = |(_, axis): &(u16, Axis)| Looked {
            ids: ids(axis),
            axis: axis.clone(),
            to_ask: Vec::new(),
            next: Instant::ZERO,
        };
        Self {
            axes: link.wire.axes.iter().map(looked).collect(),
            wire: Arc::clone(&link.wire),
            desk: Arc::clone(&link.desk),
            shared: Arc::clone(shared),
            turn: 0,
            rest_until: Instant::ZERO,
        }
    }

    /// Looks until the bench closes.
    pub fn run(mut self) {
        while !self.shared.is_closing() {
            if self.desk.work() {
                continue;
            }
            let now = self.shared.now();
            if now < self.rest_until {
                self.desk.wait(self.rest_until.since(now).min(IDLE));
            } else if self.ask() {
                self.rest_until = self.shared.now() + self.shared.now().since(now);
            } else {
                self.desk.wait(IDLE);
            }
        }
        // What is left is told that it comes too late.
        while self.desk.work() {}
    }

    /// Asks one thing of the axis whose turn it is. False when none is to be asked.
    fn ask(&mut self) -> bool {
        let now = self.shared.now();
        for _ in 0..self.axes.len() {
            self.turn = (self.turn + 1) % self.axes.len();
            let looked = &mut self.axes[self.turn];
            if looked.to_ask.is_empty() && now >= looked.next {
                looked.to_ask.clone_from(&looked.ids);
                looked.next = now + STATE_EVERY;
            }
            if let Some(id) = looked.to_ask.pop() {
                looked.read(id, now);
                self.hold_back();
                return true;
            }
        }
        false
    }

    /// Stops an axis that is about to leave the limits that a file sets it.
    fn hold_back(&self) {
        let axis = &self.axes[self.turn].axis;
        if !axis.has_ends() || !axis.state().armed || axis.turns() != Some(true) {
            return;
        }
        let reason = match axis.leaving(AHEAD) {
            Ok(None) => return,
            Ok(Some(reason)) => reason,
            Err(error) => error.to_string(),
        };
        let (axes, since, report) = (vec![self.turn], self.shared.now(), None);
        let who = super::shared::SERVER.into();
        self.wire.stop(StopThese { axes, who, reason, since, report });
    }
}

/// What signals read, each once; the most telling is asked first, being last.
fn ids(axis: &Axis) -> Vec<ParameterId> {
    let mut ids = Vec::new();
    let plain = axis.profile().signals.iter().filter(|source| source.signal != Signal::Time);
    for source in plain {
        if !ids.contains(&source.parameter) {
            ids.push(source.parameter);
        }
    }
    ids.reverse();
    ids
}

impl Looked {
    fn read(&mut self, id: ParameterId, now: Instant) {
        let Err(error) = self.axis.read(id) else { return };
        let polepair::Error::Failed { outcome, .. } = error else {
            return self.ids.retain(|other| *other != id);
        };
        match outcome {
            Outcome::NotDone(Failure::Refused { .. } | Failure::Impossible(_)) => {
                self.ids.retain(|other| *other != id);
            }
            Outcome::Unknown(failure) | Outcome::NotDone(failure)
                if matches!(failure, Failure::Silent | Failure::LinkDown) =>
            {
                self.to_ask.clear();
                self.next = now + PATIENCE;
            }
            _ => {}
        }
    }
}
