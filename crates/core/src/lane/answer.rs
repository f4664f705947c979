//! The reply to a request of a plan: the step that it completes, and the proof of a missing reply.

use super::execute::{
    JobState, complete_step, fail_step, missing_factor, next_state, skip_missing_step, skip_step,
};
use super::guard::{GuardRead, GuardVerdict};
use super::job::{InFlight, PlanRun, StepSource, StepStage};
use super::slot::AxisSlot;
use super::watch::WatchValue;
use crate::axis::{ExecutionProof, ProgramEnd, Refusal, UnmetWait};
use crate::error::{Failure, Outcome};
use crate::plan::Step;
use crate::profile::{Access, ParameterId, Persistence};
use crate::program::ProgramCommand;
use crate::station::{Request, RequestClass};
use crate::time::Instant;

/// Time for which a request to a busy drive is repeated, and accepted values are read back.
pub const BUSY_MAX_MS: u32 = 1000;
/// Pause before a request to a busy drive is repeated.
pub const BUSY_PAUSE_MS: u32 = 20;
/// Pause in place of a wait for a state that no drive of a group may be asked for.
// \[I\] No manual states how long a power stage takes. If it takes longer, the start is lost, and was not claimed.
const UNREAD_WAIT_MS: u32 = 500;

/// Processes the reply to a request of a plan, or its absence.
pub fn handle_run_answer<R: Request, A: Copy + 'static>(
    now: Instant,
    run: &mut PlanRun,
    slot: &mut AxisSlot<R, A>,
    in_flight: InFlight,
    raw: Result<i64, Failure>,
) -> JobState {
    if let InFlight::Factor(id) = in_flight {
        // Once the steps are checked, factors are only read for the judge, who can do without them.
        let is_needed = !run.checked && missing_factor(run, slot) == Some(id);
        slot.count_attempt(id);
        return match raw {
            Err(failure) if is_needed && !slot.lacks_parameter(id) => {
                JobState::Ended(Outcome::NotDone(failure))
            }
            // Positions are judged without a unit then.
            Ok(_) | Err(Failure::Refused { .. }) => JobState::Ready,
            Err(failure) => fail_step(run, failure),
        };
    }
    let group = slot.driver.is_group();
    if matches!(run.stage, StepStage::QueryProgram | StepStage::EndProgram) {
        return handle_program_answer(run, slot, raw);
    }
    if run.stage == StepStage::EndStore {
        // The stop begins again: its first step was stored instead of executed.
        slot.state.store_ended |= raw.is_ok();
        run.stage = StepStage::First;
        return JobState::Ready;
    }
    // A module that is receiving a program stores the stop as one more instruction.
    if let Err(Failure::Refused { code }) = raw
        && run.is_stop()
        && run.stage == StepStage::First
        && slot.driver.refusal(code) == Refusal::Stored
        && !core::mem::replace(&mut run.ended_store, true)
    {
        run.stage = StepStage::EndStore;
        return JobState::Ready;
    }
    debug_assert!(
        run.stage != StepStage::Before || matches!(in_flight, InFlight::Watch(_)),
        "only readings precede a start"
    );
    if let (StepStage::Guard(read, id), InFlight::Guard(_)) = (run.stage, in_flight) {
        return handle_guard_answer(run, slot, read, id, raw);
    }
    if let InFlight::Proof(_) = in_flight {
        return handle_proof(now, run, raw);
    }
    if let InFlight::Watch(id) = in_flight {
        return handle_watch_answer(now, run, slot, id, raw);
    }
    match (in_flight, raw) {
        (InFlight::Send(_), Err(Failure::Silent)) if !group && !run.is_stop() => {
            // TML leaves open what a missing acknowledgement means, so the drive's registers are asked (TML-1).
            match execution_proof(run, slot) {
                Some(proof) => run.stage = StepStage::Proof(proof),
                None if slot.begin_start_proof(now, run) => run.stage = StepStage::StartProof,
                None => return fail_step(run, Failure::Silent),
            }
            JobState::Ready
        }
        (InFlight::Write(id, value, class), Err(Failure::Silent | Failure::Misbehaved)) => {
            // Never written twice without a look: the drive's value shows whether the lost request was executed
            // (REQ-1).
            let readable = slot.parameter(id).is_some_and(|p| p.access == Access::ReadWrite);
            if class == RequestClass::ReadBack && readable {
                run.stage = StepStage::ReadBack(id, value);
                return JobState::Ready;
            }
            // A target register reads back what was written even if the motor never started, so the motion itself
            // is looked at.
            let moves = slot.parameter(id).is_some_and(|parameter| parameter.moves);
            if moves && !group && slot.begin_start_proof(now, run) {
                run.stage = StepStage::StartProof;
                return JobState::Ready;
            }
            fail_step(run, raw.err().unwrap_or(Failure::Silent))
        }
        // No drive of a group may be asked: what was sent is all that can be done.
        (InFlight::Read(_), Err(failure @ (Failure::NotReady { .. } | Failure::Impossible(_))))
            if group =>
        {
            skip_unread(now, run, failure)
        }
        (InFlight::Read(_), Err(Failure::Refused { .. } | Failure::WrongSize { .. }))
            if matches!(run.current_step(), Some(Step::SkipIfMissing { .. })) =>
        {
            skip_missing_step(run)
        }
        (_, Err(Failure::Refused { .. } | Failure::WrongSize { .. }))
            if run.current_step().is_some_and(|it| slot.skips_step(&it)) =>
        {
            skip_missing_step(run)
        }
        // The drive is not done with what it accepted.
        (InFlight::ReadBack(_, value), Ok(raw)) if raw != value && run.accepted => {
            let since = *run.waiting_since.get_or_insert(now);
            if now <= since.plus_ms(BUSY_MAX_MS) {
                return JobState::Sleeping(now.plus_ms(BUSY_PAUSE_MS));
            }
            run.record_proof(true);
            complete_step(now, run, value)
        }
        // Accepted, and nothing shows the value.
        (InFlight::ReadBack(_, value), Err(Failure::Refused { .. })) if run.accepted => {
            run.record_proof(true);
            complete_step(now, run, value)
        }
        // It is the write that has no reply.
        (InFlight::ReadBack(..), Err(Failure::Refused { .. })) => fail_step(run, Failure::Silent),
        (InFlight::Write(id, value, _), Err(Failure::Refused { code }))
            if slot.driver.refusal(code) == Refusal::Accepted =>
        {
            run.accepted = true;
            run.record_proof(true);
            if slot.parameter(id).is_some_and(|p| p.access == Access::ReadWrite) {
                run.stage = StepStage::ReadBack(id, value);
                return JobState::Ready;
            }
            complete_step(now, run, value)
        }
        (InFlight::Send(_), Err(Failure::Refused { code }))
            if slot.driver.refusal(code) == Refusal::Accepted =>
        {
            run.record_proof(true);
            complete_step(now, run, run.last_value)
        }
        (InFlight::ReadBack(id, value), Ok(raw)) if raw != value => {
            // The reading proves that the write was not executed, and a drive answers in order: nothing older can
            // arrive.
            let rewritable = slot.parameter(id).is_some_and(|it| slot.driver.may_rewrite(it));
            if rewritable && !group && run.may_resend() {
                run.stage = StepStage::Write(value);
                return JobState::Ready;
            }
            fail_step(run, Failure::Silent)
        }
        (_, Err(failure)) => fail_step(run, failure),
        (_, Ok(raw)) => {
            if let InFlight::Write(id, value, _) | InFlight::ReadBack(id, value) = in_flight {
                count_flash_write(slot, id, value, run);
            }
            if let InFlight::Read(id) = in_flight {
                // The readings of the plan itself count as well: they cost no further request.
                run.guard.note(slot, id, raw);
                if run.is_homing_under_way() && !group {
                    let value = WatchValue { before: false, flag: None };
                    slot.observe(now, slot.driver.address(), &value, id, raw);
                }
                if let Some(state) = judge_wait(now, run, slot, id, raw) {
                    return state;
                }
                if let Some(Step::NoFault { .. }) = run.current_step() {
                    return complete_step(now, run, slot.profile.fault_word(raw).into());
                }
            }
            complete_step(now, run, raw)
        }
    }
}

