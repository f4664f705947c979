//! State of one axis and its drive in a world, and the invariants between them.

#[cfg(test)]
mod tests;
mod witness;

use polepair_core::axis::{Command, Verb};
use polepair_core::error::{Failure, Outcome};
use polepair_core::profile::{AxisKind, Encoding, ParameterId, Profile, Signal};
use polepair_core::station::{AxisIndex, Ticket};
use polepair_core::time::Instant;
use polepair_drives::surroundings::GroundTruth;

use super::inert::InertParameter;
use super::observer::{MotionObserver, MotionViolation};
use crate::can_bus::CanPlugStatus;
use crate::check::{PossibleValues, Violation};
use crate::random::{Ppm, Random};
use crate::world::{NodeId, World};
use witness::ClaimWitness;

/// Speed that is asked for at most, rad/s.
const SPEED_MAX: i64 = 30;
/// A motor at rest creeps less than this, rad/s.
const REST_SPEED: f64 = 0.5;
/// Powering a motor at rest may move it so far, rad: it settles on the nearest count.
const JUMP_MAX: f64 = 0.3;
/// A reading of the position may be off by this, rad, besides what the motor moves meanwhile.
const POSITION_ERROR_MAX: f64 = 0.1;

/// Chance that a write makes a drive ready for a request, and that an axis stays disarmed.
const READY_CHANCE: Ppm = Ppm(330_000);
const FORGET_CHANCE: Ppm = Ppm(100_000);

/// A request to an axis.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum AxisAction {
    /// Reads inert parameter n.
    Read(usize),
    /// Writes inert parameter n.
    Write(usize, i64),
    /// Reads a signal.
    ReadSignal(Signal, ParameterId),
    /// A verb.
    Command(Verb),
}

/// A question under way.
#[derive(Clone, Copy, Debug)]
pub struct OpenAction {
    pub ticket: Ticket,
    pub action: AxisAction,
    pub asked_at: Instant,
    truth_before: GroundTruth,
    /// Damage by the wire until then: see [`FrameDamage`].
    damage: FrameDamage,
    /// The drive lost its supply, or took a changed request as good, meanwhile.
    pub doubtful: bool,
}

/// One axis and its drive.
#[derive(Debug)]
pub struct SwarmAxis {
    pub index: AxisIndex,
    pub drive: NodeId,
    pub profile: &'static Profile,
    pub protocol: &'static str,
    pub open: Vec<OpenAction>,
    inert: Vec<(InertParameter, PossibleValues)>,
    /// Position reported minus position true, while it is known to be constant.
    position_offset: Option<f64>,
    homing_idle: HomingIdle,
    observer: MotionObserver,
    witness: ClaimWitness,
    /// Something outside the wire holds its motor, or has taken its power: its motion is its own.
    pub disturbed: bool,
    disturbed_at: Option<Instant>,
    /// True if it was armed since its link was last lost.
    armed: bool,
    /// The drive's last transmission that was looked at.
    pub last_judged: u32,
    /// True if the drive may have executed a request of no host.
    pub untrusted: bool,
    /// And may no longer be where it was: at another address or baud rate.
    pub address_uncertain: bool,
    /// Intruders' frames that its drive may have obeyed so far.
    pub intruder_frames: u64,
    /// Another drive of the same address is on the wire.
    pub has_twin: bool,
    damage: FrameDamage,
    /// True if a motion ended without certainty and the host's controller has not been empty since: its frame may
    /// still be on the wire.
    late_motion: bool,
    /// Verbs executed twice, because their frame was received twice: the drive cannot distinguish that from two
    /// requests.
    pub repeated: u64,
    /// Verbs that count as done although the drive missed their frame, which the host cannot notice.
    pub unreported: u64,
}

/// Damage by a bus so far to the frames of an axis.
#[derive(Clone, Copy, Debug, Default)]
struct FrameDamage {
    /// Frames of the host that were taken twice.
    taken_twice: u64,
    /// Frames of hosts that the drive did not get.
    missed: u64,
}

/// Time since which a drive is known to carry out no homing.
#[derive(Clone, Copy, Debug)]
struct HomingIdle(Option<Instant>);

impl Default for HomingIdle {
    fn default() -> Self {
        Self(Some(Instant::ZERO))
    }
}

