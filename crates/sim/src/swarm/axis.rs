//! What a world knows of one axis and its drive, and what must hold between the two.

#[cfg(test)]
mod tests;

use polepair_core::axis::{Command, Verb};
use polepair_core::drives::bench::Truth;
use polepair_core::error::{Failure, Outcome};
use polepair_core::profile::{AxisKind, Encoding, ParameterId, Profile, Signal};
use polepair_core::station::{AxisIndex, Ticket};
use polepair_core::time::Instant;

use super::inert::Inert;
use super::witness::{Found, Witness};
use crate::can_bus::Standing;
use crate::check::{Possible, Violation};
use crate::random::{Ppm, Random};
use crate::world::{NodeId, World};

/// Speed that is asked for at most, rad/s.
const SPEED_MAX: i64 = 30;
/// A motor at rest creeps less than this, rad/s.
const REST: f64 = 0.5;
/// Powering a motor at rest may move it so far, rad: it settles on the nearest count.
const JUMP_MAX: f64 = 0.3;
/// A reading of the position may be off by this, rad, besides what the motor moves meanwhile.
const POSITION_ERROR_MAX: f64 = 0.1;

/// How often a write makes a drive ready for what it is asked, and an axis stays disarmed.
const READY: Ppm = Ppm(330_000);
const FORGETS: Ppm = Ppm(100_000);

/// What is asked of an axis.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum What {
    /// Reads inert parameter n.
    Read(usize),
    /// Writes inert parameter n.
    Write(usize, i64),
    /// Reads a signal.
    Look(Signal, ParameterId),
    /// A verb.
    Do(Verb),
}

/// A question under way.
#[derive(Clone, Copy, Debug)]
pub struct Open {
    pub ticket: Ticket,
    pub what: What,
    pub since: Instant,
    before: Truth,
    /// What the wire had done by then: see [`Toll`].
    toll: Toll,
    /// The drive lost its supply, or took a changed request as good, meanwhile.
    pub doubtful: bool,
}

/// One axis and its drive.
#[derive(Debug)]
pub struct Axis {
    pub index: AxisIndex,
    pub drive: NodeId,
    pub profile: &'static Profile,
    pub protocol: &'static str,
    pub open: Vec<Open>,
    inert: Vec<(Inert, Possible)>,
    /// Position reported minus position true, while it is known to be constant.
    offset: Option<f64>,
    homed: Homed,
    witness: Witness,
    /// Somebody armed it since its link was last lost.
    armed: bool,
    /// The drive's last transmission that was looked at.
    pub judged: u32,
    /// The drive may have done something that nobody asked for.
    pub spoiled: bool,
    /// And may no longer be where it was: at another address or baud rate.
    pub elsewhere: bool,
    /// Strangers' frames that its drive may have obeyed so far.
    pub misled: u64,
    /// Another drive of the same address is on the wire.
    pub twinned: bool,
    toll: Toll,
    /// Verbs executed twice, because their frame was taken twice: nothing tells it from two.
    pub repeated: u64,
    /// Verbs that count as done, though the drive missed their frame: nothing tells the host.
    pub untold: u64,
}

/// What a bus did so far to the frames of an axis.
#[derive(Clone, Copy, Debug, Default)]
struct Toll {
    /// Frames of the host that were taken twice.
    doubled: u64,
    /// Frames of hosts that the drive did not get.
    missed: u64,
}

/// Since when a drive is known to carry out no homing.
#[derive(Clone, Copy, Debug)]
struct Homed(Option<Instant>);

impl Default for Homed {
    fn default() -> Self {
        Self(Some(Instant::ZERO))
    }
}