/// Goes on without a reading that no drive of a group may give.
fn skip_unread(now: Instant, run: &mut PlanRun, failure: Failure) -> JobState {
    let step = run.current_step();
    if run.is_stop() {
        return skip_step(run);
    }
    // A value that is copied or compared has to be known.
    if matches!(step, Some(Step::Copy { .. } | Step::WriteBits { .. } | Step::Ensure(..))) {
        return fail_step(run, failure);
    }
    run.unconfirmed = true;
    let next = skip_step(run);
    match step {
        Some(Step::Until { .. }) => JobState::Sleeping(now.plus_ms(UNREAD_WAIT_MS)),
        _ => next,
    }
}

/// The readings that show whether the drive executed the current step, which it did not acknowledge.
fn execution_proof<R: Request, A: Copy + 'static>(
    run: &PlanRun,
    slot: &AxisSlot<R, A>,
) -> Option<ExecutionProof> {
    let Some(Step::Send { function, index, operand, like }) = run.current_step() else {
        return None;
    };
    let raw = slot.operand_value(operand, &run.command, like).ok()??;
    slot.driver.execution_proof(function, index, raw)
}

/// Evaluates a reading for a step that the drive did not acknowledge: the step was executed, or it is
/// sent again if the drive has no fault (TML communication manual, chapter 3).
fn handle_proof(now: Instant, run: &mut PlanRun, raw: Result<i64, Failure>) -> JobState {
    match (run.stage, raw) {
        (StepStage::Proof(proof), Ok(raw)) if proof.executed.passes(raw) => {
            run.record_proof(true);
            complete_step(now, run, run.last_value)
        }
        (StepStage::Proof(proof), Ok(_)) => {
            run.record_proof(false);
            run.stage = StepStage::FaultBeforeResend(proof);
            JobState::Ready
        }
        (StepStage::FaultBeforeResend(proof), Ok(raw)) => {
            // A drive with a fault ignores such a request whenever it comes, so to send it again would be of no
            // use.
            if raw & proof.fault_mask == 0 && run.may_resend() {
                run.stage = StepStage::First;
                return JobState::Ready;
            }
            fail_step(run, Failure::Silent)
        }
        (_, raw) => fail_step(run, raw.err().unwrap_or(Failure::Silent)),
    }
}

