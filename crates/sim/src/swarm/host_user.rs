//! The random user of one host: reads, writes, moves, stops, and records its expectations.

use polepair_core::error::{Failure, Outcome};
use polepair_core::medium::MediumKind;
use polepair_core::proto::thruster::wire::REFUSED;
use polepair_core::station::{Counters, Ticket};
use polepair_core::time::Instant;

use super::axis::{AxisAction, SwarmAxis};
use super::{RECOVERY_MS, WorldReport};
use crate::check::{CanChecker, ReplyMatch, SerialChecker, Violation};
use crate::random::Random;
use crate::world::{NodeId, WireId, World};

/// Limit of the list of changed requests that a drive accepted.
const MISTAKEN_MAX: usize = 16;
/// Time within which every request must have ended; homing is the longest.
const ANSWER_MAX_MS: u32 = 120_000;

/// The identifier by which a network is commanded (CiA 301), and that it is a standard one.
const NMT: (u32, bool) = (0, false);

/// One host with its user.
#[derive(Debug)]
pub struct HostUser {
    pub host: NodeId,
    pub wire: WireId,
    pub medium: MediumKind,
    pub axes: Vec<SwarmAxis>,
    pub next_at: Instant,
    checker: InvariantChecker,
    /// The last requests that were changed on the way, passed every check and were answered. Where a reply has no
    /// sender, as TML's acknowledgement, the host cannot notice that another drive sent it, or executed something else.
    mistaken_requests: Vec<u32>,
    /// The last transmission that the host received.
    last_heard: u32,
    /// Number of times the host's controller went bus-off so far.
    bus_off_count: u64,
    /// True if its link was lost because another program commanded the network (NMT) at the same instants. CiA 301 has
    /// one master for that; a host cannot see the frames that wait in the controller of another, and cannot cancel
    /// those in its own.
    lost_to_clash: bool,
    random: Random,
    tickets: u32,
    /// Longest time between two questions, µs.
    think_time_us: u64,
    /// Questions that may be open at once.
    open_max: usize,
    /// Nothing but the splitting of bytes goes wrong here: every question must be answered.
    pub fault_free: bool,
    /// From here on every question must be answered.
    must_work_from: Instant,
}

/// Reason for which a wrong value is excused.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum Excuse {
    /// A second copy was taken for the answer.
    Copy,
    /// A frame of no sender passed every check.
    Collision,
}

/// Checker of the host, by its medium.
#[derive(Debug)]
enum InvariantChecker {
    Serial(Box<SerialChecker>),
    Can(Box<CanChecker>),
}

impl HostUser {
    pub fn new(
        world: &World,
        host: NodeId,
        wire: WireId,
        axes: Vec<SwarmAxis>,
        random: &mut Random,
    ) -> Self {
        let (mut random, medium) = (random.fork(), world.medium(wire));
        let protocol = axes.first().map_or("", |axis| axis.protocol);
        let checker = match medium {
            MediumKind::Serial => {
                InvariantChecker::Serial(Box::new(SerialChecker::new(host, wire, protocol)))
            }
            MediumKind::Can => {
                InvariantChecker::Can(Box::new(CanChecker::new(host, wire, world.bit_rate(wire))))
            }
        };
        Self {
            host,
            wire,
            medium,
            axes,
            next_at: Instant::ZERO,
            checker,
            mistaken_requests: Vec::new(),
            last_heard: 0,
            bus_off_count: 0,
            lost_to_clash: false,
            tickets: 0,
            think_time_us: random.pick(&[500, 5_000, 50_000]),
            open_max: random.between(1, 6) as usize,
            fault_free: false,
            must_work_from: Instant::FAR_FUTURE,
            random,
        }
    }

    /// Leaves room for others on the wire: at most `open_max` questions, one in `think_us` µs.
    pub fn limit_rate(&mut self, think_us: u64, open_max: usize) {
        self.think_time_us = self.think_time_us.max(think_us);
        self.open_max = self.open_max.min(open_max);
    }

    /// The faults have ended: from `now` plus the time to recover on everything must work.
    pub fn end_faults(&mut self, now: Instant) {
        self.must_work_from = now.plus_ms(RECOVERY_MS);
    }

    /// Asks something, and decides when to ask next.
    pub fn submit_random(&mut self, world: &mut World, report: &mut WorldReport) {
        let now = world.now();
        self.next_at = now.plus_ns(1 + self.random.below(self.think_time_us * 1_000));
        let open: usize = self.axes.iter().map(|axis| axis.open.len()).sum();
        if open >= self.open_max || self.axes.is_empty() {
            return;
        }
        let which = self.random.below(self.axes.len() as u64) as usize;
        let drawn = self.axes[which].draw_action(&mut self.random);
        let calm = now >= self.must_work_from;
        let what = match drawn {
            Some(AxisAction::Command(_)) if calm => self.axes[which].liveness_read(),
            drawn => drawn,
        };
        if let Some(what) = what {
            self.tickets += 1;
            let ticket = Ticket(self.tickets);
            let accepted =
                self.axes[which].submit(world, self.host, ticket, what, &mut self.random);
            if accepted && !self.axes[which].may_execute(what) {
                let what = format!("{ticket:?} {what:?} was taken by an axis that is not armed");
                report.add_violations([Violation { invariant: "I6", at: now, what }]);
            }
            report.log_event(now, || {
                format!("{:?} {ticket:?} axis {which}: {what:?}, taken {accepted}", self.host)
            });
        }
    }

