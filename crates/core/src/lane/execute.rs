//! The executor of plans: the next request of a job, and the state of its run. Replies to it are processed in
//! `answer`.

use core::time::Duration;

use super::answer::{BUSY_MAX_MS, BUSY_PAUSE_MS, handle_run_answer};
use super::job::{GroupResult, InFlight, Job, JobTask, PlanRun, StepStage};
use super::path::PathStream;
use super::slot::AxisSlot;
use super::watch::WatchStep;
use crate::axis::Refusal;
use crate::error::{Extent, Failure, Outcome, Unsupported};
use crate::plan::Step;
use crate::profile::ParameterId;
use crate::program::ProgramCommand;
use crate::program::TransferKind;
use crate::station::{Request, RequestClass};
use crate::time::Instant;

/// Interval of reading a condition of a wait.
// As often as the judge reads a drive's report, see `watch`: a waiting plan takes a tenth of a serial
// line.
const POLL_INTERVAL: Duration = Duration::from_millis(20);

/// Next state of a job.
#[derive(Debug)]
pub enum JobState {
    /// Ready, with a request to send.
    Ready,
    /// Sleeping until then.
    Sleeping(Instant),
    /// Waiting for points of its path.
    NeedsPoints,
    /// Ended with this outcome.
    Ended(Outcome),
}

fn end_impossible(reason: Unsupported) -> JobState {
    JobState::Ended(Outcome::NotDone(Failure::Impossible(reason)))
}

/// The request of a ready job that reads a parameter, where no scale is missing: what happens most,
/// so it is looked at first and its request is copied nowhere.
#[inline]
pub fn plain_read_request<'a, R: Request, A: Copy + 'static>(
    job: &Job<R>,
    slot: &'a AxisSlot<R, A>,
) -> Option<(ParameterId, &'a R)> {
    let JobTask::Read(id) = job.task else { return None };
    Some((id, slot.plain_read_request(id)?))
}

/// The request that a ready job has next. Changes nothing that matters if the host will not have it.
#[inline(never)]
pub fn next_request<R: Request, A: Copy + 'static>(
    now: Instant,
    job: &mut Job<R>,
    slot: &mut AxisSlot<R, A>,
) -> Result<(R, InFlight), JobState> {
    match &mut job.task {
        JobTask::Read(id) => {
            let id = *id;
            let in_flight = slot.missing_factor(id).map_or(InFlight::Read(id), InFlight::Factor);
            read_request(slot, in_flight).map_err(end_impossible)
        }
        JobTask::Raw(request) => Ok((*request, InFlight::Send(request.class()))),
        JobTask::Run(run) => next_run_request(now, run, slot),
        JobTask::Path => with_path(slot, |path, slot| path.next_request(now, slot))
            .unwrap_or(Err(JobState::Ended(Outcome::NotDone(Failure::Cancelled)))),
        JobTask::Transfer(_) => next_transfer_request(slot).map_err(JobState::Ended),
    }
}

/// Lets the axis' path, if it has one, do something with the axis.
fn with_path<R: Request, A: Copy + 'static, T>(
    slot: &mut AxisSlot<R, A>,
    f: impl FnOnce(&mut PathStream, &mut AxisSlot<R, A>) -> T,
) -> Option<T> {
    let mut path = slot.path.take()?;
    let done = f(&mut path, slot);
    slot.path = Some(path);
    Some(done)
}

/// The request for the present step of the axis' transfer.
fn next_transfer_request<R: Request, A: Copy + 'static>(
    slot: &mut AxisSlot<R, A>,
) -> Result<(R, InFlight), Outcome> {
    let AxisSlot { transfer: Some(transfer), driver, .. } = slot else {
        return Err(Outcome::NotDone(Failure::Cancelled));
    };
    let step = transfer.current_step();
    let request = driver.memory().ok_or(Unsupported::NoPlan);
    match request.and_then(|memory| memory.transfer_request(step)) {
        Ok(request) => Ok((request, InFlight::Send(request.class()))),
        Err(reason) => Err(transfer.abort_outcome(Failure::Impossible(reason))),
    }
}

