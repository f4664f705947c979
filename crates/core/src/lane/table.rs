//! The table of jobs: who has something to send, who waits, who is through.

use alloc::boxed::Box;

use super::execute::{self, Next};
use super::job::{Asked, Job, Parts, Task};
use super::slot::{self, Slot};
use super::transfer::TransferKind;
use super::{JOBS_MAX, STOP_JOBS};
use crate::axis::Part;
use crate::error::{Failure, Outcome, Unsupported};
use crate::station::{AxisIndex, Event, Request, Ticket, To};
use crate::time::{Instant, earliest};

/// At most [`JOBS_MAX`] jobs. Bit n of each mask stands for job n.
pub struct Table<R> {
    jobs: Box<[Option<Job<R>>; JOBS_MAX]>,
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
    /// Those behind who was served last: the next one is looked for among them first.
    behind: u64,
    /// When the first of those that wait goes on.
    pub wake: Option<Instant>,
}

impl<R: Request> Table<R> {
    pub fn new() -> Self {
        Self {
            jobs: Box::new([const { None }; JOBS_MAX]),
            used: 0,
            ready: 0,
            urgent: 0,
            going: 0,
            sleeping: 0,
            ended: 0,
            behind: !1,
            wake: None,
        }
    }

    /// Takes a job in. A stop has places that nothing else takes, and goes before all else.
    #[inline]
    pub fn add(
        &mut self,
        ticket: Ticket,
        axis: AxisIndex,
        task: Task<R>,
        stop: bool,
    ) -> Result<(), Unsupported> {
        let n = (!self.used).trailing_zeros() as usize;
        if n >= JOBS_MAX - if stop { 0 } else { STOP_JOBS } {
            return Err(Unsupported::Busy);
        }
        let moves = match &task {
            Task::Run(run) => run.moves(),
            Task::Path => true,
            _ => false,
        };
        self.jobs[n] = Some(Job {
            ticket,
            axis: axis.0,
            task,
            asked: Asked::Nothing,
            cancelled: false,
            once: false,
            parts: Parts::None,
            until: Instant::ZERO,
            outcome: None,
        });
        let bit = 1 << n;
        self.used |= bit;
        self.ready |= bit;
        if stop || moves || (self.urgent | self.going) & bit != 0 {
            self.urgent = self.urgent & !bit | u64::from(stop) << n;
            self.going = self.going & !bit | u64::from(moves) << n;
        }
        Ok(())
    }

    /// Whose turn it is of those `open`: stops first, then what is going, then all others in a ring.
    #[inline]
    pub fn next(&mut self, open: u64) -> Option<(usize, &mut Job<R>)> {
        let ready = self.ready & open;
        if ready == 0 {
            return None;
        }
        let mut from = ready;
        if from & (self.urgent | self.going) != 0 {
            let urgent = from & self.urgent;
            from &= if urgent == 0 { self.going } else { urgent };
        }
        let behind = from & self.behind;
        let pick = if behind == 0 { from } else { behind };
        let n = pick.trailing_zeros() as usize;
        Some((n, self.jobs.get_mut(n)?.as_mut()?))
    }

    /// Job `n`.
    pub fn get_mut(&mut self, n: usize) -> Option<&mut Job<R>> {
        self.jobs.get_mut(n)?.as_mut()
    }

    /// The axis that job `n` is for.
    pub fn axis(&self, n: usize) -> Option<u8> {
        Some(self.jobs.get(n)?.as_ref()?.axis)
    }

    /// The jobs of the axis that job `n` is for.
    #[cold]
    pub fn of_axis(&self, n: usize) -> u64 {
        let axis = |n: usize| self.jobs[n].as_ref().map(|job| job.axis);
        bits(self.used).filter(|m| axis(*m) == axis(n)).fold(0, |mask, m| mask | 1 << m)
    }

    /// What the host calls the protocol's own request that runs under `ticket`.
    pub fn raw(&self, ticket: Ticket) -> Option<Ticket> {
        let is = |n: &usize| {
            let job = self.jobs[*n].as_ref();
            job.is_some_and(|job| job.ticket == ticket && matches!(job.task, Task::Raw(_)))
        };
        bits(self.used & !self.ended).find(is).map(|n| Ticket(n as u32))
    }

    /// The request of job `n` is out: the next turn is another's.
    #[inline]
    pub fn sent(&mut self, n: usize) {
        self.ready &= !(1 << n);
        self.behind = !1 << n;
    }