    /// Checks everything after an event that touched this host.
    pub fn check_event(&mut self, world: &mut World, report: &mut WorldReport) {
        let standing = world.can_status(self.wire, self.host);
        if let Some(standing) =
            standing.filter(|standing| standing.bus_off_count > self.bus_off_count)
        {
            self.bus_off_count = standing.bus_off_count;
            self.record_link_lost();
            self.lost_to_clash = standing.clash_id == Some(NMT);
        }
        self.detect_misled_drives(world, report);
        for axis in &mut self.axes {
            let standings = (standing.as_ref(), world.can_status(self.wire, axis.drive));
            report.add_violations(axis.check_event(world, self.host, standings));
        }
        let mut ends = Vec::new();
        while let Some(end) =
            world.inspect(self.host, |n, _| n.axes().and_then(|axes| axes.poll_outcome()))
        {
            ends.push(end);
        }
        self.check_invariants(world, report, &ends);
        for (ticket, outcome) in ends {
            self.check_outcome(world, report, ticket, outcome);
        }
    }

    fn check_invariants(
        &mut self,
        world: &mut World,
        report: &mut WorldReport,
        ends: &[(Ticket, Outcome)],
    ) {
        let gave_up: Vec<_> = ends
            .iter()
            .filter(|(_, outcome)| {
                matches!(outcome.failure(), Some(Failure::Silent | Failure::Misbehaved))
            })
            .collect();
        let copied = match &mut self.checker {
            InvariantChecker::Serial(watch) => {
                let copies = watch.copies_taken;
                report.add_violations(watch.check_event(world, !gave_up.is_empty()));
                let transmission_label = world.serial_status(self.wire, self.host).last_from_others;
                let fresh = std::mem::replace(&mut self.last_heard, transmission_label.tag)
                    != transmission_label.tag;
                let mistaken =
                    fresh && self.mistaken_requests.contains(&transmission_label.answers);
                report.wire_collisions += u64::from(mistaken);
                watch.copies_taken > copies || mistaken
            }
            InvariantChecker::Can(watch) => {
                let axis = |t| self.axes.iter().find(|axis| has_ticket(axis, t));
                let drives = gave_up.iter().filter_map(|(t, _)| axis(*t));
                let drives: Vec<_> =
                    drives.map(|axis| (axis.drive, open_verb_since(axis, ends))).collect();
                let believed = (watch.copies_taken, watch.intruder_taken);
                report.add_violations(watch.check_event(world, &drives));
                let copied = watch.copies_taken > believed.0;
                if copied {
                    let from = watch.last_sender;
                    let locate =
                        |a: &SwarmAxis| world.can_status(self.wire, a.drive).map(|s| s.plug);
                    let whose = self.axes.iter().find(|axis| locate(axis) == Some(from));
                    let protocol = whose.map_or("a twin", |axis| axis.protocol);
                    *report.copies_on.entry(protocol).or_default() += 1;
                }
                report.wire_collisions += watch.intruder_taken - believed.1;
                copied || watch.intruder_taken > believed.1
            }
        };
        if copied {
            // Its result is no knowledge, right or wrong.
            self.axes.iter_mut().for_each(SwarmAxis::invalidate);
        }
    }

    /// A drive that answers after bytes were changed may have taken them for a request; and on CAN
    /// one may have taken an intruder's frame.
    fn detect_misled_drives(&mut self, world: &World, report: &mut WorldReport) {
        let old = self.mistaken_requests.len().saturating_sub(MISTAKEN_MAX);
        self.mistaken_requests.drain(..old);
        for axis in &mut self.axes {
            let misled = match &self.checker {
                InvariantChecker::Serial(watch) => {
                    let sent = world.serial_status(self.wire, axis.drive).last_sent;
                    let fresh = std::mem::replace(&mut axis.last_judged, sent.tag) != sent.tag;
                    let misled = fresh && sent.tainted && watch.accepted_unsent(world, axis.drive);
                    let mistook = misled && watch.accepted_changed(world, axis.drive);
                    self.mistaken_requests.extend(mistook.then_some(sent.answers));
                    misled
                }
                InvariantChecker::Can(_) => {
                    let misled =
                        world.can_status(self.wire, axis.drive).map_or(0, |s| s.intruder_frames);
                    std::mem::replace(&mut axis.intruder_frames, misled) != misled
                }
            };
            if misled {
                report.requests_collided += 1;
                (axis.untrusted, axis.address_uncertain) = (true, true);
                axis.invalidate();
            }
        }
    }

