//! The one executor of plans: what a job asks next, and what an answer makes of it.

use core::time::Duration;

use super::job::{Asked, Job, Parts, Run, Stage, Task};
use super::path::Path;
use super::slot::Slot;
use super::transfer::{Transfer, TransferKind};
use crate::error::{Extent, Failure, Outcome, Unsupported};
use crate::plan::Step;
use crate::profile::{Access, ParameterId, Persistence};
use crate::station::{Class, Request};
use crate::time::Instant;

/// How often a condition that is waited for is read.
const POLL: Duration = Duration::from_millis(20);

/// What becomes of a job.
#[derive(Debug)]
pub enum Next {
    /// It has something to send.
    Go,
    /// It waits.
    Sleep(Instant),
    /// It waits for points of its path.
    Hungry,
    /// It is over.
    End(Outcome),
}

fn impossible(reason: Unsupported) -> Next {
    Next::End(Outcome::NotDone(Failure::Impossible(reason)))
}

/// The request of a ready job that reads a parameter, where no scale is missing: what happens most,
/// so it is looked at first and its request is copied nowhere.
#[inline]
pub fn plain_read<'a, R: Request, A: Copy + 'static>(
    job: &Job<R>,
    slot: &'a Slot<R, A>,
) -> Option<(ParameterId, &'a R)> {
    let Task::Read(id) = job.task else { return None };
    Some((id, slot.plain_read(id)?))
}

/// The request that a ready job has next. Changes nothing that matters if the host will not have it.
#[inline(never)]
pub fn next<R: Request, A: Copy + 'static>(
    now: Instant,
    job: &mut Job<R>,
    slot: &mut Slot<R, A>,
) -> Result<(R, Asked), Next> {
    match &mut job.task {
        Task::Read(id) => {
            let id = *id;
            let asked = slot.missing(id).map_or(Asked::Read(id), Asked::Factor);
            read(slot, asked).map_err(impossible)
        }
        Task::Raw(request) => Ok((*request, Asked::Send(request.class()))),
        Task::Run(run) => next_of_run(now, run, slot),
        Task::Path => along_path(slot, |path, slot| path.next(now, slot))
            .unwrap_or(Err(Next::End(Outcome::NotDone(Failure::Cancelled)))),
        Task::Transfer(_) => with_transfer(slot, Transfer::next)
            .unwrap_or(Err(Next::End(Outcome::NotDone(Failure::Cancelled)))),
    }
}

/// Lets the axis' path, if it has one, do something with the axis.
fn along_path<R: Request, A: Copy + 'static, T>(
    slot: &mut Slot<R, A>,
    f: impl FnOnce(&mut Path, &mut Slot<R, A>) -> T,
) -> Option<T> {
    let mut path = slot.path.take()?;
    let done = f(&mut path, slot);
    slot.path = Some(path);
    Some(done)
}

/// Lets the axis' transfer, if it has one, do something with the axis.
fn with_transfer<R: Request, A: Copy + 'static, T>(
    slot: &mut Slot<R, A>,
    f: impl FnOnce(&mut Transfer, &mut Slot<R, A>) -> T,
) -> Option<T> {
    let mut transfer = slot.transfer.take()?;
    let done = f(&mut transfer, slot);
    slot.transfer = Some(transfer);
    Some(done)
}

#[inline]
fn read<R: Request, A: Copy + 'static>(
    slot: &Slot<R, A>,
    asked: Asked,
) -> Result<(R, Asked), Unsupported> {
    let id = asked.parameter().ok_or(Unsupported::NoSuchParameter)?;
    Ok((*slot.read(id)?, asked))
}

#[inline(never)]
fn next_of_run<R: Request, A: Copy + 'static>(
    now: Instant,
    run: &mut Run,
    slot: &mut Slot<R, A>,
) -> Result<(R, Asked), Next> {
    if !run.checked {
        if let Some(id) = missing_factor(run, slot) {
            return read(slot, Asked::Factor(id)).map_err(impossible);
        }
        for at in 0..=u8::MAX {
            let Some(step) = run.steps.step(at) else { break };
            slot.check(&step, &run.command).map_err(impossible)?;
        }
        run.checked = true;
    }
    // Each turn of this loop passes a step that sends nothing; plans are bounded.
    loop {
        match run.stage {
            Stage::Confirm(id, raw) => {
                return read(slot, Asked::Confirm(id, raw)).map_err(impossible);
            }
            Stage::Sleep(until) if until > now => return Err(Next::Sleep(until)),
            Stage::Sleep(_) => run.stage = Stage::First,
            _ => {}
        }
        let Some(step) = run.step() else { return Err(Next::End(finished(run))) };
        if slot.leaves_out(&step) {
            leave_out(run);
            continue;
        }
        match request(now, run, slot, step) {
            Ok(Some(next)) => return Ok(next),
            Ok(None) => {}
            Err(reason) => return Err(failed(run, Failure::Impossible(reason))),
        }
    }
}

