//! One host and the axes it serves: jobs take turns on the wire, stops first; plans are run here.
//!
//! All storage is made when the lane is made, an axis joins it, or a path is begun; nothing allocates
//! afterwards.

mod axes;
mod cycle;
mod execute;
mod job;
mod news;
mod path;
mod readdress;
mod slot;
mod table;
#[cfg(test)]
mod tests;
mod transfer;

use alloc::boxed::Box;
use alloc::collections::VecDeque;
use alloc::vec::Vec;
use core::marker::PhantomData;

use crate::axis::{Axes, Command, News, Part, Rehearsed, RehearsedStep, State, StopPart, Verb};
use crate::error::{Failure, Outcome, Unsupported};
use crate::explain::Raw;
use crate::medium::Medium;
use crate::plan::Step;
use crate::profile::{ParameterId, Profile, Readdress};
use crate::program::{MemoryRules, Order};
use crate::station::{
    AxisIndex, Class, Counters, Event, Host, LineEvent, Request, Station, Ticket, Timed, To,
};
use crate::stream::cyclic::{Account, Following, LOAD_MAX_PERCENT, Setpoint};
use crate::stream::{PathKind, Point};
use crate::time::{Instant, earliest};
use cycle::Cycle;
use job::{Asked, Run, Steps, Task, Write};
pub use news::NEWS_MAX;
use news::Tidings;
use path::Path;
use slot::Slot;
pub use slot::{BoxedDriver, MakeDriver};
use table::Table;
pub use transfer::{Piece, Transfer, TransferKind};

/// Jobs that a lane holds at once.
pub const JOBS_MAX: usize = 64;
/// Places among them that only stops take: whatever else waits, a stop is never refused as busy
/// because of it.
pub const STOP_JOBS: usize = 4;

/// Answers of a group's drives that wait to be taken at most; the oldest go first, which nobody took.
pub const PARTS_MAX: usize = 512;

/// One host, its axes, and the jobs that take turns on it.
pub struct Lane<M: Medium, H: Host<M>> {
    host: H,
    slots: Vec<Slot<H::Request, H::Answer>>,
    jobs: Table<H::Request>,
    /// What drives of a group answered and nobody has taken yet.
    parts: VecDeque<Part>,
    /// Axes that follow one beat, or did last.
    cycle: Option<Box<Cycle>>,
    /// What happened and nobody has taken yet, while somebody listens.
    tidings: Option<Box<Tidings>>,
    /// What makes the driver of an axis that joins.
    make: Option<MakeDriver<H::Request, H::Answer>>,
    medium: PhantomData<fn() -> M>,
}

impl<M: Medium, H: Host<M>> core::fmt::Debug for Lane<M, H> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("Lane").field("slots", &self.slots).finish_non_exhaustive()
    }
}

/// The steps by which a lane writes one parameter: permanent memory is spared, or asked for.
#[must_use]
pub fn write_steps(profile: &Profile, id: ParameterId, raw: i64, keep: bool) -> Vec<Step> {
    let steps = Steps::Write(Write::new(profile, id, raw, keep));
    (0..=u8::MAX).map_while(|at| steps.step(at)).collect()
}

impl<M: Medium, H: Host<M>> Lane<M, H> {
    /// A lane of that host with one axis per driver, in that order. At most 256 axes.
    pub fn new(
        host: H,
        drivers: impl IntoIterator<Item = BoxedDriver<H::Request, H::Answer>>,
    ) -> Self {
        let slots: Vec<Slot<_, _>> = drivers.into_iter().take(256).map(Slot::new).collect();
        let groups = slots.iter().any(|slot| slot.driver.is_group());
        Self {
            host,
            slots,
            jobs: Table::new(),
            parts: VecDeque::with_capacity(if groups { PARTS_MAX } else { 0 }),
            cycle: None,
            tidings: None,
            make: None,
            medium: PhantomData,
        }
    }

    /// The same lane, which axes can [join](Axes::join).
    #[must_use]
    pub fn growing(self, make: MakeDriver<H::Request, H::Answer>) -> Self {
        Self { make: Some(make), ..self }
    }