    /// Reason for which no host could notice a wrong value, if there is one.
    fn find_excuse(&self, world: &World) -> Option<Excuse> {
        match &self.checker {
            InvariantChecker::Serial(watch) if watch.last_match_copied => Some(Excuse::Copy),
            InvariantChecker::Serial(watch) => (watch.last_match_tainted
                && watch.is_wire_collision(world))
            .then_some(Excuse::Collision),
            InvariantChecker::Can(watch) => match watch.last_match {
                ReplyMatch::Sound => None,
                ReplyMatch::Copy | ReplyMatch::Unknown => Some(Excuse::Copy),
                ReplyMatch::Intruder => Some(Excuse::Collision),
            },
        }
    }

    fn check_outcome(
        &mut self,
        world: &mut World,
        report: &mut WorldReport,
        ticket: Ticket,
        outcome: Outcome,
    ) {
        report.log_event(world.now(), || format!("{:?} {ticket:?} ends: {outcome:?}", self.host));
        match outcome {
            Outcome::Done(_) => report.done += 1,
            Outcome::NotDone(_) => report.not_done += 1,
            Outcome::Partly(..) | Outcome::Unknown(_) => report.unknown += 1,
        }
        let excuse = self.find_excuse(world);
        let owner = self.axes.iter_mut().find(|a| a.open.iter().any(|o| o.ticket == ticket));
        let at = world.now();
        let Some(axis) = owner else {
            let what = format!("{ticket:?} ended twice or was never asked: {outcome:?}");
            return report.add_violations([Violation { invariant: "I3", at, what }]);
        };
        let open = axis.open.iter().find(|o| o.ticket == ticket).copied();
        match axis.check_outcome(world, self.host, ticket, outcome) {
            Err((invariant, what)) if excuse.is_none() => {
                let what = format!("{} {:?}: {what}", axis.profile.name, axis.index);
                report.add_violations([Violation { invariant, at, what }]);
            }
            found if excuse.is_some() => {
                let collided = found.is_err() && excuse == Some(Excuse::Collision);
                report.wire_collisions += u64::from(collided);
                // A frame of no sender is no knowledge either if it contradicts nothing yet.
                axis.invalidate();
            }
            _ => {}
        }
        let must_work = self.fault_free || open.is_some_and(|o| o.asked_at >= self.must_work_from);
        // A stop may end a read: that is an answer too. And a value may look like a refusal.
        let ends = [Failure::Cancelled, Failure::Refused { code: REFUSED }];
        let answered = matches!(outcome, Outcome::Done(_))
            || ends.iter().any(|end| outcome == Outcome::NotDone(*end));
        let question = matches!(
            open.map(|o| o.action),
            Some(AxisAction::Read(_) | AxisAction::ReadSignal(..))
        );
        if self.lost_to_clash && outcome == Outcome::NotDone(Failure::LinkDown) {
            report.clashes += u64::from(must_work && question);
        } else if must_work && question && !answered && !axis.address_uncertain {
            let what =
                format!("{} {:?}: {open:?} ended as {outcome:?}", axis.profile.name, axis.index);
            let invariant = if self.fault_free { "I9" } else { "I11" };
            report.add_violations([Violation { invariant, at, what }]);
        }
    }

    /// The link went down or came up: nothing may be armed any more.
    pub fn record_link_lost(&mut self) {
        self.lost_to_clash = false;
        self.axes.iter_mut().for_each(SwarmAxis::record_disarmed);
    }

    /// The world ends: whatever was asked long ago must have ended.
    pub fn finish(&mut self, world: &mut World, report: &mut WorldReport) {
        let now = world.now();
        let counters: Option<Counters> =
            world.inspect(self.host, |n, _| n.axes().map(|a| a.counters()));
        report.requests += counters.expect("the host is in its world").sent;
        report.copies_taken += match &self.checker {
            InvariantChecker::Serial(watch) => watch.copies_taken,
            InvariantChecker::Can(watch) => watch.copies_taken,
        };
        for axis in &self.axes {
            report.repeated += axis.repeated;
            if axis.unreported > 0 {
                *report.unreported_on.entry(axis.protocol).or_default() += axis.unreported;
            }
            report.starts += axis.truth(world).starts;
        }
        for open in self.axes.iter().flat_map(|axis| &axis.open) {
            if open.asked_at.plus_ms(ANSWER_MAX_MS) < now {
                let what = format!("{open:?} never ended");
                report.add_violations([Violation { invariant: "I11", at: now, what }]);
            }
        }
    }
}

fn open_verb_since(axis: &SwarmAxis, ends: &[(Ticket, Outcome)]) -> Option<Instant> {
    axis.verb_since(|t| !ends.iter().any(|(ended, _)| *ended == t))
}

fn has_ticket(axis: &&SwarmAxis, t: Ticket) -> bool {
    axis.open.iter().any(|open| open.ticket == t)
}