impl HomingIdle {
    /// A verb has ended. Returns whether the drive's zero may be another than before.
    fn record_end(&mut self, now: Instant, verb: Verb, outcome: Outcome) -> bool {
        let done = matches!(outcome, Outcome::Done(_));
        match verb {
            // The drive goes on with what was begun, whatever the host's job came to.
            Verb::Home if matches!(outcome, Outcome::Partly(..) | Outcome::Unknown(_)) => {
                self.0 = None;
            }
            Verb::Home => self.0 = Some(now),
            Verb::Stop | Verb::QuickStop | Verb::Disable if done && self.0.is_none() => {
                self.0 = Some(now);
            }
            _ => return false,
        }
        true
    }

    /// Returns whether that was so already when something was asked then.
    fn is_idle_since(self, then: Instant) -> bool {
        self.0.is_some_and(|since| since <= then)
    }
}

impl SwarmAxis {
    pub fn new(
        index: AxisIndex,
        drive: NodeId,
        profile: &'static Profile,
        protocol: &'static str,
        inert: &[InertParameter],
    ) -> Self {
        let inert = inert.iter().map(|i| (*i, PossibleValues::ANY)).collect();
        let open = Vec::new();
        Self {
            index,
            drive,
            profile,
            protocol,
            open,
            inert,
            position_offset: None,
            homing_idle: HomingIdle::default(),
            observer: MotionObserver::default(),
            witness: ClaimWitness::default(),
            disturbed: false,
            disturbed_at: None,
            armed: false,
            last_judged: 0,
            untrusted: false,
            address_uncertain: false,
            intruder_frames: 0,
            has_twin: false,
            damage: FrameDamage::default(),
            late_motion: false,
            repeated: 0,
            unreported: 0,
        }
    }

    /// True state of the drive now.
    pub fn truth(&self, world: &mut World) -> GroundTruth {
        world
            .inspect(self.drive, |n, now| n.surroundings().map(|b| b.ground_truth(now)))
            .expect("the drive is in its world")
    }

    /// Nothing that was known of the drive holds any more.
    pub fn invalidate(&mut self) {
        self.inert.iter_mut().for_each(|(_, possible)| *possible = PossibleValues::ANY);
        self.open.iter_mut().for_each(|open| open.doubtful = true);
        self.position_offset = None;
        self.observer.invalidate();
        self.witness.forget();
    }

    /// Something is done to the drive from outside the wire.
    pub fn record_disturbance(&mut self, now: Instant) {
        (self.disturbed, self.disturbed_at) = (true, Some(now));
        // A stepper module has no switch, and counts the steps that a jam takes from its motor.
        if self.profile.signal(Signal::Enabled).is_none() {
            self.position_offset = None;
            self.witness.forget();
        }
        self.observer.invalidate();
    }

    /// Records that the link was lost: until the axis is armed, nothing may start its motor.
    pub fn record_disarmed(&mut self) {
        self.armed = false;
        self.observer.record_link_lost();
    }

    /// Checks drive and host after an event.
    pub fn check_event(
        &mut self,
        world: &mut World,
        host: NodeId,
        standings: (Option<&CanPlugStatus>, Option<CanPlugStatus>),
    ) -> Option<Violation> {
        let (own, drives) = standings;

        let truth = self.truth(world);
        // A frame in the controller cannot be recalled.
        let waits = own.is_some_and(|standing| standing.is_waiting);
        self.late_motion &= waits;
        let going = waits || self.open.iter().any(|open| starts_motion(open.action));
        let toll = FrameDamage {
            taken_twice: own.map_or(0, |standing| standing.taken_twice),
            missed: drives.map_or(0, |standing| standing.missed),
        };
        self.observer.record_duplicates(toll.taken_twice - self.damage.taken_twice);
        self.damage = toll;
        let found = if self.disturbed {
            None
        } else {
            self.observer
                .check(world.now(), truth, going || self.untrusted)
                .or_else(|| self.check_enable_jump(&truth))
        };
        let found = found.or_else(|| {
            let armed = world.inspect(host, |n, _| n.axes()?.state(self.index).map(|s| s.armed));
            let unasked = armed == Some(true) && !self.armed;
            unasked.then(|| ("I6", "armed, but nobody armed it since the link was lost".into()))
        });
        let (name, index, at) = (self.profile.name, self.index, world.now());
        found.map(|(invariant, what)| Violation {
            invariant,
            at,
            what: format!("{name} {index:?}: {what}"),
        })
    }