    /// The host, for what only its protocol has.
    pub fn host(&self) -> &H {
        &self.host
    }

    fn slot(&self, axis: AxisIndex) -> Result<&Slot<H::Request, H::Answer>, Unsupported> {
        self.slots.get(usize::from(axis.0)).ok_or(Unsupported::NoSuchAxis)
    }

    /// Takes what the host has to tell, as it may after every call.
    #[inline]
    fn settle(&mut self, now: Instant) {
        while let Some(event) = self.host.poll_event() {
            let silent = silent(&self.jobs, event);
            let told = (&mut self.parts, &mut self.tidings);
            take(now, &mut self.jobs, &mut self.slots, told, event);
            if let (Some(cycle), (To::Address(address), Ok(_))) = (&mut self.cycle, event) {
                cycle.heard(now, *address, &self.slots);
            }
            if let Some(axis) = silent {
                self.note_heard(axis);
            }
        }
    }

    /// Keeps what came while a request of this axis was on the wire, that ended in silence.
    #[cold]
    fn note_heard(&mut self, axis: u8) {
        let mut counted = self.host.counters();
        counted.skipped += self.host.unread() as u64;
        if let Some(slot) = self.slots.get_mut(usize::from(axis)) {
            slot.heard = counted.since(slot.asked_at);
        }
    }

    /// Hands the host the next request, if one is ready and the host can take it.
    #[inline]
    fn feed(&mut self, now: Instant) {
        // Where a host asks many drives at once, those that have one to answer are passed by.
        let mut open = u64::MAX;
        while let Some((n, job)) = self.jobs.next(open) {
            let Some(slot) = self.slots.get_mut(usize::from(job.axis)) else { return };
            if core::mem::take(&mut slot.mistaken) {
                self.host.mistrust(now, slot.driver.address());
            }
            if let Some((id, request)) = execute::plain_read(job, slot) {
                if let Ok(()) = self.host.submit(now, Ticket(n as u32), *request) {
                    job.asked = Asked::Read(id);
                    if job.once {
                        self.host.send_once(Ticket(n as u32));
                    }
                    slot.asked_at = self.host.counters();
                    self.jobs.sent(n);
                } else if H::PARALLEL {
                    open &= !self.jobs.of_axis(n);
                    continue;
                } else {
                    return;
                }
            } else if !self.feed_one(now, n) {
                if H::PARALLEL {
                    open &= !self.jobs.of_axis(n);
                    continue;
                }
                return;
            }
            // A host may end a request at once that its protocol's rules forbid.
            self.settle(now);
        }
    }

    /// Lets job `n` have its turn. Returns false when the host will not have its request.
    #[inline(never)]
    fn feed_one(&mut self, now: Instant, n: usize) -> bool {
        let Some(job) = self.jobs.get_mut(n) else { return false };
        let Some(slot) = self.slots.get_mut(usize::from(job.axis)) else { return false };
        match execute::next(now, job, slot) {
            Ok((request, asked)) => {
                // What still waits for the line to be silent comes after a stop, not before it.
                if request.is_stop()
                    && let Some(Ticket(other)) = self.host.recall(&request)
                {
                    self.jobs.given_back(other as usize);
                }
                let Ok(()) = self.host.submit(now, Ticket(n as u32), request) else { return false };
                slot.asked_at = self.host.counters();
                if let Some(job) = self.jobs.get_mut(n) {
                    job.asked = asked;
                    if job.once {
                        self.host.send_once(Ticket(n as u32));
                    }
                    slot.state.going |= job.sets_going(slot.profile, asked);
                }
                self.jobs.sent(n);
            }
            Err(next) => {
                if matches!(next, execute::Next::End(Outcome::Done(_))) && job.ends_going() {
                    slot.state.going = false;
                }
                self.jobs.passed(n, next);
            }
        }
        true
    }
}

