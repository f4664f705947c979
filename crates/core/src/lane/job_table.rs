//! The table of jobs: pending, waiting, complete.

use alloc::boxed::Box;

use super::execute::{self, JobState};
use super::job::{GroupResult, InFlight, Job, JobTask};
use super::slot::{self, AxisSlot};
use super::watch::WatchValue;
use super::{JOBS_MAX, RESERVED_STOP_JOBS};
use crate::axis::GroupAnswer;
use crate::error::{Failure, Outcome, Unsupported};
use crate::program::TransferKind;
use crate::station::{AxisIndex, EventSubject, HostEvent, Request, Ticket};
use crate::time::{Instant, earliest};

/// At most [`JOBS_MAX`] jobs. Bit n of each mask belongs to job n.
pub struct JobTable<R> {
    jobs: Box<[Option<Job<R>>; JOBS_MAX]>,
    used: u64,
    /// Has something to send.
    ready: u64,
    /// Goes before the others.
    urgent: u64,
    /// Jobs of plans that move or power the motor, a bit each: until such a plan waits, only a stop comes between its
    /// steps, so that no other request undoes an earlier step.
    motion: u64,
    /// Waits for a time.
    sleeping: u64,
    /// Has its outcome.
    ended: u64,
    /// Jobs behind the last served one: the next is searched among them first.
    after_last: u64,
    /// Time at which the first waiting job continues.
    pub wake_at: Option<Instant>,
}

impl<R: Request> JobTable<R> {
    pub fn new() -> Self {
        Self {
            jobs: Box::new([const { None }; JOBS_MAX]),
            used: 0,
            ready: 0,
            urgent: 0,
            motion: 0,
            sleeping: 0,
            ended: 0,
            after_last: !1,
            wake_at: None,
        }
    }

    /// Takes a job in. A stop has places that nothing else takes, and goes before all else.
    #[inline]
    pub fn add(
        &mut self,
        ticket: Ticket,
        axis: AxisIndex,
        task: JobTask<R>,
        stop: bool,
    ) -> Result<(), Unsupported> {
        // The lowest free bits are used first, so the reserved places are the last to be filled.
        let n = (!self.used).trailing_zeros() as usize;
        if n >= JOBS_MAX - if stop { 0 } else { RESERVED_STOP_JOBS } {
            return Err(Unsupported::Busy);
        }
        let moves = match &task {
            JobTask::Run(run) => run.needs_arming(),
            JobTask::Path => true,
            _ => false,
        };
        self.jobs[n] = Some(Job {
            ticket,
            axis: axis.0,
            task,
            in_flight: InFlight::Nothing,
            cancelled: false,
            no_retry: false,
            group_result: GroupResult::None,
            sleeps_until: Instant::ZERO,
            busy_since: None,
            outcome: None,
        });
        let bit = 1 << n;
        debug_assert_eq!(
            (self.ready | self.sleeping | self.ended) & bit,
            0,
            "a free place has no state"
        );
        self.used |= bit;
        self.ready |= bit;
        if stop || moves || (self.urgent | self.motion) & bit != 0 {
            self.urgent = self.urgent & !bit | u64::from(stop) << n;
            self.motion = self.motion & !bit | u64::from(moves) << n;
        }
        Ok(())
    }

    /// The next of the `open` jobs: stops first, then started jobs, then the others in turn.
    #[inline]
    pub fn next_ready(&mut self, open: u64) -> Option<(usize, &mut Job<R>)> {
        let ready = self.ready & open;
        if ready == 0 {
            return None;
        }
        let mut from = ready;
        if from & (self.urgent | self.motion) != 0 {
            let urgent = from & self.urgent;
            from &= if urgent == 0 { self.motion } else { urgent };
        }
        // In turns, so that one caller who asks again and again does not keep the others waiting.
        let behind = from & self.after_last;
        let pick = if behind == 0 { from } else { behind };
        let n = pick.trailing_zeros() as usize;
        Some((n, self.jobs.get_mut(n)?.as_mut()?))
    }

