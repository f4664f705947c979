//! One host and the axes it serves: jobs take turns on the wire, stops first; plans are run here.
//!
//! All storage is made when the lane is made; nothing allocates afterwards.

mod execute;
mod job;
mod slot;
#[cfg(test)]
mod tests;

use alloc::boxed::Box;
use alloc::vec::Vec;
use core::marker::PhantomData;

use crate::axis::{Axes, Command, Rehearsed, RehearsedStep, State};
use crate::error::{Failure, Outcome, Unsupported};
use crate::medium::Medium;
use crate::plan::Step;
use crate::profile::{ParameterId, Profile};
use crate::station::{
    AxisIndex, Class, Counters, Host, LineEvent, Request, Station, Ticket, Timed, To,
};
use crate::time::{Instant, earliest};
use execute::Next;
use job::{Asked, Job, Run, Stage, Steps, Task, Write};
pub use slot::BoxedDriver;
use slot::Slot;

/// Jobs that a lane holds at once.
pub const JOBS_MAX: usize = 64;
/// Places among them that only stops take: whatever else waits, a stop is never refused as busy
/// because of it.
pub const STOP_JOBS: usize = 4;

/// One host, its axes, and the jobs that take turns on it.
pub struct Lane<M: Medium, H: Host<M>> {
    host: H,
    slots: Vec<Slot<H::Request, H::Answer>>,
    jobs: Box<[Option<Job<H::Request>>]>,
    /// Bit n stands for job n in each of these.
    used: u64,
    /// Has something to send.
    ready: u64,
    /// Goes before the others.
    urgent: u64,
    /// Runs a plan that moves or powers the motor: until it waits, nothing but a stop comes between
    /// its steps, so that nobody changes what an earlier step made sure of.
    going: u64,
    /// Waits for a time.
    sleeping: u64,
    /// Has its outcome.
    ended: u64,
    /// Who was served last: the next one is looked for behind it.
    turn: u32,
    wake: Option<Instant>,
    medium: PhantomData<fn() -> M>,
}

impl<M: Medium, H: Host<M>> core::fmt::Debug for Lane<M, H> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("Lane").field("slots", &self.slots).finish_non_exhaustive()
    }
}

impl<M: Medium, H: Host<M>> Lane<M, H> {
    /// A lane of that host with one axis per driver, in that order. At most 256 axes.
    pub fn new(
        host: H,
        drivers: impl IntoIterator<Item = BoxedDriver<H::Request, H::Answer>>,
    ) -> Self {
        Self {
            host,
            slots: drivers.into_iter().take(256).map(Slot::new).collect(),
            jobs: (0..JOBS_MAX).map(|_| None).collect(),
            used: 0,
            ready: 0,
            urgent: 0,
            going: 0,
            sleeping: 0,
            ended: 0,
            turn: 0,
            wake: None,
            medium: PhantomData,
        }
    }

    /// The host, for what only its protocol has.
    pub fn host(&self) -> &H {
        &self.host
    }

    fn slot(&self, axis: AxisIndex) -> Result<&Slot<H::Request, H::Answer>, Unsupported> {
        self.slots.get(usize::from(axis.0)).ok_or(Unsupported::NoSuchAxis)
    }

    fn add(
        &mut self,
        ticket: Ticket,
        axis: AxisIndex,
        task: Task<H::Request>,
        stop: bool,
    ) -> Result<usize, Unsupported> {
        let n = (!self.used).trailing_zeros() as usize;
        if n >= JOBS_MAX - if stop { 0 } else { STOP_JOBS } {
            return Err(Unsupported::Busy);
        }
        self.jobs[n] = Some(Job {
            ticket,
            axis: axis.0,
            task,
            asked: Asked::Nothing,
            cancelled: false,
            outcome: None,
        });
        self.used |= 1 << n;
        self.ready |= 1 << n;
        Ok(n)
    }

    #[inline]
    fn end(&mut self, n: usize, outcome: Outcome) {
        if let Some(job) = &mut self.jobs[n] {
            job.outcome = Some(outcome);
            job.asked = Asked::Nothing;
        }
        let bit = !(1 << n);
        self.ready &= bit;
        self.urgent &= bit;
        self.going &= bit;
        self.sleeping &= bit;
        self.ended |= !bit;
    }