    /// The host gave the request of job `n` back, unsent: a stop has its place.
    #[cold]
    pub fn given_back(&mut self, n: usize) {
        let Some(Some(job)) = self.jobs.get_mut(n) else { return };
        job.asked = Asked::Nothing;
        if job.cancelled {
            let outcome = execute::cut_short(job, Failure::Cancelled);
            self.end(n, outcome);
        } else {
            self.ready |= 1 << n;
        }
    }

    /// Job `n` had its turn and sent nothing.
    pub fn passed(&mut self, n: usize, next: Next) {
        self.ready &= !(1 << n);
        self.follow(n, next);
    }

    /// Takes the answer to a read of a parameter, if the event is one: what happens most, so it is
    /// looked at first. Returns false when it is something else.
    #[inline]
    pub fn read_answered<A: Copy + 'static>(
        &mut self,
        now: Instant,
        slots: &mut [Slot<R, A>],
        event: &Event<A>,
    ) -> bool {
        let (To::Ticket(Ticket(n)), Ok(answer)) = event else { return false };
        let n = *n as usize;
        let Some(Some(job)) = self.jobs.get_mut(n) else { return false };
        let (Task::Read(_), Asked::Read(id), Parts::None) = (&job.task, job.asked, job.parts)
        else {
            return false;
        };
        let Some(slot) = slots.get_mut(usize::from(job.axis)) else { return false };
        match slot.answered(now, id, answer) {
            Ok(raw) => self.end(n, Outcome::Done(raw)),
            Err(failure) => self.fail(n, failure),
        }
        true
    }

    /// What the answer to its request makes of job `n`.
    pub fn answered<A: Copy + 'static>(
        &mut self,
        now: Instant,
        slots: &mut [Slot<R, A>],
        n: usize,
        answer: &Result<A, Failure>,
    ) {
        let Some(Some(job)) = self.jobs.get_mut(n) else { return };
        let Some(slot) = slots.get_mut(usize::from(job.axis)) else { return };
        let parameter = job.asked.parameter().and_then(|id| slot.profile.parameter(id));
        let raw = match answer {
            Ok(answer) => slot.driver.answer(parameter, answer),
            Err(failure) => Err(*failure),
        };
        let raw = execute::together(job, raw);
        let next = execute::answered(now, job, slot, raw);
        if matches!(next, Next::End(Outcome::Done(_))) && job.ends_going() {
            slot.state.going = false;
        }
        self.follow(n, next);
    }

    /// Takes what one drive of a group answered to the request of job `n`.
    #[cold]
    pub fn part<A: Copy + 'static>(
        &mut self,
        now: Instant,
        slots: &mut [Slot<R, A>],
        (n, address): (usize, u32),
        answer: &Result<A, Failure>,
    ) -> Option<Part> {
        let job = self.jobs.get_mut(n)?.as_mut()?;
        let slot = slots.get_mut(usize::from(job.axis))?;
        let (profile, asked) = (slot.profile, job.asked.parameter());
        let parameter = asked.and_then(|id| profile.parameter(id));
        let raw = slot.driver.answer(parameter, answer.as_ref().ok()?).ok()?;
        job.parts = job.parts.and(raw, execute::passes(job, raw));
        let part = Part { ticket: job.ticket, address, raw };
        if let Some(id) = asked {
            slot::told(now, slots, &part, (profile, id));
        }
        // What the lane asks for itself is nobody else's business.
        matches!(job.asked, Asked::Read(_) | Asked::Send(_)).then_some(part)
    }

    fn follow(&mut self, n: usize, next: Next) {
        match next {
            Next::Go => self.ready |= 1 << n,
            Next::Sleep(until) => {
                if let Some(job) = &mut self.jobs[n] {
                    job.until = until;
                }
                self.sleeping |= 1 << n;
                self.wake = earliest(self.wake, Some(until));
            }
            Next::Hungry => {}
            Next::End(outcome) => self.end(n, outcome),
        }
    }

    /// Ends a job that neither is ready nor sleeps.
    #[inline]
    fn end(&mut self, n: usize, outcome: Outcome) {
        if let Some(job) = &mut self.jobs[n] {
            job.outcome = Some(outcome);
            job.asked = Asked::Nothing;
        }
        self.ended |= 1 << n;
    }

    #[cold]
    fn fail(&mut self, n: usize, failure: Failure) {
        self.end(n, Outcome::NotDone(failure));
    }

    /// Ends a job wherever it is.
    fn end_at_once(&mut self, n: usize, outcome: Outcome) {
        self.ready &= !(1 << n);
        self.sleeping &= !(1 << n);
        self.end(n, outcome);
    }

    /// Gives out one that is through.
    #[inline]
    pub fn outcome(&mut self) -> Option<(Ticket, Outcome)> {
        if self.ended == 0 {
            return None;
        }
        let n = self.ended.trailing_zeros() as usize;
        self.ended &= !(1 << n);
        self.used &= !(1 << n);
        let place = self.jobs.get_mut(n)?;
        let job = place.as_ref()?;
        // Made anew, as one number: what was just written in parts is slow to read as a whole.
        if let Some(Outcome::Done(raw)) = job.outcome {
            let ticket = job.ticket;
            *place = None;
            return Some((ticket, Outcome::Done(raw)));
        }
        failed(place)
    }

    /// Ends what runs on an axis, reads excepted: a stop is next.
    pub fn cancel(&mut self, axis: AxisIndex) {
        for n in bits(self.used & !self.ended) {
            let Some(job) = &mut self.jobs[n] else { continue };
            if job.axis != axis.0 || matches!(job.task, Task::Read(_)) {
                continue;
            }
            if job.asked == Asked::Nothing {
                let outcome = execute::cut_short(job, Failure::Cancelled);
                self.end_at_once(n, outcome);
            } else {
                job.cancelled = true;
            }
        }
    }

    /// The link is down: whatever is under way ends.
    pub fn lose(&mut self) {
        for n in bits(self.used & !self.ended) {
            let Some(job) = &self.jobs[n] else { continue };
            let outcome = execute::cut_short(job, Failure::LinkDown);
            self.end_at_once(n, outcome);
        }
    }

    /// Whether an axis runs a plan that moves or stops it.
    pub fn moving(&self, axis: AxisIndex) -> bool {
        bits(self.used & !self.ended).filter_map(|n| self.jobs[n].as_ref()).any(|job| {
            let moves = match &job.task {
                Task::Run(run) => run.moves() || run.is_stop(),
                Task::Path | Task::Transfer(TransferKind::Write) => true,
                _ => false,
            };
            job.axis == axis.0 && moves
        })
    }

    /// Whether words are on their way into an axis' memory or out of it.
    pub fn transfers(&self, axis: AxisIndex) -> bool {
        let jobs = bits(self.used & !self.ended).filter_map(|n| self.jobs[n].as_ref());
        let mut transfers = jobs.filter(|job| matches!(job.task, Task::Transfer(_)));
        transfers.any(|job| job.axis == axis.0)
    }

    /// No request of the job of this ticket is sent again.
    pub fn send_once(&mut self, ticket: Ticket) {
        for n in bits(self.used & !self.ended) {
            if let Some(job) = self.jobs[n].as_mut().filter(|job| job.ticket == ticket) {
                job.once = true;
            }
        }
    }

    /// The axis on whose path the job of this ticket is, which goes on because there are points.
    pub fn fed(&mut self, ticket: Ticket) -> Option<u8> {
        for n in bits(self.used & !self.ended) {
            let Some(job) = &self.jobs[n] else { continue };
            if job.ticket != ticket || !matches!(job.task, Task::Path) {
                continue;
            }
            if job.asked == Asked::Nothing {
                self.sleeping &= !(1 << n);
                self.ready |= 1 << n;
            }
            return Some(job.axis);
        }
        None
    }

    /// Lets those whose time has come go on.
    #[inline]
    pub fn rouse(&mut self, now: Instant) {
        if self.wake.is_some_and(|wake| wake <= now) {
            self.rouse_sleepers(now);
        }
    }

    fn rouse_sleepers(&mut self, now: Instant) {
        self.wake = None;
        for n in bits(self.sleeping) {
            let Some(job) = &self.jobs[n] else { continue };
            if job.until > now {
                self.wake = earliest(self.wake, Some(job.until));
            } else {
                self.sleeping &= !(1 << n);
                self.ready |= 1 << n;
            }
        }
    }
}

/// Takes a job that is through out of its place.
#[cold]
fn failed<R>(place: &mut Option<Job<R>>) -> Option<(Ticket, Outcome)> {
    let job = place.take()?;
    Some((job.ticket, job.outcome?))
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