    /// Job `n`.
    pub fn get_mut(&mut self, n: usize) -> Option<&mut Job<R>> {
        self.jobs.get_mut(n)?.as_mut()
    }

    /// The axis that job `n` is for.
    pub fn axis_of(&self, n: usize) -> Option<u8> {
        Some(self.jobs.get(n)?.as_ref()?.axis)
    }

    /// The jobs of the axis that job `n` is for.
    #[cold]
    pub fn same_axis_mask(&self, n: usize) -> u64 {
        set_bits(self.used)
            .filter(|m| self.job_axis(*m) == self.job_axis(n))
            .fold(0, |mask, m| mask | 1 << m)
    }

    fn job_axis(&self, n: usize) -> Option<u8> {
        self.jobs[n].as_ref().map(|job| job.axis)
    }

    /// The host's ticket for the protocol's own request that runs under `ticket`.
    pub fn raw_request_ticket(&self, ticket: Ticket) -> Option<Ticket> {
        set_bits(self.used & !self.ended)
            .find(|n| {
                let job = self.jobs[*n].as_ref();
                job.is_some_and(|job| job.ticket == ticket && matches!(job.task, JobTask::Raw(_)))
            })
            .map(|n| Ticket(n as u32))
    }

    /// The request of job `n` is out: the next turn is another's.
    #[inline]
    pub fn mark_sent(&mut self, n: usize) {
        self.ready &= !(1 << n);
        debug_assert_eq!(self.used >> n & 1, 1, "only a job in use is sent");
        debug_assert_eq!(
            (self.sleeping | self.ended) >> n & 1,
            0,
            "what is sent neither sleeps nor has ended"
        );
        self.after_last = !1 << n;
    }

    /// The host gave the request of job `n` back, unsent: a stop has its place.
    #[cold]
    pub fn return_unsent(&mut self, n: usize) {
        let Some(Some(job)) = self.jobs.get_mut(n) else { return };
        job.in_flight = InFlight::Nothing;
        if job.cancelled {
            // It could not be recalled before, because its request was waiting for the line to be silent (STOP-3).
            let outcome = execute::abort_outcome(job, Failure::Cancelled);
            self.end_job(n, outcome);
        } else {
            self.ready |= 1 << n;
        }
    }

    /// Job `n` had its turn and sent nothing.
    pub fn apply_unsent(&mut self, n: usize, next: JobState) {
        self.ready &= !(1 << n);
        self.apply(n, next);
    }