    /// Ends what runs on an axis, reads excepted: a stop is next.
    fn cancel(&mut self, axis: AxisIndex) {
        for n in bits(self.used & !self.ended) {
            let Some(job) = &mut self.jobs[n] else { continue };
            if job.axis != axis.0 || matches!(job.task, Task::Read(_)) {
                continue;
            }
            if job.asked == Asked::Nothing {
                let failure = Failure::Cancelled;
                let touched = execute::may_have_been_executed(job);
                self.end(
                    n,
                    if touched { Outcome::Unknown(failure) } else { Outcome::NotDone(failure) },
                );
            } else {
                job.cancelled = true;
            }
        }
    }

    fn moving(&self, axis: AxisIndex) -> bool {
        bits(self.used & !self.ended).any(|n| {
            self.jobs[n].as_ref().is_some_and(|job| {
                let verb = match job.task {
                    Task::Run(run) => run.verb,
                    _ => None,
                };
                job.axis == axis.0 && verb.is_some_and(|v| v.needs_arming() || v.is_stop())
            })
        })
    }

    /// Takes what the host has to tell.
    fn settle(&mut self, now: Instant) {
        while let Some((to, answer)) = self.host.poll_event() {
            match to {
                To::Ticket(Ticket(n)) => self.answered(now, n as usize, answer),
                To::Address(address) => {
                    if let Ok(answer) = answer {
                        self.unasked(now, address, &answer);
                    }
                }
            }
        }
    }

    fn unasked(&mut self, now: Instant, address: u32, answer: &H::Answer) {
        for slot in self.slots.iter_mut().filter(|slot| slot.driver.address() == address) {
            if let Some((signal, raw)) = slot.driver.unasked(answer) {
                let reading = crate::axis::Reading { value: raw as f64, raw, at: Some(now) };
                slot.state.note(signal, reading);
            }
        }
    }

    fn answered(&mut self, now: Instant, n: usize, answer: Result<H::Answer, Failure>) {
        let Some(Some(job)) = self.jobs.get_mut(n) else { return };
        let Some(slot) = self.slots.get_mut(usize::from(job.axis)) else { return };
        let parameter = job.asked.parameter().and_then(|id| slot.profile.parameter(id));
        let raw = match &answer {
            Ok(answer) => slot.driver.answer(parameter, answer),
            Err(failure) => Err(*failure),
        };
        // What happens most, ahead of everything else: a read was answered.
        if let (Task::Read(_), Asked::Read(id), Ok(raw)) = (&job.task, job.asked, &raw) {
            slot.note(now, id, *raw);
            return self.end(n, Outcome::Done(*raw));
        }
        let next = execute::answered(now, job, slot, raw);
        self.follow(n, next);
    }

    fn follow(&mut self, n: usize, next: Next) {
        match next {
            Next::Go => self.ready |= 1 << n,
            Next::Sleep(until) => {
                self.sleeping |= 1 << n;
                self.wake = earliest(self.wake, Some(until));
            }
            Next::End(outcome) => self.end(n, outcome),
        }
    }

    /// Lets those whose time has come go on.
    fn rouse(&mut self, now: Instant) {
        if self.wake.is_none_or(|wake| wake > now) {
            return;
        }
        self.wake = None;
        for n in bits(self.sleeping) {
            let Some(Job { task: Task::Run(run), .. }) = &mut self.jobs[n] else { continue };
            match run.stage {
                Stage::Sleep(until) if until > now => {
                    self.wake = earliest(self.wake, Some(until));
                }
                _ => {
                    self.sleeping &= !(1 << n);
                    self.ready |= 1 << n;
                }
            }
        }
    }

    /// Hands the host the next request, if one is ready and the host can take it.
    fn feed(&mut self, now: Instant) {
        while self.ready != 0 {
            let n = self.next_turn();
            let Some(job) = &mut self.jobs[n] else { return };
            let Some(slot) = self.slots.get_mut(usize::from(job.axis)) else { return };
            let ticket = Ticket(n as u32);
            let submitted = match execute::plain_read(job, slot) {
                Some((id, request)) => {
                    self.host.submit(now, ticket, *request).map(|()| Asked::Read(id))
                }
                None => match execute::next(now, job, slot) {
                    Ok((request, asked)) => self.host.submit(now, ticket, request).map(|()| asked),
                    Err(next) => {
                        self.ready &= !(1 << n);
                        self.follow(n, next);
                        continue;
                    }
                },
            };
            let Ok(asked) = submitted else { return };
            job.asked = asked;
            execute::sent(job, asked);
            self.ready &= !(1 << n);
            self.turn = n as u32;
            // A host may end a request at once that its protocol's rules forbid.
            self.settle(now);
        }
    }

