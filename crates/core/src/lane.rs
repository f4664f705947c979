//! One host with its axes: jobs take turns on the wire, stops first. Plans are executed here.
//!
//! Memory is allocated when the lane is made, an axis is added, or a path is begun, and not afterwards.

mod address_change;
mod answer;
mod axes;
mod cyclic;
mod event_queue;
mod execute;
mod guard;
mod job;
mod job_table;
mod measure;
mod path;
mod slot;
mod step_check;
#[cfg(test)]
mod tests;
mod watch;

use alloc::boxed::Box;
use alloc::collections::VecDeque;
use alloc::vec::Vec;
use core::marker::PhantomData;

use crate::axis::{
    AxisEvent, AxisStatus, Command, GroupAnswer, RehearsalAction, RehearsalStep, StopPart, Verb,
};
use crate::error::{Failure, Outcome, Unsupported};
use crate::explain::{Impact, RawFrame};
use crate::medium::Medium;
use crate::plan::Step;
use crate::profile::{AddressRole, Parameter, ParameterId, Profile, Signal};
use crate::program::{MemoryRules, ProgramCommand};
use crate::proto::drive_address;
use crate::station::{
    AxisIndex, Counters, EventSubject, Host, HostEvent, LineEvent, Request, RequestClass, Station,
    Ticket, Timed,
};
use crate::stream::cyclic::{CycleStatistics, CyclicConfig, LOAD_MAX_PERCENT, SetpointKind};
use crate::stream::{PathKind, Point};
use crate::time::{Instant, earliest};
use cyclic::CyclicMotion;
pub use event_queue::AXIS_EVENTS_MAX;
use event_queue::EventQueue;
use job::{InFlight, JobTask, PlanRun, StepSource, WriteSteps};
use job_table::JobTable;
use path::PathStream;
use slot::AxisSlot;
pub use slot::{BoxedDriver, DriverFactory};

/// Jobs that a lane holds at once.
pub const JOBS_MAX: usize = 64;
/// Number of job slots reserved for stops. A stop is never refused as busy because of other jobs.
pub const RESERVED_STOP_JOBS: usize = 4;

/// Most group replies in the queue; the oldest are dropped.
pub const GROUP_ANSWERS_MAX: usize = 512;

/// One host, its axes, and the jobs that take turns on it.
pub struct Lane<M: Medium, H: Host<M>> {
    host: H,
    slots: Vec<AxisSlot<H::Request, H::Answer>>,
    jobs: JobTable<H::Request>,
    /// Answers of drives of a group that were not taken yet.
    group_answers: VecDeque<GroupAnswer>,
    /// Axes that follow one beat, or did last.
    cyclic: Option<Box<CyclicMotion>>,
    /// Events that were not taken yet, while there is a listener.
    events: Option<Box<EventQueue>>,
    /// Factory of the driver of an axis that joins.
    driver_factory: Option<DriverFactory<H::Request, H::Answer>>,
    medium: PhantomData<fn() -> M>,
}

impl<M: Medium, H: Host<M>> core::fmt::Debug for Lane<M, H> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("Lane").field("slots", &self.slots).finish_non_exhaustive()
    }
}

/// The steps that write one parameter, to RAM or to permanent memory.
#[must_use]
pub fn write_steps(
    profile: &Profile,
    id: ParameterId,
    parameter: &Parameter,
    raw: i64,
    keep: bool,
) -> Vec<Step> {
    let steps = StepSource::Write(WriteSteps::new(profile, id, parameter, raw, keep, false));
    (0..=u8::MAX).map_while(|at| steps.step(at)).collect()
}

impl<M: Medium, H: Host<M>> Lane<M, H> {
    /// A lane of that host with one axis per driver, in that order. At most 256 axes.
    pub fn new(
        host: H,
        drivers: impl IntoIterator<Item = BoxedDriver<H::Request, H::Answer>>,
    ) -> Self {
        let slots: Vec<AxisSlot<_, _>> = drivers.into_iter().take(256).map(AxisSlot::new).collect();
        let groups = slots.iter().any(|slot| slot.driver.is_group());
        Self {
            host,
            slots,
            jobs: JobTable::new(),
            group_answers: VecDeque::with_capacity(if groups { GROUP_ANSWERS_MAX } else { 0 }),
            cyclic: None,
            events: None,
            driver_factory: None,
            medium: PhantomData,
        }
    }