#[inline]
fn read_request<R: Request, A: Copy + 'static>(
    slot: &AxisSlot<R, A>,
    in_flight: InFlight,
) -> Result<(R, InFlight), Unsupported> {
    let id = in_flight.parameter().ok_or(Unsupported::NoSuchParameter)?;
    Ok((*slot.read_request(id)?, in_flight))
}

#[inline(never)]
fn next_run_request<R: Request, A: Copy + 'static>(
    now: Instant,
    run: &mut PlanRun,
    slot: &mut AxisSlot<R, A>,
) -> Result<(R, InFlight), JobState> {
    if !run.checked {
        if let Some(id) = missing_factor(run, slot) {
            return read_request(slot, InFlight::Factor(id)).map_err(end_impossible);
        }
        // All limits are checked before the first byte, so that a plan never ends half way because of an
        // argument.
        for at in 0..=u8::MAX {
            let Some(step) = run.steps.step(at) else { break };
            slot.check_step(&step, &run.command).map_err(end_impossible)?;
        }
        if let Some(id) = slot.unread_goal_factor(run) {
            return read_request(slot, InFlight::Factor(id)).map_err(end_impossible);
        }
        // Once for each plan: the loop below passes here with every request.
        run.checked = true;
        slot.begin_motion(run);
    }
    // Each turn of this loop passes a step that sends nothing; plans are bounded.
    loop {
        // To end a program that may not run is of less use than a stop that arrives.
        if run.is_program_end_due() && matches!(run.undo_reason, Some(Failure::Silent)) {
            // No drive receives: the whole stop is repeated.
            run.resume_stop(false);
        }
        if run.is_program_end_due() && run.stage == StepStage::First {
            let asks = slot.program_request(ProgramCommand::QueryProgram).is_some();
            run.stage = if asks { StepStage::QueryProgram } else { StepStage::EndProgram };
        }
        match run.stage {
            StepStage::QueryProgram => return program_request(slot, ProgramCommand::QueryProgram),
            StepStage::EndProgram => return program_request(slot, ProgramCommand::End),
            StepStage::EndStore => return program_request(slot, ProgramCommand::EndStore),
            StepStage::ReadBack(id, raw) => {
                return read_request(slot, InFlight::ReadBack(id, raw)).map_err(end_impossible);
            }
            StepStage::Proof(proof) => {
                return read_request(slot, InFlight::Proof(proof.parameter))
                    .map_err(end_impossible);
            }
            StepStage::FaultBeforeResend(proof) => {
                return read_request(slot, InFlight::Proof(proof.fault_parameter))
                    .map_err(end_impossible);
            }
            StepStage::Sleep(until) if until > now => return Err(JobState::Sleeping(until)),
            // The condition is read anew after the pause: an old reading proves nothing.
            StepStage::Sleep(_) => run.stage = StepStage::First,
            StepStage::Guard(_, id) => {
                return read_request(slot, InFlight::Guard(id)).map_err(end_impossible);
            }
            StepStage::Before => match slot.next_before(run) {
                Some(id) => return watch_request(slot, id),
                None => {
                    slot.set_targets(run);
                    run.stage = StepStage::First;
                    run.watch = Default::default();
                }
            },
            StepStage::StartProof => {
                let proof = slot.poll_start_proof(now, run);
                match follow_start_proof(now, run, slot, proof) {
                    Some(next) => return next,
                    None => continue,
                }
            }
            _ => {}
        }
        let Some(step) = run.current_step() else {
            return Err(JobState::Ended(finished_outcome(run)));
        };
        // An object that the drive refused as missing changes nothing here, see `AxisSlot::skips_step`.
        if slot.skips_step(&step) {
            advance_past_missing(run);
            continue;
        }
        if step.is_judged() {
            match slot.poll_watch(now, run, step) {
                WatchStep::Read(id) => return watch_request(slot, id),
                WatchStep::Factor(id) => {
                    return read_request(slot, InFlight::Factor(id)).map_err(end_impossible);
                }
                WatchStep::Sleep(until) => return Err(JobState::Sleeping(until)),
                WatchStep::Failed(failure) => return Err(fail_step(run, failure)),
                WatchStep::Done => run.advance(run.last_value),
            }
            continue;
        }
        match step_request(now, run, slot, step) {
            Ok(Some(next)) => return Ok(next),
            Ok(None) => {}
            Err(reason) => return Err(fail_step(run, Failure::Impossible(reason))),
        }
    }
}