impl Homed {
    /// A verb has ended. Returns whether the drive's zero may be another than before.
    fn ended(&mut self, now: Instant, verb: Verb, outcome: Outcome) -> bool {
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

    /// Whether that was so already when something was asked then.
    fn before(self, then: Instant) -> bool {
        self.0.is_some_and(|since| since <= then)
    }
}

impl Axis {
    pub fn new(
        index: AxisIndex,
        drive: NodeId,
        profile: &'static Profile,
        protocol: &'static str,
        inert: &[Inert],
    ) -> Self {
        let inert = inert.iter().map(|i| (*i, Possible::ANY)).collect();
        let open = Vec::new();
        Self {
            index,
            drive,
            profile,
            protocol,
            open,
            inert,
            offset: None,
            homed: Homed::default(),
            witness: Witness::default(),
            armed: false,
            judged: 0,
            spoiled: false,
            elsewhere: false,
            misled: 0,
            twinned: false,
            toll: Toll::default(),
            repeated: 0,
            untold: 0,
        }
    }

    /// What is true of the drive now.
    pub fn truth(&self, world: &mut World) -> Truth {
        world.look(self.drive, |n, now| n.bench().map(|b| b.truth(now))).unwrap_or_default()
    }

    /// Nothing that was known of the drive holds any more.
    pub fn forget(&mut self) {
        self.inert.iter_mut().for_each(|(_, possible)| *possible = Possible::ANY);
        self.open.iter_mut().for_each(|open| open.doubtful = true);
        self.offset = None;
        self.witness.forget();
    }

    /// The link was lost: until somebody arms the axis, nothing may set its motor going.
    pub fn disarmed(&mut self) {
        self.armed = false;
        self.witness.lost();
    }