    /// The lane with a factory, so that axes can [join](crate::axis::AxisDirectory::add_axis).
    #[must_use]
    pub fn with_driver_factory(self, make: DriverFactory<H::Request, H::Answer>) -> Self {
        Self { driver_factory: Some(make), ..self }
    }

    /// The host, for what only its protocol has.
    pub fn host(&self) -> &H {
        &self.host
    }

    fn slot(&self, axis: AxisIndex) -> Result<&AxisSlot<H::Request, H::Answer>, Unsupported> {
        self.slots.get(usize::from(axis.0)).ok_or(Unsupported::NoSuchAxis)
    }

    /// Processes all pending host events. Runs after every call.
    #[inline]
    fn drain_host_events(&mut self, now: Instant) {
        while let Some(event) = self.host.poll_event() {
            // Looked up before the event is processed, because that may free the job's place.
            let silent = silent_axis(&self.jobs, event);
            let report = (&mut self.group_answers, &mut self.events);
            handle_host_event(now, &mut self.jobs, &mut self.slots, report, event);
            if let (Some(cycle), (EventSubject::Unsolicited(address), Ok(_))) =
                (&mut self.cyclic, event)
            {
                cycle.handle_report(now, *address, &self.slots);
            }
            if let Some(axis) = silent {
                self.record_silence(axis);
            }
        }
    }

    /// Records the frames received during a request of this axis that timed out.
    #[cold]
    fn record_silence(&mut self, axis: u8) {
        // A session keeps only its counters; the difference to those at the request is the traffic during it
        // (REQ-4). Bytes that are no frame yet count as skipped: an adapter at the wrong rate produces nothing
        // else.
        let mut counted = self.host.counters();
        counted.skipped += self.host.unparsed_len() as u64;
        if let Some(slot) = self.slots.get_mut(usize::from(axis)) {
            slot.silence_counters = counted.since(slot.counters_at_request);
        }
    }

    /// Submits the next ready request to the host, if the host is free.
    #[inline]
    fn submit_ready_jobs(&mut self, now: Instant) {
        // A host that asks many drives at once skips those that have not answered yet.
        let mut open = u64::MAX;
        while let Some((n, job)) = self.jobs.next_ready(open) {
            let Some(slot) = self.slots.get_mut(usize::from(job.axis)) else { return };
            // A scale that cannot be true may be the reply to another question (REQ-6). The host first proves the
            // order of replies again; without that it would believe the same wrong value twice.
            if core::mem::take(&mut slot.implausible_reply) {
                self.host.quarantine_drive(now, drive_address(slot.driver.address()));
            }
            if let Some((id, request)) = execute::plain_read_request(job, slot) {
                if let Ok(()) = self.host.submit(now, Ticket(n as u32), *request) {
                    debug_assert_eq!(
                        job.in_flight,
                        InFlight::Nothing,
                        "one request of a job at a time"
                    );
                    job.in_flight = InFlight::Read(id);
                    if job.no_retry {
                        self.host.disable_retries(Ticket(n as u32));
                    }
                    slot.counters_at_request = self.host.counters();
                    self.jobs.mark_sent(n);
                } else if H::PARALLEL {
                    open &= !self.jobs.same_axis_mask(n);
                    continue;
                } else {
                    return;
                }
            } else if !self.submit_job(now, n) {
                if H::PARALLEL {
                    open &= !self.jobs.same_axis_mask(n);
                    continue;
                }
                return;
            }
            // A host may end a request at once that its protocol's rules forbid.
            self.drain_host_events(now);
        }
    }