/// A scale that the run's arguments need and nobody knows yet.
fn missing_factor<R: Request, A: Copy + 'static>(
    run: &Run,
    slot: &Slot<R, A>,
) -> Option<ParameterId> {
    (0..=u8::MAX).map_while(|at| run.steps.step(at)).find_map(|step| match step {
        Step::Write(id, _) | Step::Send { like: Some(id), .. } => {
            let unknown = !slot.check(&step, &run.command).unwrap_or(true);
            unknown.then(|| slot.missing(id)).flatten()
        }
        _ => None,
    })
}

/// The request of a step; `None` when the step is passed without one.
fn request<R: Request, A: Copy + 'static>(
    now: Instant,
    run: &mut Run,
    slot: &Slot<R, A>,
    step: Step,
) -> Result<Option<(R, Asked)>, Unsupported> {
    let write = |run: &Run, id, raw| {
        let parameter = slot.writable(id, raw)?;
        let class = run.class(parameter);
        let request = slot.driver.write(parameter, raw, class)?;
        Ok(Some((request, Asked::Write(id, raw, class))))
    };
    match (step, run.stage) {
        (Step::Write(id, operand), _) => match slot.operand(operand, &run.command, Some(id))? {
            Some(raw) => write(run, id, raw),
            None => {
                run.advance(run.last);
                Ok(None)
            }
        },
        (Step::Ensure(id, raw), Stage::Write(_)) => write(run, id, raw),
        (Step::Copy { to, .. }, Stage::Write(raw)) => write(run, to, raw),
        (
            Step::Ensure(id, _)
            | Step::Copy { from: id, .. }
            | Step::Read(id)
            | Step::Require { read: id, .. }
            | Step::Skip { read: id, .. }
            | Step::Without { read: id, .. }
            | Step::NoFault { read: id, .. }
            | Step::Until { read: id, .. },
            _,
        ) => read(slot, Asked::Read(id)).map(Some),
        (Step::Send { function, index, operand, like }, _) => {
            match slot.operand(operand, &run.command, like)? {
                Some(raw) => {
                    let driver = &slot.driver;
                    let request = driver.send_for(&run.command, function, index, raw)?;
                    Ok(Some((request, Asked::Send(request.class()))))
                }
                None => {
                    run.advance(run.last);
                    Ok(None)
                }
            }
        }
        (Step::Keep(id), _) => {
            let parameter = slot.profile.parameter(id).ok_or(Unsupported::NoSuchParameter)?;
            Ok(Some((slot.driver.keep(parameter)?, Asked::Send(Class::Never))))
        }
        (Step::Wait { ms }, _) => {
            match run.since {
                Some(_) => run.advance(run.last),
                None => {
                    run.since = Some(now);
                    run.stage = Stage::Sleep(now.plus_ms(ms));
                }
            }
            Ok(None)
        }
    }
}

/// How a job ends that something else ends.
pub fn cut_short<R: Request>(job: &Job<R>, failure: Failure) -> Outcome {
    match job.task {
        Task::Run(mut run) => {
            // What is out may be executed.
            if job.asked.changes() {
                run.note(job.asked, Err(Failure::Silent));
            }
            run.ended(failure)
        }
        Task::Path | Task::Transfer(TransferKind::Write) => Outcome::Unknown(failure),
        _ if job.asked.changes() => Outcome::Unknown(failure),
        _ => Outcome::NotDone(failure),
    }
}

/// Whether one drive of a group passes the test of the step that a job is at.
pub fn passes<R: Request>(job: &Job<R>, raw: i64) -> bool {
    let Task::Run(run) = &job.task else { return true };
    match run.step() {
        Some(Step::Require { test, .. } | Step::Skip { test, .. } | Step::Until { test, .. }) => {
            test.passes(raw)
        }
        Some(Step::NoFault { mask, .. }) => raw & mask == 0,
        _ => true,
    }
}

/// What a group answered, all together: for a test what fails it, else the value that all have.
pub fn together<R: Request>(job: &mut Job<R>, raw: Result<i64, Failure>) -> Result<i64, Failure> {
    const HINT: &str = "the drives of this group have different values of a parameter that is \
                        needed; command them one by one, or make them equal";
    let tests = matches!(&job.task, Task::Run(run) if !matches!(run.stage, Stage::Confirm(..)));
    let tests = tests && matches!(job.asked, Asked::Read(_));
    match core::mem::replace(&mut job.parts, Parts::None) {
        Parts::Agree(value) | Parts::Fails(value) => raw.and(Ok(value)),
        Parts::Differ(value) if tests => raw.and(Ok(value)),
        Parts::Differ(_) if job.asked.parameter().is_some() => {
            raw.and(Err(Failure::NotReady { hint: HINT }))
        }
        Parts::Differ(_) | Parts::None => raw,
    }
}