    fn next_turn(&self) -> usize {
        let (urgent, going) = (self.ready & self.urgent, self.ready & self.going);
        let from = match (urgent, going) {
            (0, 0) => self.ready,
            (0, going) => going,
            (urgent, _) => urgent,
        };
        let behind = from & (u64::MAX << (self.turn + 1).min(63));
        let pick = if behind == 0 { from } else { behind };
        pick.trailing_zeros() as usize
    }
}

impl<M: Medium, H: Host<M>> Timed for Lane<M, H> {
    fn handle_timeout(&mut self, now: Instant) {
        self.host.handle_timeout(now);
        self.settle(now);
        self.rouse(now);
    }

    fn poll_timeout(&self) -> Option<Instant> {
        earliest(self.host.poll_timeout(), self.wake)
    }
}

impl<M: Medium, H: Host<M>> Station<M> for Lane<M, H> {
    fn handle_input(&mut self, now: Instant, unit: &M::Unit) {
        self.host.handle_input(now, unit);
        self.settle(now);
    }

    fn handle_line(&mut self, now: Instant, event: LineEvent) {
        self.host.handle_line(now, event);
        self.settle(now);
        if event == LineEvent::Down {
            for n in bits(self.used & !self.ended) {
                let lost = self.jobs[n].as_ref().is_some_and(execute::may_have_been_executed);
                let failure = Failure::LinkDown;
                self.end(
                    n,
                    if lost { Outcome::Unknown(failure) } else { Outcome::NotDone(failure) },
                );
            }
        }
        if matches!(event, LineEvent::Down | LineEvent::Up) {
            self.slots.iter_mut().for_each(Slot::forget);
        }
    }

    fn poll_transmit(&mut self, now: Instant, out: &mut M::Out) -> Option<usize> {
        self.settle(now);
        self.rouse(now);
        self.feed(now);
        self.host.poll_transmit(now, out)
    }

    fn line(&self) -> M::Line {
        self.host.line()
    }
}

impl<M: Medium, H: Host<M>> Axes for Lane<M, H> {
    fn axes(&self) -> usize {
        self.slots.len()
    }

    fn address(&self, axis: AxisIndex) -> Option<u32> {
        Some(self.slot(axis).ok()?.driver.address())
    }