    /// Submits the next request of job `n`. Returns false if the host does not accept it.
    #[inline(never)]
    fn submit_job(&mut self, now: Instant, n: usize) -> bool {
        let Some(job) = self.jobs.get_mut(n) else { return false };
        let Some(slot) = self.slots.get_mut(usize::from(job.axis)) else { return false };
        match execute::next_request(now, job, slot) {
            Ok((request, in_flight)) => {
                // Requests that wait for a silent line go after a stop, not before it.
                if request.is_stop()
                    && let Some(Ticket(other)) = self.host.recall(&request)
                {
                    self.jobs.return_unsent(other as usize);
                }
                let Ok(()) = self.host.submit(now, Ticket(n as u32), request) else { return false };
                slot.counters_at_request = self.host.counters();
                if let Some(job) = self.jobs.get_mut(n) {
                    job.in_flight = in_flight;
                    if job.no_retry {
                        self.host.disable_retries(Ticket(n as u32));
                    }
                    // From here on the motor may turn, whatever becomes of the reply.
                    slot.state.motion_active |= job.starts_motion(slot, in_flight);
                }
                self.jobs.mark_sent(n);
            }
            Err(next) => {
                debug_assert_eq!(
                    job.in_flight,
                    InFlight::Nothing,
                    "a job that sends nothing waits for nothing"
                );
                execute::note_end(now, &next, job, slot);
                self.jobs.apply_unsent(n, next);
            }
        }
        true
    }
}

/// The axis whose request timed out with this event.
fn silent_axis<R: Request, A>(jobs: &JobTable<R>, (to, answer): &HostEvent<A>) -> Option<u8> {
    match (to, answer) {
        (EventSubject::Request(Ticket(n)), Err(Failure::Silent)) => jobs.axis_of(*n as usize),
        _ => None,
    }
}

/// Processes one host event.
#[inline(never)]
fn handle_host_event<R: Request, A: Copy + 'static>(
    now: Instant,
    jobs: &mut JobTable<R>,
    slots: &mut [AxisSlot<R, A>],
    report: (&mut VecDeque<GroupAnswer>, &mut Option<Box<EventQueue>>),
    (to, answer): &HostEvent<A>,
) {
    let (parts, event_queue) = report;

    match (to, answer) {
        (EventSubject::Request(Ticket(n)), _) => {
            jobs.handle_answer(now, slots, *n as usize, answer)
        }
        (EventSubject::Unsolicited(address), Ok(answer)) => {
            slot::handle_unsolicited(now, slots, event_queue, *address, answer)
        }
        (EventSubject::GroupMember(Ticket(n), address), _) => {
            let part = jobs.handle_group_answer(now, slots, *n as usize, *address, answer);
            let Some(part) = part else { return };
            // The newest replies are of more use than the oldest to a caller that fell behind.
            if parts.len() >= GROUP_ANSWERS_MAX {
                parts.pop_front();
            }
            parts.push_back(part);
        }
        (EventSubject::Unsolicited(_), Err(_)) => {}
    }
}

impl<M: Medium, H: Host<M>> Timed for Lane<M, H> {
    fn handle_timeout(&mut self, now: Instant) {
        self.host.handle_timeout(now);
        self.drain_host_events(now);
        self.jobs.wake_due_jobs(now);
    }

    fn poll_timeout(&self) -> Option<Instant> {
        let due = self.cyclic.as_ref().and_then(|cycle| cycle.due());
        earliest(due, earliest(self.host.poll_timeout(), self.jobs.wake_at))
    }
}

impl<M: Medium, H: Host<M>> Station<M> for Lane<M, H> {
    fn handle_input(&mut self, now: Instant, unit: &M::Unit) {
        self.host.handle_input(now, unit);
        while let Some(event) = self.host.poll_event() {
            if self.jobs.handle_read_answer(now, &mut self.slots, event) {
                continue;
            }
            // Looked up before the event is processed, because that may free the job's place.
            let silent = silent_axis(&self.jobs, event);
            let report = (&mut self.group_answers, &mut self.events);
            handle_host_event(now, &mut self.jobs, &mut self.slots, report, event);
            if let (Some(cycle), (EventSubject::Unsolicited(address), Ok(_))) =
                (&mut self.cyclic, event)
            {
                cycle.handle_report(now, *address, &self.slots);
            }
            if let Some(axis) = silent {
                self.record_silence(axis);
            }
        }
    }

    fn handle_line(&mut self, now: Instant, event: LineEvent) {
        self.host.handle_line(now, event);
        self.drain_host_events(now);
        // A bus-off controller sends nothing: for every job that is a pulled cable.
        if matches!(event, LineEvent::Down | LineEvent::BusOff) {
            self.jobs.handle_link_down();
            if let Some(cycle) = &mut self.cyclic {
                cycle.handle_link_down();
            }
        }
        // Whatever was plugged in since may be another drive, with other scales. A break is only a disturbed
        // line.
        if event != LineEvent::Break {
            self.slots.iter_mut().for_each(AxisSlot::forget_learned);
        }
    }