    /// Takes the answer to a read of a parameter, if the event is one: what happens most, so it is
    /// looked at first. Returns false when it is something else.
    #[inline]
    pub fn handle_read_answer<A: Copy + 'static>(
        &mut self,
        now: Instant,
        slots: &mut [AxisSlot<R, A>],
        event: &HostEvent<A>,
    ) -> bool {
        let (EventSubject::Request(Ticket(n)), Ok(answer)) = event else { return false };
        let n = *n as usize;
        let Some(Some(job)) = self.jobs.get_mut(n) else { return false };
        let (JobTask::Read(_), InFlight::Read(id), GroupResult::None) =
            (&job.task, job.in_flight, job.group_result)
        else {
            return false;
        };
        let Some(slot) = slots.get_mut(usize::from(job.axis)) else { return false };
        match slot.handle_answer(now, id, answer) {
            Ok(raw) => self.end_job(n, Outcome::Done(raw)),
            // The general way counts attempts and marks what the drive lacks.
            // A busy drive is asked again.
            Err(Failure::Refused { .. } | Failure::WrongSize { .. }) => return false,
            Err(failure) => self.fail_job(n, failure),
        }
        true
    }

    /// Processes the reply to the request of job `n`.
    pub fn handle_answer<A: Copy + 'static>(
        &mut self,
        now: Instant,
        slots: &mut [AxisSlot<R, A>],
        n: usize,
        answer: &Result<A, Failure>,
    ) {
        let Some(Some(job)) = self.jobs.get_mut(n) else { return };
        let Some(slot) = slots.get_mut(usize::from(job.axis)) else { return };
        let parameter = job.in_flight.parameter().and_then(|id| slot.parameter(id));
        let raw = match answer {
            Ok(answer) => slot.driver.decode_answer(parameter, answer),
            Err(failure) => Err(*failure),
        };
        let raw = execute::merge_group_result(job, raw);
        let next = execute::handle_answer(now, job, slot, raw);
        execute::note_end(now, &next, job, slot);
        self.apply(n, next);
    }

    /// Processes the reply of one drive of a group to the request of job `n`.
    #[cold]
    pub fn handle_group_answer<A: Copy + 'static>(
        &mut self,
        now: Instant,
        slots: &mut [AxisSlot<R, A>],
        n: usize,
        address: u32,
        answer: &Result<A, Failure>,
    ) -> Option<GroupAnswer> {
        let job = self.jobs.get_mut(n)?.as_mut()?;
        let slot = slots.get_mut(usize::from(job.axis))?;
        let (profile, parameter_id) = (slot.profile, job.in_flight.parameter());
        let parameter = parameter_id.and_then(|id| slot.parameter(id));
        let raw = slot.driver.decode_answer(parameter, answer.as_ref().ok()?).ok()?;
        job.group_result = job.group_result.combine(raw, execute::passes_test(job, raw));
        let part = GroupAnswer { ticket: job.ticket, address, raw };
        if let (InFlight::Watch(id), JobTask::Run(run)) = (job.in_flight, &job.task) {
            slot.observe(now, address, &WatchValue::of(run), id, raw);
        }
        if let Some(id) = parameter_id {
            slot::record_group_answer(now, slots, &part, profile, id);
        }
        // Requests of the lane itself concern no other job.
        matches!(job.in_flight, InFlight::Read(_) | InFlight::Send(_)).then_some(part)
    }

    fn apply(&mut self, n: usize, next: JobState) {
        match next {
            JobState::Ready => self.ready |= 1 << n,
            JobState::Sleeping(until) => {
                if let Some(job) = &mut self.jobs[n] {
                    job.sleeps_until = until;
                }
                debug_assert_eq!(
                    (self.ready | self.ended) >> n & 1,
                    0,
                    "a job either runs or sleeps"
                );
                self.sleeping |= 1 << n;
                self.wake_at = earliest(self.wake_at, Some(until));
            }
            JobState::NeedsPoints => {}
            JobState::Ended(outcome) => self.end_job(n, outcome),
        }
    }

    /// Ends a job that neither is ready nor sleeps.
    #[inline]
    fn end_job(&mut self, n: usize, outcome: Outcome) {
        if let Some(job) = &mut self.jobs[n] {
            debug_assert!(job.outcome.is_none(), "an outcome is final");
            job.outcome = Some(outcome);
            job.in_flight = InFlight::Nothing;
        }
        debug_assert_eq!(self.used >> n & 1, 1, "only a job in use can end");
        self.ended |= 1 << n;
    }

    #[cold]
    fn fail_job(&mut self, n: usize, failure: Failure) {
        self.end_job(n, Outcome::NotDone(failure));
    }

    /// Ends a job wherever it is.
    fn abort_job(&mut self, n: usize, outcome: Outcome) {
        self.ready &= !(1 << n);
        self.sleeping &= !(1 << n);
        self.end_job(n, outcome);
    }

    /// Gives out one that is through.
    #[inline]
    pub fn pop_outcome(&mut self) -> Option<(Ticket, Outcome)> {
        if self.ended == 0 {
            return None;
        }
        let n = self.ended.trailing_zeros() as usize;
        self.ended &= !(1 << n);
        self.used &= !(1 << n);
        let position = self.jobs.get_mut(n)?;
        let job = position.as_ref()?;
        // Made anew, as one number: what was just written in parts is slow to read as a whole.
        if let Some(Outcome::Done(raw)) = job.outcome {
            let ticket = job.ticket;
            *position = None;
            return Some((ticket, Outcome::Done(raw)));
        }
        take_ended(position)
    }

    /// Ends what runs on an axis, reads excepted: a stop is next.
    pub fn cancel_axis(&mut self, axis: AxisIndex) {
        for n in set_bits(self.used & !self.ended) {
            let Some(job) = &mut self.jobs[n] else { continue };
            if job.axis != axis.0 || matches!(job.task, JobTask::Read(_)) {
                continue;
            }
            if job.in_flight == InFlight::Nothing {
                let outcome = execute::abort_outcome(job, Failure::Cancelled);
                self.abort_job(n, outcome);
            } else {
                // Its request is on the wire. To end it now would free its place for another job, and the reply would
                // be taken for that one's.
                job.cancelled = true;
            }
        }
    }

    /// Ends all running jobs after the loss of the link.
    pub fn handle_link_down(&mut self) {
        for n in set_bits(self.used & !self.ended) {
            let Some(job) = &self.jobs[n] else { continue };
            // A reply may still come after the cable is back. The host refuses it then, because the job is gone
            // (REQ-8).
            let outcome = execute::abort_outcome(job, Failure::LinkDown);
            self.abort_job(n, outcome);
        }
    }

    /// Returns whether an axis runs a plan that moves or stops it.
    pub fn is_moving(&self, axis: AxisIndex) -> bool {
        set_bits(self.used & !self.ended).filter_map(|n| self.jobs[n].as_ref()).any(|job| {
            let moves = match &job.task {
                JobTask::Run(run) => run.needs_arming() || run.is_stop(),
                JobTask::Path | JobTask::Transfer(TransferKind::Write) => true,
                _ => false,
            };
            job.axis == axis.0 && moves
        })
    }

    /// Returns whether a memory transfer of an axis is running.
    pub fn has_transfer(&self, axis: AxisIndex) -> bool {
        let jobs = set_bits(self.used & !self.ended).filter_map(|n| self.jobs[n].as_ref());
        let mut transfers = jobs.filter(|job| matches!(job.task, JobTask::Transfer(_)));
        transfers.any(|job| job.axis == axis.0)
    }

    /// No request of the job of this ticket is sent again.
    pub fn disable_retries(&mut self, ticket: Ticket) {
        for n in set_bits(self.used & !self.ended) {
            if let Some(job) = self.jobs[n].as_mut().filter(|job| job.ticket == ticket) {
                job.no_retry = true;
            }
        }
    }

    /// Resumes the path job of this ticket because points have arrived, and returns its axis.
    pub fn resume_path(&mut self, ticket: Ticket) -> Option<u8> {
        for n in set_bits(self.used & !self.ended) {
            let Some(job) = &self.jobs[n] else { continue };
            if job.ticket != ticket || !matches!(job.task, JobTask::Path) {
                continue;
            }
            if job.in_flight == InFlight::Nothing {
                self.sleeping &= !(1 << n);
                self.ready |= 1 << n;
            }
            return Some(job.axis);
        }
        None
    }

    /// Resumes the jobs whose pause has ended.
    #[inline]
    pub fn wake_due_jobs(&mut self, now: Instant) {
        if self.wake_at.is_some_and(|wake| wake <= now) {
            self.scan_sleeping_jobs(now);
        }
    }

    fn scan_sleeping_jobs(&mut self, now: Instant) {
        self.wake_at = None;
        for n in set_bits(self.sleeping) {
            let Some(job) = &self.jobs[n] else { continue };
            if job.sleeps_until > now {
                self.wake_at = earliest(self.wake_at, Some(job.sleeps_until));
            } else {
                self.sleeping &= !(1 << n);
                self.ready |= 1 << n;
            }
        }
    }
}

/// Takes a job that is through out of its place.
#[cold]
fn take_ended<R>(position: &mut Option<Job<R>>) -> Option<(Ticket, Outcome)> {
    let job = position.take()?;
    Some((job.ticket, job.outcome?))
}

fn set_bits(mut mask: u64) -> impl Iterator<Item = usize> {
    core::iter::from_fn(move || {
        let n = mask.trailing_zeros() as usize;
        (mask != 0).then(|| {
            mask &= mask - 1;
            n
        })
    })
}
