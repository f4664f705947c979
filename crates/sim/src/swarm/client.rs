//! Who asks: one host's user, who reads, writes, moves and stops at random and keeps the books.

use polepair_core::error::{Failure, Outcome};
use polepair_core::medium::MediumKind;
use polepair_core::proto::thruster::wire::REFUSED;
use polepair_core::station::{Counters, Ticket};
use polepair_core::time::Instant;

use super::axis::{Axis, What};
use super::{RECOVERY_MS, Report};
use crate::check::{CanWatch, Match, Violation, Watch};
use crate::random::Random;
use crate::world::{NodeId, WireId, World};

/// Changed requests that some drive took as good: so many are kept.
const MISTAKEN_MAX: usize = 16;
/// Every question must have ended after so long; homing is the longest.
const PATIENCE_MS: u32 = 120_000;

/// The identifier by which a network is commanded (CiA 301), and that it is a standard one.
const NMT: (u32, bool) = (0, false);

/// One host with its user.
#[derive(Debug)]
pub struct Client {
    pub host: NodeId,
    pub wire: WireId,
    pub medium: MediumKind,
    pub axes: Vec<Axis>,
    pub next_at: Instant,
    watch: Judge,
    /// The last requests that were changed on the way, passed every check and were answered. Where an
    /// answer names nobody, as TML's acknowledgement, nothing tells the host that another drive gives
    /// it, or that what was done is not what it asked.
    mistaken: Vec<u32>,
    /// The last transmission that the host heard.
    heard: u32,
    /// How often the host's controller went bus-off so far.
    off: u64,
    /// Its link was lost because another program commanded the network (NMT) in the same instants. CiA
    /// 301 has one master for that; a host sees nothing of what waits in the controller of another, and
    /// what waits in its own cannot be called back.
    clashed: bool,
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

/// Why a value may be wrong.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Excuse {
    /// A second copy was taken for the answer.
    Copy,
    /// What nobody sent passed every check.
    Collision,
}

/// Who judges the host, by its medium.
#[derive(Debug)]
enum Judge {
    Serial(Box<Watch>),
    Can(Box<CanWatch>),
}

impl Client {
    pub fn new(
        world: &World,
        host: NodeId,
        wire: WireId,
        axes: Vec<Axis>,
        random: &mut Random,
    ) -> Self {
        let (mut random, medium) = (random.fork(), world.medium(wire));
        let protocol = axes.first().map_or("", |axis| axis.protocol);
        let watch = match medium {
            MediumKind::Serial => Judge::Serial(Box::new(Watch::new(host, wire, protocol))),
            MediumKind::Can => {
                Judge::Can(Box::new(CanWatch::new(host, wire, world.bit_rate(wire))))
            }
        };
        Self {
            host,
            wire,
            medium,
            axes,
            next_at: Instant::ZERO,
            watch,
            mistaken: Vec::new(),
            heard: 0,
            off: 0,
            clashed: false,
            tickets: 0,
            think_us: random.pick(&[500, 5_000, 50_000]),
            open_max: random.between(1, 6) as usize,
            sound: false,
            calm_at: Instant::FAR,
            random,
        }
    }

    /// Others are on the wire too, who must get a word in: at most `open_max` questions, one in so
    /// many µs.
    pub fn share(&mut self, think_us: u64, open_max: usize) {
        self.think_us = self.think_us.max(think_us);
        self.open_max = self.open_max.min(open_max);
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
        let standing = world.standing(self.wire, self.host);
        if let Some(standing) = standing.filter(|standing| standing.off > self.off) {
            self.off = standing.off;
            self.disarmed();
            self.clashed = standing.clashed == Some(NMT);
        }
        self.notice_spoiling(world, report);
        for axis in &mut self.axes {
            let standings = (standing.as_ref(), world.standing(self.wire, axis.drive));
            report.violations_of(axis.after(world, self.host, standings));
        }
        let mut ends = Vec::new();
        while let Some(end) =
            world.look(self.host, |n, _| n.axes().and_then(|axes| axes.poll_outcome()))
        {
            ends.push(end);
        }
        self.judge(world, report, &ends);
        for (ticket, outcome) in ends {
            self.ended(world, report, ticket, outcome);
        }
    }

    fn judge(&mut self, world: &mut World, report: &mut Report, ends: &[(Ticket, Outcome)]) {
        let gave_up: Vec<_> = ends
            .iter()
            .filter(|(_, outcome)| {
                matches!(outcome.failure(), Some(Failure::Silent | Failure::Misbehaved))
            })
            .collect();
        let copied = match &mut self.watch {
            Judge::Serial(watch) => {
                let copies = watch.copies_taken;
                report.violations_of(watch.after(world, !gave_up.is_empty()));
                let heard = world.knowledge(self.wire, self.host).heard_others;
                let fresh = std::mem::replace(&mut self.heard, heard.tag) != heard.tag;
                let mistaken = fresh && self.mistaken.contains(&heard.answers);
                report.wire_collisions += u64::from(mistaken);
                watch.copies_taken > copies || mistaken
            }
            Judge::Can(watch) => {
                let has = |axis: &&Axis, t| axis.open.iter().any(|open| open.ticket == t);
                let axis = |t| self.axes.iter().find(|axis| has(axis, t));
                let waits = |t: Ticket| !ends.iter().any(|(ended, _)| *ended == t);
                let verb = |axis: &Axis| axis.verb_since(waits);
                let drives = gave_up.iter().filter_map(|(t, _)| axis(*t));
                let drives: Vec<_> = drives.map(|axis| (axis.drive, verb(axis))).collect();
                let believed = (watch.copies_taken, watch.strange_taken);
                report.violations_of(watch.after(world, &drives));
                let copied = watch.copies_taken > believed.0;
                if copied {
                    let from = watch.last_from;
                    let place = |a: &Axis| world.standing(self.wire, a.drive).map(|s| s.plug);
                    let whose = self.axes.iter().find(|axis| place(axis) == Some(from));
                    let protocol = whose.map_or("a twin", |axis| axis.protocol);
                    *report.copies_on.entry(protocol).or_default() += 1;
                }
                report.wire_collisions += watch.strange_taken - believed.1;
                copied || watch.strange_taken > believed.1
            }
        };
        if copied {
            // What came of it is no knowledge, right or wrong.
            self.axes.iter_mut().for_each(Axis::forget);
        }
    }