    /// What must hold of drive and host after every event.
    pub fn after(
        &mut self,
        world: &mut World,
        host: NodeId,
        (own, drives): (Option<&Standing>, Option<Standing>),
    ) -> Option<Violation> {
        let truth = self.truth(world);
        // What a controller holds cannot be called back.
        let waits = own.is_some_and(|standing| standing.waits);
        let going = waits || self.open.iter().any(|open| is_start(open.what));
        let toll = Toll {
            doubled: own.map_or(0, |standing| standing.doubled),
            missed: drives.map_or(0, |standing| standing.missed),
        };
        self.witness.doubled(toll.doubled - self.toll.doubled);
        self.toll = toll;
        let found = self.witness.look(world.now(), truth, going || self.spoiled);
        let found = found.or_else(|| self.jumped(&truth)).or_else(|| {
            let armed = world.look(host, |n, _| n.axes()?.state(self.index).map(|s| s.armed));
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

    /// Whether a lane may take such a question now.
    pub fn may_be_asked(&self, what: What) -> bool {
        self.armed || !is_start(what)
    }

    /// Since when a verb is open, of those tickets that `waits` names.
    pub fn verb_since(&self, waits: impl Fn(Ticket) -> bool) -> Option<Instant> {
        let verbs = self.open.iter().filter(|open| matches!(open.what, What::Do(_)));
        verbs.filter(|open| waits(open.ticket)).map(|open| open.since).min()
    }

    /// Powering a motor at rest leaves it where it is.
    fn jumped(&self, truth: &Truth) -> Option<Found> {
        let open = self.open.iter().find(|open| open.what == What::Do(Verb::Enable))?;
        let from = &open.before;
        let alone = !self.open.iter().any(|open| moves(open.what));
        let judged = alone && !open.doubtful && !self.spoiled;
        let rested = from.velocity.abs() < REST && !from.enabled;
        let jump = (truth.position - from.position).abs();
        (judged && rested && jump > JUMP_MAX)
            .then(|| ("I7", format!("enabling moved the motor by {jump:.3} rad")))
    }

    /// Something to ask, or `None` when what was drawn is under way already.
    pub fn draw(&self, random: &mut Random) -> Option<What> {
        let what = match random.below(10) {
            0..=2 if !self.inert.is_empty() => {
                What::Read(random.below(self.inert.len() as u64) as usize)
            }
            3..=4 if !self.inert.is_empty() => self.draw_write(random),
            5..=7 => {
                let source = self
                    .profile
                    .signals
                    .get(random.below(self.profile.signals.len().max(1) as u64) as usize)?;
                What::Look(source.signal, source.parameter)
            }
            _ => What::Do(random.pick(&VERBS)),
        };
        let same = |open: &Open| match (open.what, what) {
            (What::Read(a) | What::Write(a, _), What::Read(b) | What::Write(b, _)) => a == b,
            (What::Do(a), What::Do(b)) => a == b,
            _ => false,
        };
        (!self.open.iter().any(same)).then_some(what)
    }

    /// A value for an inert parameter; often one without which some plan refuses to begin.
    fn draw_write(&self, random: &mut Random) -> What {
        let wanted = self.inert.iter().position(|(inert, _)| !inert.wanted.is_empty());
        if let Some(n) = wanted.filter(|_| random.chance(READY)) {
            return What::Write(n, random.pick(self.inert[n].0.wanted));
        }
        let n = random.below(self.inert.len() as u64) as usize;
        let range = self.inert[n].0;
        What::Write(n, random.between(range.min, range.max))
    }

    /// The signal that is polled to see whether the drive answers.
    pub fn pulse(&self) -> Option<What> {
        let source = self.profile.signals.first()?;
        Some(What::Look(source.signal, source.parameter))
    }

    /// Submits a question. Returns whether it was taken.
    pub fn ask(
        &mut self,
        world: &mut World,
        host: NodeId,
        ticket: Ticket,
        what: What,
        random: &mut Random,
    ) -> bool {
        let before = self.truth(world);
        let axis = self.index;
        let command = match what {
            What::Do(verb) => Some(command(verb, random)),
            _ => None,
        };
        let id = |n: usize| self.inert[n].0.id;
        // Now and then somebody forgets to arm it.
        let arms = is_start(what) && !random.chance(FORGETS);
        let armed = self.armed || arms;
        let taken = world.with(host, |node, now| {
            let axes = node.axes()?;
            match (what, command) {
                (What::Read(n), _) => axes.read(now, ticket, axis, id(n)).ok(),
                (What::Write(n, raw), _) => axes.write(now, ticket, axis, id(n), raw, false).ok(),
                (What::Look(_, parameter), _) => axes.read(now, ticket, axis, parameter).ok(),
                (What::Do(_), Some(command)) => {
                    if arms {
                        axes.arm(axis, true);
                    }
                    axes.command(now, ticket, axis, command).ok()
                }
                _ => None,
            }
        });
        if taken.is_some() {
            if let What::Do(Verb::Home) = what {
                self.offset = None;
            }
            if is_start(what) {
                let by = command.filter(|c| c.verb == Verb::MoveBy && self.is_rotary());
                self.witness.asked(world.now(), &before, by.and_then(|c| c.target));
            }
            let since = world.now();
            self.open.push(Open { ticket, what, since, before, toll: self.toll, doubtful: false });
        }
        self.armed = armed;
        taken.is_some()
    }

    /// Judges the end of a question. The text says what is wrong and which invariant it breaks.
    pub fn ended(
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
        match (open.what, outcome) {
            (What::Read(n), Outcome::Done(raw)) => self.read(n, raw, open.doubtful),
            (What::Write(n, raw), outcome) => {
                self.wrote(n, raw, outcome, open.doubtful);
                Ok(())
            }
            // What was read before a drive's restart says nothing of after it.
            (What::Look(Signal::Position, id), Outcome::Done(raw))
                if !open.doubtful
                    && self.witness.rested_since(open.since)
                    && self.homed.before(open.since) =>
            {
                self.position(world, host, id, raw)
            }
            (What::Do(verb), outcome) => self.did(world, verb, outcome, &open),
            _ => Ok(()),
        }
    }

    fn read(&mut self, n: usize, raw: i64, doubtful: bool) -> Result<(), (&'static str, String)> {
        let (inert, possible) = &mut self.inert[n];
        let known = possible.clone();
        if doubtful || self.twinned {
            // The answer may be older than what made it doubtful.
            *possible = Possible::ANY;
            return Ok(());
        }
        if possible.agrees(raw) {
            return Ok(());
        }
        let name = self.profile.parameter(inert.id).map_or("?", |p| p.name);
        Err(("I3", format!("{name} reads {raw}, but is {known:?}")))
    }

    fn wrote(&mut self, n: usize, raw: i64, outcome: Outcome, doubtful: bool) {
        let possible = &mut self.inert[n].1;
        match outcome {
            _ if doubtful => *possible = Possible::ANY,
            Outcome::Done(_) => possible.is(raw),
            Outcome::Unknown(_) | Outcome::Partly(..) => possible.may_be(raw),
            Outcome::NotDone(_) => {}
        }
    }

    fn is_rotary(&self) -> bool {
        self.profile.axis == AxisKind::Rotary
    }

    /// The position reported must follow the shaft, apart from a constant.
    fn position(
        &mut self,
        world: &mut World,
        host: NodeId,
        id: ParameterId,
        raw: i64,
    ) -> Result<(), (&'static str, String)> {
        let truth = self.truth(world);
        let reported = world.look(host, |n, _| n.axes()?.to_si(self.index, id, raw));
        let Some(reported) = reported.filter(|_| self.is_rotary()) else { return Ok(()) };
        let homing = self.open.iter().any(|open| open.what == What::Do(Verb::Home));
        if self.spoiled || homing {
            return Ok(());
        }
        let offset = reported - truth.position;
        // What has no more than 16 bits for it begins again at the other end.
        let narrow = self.profile.parameter(id).is_some_and(|p| p.encoding == Encoding::I16);
        let next = world.look(host, |n, _| n.axes()?.to_si(self.index, id, raw + (1 << 16)));
        let turn = next.filter(|_| narrow).map(|next| next - reported);
        match self.offset.replace(offset) {
            Some(known) if apart(known, offset, turn) > POSITION_ERROR_MAX => Err((
                "I14",
                format!(
                    "position reads {reported:.4} rad, should be {:.4}",
                    truth.position + known
                ),
            )),
            _ => Ok(()),
        }
    }

    fn did(
        &mut self,
        world: &mut World,
        verb: Verb,
        outcome: Outcome,
        open: &Open,
    ) -> Result<(), (&'static str, String)> {
        let after = self.truth(world);
        if self.homed.ended(world.now(), verb, outcome) {
            self.offset = None;
        }
        if open.doubtful || self.spoiled {
            return Ok(());
        }
        let executed = after.unrepeatable.saturating_sub(open.before.unrepeatable);
        let once = verb.is_move() || matches!(verb, Verb::Velocity | Verb::Torque);
        let copies = self.toll.doubled - open.toll.doubled;
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
        if done && self.toll.missed > open.toll.missed {
            self.untold += 1;
        } else if done {
            return Err(("I3", "move-by ended as done, but was not executed".into()));
        }
        Ok(())
    }
}

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

/// How far two offsets are apart, where what is counted begins again after `turn`, if it does.
fn apart(one: f64, other: f64, turn: Option<f64>) -> f64 {
    let error = one - other;
    (error - turn.map_or(0.0, |turn| turn * (error / turn).round())).abs()
}

/// Whether it may set the motor going: then the axis must be armed.
const fn is_start(what: What) -> bool {
    matches!(what, What::Do(verb) if verb.needs_arming())
}

const fn moves(what: What) -> bool {
    match what {
        What::Do(verb) => {
            verb.is_move() || matches!(verb, Verb::Velocity | Verb::Torque | Verb::Home)
        }
        _ => false,
    }
}

fn command(verb: Verb, random: &mut Random) -> Command {
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
