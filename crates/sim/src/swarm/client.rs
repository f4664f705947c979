//! Who asks: one host's user, who reads, writes, moves and stops at random and keeps the books.

use polepair_core::error::{Failure, Outcome};
use polepair_core::station::{Counters, Ticket};
use polepair_core::time::Instant;

use super::axis::{Axis, What};
use super::{RECOVERY_MS, Report};
use crate::check::{Violation, Watch};
use crate::random::Random;
use crate::world::{NodeId, WireId, World};

/// Every question must have ended after so long; homing is the longest.
const PATIENCE_MS: u32 = 120_000;

/// One host with its user.
#[derive(Debug)]
pub struct Client {
    pub host: NodeId,
    pub wire: WireId,
    pub axes: Vec<Axis>,
    pub next_at: Instant,
    watch: Watch,
    random: Random,
    tickets: u32,
    /// Longest time between two questions, µs.
    think_us: u64,
    /// Questions that may be open at once.
    open_max: usize,
    /// Nothing but the splitting of bytes goes wrong here: every question must be answered.
    pub sound: bool,
    /// From here on every question must be answered.
    calm_at: Instant,
}

impl Client {
    pub fn new(
        host: NodeId,
        wire: WireId,
        protocol: &str,
        axes: Vec<Axis>,
        mut random: Random,
    ) -> Self {
        Self {
            host,
            wire,
            axes,
            next_at: Instant::ZERO,
            watch: Watch::new(host, wire, protocol),
            tickets: 0,
            think_us: random.pick(&[500, 5_000, 50_000]),
            open_max: random.between(1, 6) as usize,
            sound: false,
            calm_at: Instant::FAR,
            random,
        }
    }

    /// The faults have ended: from `now` plus the time to recover on everything must work.
    pub fn calm(&mut self, now: Instant) {
        self.calm_at = now.plus_ms(RECOVERY_MS);
    }

    /// Asks something, and decides when to ask next.
    pub fn ask(&mut self, world: &mut World, report: &mut Report) {
        let now = world.now();
        self.next_at = now.plus_ns(1 + self.random.below(self.think_us * 1_000));
        let open: usize = self.axes.iter().map(|axis| axis.open.len()).sum();
        if open >= self.open_max || self.axes.is_empty() {
            return;
        }
        let which = self.random.below(self.axes.len() as u64) as usize;
        let drawn = self.axes[which].draw(&mut self.random);
        let calm = now >= self.calm_at;
        let what = match drawn {
            Some(What::Do(_)) if calm => self.axes[which].pulse(),
            drawn => drawn,
        };
        if let Some(what) = what {
            self.tickets += 1;
            let ticket = Ticket(self.tickets);
            let taken = self.axes[which].ask(world, self.host, ticket, what, &mut self.random);
            if taken && !self.axes[which].may_be_asked(what) {
                let what = format!("{ticket:?} {what:?} was taken by an axis that is not armed");
                report.violations_of([Violation { invariant: "I6", at: now, what }]);
            }
            report.write(now, || {
                format!("{:?} {ticket:?} axis {which}: {what:?}, taken {taken}", self.host)
            });
        }
    }

    /// Checks everything after an event that touched this host.
    pub fn after(&mut self, world: &mut World, report: &mut Report) {
        self.notice_spoiling(world, report);
        for axis in &mut self.axes {
            report.violations_of(axis.after(world, self.host));
        }
        let mut ends = Vec::new();
        while let Some(end) =
            world.look(self.host, |n, _| n.axes().and_then(|axes| axes.poll_outcome()))
        {
            ends.push(end);
        }
        let gave_up = ends.iter().any(|(_, outcome)| {
            matches!(
                outcome,
                Outcome::NotDone(Failure::Silent | Failure::Misbehaved)
                    | Outcome::Unknown(Failure::Silent | Failure::Misbehaved)
            )
        });
        let copies = self.watch.copies_taken;
        report.violations_of(self.watch.after(world, gave_up));
        if self.watch.copies_taken > copies {
            // What came of it is no knowledge, right or wrong.
            self.axes.iter_mut().for_each(Axis::forget);
        }
        for (ticket, outcome) in ends {
            self.ended(world, report, ticket, outcome);
        }
    }

    /// A drive that answers after bytes were changed may have taken them for a request.
    fn notice_spoiling(&mut self, world: &World, report: &mut Report) {
        for axis in &mut self.axes {
            let sent = world.knowledge(self.wire, axis.drive).sent;
            if sent.tag == axis.judged {
                continue;
            }
            axis.judged = sent.tag;
            if sent.tainted && self.watch.misled(world, axis.drive) {
                report.requests_collided += 1;
                axis.spoiled = true;
                axis.forget();
            }
        }
    }

    fn ended(&mut self, world: &mut World, report: &mut Report, ticket: Ticket, outcome: Outcome) {
        report.write(world.now(), || format!("{:?} {ticket:?} ends: {outcome:?}", self.host));
        match outcome {
            Outcome::Done(_) => report.done += 1,
            Outcome::NotDone(_) => report.not_done += 1,
            Outcome::Unknown(_) => report.unknown += 1,
        }
        let owner = self.axes.iter_mut().find(|a| a.open.iter().any(|o| o.ticket == ticket));
        let at = world.now();
        let Some(axis) = owner else {
            let what = format!("{ticket:?} ended twice or was never asked: {outcome:?}");
            return report.violations_of([Violation { invariant: "I3", at, what }]);
        };
        let open = axis.open.iter().find(|o| o.ticket == ticket).copied();
        if let Err((invariant, what)) = axis.ended(world, self.host, ticket, outcome) {
            let name = axis.profile.name;
            if self.watch.last_match_copied {
                axis.forget();
            } else if self.watch.last_match_tainted && self.watch.collided(world) {
                report.wire_collisions += 1;
                axis.forget();
            } else {
                let what = format!("{name} {:?}: {what}", axis.index);
                report.violations_of([Violation { invariant, at, what }]);
            }
        }
        let must_work = self.sound || open.is_some_and(|o| o.since >= self.calm_at);
        // A stop may end a read: that is an answer too.
        let cancelled = outcome == Outcome::NotDone(Failure::Cancelled);
        let answered = cancelled || matches!(outcome, Outcome::Done(_));
        let question = matches!(open.map(|o| o.what), Some(What::Read(_) | What::Look(..)));
        if must_work && question && !answered && !axis.spoiled {
            let what =
                format!("{} {:?}: {open:?} ended as {outcome:?}", axis.profile.name, axis.index);
            let invariant = if self.sound { "I9" } else { "I11" };
            report.violations_of([Violation { invariant, at, what }]);
        }
    }

    /// The link went down or came up: nothing may be armed any more.
    pub fn disarmed(&mut self) {
        self.axes.iter_mut().for_each(Axis::disarmed);
    }

    /// The world ends: whatever was asked long ago must have ended.
    pub fn close(&mut self, world: &mut World, report: &mut Report) {
        let now = world.now();
        let counters: Option<Counters> =
            world.look(self.host, |n, _| n.axes().map(|a| a.counters()));
        report.requests += counters.unwrap_or_default().sent;
        report.made.add(&world.made(self.wire));
        report.copies_taken += self.watch.copies_taken;
        for axis in &self.axes {
            report.starts += axis.truth(world).starts;
        }
        for open in self.axes.iter().flat_map(|axis| &axis.open) {
            if open.since.plus_ms(PATIENCE_MS) < now {
                let what = format!("{open:?} never ended");
                report.violations_of([Violation { invariant: "I11", at: now, what }]);
            }
        }
    }
}