    fn poll_transmit(&mut self, now: Instant, out: &mut M::Out) -> Option<usize> {
        // A beat keeps its time whatever other requests wait.
        if let Some(cycle) = &mut self.cyclic
            && let Some(request) = cycle.poll_request(now, &mut self.slots)
        {
            return Some(self.host.transmit_now(now, &request, out));
        }
        self.jobs.wake_due_jobs(now);
        self.submit_ready_jobs(now);
        let sent = self.host.poll_transmit(now, out);
        self.drain_host_events(now);
        sent
    }

    fn line(&self) -> M::Line {
        self.host.line()
    }
}

/// Kind of set-point that a verb prepares a drive for.
const fn setpoint_kind_of(verb: Verb) -> Option<SetpointKind> {
    match verb {
        Verb::FollowPosition => Some(SetpointKind::Position),
        Verb::FollowVelocity => Some(SetpointKind::Velocity),
        Verb::FollowTorque => Some(SetpointKind::Torque),
        _ => None,
    }
}

impl<M: Medium, H: Host<M>> Lane<M, H> {
    fn slot_mut(
        &mut self,
        axis: AxisIndex,
    ) -> Result<&mut AxisSlot<H::Request, H::Answer>, Unsupported> {
        self.slots.get_mut(usize::from(axis.0)).ok_or(Unsupported::NoSuchAxis)
    }

    /// Starts steps that carry a command out; what stops ends what runs.
    fn start_steps(
        &mut self,
        ticket: Ticket,
        axis: AxisIndex,
        steps: &'static [Step],
        undo: &'static [Step],
        halt_steps: Option<usize>,
        command: Command,
    ) -> Result<(), Unsupported> {
        let verb = command.verb;
        if verb.is_stop() {
            self.cancel_motion(axis);
        }
        if verb.needs_arming() || verb.is_stop() {
            self.slot_mut(axis)?.setpoint_kind = setpoint_kind_of(verb);
        }
        let ends_program = self.slot(axis)?.program_end_request(&command).is_some();
        // A program that goes on would set the motor going again after the stop, so it is ended between two
        // stops (STOP-19).
        let program_end = halt_steps.filter(|_| ends_program).and_then(|at| u8::try_from(at).ok());
        if program_end.is_some() {
            let state = &mut self.slot_mut(axis)?.state;
            (state.program_end, state.store_ended) = (None, false);
        }
        let run = PlanRun {
            program_end,
            ..PlanRun::new(StepSource::Plan(steps), undo, command, Some(verb))
        };
        self.jobs.add(ticket, axis, JobTask::Run(run), verb.is_stop())
    }

    fn in_cyclic_motion(&self, axis: AxisIndex) -> bool {
        self.cyclic.as_ref().is_some_and(|cycle| cycle.is_commanding(axis))
    }

    /// Returns whether a job moves or stops an axis.
    fn is_moving(&self, axis: AxisIndex) -> bool {
        self.jobs.is_moving(axis) || self.in_cyclic_motion(axis)
    }

    /// Ends what moves an axis: a stop is next. All that follow its beat stop with it.
    fn cancel_motion(&mut self, axis: AxisIndex) {
        self.jobs.cancel_axis(axis);
        if let Some(cycle) = self.cyclic.as_mut().filter(|cycle| cycle.is_commanding(axis)) {
            cycle.cancel();
        }
    }

    /// Refuses a write that may move the motor unless the axis is armed and follows no set-points.
    fn check_moves(&self, axis: AxisIndex, parameter: &Parameter) -> Result<(), Unsupported> {
        if parameter.moves && !self.slot(axis)?.state.armed {
            return Err(Unsupported::NotArmed);
        }
        if parameter.moves && self.in_cyclic_motion(axis) {
            return Err(Unsupported::Busy);
        }
        Ok(())
    }