    /// A drive that answers after bytes were changed may have taken them for a request; and on CAN
    /// one may have taken a stranger's frame.
    fn notice_spoiling(&mut self, world: &World, report: &mut Report) {
        let old = self.mistaken.len().saturating_sub(MISTAKEN_MAX);
        self.mistaken.drain(..old);
        for axis in &mut self.axes {
            let misled = match &self.watch {
                Judge::Serial(watch) => {
                    let sent = world.knowledge(self.wire, axis.drive).sent;
                    let fresh = std::mem::replace(&mut axis.judged, sent.tag) != sent.tag;
                    let misled = fresh && sent.tainted && watch.misled(world, axis.drive);
                    let mistook = misled && watch.mistook(world, axis.drive);
                    self.mistaken.extend(mistook.then_some(sent.answers));
                    misled
                }
                Judge::Can(_) => {
                    let misled = world.standing(self.wire, axis.drive).map_or(0, |s| s.misled);
                    std::mem::replace(&mut axis.misled, misled) != misled
                }
            };
            if misled {
                report.requests_collided += 1;
                (axis.spoiled, axis.elsewhere) = (true, true);
                axis.forget();
            }
        }
    }

    /// Whether a wrong value comes of what no host can tell.
    fn excuses(&self, world: &World) -> Option<Excuse> {
        match &self.watch {
            Judge::Serial(watch) if watch.last_match_copied => Some(Excuse::Copy),
            Judge::Serial(watch) => {
                (watch.last_match_tainted && watch.collided(world)).then_some(Excuse::Collision)
            }
            Judge::Can(watch) => match watch.last_match {
                Match::Sound => None,
                Match::Copied | Match::Unknown => Some(Excuse::Copy),
                Match::Strange => Some(Excuse::Collision),
            },
        }
    }

    fn ended(&mut self, world: &mut World, report: &mut Report, ticket: Ticket, outcome: Outcome) {
        report.write(world.now(), || format!("{:?} {ticket:?} ends: {outcome:?}", self.host));
        match outcome {
            Outcome::Done(_) => report.done += 1,
            Outcome::NotDone(_) => report.not_done += 1,
            Outcome::Partly(..) | Outcome::Unknown(_) => report.unknown += 1,
        }
        let excuse = self.excuses(world);
        let owner = self.axes.iter_mut().find(|a| a.open.iter().any(|o| o.ticket == ticket));
        let at = world.now();
        let Some(axis) = owner else {
            let what = format!("{ticket:?} ended twice or was never asked: {outcome:?}");
            return report.violations_of([Violation { invariant: "I3", at, what }]);
        };
        let open = axis.open.iter().find(|o| o.ticket == ticket).copied();
        match axis.ended(world, self.host, ticket, outcome) {
            Err((invariant, what)) if excuse.is_none() => {
                let what = format!("{} {:?}: {what}", axis.profile.name, axis.index);
                report.violations_of([Violation { invariant, at, what }]);
            }
            found if excuse.is_some() => {
                let collided = found.is_err() && excuse == Some(Excuse::Collision);
                report.wire_collisions += u64::from(collided);
                // What nobody sent is no knowledge either where it contradicts nothing yet.
                axis.forget();
            }
            _ => {}
        }
        let must_work = self.sound || open.is_some_and(|o| o.since >= self.calm_at);
        // A stop may end a read: that is an answer too. And a value may look like a refusal.
        let ends = [Failure::Cancelled, Failure::Refused { code: REFUSED }];
        let answered = matches!(outcome, Outcome::Done(_))
            || ends.iter().any(|end| outcome == Outcome::NotDone(*end));
        let question = matches!(open.map(|o| o.what), Some(What::Read(_) | What::Look(..)));
        if self.clashed && outcome == Outcome::NotDone(Failure::LinkDown) {
            report.clashes += u64::from(must_work && question);
        } else if must_work && question && !answered && !axis.elsewhere {
            let what =
                format!("{} {:?}: {open:?} ended as {outcome:?}", axis.profile.name, axis.index);
            let invariant = if self.sound { "I9" } else { "I11" };
            report.violations_of([Violation { invariant, at, what }]);
        }
    }

    /// The link went down or came up: nothing may be armed any more.
    pub fn disarmed(&mut self) {
        self.clashed = false;
        self.axes.iter_mut().for_each(Axis::disarmed);
    }

    /// The world ends: whatever was asked long ago must have ended.
    pub fn close(&mut self, world: &mut World, report: &mut Report) {
        let now = world.now();
        let counters: Option<Counters> =
            world.look(self.host, |n, _| n.axes().map(|a| a.counters()));
        report.requests += counters.unwrap_or_default().sent;
        report.copies_taken += match &self.watch {
            Judge::Serial(watch) => watch.copies_taken,
            Judge::Can(watch) => watch.copies_taken,
        };
        for axis in &self.axes {
            report.repeated += axis.repeated;
            if axis.untold > 0 {
                *report.untold_on.entry(axis.protocol).or_default() += axis.untold;
            }
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