/// What an answer, or its lack, makes of a job.
#[inline(never)]
pub fn answered<R: Request, A: Copy + 'static>(
    now: Instant,
    job: &mut Job<R>,
    slot: &mut Slot<R, A>,
    raw: Result<i64, Failure>,
) -> Next {
    let asked = core::mem::replace(&mut job.asked, Asked::Nothing);
    if let Task::Run(run) = &mut job.task {
        run.note(asked, raw);
    }
    match (asked.parameter(), raw) {
        (Some(id), Ok(raw)) => slot.note(now, id, raw),
        (Some(id), Err(Failure::Refused { code })) => slot.refused(id, code),
        _ => {}
    }
    if raw == Err(Failure::LinkDown) {
        let failure = Failure::LinkDown;
        return Next::End(match &job.task {
            Task::Run(run) => run.ended(failure),
            _ if asked.changes() => Outcome::Unknown(failure),
            _ => cut_short(job, failure),
        });
    }
    match &mut job.task {
        Task::Run(run) if job.cancelled => Next::End(cancelled(run, asked, raw)),
        Task::Read(id) => match (asked, raw) {
            (Asked::Factor(id), _) => {
                slot.tried(id);
                Next::Go
            }
            (_, Ok(raw)) => Next::End(Outcome::Done(raw)),
            (_, Err(failure)) => {
                debug_assert_eq!(asked, Asked::Read(*id));
                Next::End(Outcome::NotDone(failure))
            }
        },
        Task::Raw(_) => Next::End(match raw {
            Ok(raw) => Outcome::Done(raw),
            Err(failure) => outcome(asked, Err(failure), failure),
        }),
        Task::Run(run) => answered_run(now, run, slot, asked, raw),
        Task::Path if job.cancelled => Next::End(Outcome::Unknown(Failure::Cancelled)),
        Task::Path => along_path(slot, |path, slot| path.answered(now, slot, asked, raw))
            .unwrap_or(Next::End(Outcome::Unknown(Failure::Cancelled))),
        Task::Transfer(_) => {
            let cancelled = job.cancelled;
            with_transfer(slot, |transfer, slot| match cancelled {
                true => Next::End(transfer.cut_short(Failure::Cancelled)),
                false => transfer.answered(slot, raw),
            })
            .unwrap_or(Next::End(Outcome::Unknown(Failure::Cancelled)))
        }
    }
}

/// How a run ends that a stop cut short while a request of it was out.
fn cancelled(run: &Run, asked: Asked, raw: Result<i64, Failure>) -> Outcome {
    let last = run.undoing.is_none() && run.steps.step(run.at + 1).is_none();
    match (asked, raw) {
        (Asked::Write(..) | Asked::Send(_), Ok(raw)) if last => Outcome::Done(raw),
        (Asked::Confirm(_, value), Ok(raw)) if last && raw == value => Outcome::Done(raw),
        _ => run.ended(Failure::Cancelled),
    }
}

/// How a request ends that brought no answer, or a refusal.
fn outcome(asked: Asked, raw: Result<i64, Failure>, failure: Failure) -> Outcome {
    match (asked, raw) {
        (Asked::Send(Class::Idempotent), Err(_)) => Outcome::NotDone(failure),
        (Asked::Write(..) | Asked::Send(_), Err(Failure::Silent | Failure::Misbehaved)) => {
            Outcome::Unknown(failure)
        }
        _ => Outcome::NotDone(failure),
    }
}