    /// One request of the protocol's own: what may move the motor needs an armed axis, what stops it
    /// ends what runs.
    fn queue_raw_request(
        &mut self,
        ticket: Ticket,
        axis: AxisIndex,
        request: H::Request,
    ) -> Result<(), Unsupported> {
        let slot = self.slot(axis)?;
        if request.effect(slot.profile).impact >= Impact::Motion && !slot.state.armed {
            return Err(Unsupported::NotArmed);
        }
        // Its effect, and not the text that it was typed as, decides what a raw request needs.
        let stop = request.is_stop();
        if stop {
            self.cancel_motion(axis);
        }
        self.jobs.add(ticket, axis, JobTask::Raw(request), stop)
    }

    fn rehearse_step(
        &self,
        slot: &AxisSlot<H::Request, H::Answer>,
        step: Step,
        command: &Command,
        show: &mut dyn FnMut(RehearsalStep<'_>),
    ) -> Result<(), Unsupported> {
        let read = |id| slot.read_request(id).copied();
        let write = |id, raw| {
            slot.driver.write_request(slot.check_writable(id, raw)?, raw, RequestClass::ReadBack)
        };
        let (step, request) = match step {
            Step::Write(id, operand) => match slot.operand_value(operand, command, Some(id))? {
                None => return Ok(()),
                Some(raw) => {
                    let id = slot.chosen_path_parameter(id, command);
                    (RehearsalAction::Write(id, raw), write(id, raw)?)
                }
            },
            Step::WriteTogether(writes) => {
                let class = RequestClass::NoRetry;
                let request = slot.write_together_request(writes, command, class)?;
                (RehearsalAction::WriteTogether(writes), request)
            }
            Step::Ensure(id, raw) => (RehearsalAction::WriteIfDifferent(id, raw), write(id, raw)?),
            Step::WriteBits { id, mask, raw } => {
                (RehearsalAction::WriteBits(id, mask, raw), read(id)?)
            }
            Step::SkipBySign { .. } => return Ok(()),
            Step::Read(id)
            | Step::Require { read: id, .. }
            | Step::Skip { read: id, .. }
            | Step::SkipIfMissing { read: id, .. }
            | Step::NoFault { read: id, .. }
            | Step::Until { read: id, .. }
            | Step::Homed { read: id, .. }
            | Step::Arrival { flag: Some((id, _)), .. } => (RehearsalAction::Read(id), read(id)?),
            Step::Copy { from, to } => (RehearsalAction::WriteReadValue(from, to), read(from)?),
            Step::Send { function, index, operand, like } => {
                match slot.operand_value(operand, command, like)? {
                    None => return Ok(()),
                    Some(raw) => {
                        let request = slot.driver.command_request(command, function, index, raw)?;
                        (RehearsalAction::Send, request)
                    }
                }
            }
            Step::Store(id) => {
                let parameter = slot.parameter(id).ok_or(Unsupported::NoSuchParameter)?;
                (RehearsalAction::Store(id), slot.driver.store_request(parameter)?)
            }
            Step::Standstill { .. } | Step::Arrival { flag: None, .. } => {
                let awaited = match step {
                    Step::Standstill { .. } => slot.profile.signal(Signal::Velocity),
                    _ => None,
                };
                let position = slot.profile.signal(Signal::Position);
                let Some(id) = awaited.or(position).map(|source| source.parameter) else {
                    return Ok(());
                };
                (RehearsalAction::Read(id), read(id)?)
            }
            Step::Wait { ms } => {
                show(RehearsalStep { action: RehearsalAction::Wait(ms), bytes: &[], frame: None });
                return Ok(());
            }
        };
        self.show_request(step, &request, show);
        Ok(())
    }

    fn rehearse_steps(
        &self,
        slot: &AxisSlot<H::Request, H::Answer>,
        steps: &[Step],
        command: &Command,
        show: &mut dyn FnMut(RehearsalStep<'_>),
    ) -> Result<(), Unsupported> {
        let mut left_out = 0;
        for step in steps {
            if left_out > 0 {
                left_out -= 1;
                continue;
            }
            match *step {
                Step::SkipBySign { count, .. } if step.skips(command) => left_out = count,
                _ => self.rehearse_step(slot, *step, command, show)?,
            }
        }
        Ok(())
    }

    fn show_request(
        &self,
        action: RehearsalAction,
        request: &H::Request,
        show: &mut dyn FnMut(RehearsalStep<'_>),
    ) {
        M::render(&mut |out| self.host.encode_request(request, out), &mut |frame, bytes| {
            show(RehearsalStep { action, bytes, frame });
        });
    }
}