fn watch_request<R: Request, A: Copy + 'static>(
    slot: &AxisSlot<R, A>,
    id: ParameterId,
) -> Result<(R, InFlight), JobState> {
    read_request(slot, InFlight::Watch(id)).map_err(end_impossible)
}

/// Goes on with a step that was not acknowledged. `None` when readings prove that it was executed.
fn follow_start_proof<R: Request, A: Copy + 'static>(
    now: Instant,
    run: &mut PlanRun,
    slot: &AxisSlot<R, A>,
    proof: WatchStep,
) -> Option<Result<(R, InFlight), JobState>> {
    match proof {
        WatchStep::Read(id) | WatchStep::Factor(id) => Some(watch_request(slot, id)),
        WatchStep::Sleep(until) => Some(Err(JobState::Sleeping(until))),
        WatchStep::Failed(failure) => {
            run.stage = StepStage::First;
            Some(Err(fail_step(run, failure)))
        }
        WatchStep::Done => {
            run.record_proof(true);
            match complete_step(now, run, run.last_value) {
                ended @ JobState::Ended(_) => Some(Err(ended)),
                _ => None,
            }
        }
    }
}

fn program_request<R: Request, A: Copy + 'static>(
    slot: &AxisSlot<R, A>,
    command: ProgramCommand,
) -> Result<(R, InFlight), JobState> {
    debug_assert!(
        !slot.driver.is_group() || command != ProgramCommand::QueryProgram,
        "a group has no one answer"
    );
    let request = slot.program_request(command);
    let request = request.ok_or_else(|| end_impossible(Unsupported::NoPlan))?;
    Ok((request, InFlight::Send(request.class())))
}

/// The next scale factor to read: one that the arguments of the run, or the set-points after it, need
/// and that is not yet known.
pub fn missing_factor<R: Request, A: Copy + 'static>(
    run: &PlanRun,
    slot: &AxisSlot<R, A>,
) -> Option<ParameterId> {
    (0..=u8::MAX).map_while(|at| run.steps.step(at)).find_map(|step| match step {
        Step::Write(..) | Step::WriteTogether(_) | Step::Send { .. } => {
            let unknown = !slot.check_step(&step, &run.command).unwrap_or(true);
            let mut ids = step.operands().filter(|_| unknown).filter_map(|(_, like)| like);
            ids.find_map(|id| slot.missing_factor(id))
        }
        Step::Read(id) if super::setpoint_kind_of(run.command.verb).is_some() => {
            slot.missing_factor(id)
        }
        _ => None,
    })
}