    fn profile(&self, axis: AxisIndex) -> Option<&'static Profile> {
        Some(self.slot(axis).ok()?.profile)
    }

    fn state(&self, axis: AxisIndex) -> Option<&State> {
        Some(&self.slot(axis).ok()?.state)
    }

    fn arm(&mut self, axis: AxisIndex, armed: bool) {
        if let Some(slot) = self.slots.get_mut(usize::from(axis.0)) {
            slot.state.armed = armed;
        }
    }

    fn command(
        &mut self,
        _now: Instant,
        ticket: Ticket,
        axis: AxisIndex,
        command: Command,
    ) -> Result<(), Unsupported> {
        let slot = self.slot(axis)?;
        let verb = command.verb;
        let plan = slot.profile.plan(verb).ok_or(Unsupported::NoPlan)?;
        for step in plan.steps {
            slot.check(step, &command)?;
        }
        if verb.needs_arming() {
            if !slot.state.armed {
                return Err(Unsupported::NotArmed);
            }
            if self.moving(axis) {
                return Err(Unsupported::Busy);
            }
        }
        if verb.is_stop() {
            self.cancel(axis);
        }
        let run = Run::new(Steps::Plan(plan.steps), plan.undo, command, Some(verb));
        let n = self.add(ticket, axis, Task::Run(run), verb.is_stop())?;
        self.urgent |= u64::from(verb.is_stop()) << n;
        self.going |= u64::from(verb.needs_arming()) << n;
        Ok(())
    }

    fn read(
        &mut self,
        _now: Instant,
        ticket: Ticket,
        axis: AxisIndex,
        parameter: ParameterId,
    ) -> Result<(), Unsupported> {
        self.slot(axis)?.read(parameter)?;
        self.add(ticket, axis, Task::Read(parameter), false).map(drop)
    }

    fn write(
        &mut self,
        _now: Instant,
        ticket: Ticket,
        axis: AxisIndex,
        id: ParameterId,
        raw: i64,
        keep: bool,
    ) -> Result<(), Unsupported> {
        let slot = self.slot(axis)?;
        let parameter = slot.writable(id, raw)?;
        if parameter.moves && !slot.state.armed {
            return Err(Unsupported::NotArmed);
        }
        let steps = Steps::Write(Write::new(slot.profile, id, raw, keep));
        let command = Command::new(crate::axis::Verb::Store);
        let run = Run::new(steps, &[], command, None);
        self.add(ticket, axis, Task::Run(run), false).map(drop)
    }

    fn raw(
        &mut self,
        _now: Instant,
        ticket: Ticket,
        axis: AxisIndex,
        text: &str,
    ) -> Result<(), Unsupported> {
        let slot = self.slot(axis)?;
        let request = slot.driver.parse(text)?;
        if request.class() == Class::Never && !slot.state.armed {
            return Err(Unsupported::NotArmed);
        }
        let stop = request.is_stop();
        if stop {
            self.cancel(axis);
        }
        let n = self.add(ticket, axis, Task::Raw(request), stop)?;
        self.urgent |= u64::from(stop) << n;
        Ok(())
    }

    fn poll_outcome(&mut self) -> Option<(Ticket, Outcome)> {
        if self.ended == 0 {
            return None;
        }
        let n = self.ended.trailing_zeros() as usize;
        self.ended &= !(1 << n);
        self.used &= !(1 << n);
        let job = self.jobs[n].as_ref()?;
        let ended = (job.ticket, job.outcome?);
        self.jobs[n] = None;
        Some(ended)
    }

    fn rehearse(
        &self,
        axis: AxisIndex,
        command: Command,
        show: &mut dyn FnMut(Rehearsed<'_>),
    ) -> Result<(), Unsupported> {
        let slot = self.slot(axis)?;
        let plan = slot.profile.plan(command.verb).ok_or(Unsupported::NoPlan)?;
        for step in plan.steps {
            slot.check(step, &command)?;
        }
        plan.steps.iter().try_for_each(|step| self.rehearse_step(slot, *step, &command, show))
    }

    fn to_si(&self, axis: AxisIndex, parameter: ParameterId, raw: i64) -> Option<f64> {
        self.slot(axis).ok()?.to_si(parameter, raw)
    }

    fn to_raw(&self, axis: AxisIndex, parameter: ParameterId, si: f64) -> Option<i64> {
        self.slot(axis).ok()?.to_raw(parameter, si)
    }

    fn counters(&self) -> Counters {
        self.host.counters()
    }
}

impl<M: Medium, H: Host<M>> Lane<M, H> {
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
            | Step::NoFault { read: id, .. }
            | Step::Until { read: id, .. } => (RehearsedStep::Read(id), read(id)?),
            Step::Copy { from, to } => (RehearsedStep::WriteWhatWasRead(from, to), read(from)?),
            Step::Send { function, index, operand, like } => {
                match slot.operand(operand, command, like)? {
                    None => return Ok(()),
                    Some(raw) => (RehearsedStep::Send, slot.driver.send(function, index, raw)?),
                }
            }
            Step::Keep(id) => {
                let parameter = slot.profile.parameter(id).ok_or(Unsupported::NoSuchParameter)?;
                (RehearsedStep::Keep(id), slot.driver.keep(parameter)?)
            }
            Step::Wait { ms } => {
                show(Rehearsed { step: RehearsedStep::Wait(ms), bytes: &[], id: None });
                return Ok(());
            }
        };
        M::render(&mut |out| self.host.emit(&request, out), &mut |id, bytes| {
            show(Rehearsed { step, bytes, id });
        });
        Ok(())
    }
}

fn bits(mut mask: u64) -> impl Iterator<Item = usize> {
    core::iter::from_fn(move || {
        let n = mask.trailing_zeros() as usize;
        (mask != 0).then(|| {
            mask &= mask - 1;
            n
        })
    })
}