/// Decides how a wait step continues after a value that fails its test.
fn judge_wait<R: Request, A: Copy + 'static>(
    now: Instant,
    run: &mut PlanRun,
    slot: &mut AxisSlot<R, A>,
    id: ParameterId,
    raw: i64,
) -> Option<JobState> {
    let Some(Step::Until { test, required, .. }) = run.current_step() else { return None };
    slot.unmet_wait = (!test.passes(raw)).then_some(UnmetWait { parameter: id, test, value: raw });
    if test.passes(raw) || !required || run.undo_reason.is_some() || slot.driver.is_group() {
        return None;
    }
    run.waiting_since.get_or_insert(now);
    let steps = run.passed_steps();
    let verdict = run.guard.judge_poll(now, run.command.verb, steps, slot, id, raw);
    follow_verdict(run, verdict)
}

fn handle_guard_answer<R: Request, A: Copy + 'static>(
    run: &mut PlanRun,
    slot: &AxisSlot<R, A>,
    read: GuardRead,
    id: ParameterId,
    raw: Result<i64, Failure>,
) -> JobState {
    run.stage = StepStage::First;
    let raw = match raw {
        Ok(raw) => raw,
        // A signal that the value does not carry is not changed.
        Err(Failure::Refused { .. }) if read != GuardRead::FaultWithoutPower => {
            return JobState::Ready;
        }
        // The power is gone in any case; only its cause stays unknown.
        Err(_) if read == GuardRead::FaultWithoutPower => {
            return fail_step(run, Failure::PowerLost);
        }
        Err(failure) => return fail_step(run, failure),
    };
    let Some(Step::Until { read: waited_for, .. }) = run.current_step() else {
        return JobState::Ready;
    };
    let steps = run.passed_steps();
    let verdict = run.guard.judge_read(read, steps, slot, waited_for, id, raw);
    follow_verdict(run, verdict).unwrap_or(JobState::Ready)
}