/// The request of a step; `None` when the step is passed without one.
fn step_request<R: Request, A: Copy + 'static>(
    now: Instant,
    run: &mut PlanRun,
    slot: &AxisSlot<R, A>,
    step: Step,
) -> Result<Option<(R, InFlight)>, Unsupported> {
    let write = |run: &PlanRun, id, raw| {
        let parameter = slot.check_writable(id, raw)?;
        let class = run.write_class(parameter);
        let request = slot.driver.write_request(parameter, raw, class)?;
        Ok(Some((request, InFlight::Write(id, raw, class))))
    };
    match (step, run.stage) {
        (Step::Write(id, operand), _) => {
            match slot.operand_value(operand, &run.command, Some(id))? {
                Some(raw) => write(run, slot.chosen_path_parameter(id, &run.command), raw),
                None => {
                    run.advance(run.last_value);
                    Ok(None)
                }
            }
        }
        (Step::WriteTogether(writes), _) => {
            let class = if run.is_stop() { RequestClass::Stop } else { RequestClass::NoRetry };
            let request = slot.write_together_request(writes, &run.command, class)?;
            Ok(Some((request, InFlight::Send(class))))
        }
        (Step::Ensure(id, raw), StepStage::Write(_)) => write(run, id, raw),
        (Step::Copy { to, .. }, StepStage::Write(raw)) => write(run, to, raw),
        (Step::WriteBits { id, mask, raw }, StepStage::Write(read)) => {
            write(run, id, read & !mask | raw)
        }
        (Step::SkipBySign { count, .. }, _) => {
            run.advance(run.last_value);
            if step.skips(&run.command) {
                run.index = run.index.saturating_add(count);
            }
            Ok(None)
        }
        (
            Step::Ensure(id, _)
            | Step::WriteBits { id, .. }
            | Step::Copy { from: id, .. }
            | Step::Read(id)
            | Step::Require { read: id, .. }
            | Step::Skip { read: id, .. }
            | Step::SkipIfMissing { read: id, .. }
            | Step::NoFault { read: id, .. }
            | Step::Until { read: id, .. },
            _,
        ) => read_request(slot, InFlight::Read(id)).map(Some),
        (Step::Send { function, index, operand, like }, _) => {
            match slot.operand_value(operand, &run.command, like)? {
                Some(raw) => {
                    let driver = &slot.driver;
                    let request = driver.command_request(&run.command, function, index, raw)?;
                    Ok(Some((request, InFlight::Send(request.class()))))
                }
                None => {
                    run.advance(run.last_value);
                    Ok(None)
                }
            }
        }
        (Step::Store(id), _) => {
            let parameter = slot.parameter(id).ok_or(Unsupported::NoSuchParameter)?;
            Ok(Some((slot.driver.store_request(parameter)?, InFlight::Send(RequestClass::NoRetry))))
        }
        // The judge of the axis reads for these.
        (Step::Standstill { .. } | Step::Homed { .. } | Step::Arrival { .. }, _) => {
            Err(Unsupported::NoPlan)
        }
        (Step::Wait { ms }, _) => {
            match run.waiting_since {
                Some(_) => run.advance(run.last_value),
                None => {
                    run.waiting_since = Some(now);
                    run.stage = StepStage::Sleep(now.plus_ms(ms));
                }
            }
            Ok(None)
        }
    }
}

/// The outcome of a job that is ended from outside.
pub fn abort_outcome<R: Request>(job: &Job<R>, failure: Failure) -> Outcome {
    match job.task {
        JobTask::Run(mut run) => {
            // A request that has left counts as possibly executed, until something is read back.
            if job.in_flight.may_have_changed() {
                run.record_result(job.in_flight, Err(Failure::Silent));
            }
            run.outcome_for(failure)
        }
        // Points and blocks that went out stay in the drive, and nothing here knows how many of them it took.
        JobTask::Path | JobTask::Transfer(TransferKind::Write | TransferKind::WriteData) => {
            Outcome::Unknown(failure)
        }
        _ if job.in_flight.may_have_changed() => Outcome::Unknown(failure),
        _ => Outcome::NotDone(failure),
    }
}

/// Returns whether the value of one drive of a group passes the test of the job's step.
pub fn passes_test<R: Request>(job: &Job<R>, raw: i64) -> bool {
    let JobTask::Run(run) = &job.task else { return true };
    match run.current_step() {
        Some(Step::Require { test, .. } | Step::Skip { test, .. } | Step::Until { test, .. }) => {
            test.passes(raw)
        }
        Some(Step::NoFault { mask, .. }) => raw & mask == 0,
        _ => true,
    }
}