    /// Returns whether a lane may take such a question now.
    pub fn may_execute(&self, what: AxisAction) -> bool {
        self.armed || !starts_motion(what)
    }

    /// Since when a verb is open, of those tickets that `waits` names.
    pub fn verb_since(&self, waits: impl Fn(Ticket) -> bool) -> Option<Instant> {
        let verbs = self.open.iter().filter(|open| matches!(open.action, AxisAction::Command(_)));
        verbs.filter(|open| waits(open.ticket)).map(|open| open.asked_at).min()
    }

    /// Powering a motor at rest leaves it where it is.
    fn check_enable_jump(&self, truth: &GroundTruth) -> Option<MotionViolation> {
        let open =
            self.open.iter().find(|open| open.action == AxisAction::Command(Verb::Enable))?;
        let from = &open.truth_before;
        let alone = !self.open.iter().any(|open| is_motion(open.action));
        let judged = alone && !open.doubtful && !self.untrusted;
        let rested = from.velocity.abs() < REST_SPEED && !from.enabled;
        let jump = (truth.position - from.position).abs();
        (judged && rested && jump > JUMP_MAX)
            .then(|| ("I7", format!("enabling moved the motor by {jump:.3} rad")))
    }

    /// Something to ask, or `None` when what was drawn is under way already.
    pub fn draw_action(&self, random: &mut Random) -> Option<AxisAction> {
        let what = match random.below(10) {
            0..=2 if !self.inert.is_empty() => {
                AxisAction::Read(random.below(self.inert.len() as u64) as usize)
            }
            3..=4 if !self.inert.is_empty() => self.draw_write(random),
            5..=7 => {
                let source = self
                    .profile
                    .signals
                    .get(random.below(self.profile.signals.len().max(1) as u64) as usize)?;
                AxisAction::ReadSignal(source.signal, source.parameter)
            }
            _ => AxisAction::Command(random.pick(&VERBS)),
        };
        (!self.open.iter().any(|open| match (open.action, what) {
            (
                AxisAction::Read(a) | AxisAction::Write(a, _),
                AxisAction::Read(b) | AxisAction::Write(b, _),
            ) => a == b,
            (AxisAction::Command(a), AxisAction::Command(b)) => a == b,
            _ => false,
        }))
        .then_some(what)
    }

    /// A value for an inert parameter; often one without which some plan refuses to begin.
    fn draw_write(&self, random: &mut Random) -> AxisAction {
        let wanted = self.inert.iter().position(|(inert, _)| !inert.required.is_empty());
        if let Some(n) = wanted.filter(|_| random.chance(READY_CHANCE)) {
            return AxisAction::Write(n, random.pick(self.inert[n].0.required));
        }
        let n = random.below(self.inert.len() as u64) as usize;
        let range = self.inert[n].0;
        AxisAction::Write(n, random.between(range.min, range.max))
    }

    /// The signal that is polled to see whether the drive answers.
    pub fn liveness_read(&self) -> Option<AxisAction> {
        let source = self.profile.signals.first()?;
        Some(AxisAction::ReadSignal(source.signal, source.parameter))
    }

    /// Submits a question. Returns whether it was taken.
    pub fn submit(
        &mut self,
        world: &mut World,
        host: NodeId,
        ticket: Ticket,
        what: AxisAction,
        random: &mut Random,
    ) -> bool {
        let before = self.truth(world);
        let axis = self.index;
        let command = match what {
            AxisAction::Command(verb) => Some(random_command(verb, random)),
            _ => None,
        };
        // In some worlds the axis is not armed.
        let arms = starts_motion(what) && !random.chance(FORGET_CHANCE);
        let armed = self.armed || arms;
        let taken = world.with_node(host, |node, now| {
            let axes = node.axes()?;
            match (what, command) {
                (AxisAction::Read(n), _) => {
                    axes.read_parameter(now, ticket, axis, self.inert_id(n)).ok()
                }
                (AxisAction::Write(n, raw), _) => {
                    axes.write_parameter(now, ticket, axis, self.inert_id(n), raw, false).ok()
                }
                (AxisAction::ReadSignal(_, parameter), _) => {
                    axes.read_parameter(now, ticket, axis, parameter).ok()
                }
                (AxisAction::Command(_), Some(command)) => {
                    if arms {
                        axes.set_armed(axis, true);
                    }
                    axes.command(now, ticket, axis, command).ok()
                }
                _ => None,
            }
        });
        if taken.is_some() {
            if let AxisAction::Command(Verb::Home) = what {
                self.position_offset = None;
            }
            if let Some(command) = &command {
                let profile = self.profile;
                self.witness.record_command(profile, command, &before, self.position_offset);
            }
            if starts_motion(what) {
                let by = command.filter(|c| c.verb == Verb::MoveBy && self.is_rotary());
                self.observer.record_verb(world.now(), &before, by.and_then(|c| c.target));
            }
            let since = world.now();
            self.open.push(OpenAction {
                ticket,
                action: what,
                asked_at: since,
                truth_before: before,
                damage: self.damage,
                doubtful: self.late_motion,
            });
        }
        self.armed = armed;
        taken.is_some()
    }