/// The axis whose request ended in silence by this.
fn silent<R: Request, A>(jobs: &Table<R>, (to, answer): &Event<A>) -> Option<u8> {
    match (to, answer) {
        (To::Ticket(Ticket(n)), Err(Failure::Silent)) => jobs.axis(*n as usize),
        _ => None,
    }
}

/// Takes one thing that the host had to tell.
#[inline(never)]
fn take<R: Request, A: Copy + 'static>(
    now: Instant,
    jobs: &mut Table<R>,
    slots: &mut [Slot<R, A>],
    (parts, tidings): (&mut VecDeque<Part>, &mut Option<Box<Tidings>>),
    (to, answer): &Event<A>,
) {
    match (to, answer) {
        (To::Ticket(Ticket(n)), _) => jobs.answered(now, slots, *n as usize, answer),
        (To::Address(address), Ok(answer)) => {
            slot::unasked(now, slots, tidings, (*address, answer))
        }
        (To::Part(Ticket(n), address), _) => {
            let part = jobs.part(now, slots, (*n as usize, *address), answer);
            let Some(part) = part else { return };
            if parts.len() >= PARTS_MAX {
                parts.pop_front();
            }
            parts.push_back(part);
        }
        (To::Address(_), Err(_)) => {}
    }
}

impl<M: Medium, H: Host<M>> Timed for Lane<M, H> {
    fn handle_timeout(&mut self, now: Instant) {
        self.host.handle_timeout(now);
        self.settle(now);
        self.jobs.rouse(now);
    }

    fn poll_timeout(&self) -> Option<Instant> {
        let due = self.cycle.as_ref().and_then(|cycle| cycle.due());
        earliest(due, earliest(self.host.poll_timeout(), self.jobs.wake))
    }
}

impl<M: Medium, H: Host<M>> Station<M> for Lane<M, H> {
    fn handle_input(&mut self, now: Instant, unit: &M::Unit) {
        self.host.handle_input(now, unit);
        while let Some(event) = self.host.poll_event() {
            if self.jobs.read_answered(now, &mut self.slots, event) {
                continue;
            }
            let silent = silent(&self.jobs, event);
            let told = (&mut self.parts, &mut self.tidings);
            take(now, &mut self.jobs, &mut self.slots, told, event);
            if let (Some(cycle), (To::Address(address), Ok(_))) = (&mut self.cycle, event) {
                cycle.heard(now, *address, &self.slots);
            }
            if let Some(axis) = silent {
                self.note_heard(axis);
            }
        }
    }

    fn handle_line(&mut self, now: Instant, event: LineEvent) {
        self.host.handle_line(now, event);
        self.settle(now);
        if matches!(event, LineEvent::Down | LineEvent::BusOff) {
            self.jobs.lose();
            if let Some(cycle) = &mut self.cycle {
                cycle.lose();
            }
        }
        if event != LineEvent::Break {
            self.slots.iter_mut().for_each(Slot::forget);
        }
    }

    fn poll_transmit(&mut self, now: Instant, out: &mut M::Out) -> Option<usize> {
        // A beat keeps its time whatever else there is to say.
        if let Some(cycle) = &mut self.cycle
            && let Some(request) = cycle.poll(now, &mut self.slots)
        {
            return Some(self.host.say(now, &request, out));
        }
        self.jobs.rouse(now);
        self.feed(now);
        let sent = self.host.poll_transmit(now, out);
        self.settle(now);
        sent
    }

    fn line(&self) -> M::Line {
        self.host.line()
    }
}

/// What a verb makes a drive ready to follow.
const fn followed(verb: Verb) -> Option<Setpoint> {
    match verb {
        Verb::FollowPosition => Some(Setpoint::Position),
        Verb::FollowVelocity => Some(Setpoint::Velocity),
        Verb::FollowTorque => Some(Setpoint::Torque),
        _ => None,
    }
}

impl<M: Medium, H: Host<M>> Lane<M, H> {
    fn slot_mut(
        &mut self,
        axis: AxisIndex,
    ) -> Result<&mut Slot<H::Request, H::Answer>, Unsupported> {
        self.slots.get_mut(usize::from(axis.0)).ok_or(Unsupported::NoSuchAxis)
    }