/// Combines the replies of a group: for a test the value that fails it, otherwise the common value.
pub fn merge_group_result<R: Request>(
    job: &mut Job<R>,
    raw: Result<i64, Failure>,
) -> Result<i64, Failure> {
    const HINT: &str = "the drives of this group have different values of a parameter that is \
                        needed; command them one by one, or make them equal";
    let tests =
        matches!(&job.task, JobTask::Run(run) if !matches!(run.stage, StepStage::ReadBack(..)));
    let tests = tests && matches!(job.in_flight, InFlight::Read(_) | InFlight::Watch(_));
    match core::mem::replace(&mut job.group_result, GroupResult::None) {
        GroupResult::Agree(value) | GroupResult::Fails(value) => raw.and(Ok(value)),
        GroupResult::Differ(value) if tests => raw.and(Ok(value)),
        GroupResult::Differ(_) if job.in_flight.parameter().is_some() => {
            raw.and(Err(Failure::NotReady { hint: HINT }))
        }
        GroupResult::Differ(_) | GroupResult::None => raw,
    }
}

/// Processes a reply, or a time-out, for a job.
#[inline(never)]
pub fn handle_answer<R: Request, A: Copy + 'static>(
    now: Instant,
    job: &mut Job<R>,
    slot: &mut AxisSlot<R, A>,
    raw: Result<i64, Failure>,
) -> JobState {
    debug_assert_ne!(job.in_flight, InFlight::Nothing, "a reply belongs to a request");
    debug_assert!(job.outcome.is_none(), "an ended job gets no reply");
    let in_flight = core::mem::replace(&mut job.in_flight, InFlight::Nothing);
    if let Some(again) = busy_pause(now, job, slot, raw) {
        return JobState::Sleeping(again);
    }
    // A stop took the place of a read, perhaps that of another axis on the same channel: it is asked again.
    let is_displaced = raw == Err(Failure::Cancelled) && !in_flight.may_have_changed();
    if is_displaced && !job.cancelled && matches!(job.task, JobTask::Run(_)) {
        return JobState::Ready;
    }
    // Leaving the download mode changes no motor, so it does not count as a part of the stop that was
    // done.
    if let JobTask::Run(run) = &mut job.task
        && run.stage != StepStage::EndStore
    {
        run.record_result(in_flight, raw);
    }
    match (in_flight.parameter(), raw) {
        (Some(id), Ok(raw)) => slot.record_value(now, id, raw),
        (Some(id), Err(Failure::Refused { code })) => slot.handle_refusal(id, code),
        (Some(id), Err(Failure::WrongSize { .. })) => slot.mark_lacking(id),
        _ => {}
    }
    // Nothing can be read back any more, so the bits noted so far decide.
    if raw == Err(Failure::LinkDown) {
        let failure = Failure::LinkDown;
        return JobState::Ended(match &job.task {
            JobTask::Run(run) => run.outcome_for(failure),
            _ if in_flight.may_have_changed() => Outcome::Unknown(failure),
            _ => abort_outcome(job, failure),
        });
    }
    match &mut job.task {
        JobTask::Run(run) if job.cancelled => {
            JobState::Ended(cancelled_outcome(run, in_flight, raw))
        }
        JobTask::Read(id) => match (in_flight, raw) {
            (InFlight::Factor(id), _) => {
                slot.count_attempt(id);
                JobState::Ready
            }
            (_, Ok(raw)) => JobState::Ended(Outcome::Done(raw)),
            (_, Err(failure)) => {
                debug_assert_eq!(in_flight, InFlight::Read(*id));
                JobState::Ended(Outcome::NotDone(failure))
            }
        },
        JobTask::Raw(_) => JobState::Ended(match raw {
            Ok(raw) => Outcome::Done(raw),
            // Modbus exception 5: accepted, and not finished yet (Modbus application protocol 1.1b3, chapter 7).
            Err(Failure::Refused { code }) if slot.driver.refusal(code) == Refusal::Accepted => {
                Outcome::Done(0)
            }
            Err(failure) => failed_request_outcome(in_flight, Err(failure), failure),
        }),
        JobTask::Run(run) => handle_run_answer(now, run, slot, in_flight, raw),
        JobTask::Path if job.cancelled => JobState::Ended(Outcome::Unknown(Failure::Cancelled)),
        JobTask::Path => {
            with_path(slot, |path, slot| path.handle_answer(now, slot, in_flight, raw))
                .unwrap_or(JobState::Ended(Outcome::Unknown(Failure::Cancelled)))
        }
        JobTask::Transfer(_) => {
            let Some(transfer) = &mut slot.transfer else {
                return JobState::Ended(Outcome::Unknown(Failure::Cancelled));
            };
            if job.cancelled {
                return JobState::Ended(transfer.abort_outcome(Failure::Cancelled));
            }
            // A word that was not confirmed may have been written.
            if matches!(raw, Ok(_) | Err(Failure::Silent | Failure::Misbehaved)) {
                slot.state.flash_writes += transfer.permanent_words();
            }
            transfer.handle_reply(raw).map_or(JobState::Ready, JobState::Ended)
        }
    }
}