    fn inert_id(&self, n: usize) -> ParameterId {
        self.inert[n].0.id
    }

    /// Checks the end of a request. The text has the fault and the invariant that it violates.
    pub fn check_outcome(
        &mut self,
        world: &mut World,
        host: NodeId,
        ticket: Ticket,
        outcome: Outcome,
    ) -> Result<(), (&'static str, String)> {
        let Some(at) = self.open.iter().position(|open| open.ticket == ticket) else {
            return Err(("I3", format!("{ticket:?} ended twice or was never asked: {outcome:?}")));
        };
        let open = self.open.swap_remove(at);
        match (open.action, outcome) {
            (AxisAction::Read(n), Outcome::Done(raw)) => self.check_read(n, raw, open.doubtful),
            (AxisAction::Write(n, raw), outcome) => {
                self.record_write(n, raw, outcome, open.doubtful);
                Ok(())
            }
            // A value read before a drive's restart does not hold after it.
            (AxisAction::ReadSignal(Signal::Position, id), Outcome::Done(raw))
                if !open.doubtful
                    && self.observer.rested_since(open.asked_at)
                    && self.homing_idle.is_idle_since(open.asked_at) =>
            {
                self.check_position(world, host, id, raw)
            }
            (AxisAction::Command(verb), outcome) => self.check_verb(world, verb, outcome, &open),
            _ => Ok(()),
        }
    }

    fn check_read(
        &mut self,
        n: usize,
        raw: i64,
        doubtful: bool,
    ) -> Result<(), (&'static str, String)> {
        let (inert, possible) = &mut self.inert[n];
        let known = possible.clone();
        if doubtful || self.has_twin {
            // The answer may be older than what made it doubtful.
            *possible = PossibleValues::ANY;
            return Ok(());
        }
        if possible.observe(raw) {
            return Ok(());
        }
        let name = self.profile.parameter(inert.id).map_or("?", |p| p.name);
        Err(("I3", format!("{name} reads {raw}, but is {known:?}")))
    }

    fn record_write(&mut self, n: usize, raw: i64, outcome: Outcome, doubtful: bool) {
        let possible = &mut self.inert[n].1;
        match outcome {
            _ if doubtful => *possible = PossibleValues::ANY,
            Outcome::Done(_) => possible.set(raw),
            Outcome::Unknown(_) | Outcome::Partly(..) => possible.add(raw),
            Outcome::NotDone(_) => {}
        }
    }

    fn is_rotary(&self) -> bool {
        self.profile.axis == AxisKind::Rotary
    }

    /// The position reported must follow the shaft, apart from a constant.
    fn check_position(
        &mut self,
        world: &mut World,
        host: NodeId,
        id: ParameterId,
        raw: i64,
    ) -> Result<(), (&'static str, String)> {
        let truth = self.truth(world);
        let reported = world.inspect(host, |n, _| n.axes()?.to_si(self.index, id, raw));
        let Some(reported) = reported.filter(|_| self.is_rotary()) else { return Ok(()) };
        let homing = self.open.iter().any(|open| open.action == AxisAction::Command(Verb::Home));
        if self.untrusted || homing {
            return Ok(());
        }
        let offset = reported - truth.position;
        // A counter of 16 bits wraps around.
        let narrow = self.profile.parameter(id).is_some_and(|p| p.encoding == Encoding::I16);
        let next = world.inspect(host, |n, _| n.axes()?.to_si(self.index, id, raw + (1 << 16)));
        let turn = next.filter(|_| narrow).map(|next| next - reported);
        match self.position_offset.replace(offset) {
            Some(known) if offset_error(known, offset, turn) > POSITION_ERROR_MAX => Err((
                "I14",
                format!(
                    "position reads {reported:.4} rad, should be {:.4}",
                    truth.position + known
                ),
            )),
            _ => Ok(()),
        }
    }