/// Processes a reading by which a motion is judged. The drives of a group have given theirs to the judge
/// already.
fn handle_watch_answer<R: Request, A: Copy + 'static>(
    now: Instant,
    run: &mut PlanRun,
    slot: &mut AxisSlot<R, A>,
    id: ParameterId,
    raw: Result<i64, Failure>,
) -> JobState {
    slot.mark_read(run, id);
    match raw {
        Ok(raw) => {
            if !slot.driver.is_group() {
                slot.observe(now, slot.driver.address(), &WatchValue::of(run), id, raw);
            }
            // Nothing moved for `PROOF_MS`: that is no proof that nothing will, so the outcome stays unknown.
            if run.stage == StepStage::StartProof && slot.is_proof_over(now, run) {
                run.stage = StepStage::First;
                return fail_step(run, Failure::Silent);
            }
            JobState::Ready
        }
        Err(Failure::Refused { code }) => {
            // Any other refusal may be another one in the next round.
            if slot.driver.refusal(code) == Refusal::Missing {
                slot.mark_missing(id);
            }
            JobState::Ready
        }
        Err(Failure::WrongSize { .. }) => {
            slot.mark_missing(id);
            JobState::Ready
        }
        // No drive of this group may be asked.
        Err(Failure::NotReady { .. } | Failure::Impossible(_)) if slot.driver.is_group() => {
            JobState::Ready
        }
        Err(failure) => {
            run.stage = StepStage::First;
            fail_step(run, failure)
        }
    }
}

/// Processes the reply to a stop's request about the drive's own program.
fn handle_program_answer<R: Request, A: Copy + 'static>(
    run: &mut PlanRun,
    slot: &mut AxisSlot<R, A>,
    raw: Result<i64, Failure>,
) -> JobState {
    let asked = run.stage == StepStage::QueryProgram;
    match raw {
        Ok(raw) if asked && slot.is_program_running(raw) => {
            run.stage = StepStage::EndProgram;
        }
        Ok(_) if asked => {
            slot.state.program_end = Some(ProgramEnd::NoneRan);
            run.resume_stop(false);
        }
        Ok(_) => {
            let asks = slot.program_request(ProgramCommand::QueryProgram).is_some();
            slot.state.program_end =
                Some(if asks { ProgramEnd::Ended } else { ProgramEnd::MayHaveRun });
            run.resume_stop(true);
        }
        // It runs no programs.
        Err(Failure::Refused { .. }) if asked => run.resume_stop(false),
        Err(failure) => {
            // The program may go on, so the motor is stopped again all the same.
            run.undo_reason.get_or_insert(failure);
            run.resume_stop(true);
        }
    }
    next_state(run)
}

fn follow_verdict(run: &mut PlanRun, verdict: GuardVerdict) -> Option<JobState> {
    match verdict {
        GuardVerdict::WaitOn => None,
        GuardVerdict::Read(read, id) => {
            run.stage = StepStage::Guard(read, id);
            Some(JobState::Ready)
        }
        GuardVerdict::Fail(failure) => Some(fail_step(run, failure)),
    }
}

/// Counts a write to permanent memory, as far as the profile shows it, and notes a change of its RAM mode.
fn count_flash_write<R: Request, A: Copy + 'static>(
    slot: &mut AxisSlot<R, A>,
    id: ParameterId,
    value: i64,
    run: &PlanRun,
) {
    let persistence = slot.parameter(id).map(|parameter| parameter.persistence);
    let mode = slot.profile.ram.filter(|ram| ram.parameter == id);
    let is_stored = matches!(run.steps, StepSource::Write(write) if write.stores_past_ram());
    let permanent = match persistence {
        Some(Persistence::Always) => true,
        Some(Persistence::UnlessRam) => is_stored,
        _ => mode.is_some(),
    };
    slot.state.flash_writes += u32::from(permanent);
    let Some(mode) = mode else { return };
    let before = match (run.current_step(), slot.state.ram_mode_before) {
        (Some(Step::Ensure(..)), None) if value == mode.ram => Some(mode.flash),
        (Some(Step::Ensure(..)), None) => Some(mode.ram),
        (Some(Step::Ensure(..)), before) => before,
        // The caller has written it.
        _ => None,
    };
    slot.state.ram_mode_before = before.filter(|before| *before != value);
}