/// When a request is sent again that the drive refused because it was busy. The refusal proves that it was not
/// executed. `None` for any other reply, and after a second.
fn busy_pause<R: Request, A: Copy + 'static>(
    now: Instant,
    job: &mut Job<R>,
    slot: &AxisSlot<R, A>,
    raw: Result<i64, Failure>,
) -> Option<Instant> {
    let repeats = matches!(job.task, JobTask::Read(_) | JobTask::Raw(_) | JobTask::Run(_));
    match raw {
        Err(Failure::Refused { code })
            if repeats && !job.cancelled && slot.driver.refusal(code) == Refusal::Busy =>
        {
            // The refusal proves that the request was not executed, so to send it again is no repetition (REQ-1).
            let since = *job.busy_since.get_or_insert(now);
            (now <= since.plus_ms(BUSY_MAX_MS)).then(|| now.plus_ms(BUSY_PAUSE_MS))
        }
        _ => {
            job.busy_since = None;
            None
        }
    }
}

/// The outcome of a run that a stop interrupted during a request.
fn cancelled_outcome(run: &PlanRun, in_flight: InFlight, raw: Result<i64, Failure>) -> Outcome {
    let last = run.is_last_step();
    match (in_flight, raw) {
        // The stop came after its last step had been acknowledged: it was done, and then stopped.
        (InFlight::Write(..) | InFlight::Send(_), Ok(raw)) if last => Outcome::Done(raw),
        (InFlight::ReadBack(_, value), Ok(raw)) if last && raw == value => Outcome::Done(raw),
        _ => run.outcome_for(Failure::Cancelled),
    }
}

/// The outcome of a run whose request failed.
fn failed_request_outcome(
    in_flight: InFlight,
    raw: Result<i64, Failure>,
    failure: Failure,
) -> Outcome {
    match (in_flight, raw) {
        (InFlight::Send(RequestClass::Idempotent), Err(_)) => Outcome::NotDone(failure),
        (InFlight::Write(..) | InFlight::Send(_), Err(Failure::Silent | Failure::Misbehaved)) => {
            Outcome::Unknown(failure)
        }
        _ => Outcome::NotDone(failure),
    }
}

/// The state of a run after a step.
pub fn next_state(run: &PlanRun) -> JobState {
    match run.current_step() {
        None if !run.is_program_end_due() => JobState::Ended(finished_outcome(run)),
        _ => JobState::Ready,
    }
}

/// The step is left out.
pub fn skip_step(run: &mut PlanRun) -> JobState {
    run.advance(run.last_value);
    next_state(run)
}

/// Skips a step whose parameter the drive does not have.
pub fn skip_missing_step(run: &mut PlanRun) -> JobState {
    advance_past_missing(run);
    next_state(run)
}