fn answered_run<R: Request, A: Copy + 'static>(
    now: Instant,
    run: &mut Run,
    slot: &mut Slot<R, A>,
    asked: Asked,
    raw: Result<i64, Failure>,
) -> Next {
    if let Asked::Factor(id) = asked {
        slot.tried(id);
        return match raw {
            Err(failure) if !slot.lacks(id) => Next::End(Outcome::NotDone(failure)),
            _ => Next::Go,
        };
    }
    let group = slot.driver.is_group();
    match (asked, raw) {
        (Asked::Write(id, value, class), Err(Failure::Silent | Failure::Misbehaved)) => {
            let readable =
                slot.profile.parameter(id).is_some_and(|p| p.access == Access::ReadWrite);
            if class == Class::Confirm && readable {
                run.stage = Stage::Confirm(id, value);
                return Next::Go;
            }
            failed(run, raw.err().unwrap_or(Failure::Silent))
        }
        // Where no drive of a group may be asked, a stop that went out is all there is to do.
        (Asked::Read(_), Err(Failure::NotReady { .. })) if run.is_stop() && group => {
            passed_over(run)
        }
        (Asked::Read(_), Err(Failure::Refused { .. }))
            if matches!(run.step(), Some(Step::Without { .. })) =>
        {
            left_out(run)
        }
        (_, Err(Failure::Refused { .. })) if run.step().is_some_and(|it| slot.leaves_out(&it)) => {
            left_out(run)
        }
        (Asked::Confirm(_, value), Ok(raw)) if raw != value => failed(run, Failure::Silent),
        (_, Err(failure)) => failed(run, failure),
        (_, Ok(raw)) => {
            if let Asked::Write(id, ..) | Asked::Confirm(id, _) = asked {
                count_flash(slot, id, run);
            }
            passed(now, run, raw)
        }
    }
}

/// A write that went to permanent memory, as far as the profile tells.
fn count_flash<R: Request, A: Copy + 'static>(slot: &mut Slot<R, A>, id: ParameterId, run: &Run) {
    let always = slot.profile.parameter(id).is_some_and(|p| p.persistence == Persistence::Always);
    let kept = matches!(run.step(), Some(Step::Ensure(..)))
        && slot.profile.ram.is_some_and(|ram| ram.parameter == id);
    slot.state.flash_writes += u32::from(always || kept);
}

/// The step is left out.
fn passed_over(run: &mut Run) -> Next {
    run.advance(run.last);
    match run.step() {
        Some(_) => Next::Go,
        None => Next::End(finished(run)),
    }
}

/// The drive has no such parameter: what is done with it is left out.
fn left_out(run: &mut Run) -> Next {
    leave_out(run);
    match run.step() {
        Some(_) => Next::Go,
        None => Next::End(finished(run)),
    }
}

fn leave_out(run: &mut Run) {
    if let Some(Step::Without { count, .. }) = run.step() {
        run.at = run.at.saturating_add(count);
    }
    run.advance(run.last);
}

/// What a step makes of the value it got.
fn passed(now: Instant, run: &mut Run, raw: i64) -> Next {
    let Some(step) = run.step() else { return Next::End(finished(run)) };
    match (step, run.stage) {
        (Step::Ensure(_, value), Stage::First) if raw != value => run.stage = Stage::Write(raw),
        (Step::Copy { .. }, Stage::First) => run.stage = Stage::Write(raw),
        (Step::Require { test, hint, .. }, _) if !test.passes(raw) => {
            return failed(run, Failure::NotReady { hint });
        }
        (Step::Skip { test, count, .. }, _) if test.passes(raw) => {
            run.advance(raw);
            run.at = run.at.saturating_add(count);
        }
        (Step::NoFault { mask, .. }, _) if raw & mask != 0 => {
            return failed(run, Failure::Faulted { code: (raw & mask) as u32 });
        }
        (Step::Until { test, within_ms, .. }, _) if !test.passes(raw) => {
            let since = *run.since.get_or_insert(now);
            if now > since.plus_ms(within_ms) {
                return failed(run, Failure::NotReached);
            }
            run.stage = Stage::Sleep(now + POLL);
            return Next::Sleep(now + POLL);
        }
        _ => run.advance(raw),
    }
    match run.step() {
        Some(_) => Next::Go,
        None => Next::End(finished(run)),
    }
}

fn finished(run: &Run) -> Outcome {
    match run.undoing {
        None => Outcome::Done(run.last),
        Some(failure) => {
            let undone = !run.is_stop() && !run.undo_failed;
            Extent { undone, ..run.extent }.outcome(failure)
        }
    }
}

/// A step failed: a stop goes on with its next step, anything else is undone.
fn failed(run: &mut Run, failure: Failure) -> Next {
    let Extent { done, unknown, refused, .. } = run.extent;
    let wrote = done | unknown | refused != 0;
    if run.undoing.is_some() {
        run.advance(0);
    } else if run.is_stop() {
        // What is left of a stop is still worth trying.
        run.undo = run.steps.rest(run.at);
        run.base = run.at.saturating_add(1);
        run.undoing = Some(failure);
        run.at = 0;
        run.stage = Stage::First;
    } else if run.at > 0 && wrote && !run.undo.is_empty() {
        run.undoing = Some(failure);
        run.at = 0;
        run.stage = Stage::First;
        run.since = None;
    } else {
        return Next::End(run.ended(failure));
    }
    match run.step() {
        Some(_) => Next::Go,
        None => Next::End(finished(run)),
    }
}