    fn check_verb(
        &mut self,
        world: &mut World,
        verb: Verb,
        outcome: Outcome,
        open: &OpenAction,
    ) -> Result<(), (&'static str, String)> {
        let after = self.truth(world);
        let uncertain = matches!(outcome, Outcome::Partly(..) | Outcome::Unknown(_));
        self.late_motion |= verb.needs_arming() && uncertain;
        let copies = self.damage.taken_twice - open.damage.taken_twice;
        if self.homing_idle.record_end(world.now(), verb, outcome) {
            self.position_offset = None;
        }
        // It was at standstill when it was measured; a jam that ended since lets it turn again.
        let let_go = self.disturbed_at.is_some_and(|at| world.now() < at.plus_ms(LET_GO_MS));
        let unknown = self.untrusted || self.has_twin || verb.is_stop() && let_go;
        if !unknown {
            let claimed = self.witness.check(verb, outcome, open, &after, copies);
            claimed.map_err(|wrong| ("I15", wrong))?;
        }
        // A drive with a fault acknowledges what it does not execute.
        if open.doubtful || self.untrusted || self.disturbed {
            return Ok(());
        }
        let executed = after.unrepeatable.saturating_sub(open.truth_before.unrepeatable);
        let once = verb.is_move() || matches!(verb, Verb::Velocity | Verb::Torque);
        if executed > 1 && once && executed <= 1 + copies {
            self.repeated += 1;
        } else if executed > 1 && once {
            return Err(("I2", format!("{} was executed {executed} times", verb.name())));
        }
        let never = matches!(outcome, Outcome::NotDone(Failure::Silent | Failure::Misbehaved));
        if verb == Verb::MoveBy && never && executed != 0 {
            return Err(("I3", format!("move-by was executed, but ended as {outcome:?}")));
        }
        let done = verb == Verb::MoveBy && matches!(outcome, Outcome::Done(_)) && executed == 0;
        if done && self.damage.missed > open.damage.missed {
            self.unreported += 1;
        } else if done {
            return Err(("I3", "move-by ended as done, but was not executed".into()));
        }
        Ok(())
    }
}

/// A stop's last reading may be so old when it ends, ms.
const LET_GO_MS: u32 = 300;

const VERBS: [Verb; 14] = [
    Verb::Enable,
    Verb::Enable,
    Verb::Velocity,
    Verb::Velocity,
    Verb::MoveTo,
    Verb::MoveBy,
    Verb::MoveBy,
    Verb::MoveBy,
    Verb::Stop,
    Verb::QuickStop,
    Verb::Disable,
    Verb::Clear,
    Verb::Home,
    Verb::Reached,
];

/// Difference of two offsets, for counts that wrap after `turn`, if they do.
fn offset_error(one: f64, other: f64, turn: Option<f64>) -> f64 {
    let error = one - other;
    (error - turn.map_or(0.0, |turn| turn * (error / turn).round())).abs()
}

/// Returns whether it may set the motor going: then the axis must be armed.
const fn starts_motion(what: AxisAction) -> bool {
    matches!(what, AxisAction::Command(verb) if verb.needs_arming())
}

const fn is_motion(what: AxisAction) -> bool {
    match what {
        AxisAction::Command(verb) => {
            verb.is_move() || matches!(verb, Verb::Velocity | Verb::Torque | Verb::Home)
        }
        _ => false,
    }
}

fn random_command(verb: Verb, random: &mut Random) -> Command {
    let speed = random.between(-SPEED_MAX, SPEED_MAX) as f64;
    let plain = Command::new(verb);
    match verb {
        Verb::Velocity => Command { velocity: Some(speed), ..plain },
        Verb::MoveTo | Verb::MoveBy => {
            let velocity = random.chance(Ppm(500_000)).then_some(speed.abs().max(1.0));
            Command { target: Some(random.between(-20, 20) as f64), velocity, ..plain }
        }
        _ => plain,
    }
}