pub fn advance_past_missing(run: &mut PlanRun) {
    if let Some(Step::SkipIfMissing { count, .. }) = run.current_step() {
        run.index = run.index.saturating_add(count);
    }
    run.advance(run.last_value);
}

/// Completes a step with the value that was read.
pub fn complete_step(now: Instant, run: &mut PlanRun, raw: i64) -> JobState {
    let Some(step) = run.current_step() else { return JobState::Ended(finished_outcome(run)) };
    match (step, run.stage) {
        (Step::Ensure(_, value), StepStage::First) if raw != value => {
            run.stage = StepStage::Write(raw)
        }
        (Step::Ensure(..), StepStage::First) => {
            run.note_ram_mode();
            run.advance(raw);
        }
        (Step::Copy { .. } | Step::WriteBits { .. }, StepStage::First) => {
            run.stage = StepStage::Write(raw)
        }
        (Step::Require { test, hint, .. }, _) if !test.passes(raw) => {
            return fail_step(run, Failure::NotReady { hint });
        }
        (Step::Skip { test, count, .. }, _) if test.passes(raw) => {
            run.advance(raw);
            run.index = run.index.saturating_add(count);
        }
        (Step::NoFault { mask, .. }, _) if raw & mask != 0 => {
            return fail_step(run, Failure::Faulted { code: (raw & mask) as u32 });
        }
        (Step::Until { test, within_ms, required, .. }, _) if !test.passes(raw) => {
            // Counted from the first reading, not from the step's request: a slow line shall not use up the
            // drive's time.
            let since = *run.waiting_since.get_or_insert(now);
            let over = now > since.plus_ms(run.wait_limit_ms(within_ms));
            if !over {
                run.stage = StepStage::Sleep(now + POLL_INTERVAL);
                return JobState::Sleeping(now + POLL_INTERVAL);
            } else if required {
                return fail_step(run, Failure::NotReached);
            } else {
                run.advance(raw)
            }
        }
        _ => run.advance(raw),
    }
    next_state(run)
}

/// Records the end of a job in the state of its axis.
#[inline]
pub fn note_end<R: Request, A: Copy + 'static>(
    now: Instant,
    next: &JobState,
    job: &Job<R>,
    slot: &mut AxisSlot<R, A>,
) {
    let JobState::Ended(outcome) = next else { return };
    let at_rest = matches!(outcome, Outcome::Done(_))
        || matches!(outcome.failure(), Some(Failure::Elsewhere(_)));
    if at_rest && job.ends_motion() {
        // A stop that failed and a move whose end is unknown leave it set: the motor may still turn.
        slot.state.motion_active = false;
    }
    if let JobTask::Run(run) = &job.task {
        slot.end_motion_plan(now, run.verb, *outcome);
    }
}

pub fn finished_outcome(run: &PlanRun) -> Outcome {
    match run.undo_reason {
        None if run.unconfirmed && !run.is_stop() => Outcome::Unknown(Failure::Unconfirmed),
        None => Outcome::Done(run.last_value),
        Some(failure) => {
            let undone = !run.is_stop() && !run.undo_failed;
            Extent { rolled_back: undone, ..run.extent }.outcome(failure)
        }
    }
}

/// A step failed: a stop goes on with its next step, anything else is undone.
pub fn fail_step(run: &mut PlanRun, failure: Failure) -> JobState {
    let Extent { done, unknown, refused, .. } = run.extent;
    let wrote = done | unknown | refused != 0;
    if run.undo_reason.is_some() {
        run.advance(0);
    } else if run.is_stop() {
        // The later steps of a stop may still reach the motor.
        run.undo_reason = Some(failure);
        run.advance(0);
    } else if run.index > 0 && wrote && !run.undo.is_empty() {
        run.undo_reason = Some(failure);
        run.index = 0;
        run.stage = StepStage::First;
        run.waiting_since = None;
    } else {
        return JobState::Ended(run.outcome_for(failure));
    }
    next_state(run)
}