    /// Starts steps that carry a command out; what stops ends what runs.
    fn start(
        &mut self,
        ticket: Ticket,
        axis: AxisIndex,
        (steps, undo): (&'static [Step], &'static [Step]),
        command: Command,
    ) -> Result<(), Unsupported> {
        let verb = command.verb;
        if verb.is_stop() {
            self.cancel(axis);
        }
        if verb.needs_arming() || verb.is_stop() {
            self.slot_mut(axis)?.follows = followed(verb);
        }
        let run = Run::new(Steps::Plan(steps), undo, command, Some(verb));
        self.jobs.add(ticket, axis, Task::Run(run), verb.is_stop())
    }

    fn follows_beat(&self, axis: AxisIndex) -> bool {
        self.cycle.as_ref().is_some_and(|cycle| cycle.commands(axis))
    }

    /// Whether something moves an axis, or stops it.
    fn moving(&self, axis: AxisIndex) -> bool {
        self.jobs.moving(axis) || self.follows_beat(axis)
    }

    /// Ends what moves an axis: a stop is next. All that follow its beat stop with it.
    fn cancel(&mut self, axis: AxisIndex) {
        self.jobs.cancel(axis);
        if let Some(cycle) = self.cycle.as_mut().filter(|cycle| cycle.commands(axis)) {
            cycle.cancel();
        }
    }

    /// One request of the protocol's own: what may move the motor needs an armed axis, what stops it
    /// ends what runs.
    fn say(
        &mut self,
        ticket: Ticket,
        axis: AxisIndex,
        request: H::Request,
    ) -> Result<(), Unsupported> {
        if request.class() == Class::Never && !self.slot(axis)?.state.armed {
            return Err(Unsupported::NotArmed);
        }
        let stop = request.is_stop();
        if stop {
            self.cancel(axis);
        }
        self.jobs.add(ticket, axis, Task::Raw(request), stop)
    }

    fn rehearse_step(
        &self,
        slot: &Slot<H::Request, H::Answer>,
        step: Step,
        command: &Command,
        show: &mut dyn FnMut(Rehearsed<'_>),
    ) -> Result<(), Unsupported> {
        let read = |id| slot.read(id).copied();
        let write = |id, raw| slot.driver.write(slot.writable(id, raw)?, raw, Class::Confirm);
        let (step, request) = match step {
            Step::Write(id, operand) => match slot.operand(operand, command, Some(id))? {
                None => return Ok(()),
                Some(raw) => (RehearsedStep::Write(id, raw), write(id, raw)?),
            },
            Step::Ensure(id, raw) => (RehearsedStep::WriteIfDifferent(id, raw), write(id, raw)?),
            Step::Read(id)
            | Step::Require { read: id, .. }
            | Step::Skip { read: id, .. }
            | Step::Without { read: id, .. }
            | Step::NoFault { read: id, .. }
            | Step::Until { read: id, .. } => (RehearsedStep::Read(id), read(id)?),
            Step::Copy { from, to } => (RehearsedStep::WriteWhatWasRead(from, to), read(from)?),
            Step::Send { function, index, operand, like } => {
                match slot.operand(operand, command, like)? {
                    None => return Ok(()),
                    Some(raw) => {
                        let request = slot.driver.send_for(command, function, index, raw)?;
                        (RehearsedStep::Send, request)
                    }
                }
            }
            Step::Keep(id) => {
                let parameter = slot.profile.parameter(id).ok_or(Unsupported::NoSuchParameter)?;
                (RehearsedStep::Keep(id), slot.driver.keep(parameter)?)
            }
            Step::Wait { ms } => {
                show(Rehearsed { step: RehearsedStep::Wait(ms), bytes: &[], frame: None });
                return Ok(());
            }
        };
        M::render(&mut |out| self.host.emit(&request, out), &mut |frame, bytes| {
            show(Rehearsed { step, bytes, frame });
        });
        Ok(())
    }
}
