//! Conditions that a waiting step checks besides its own: power, mode and fault. A motor without power
//! never arrives, so the wait ends at once (MOVE-9).

use super::slot::AxisSlot;
use crate::axis::Verb;
use crate::error::Failure;
use crate::plan::{Compare, Step};
use crate::profile::{ParameterId, Signal, SignalSource};
use crate::station::Request;
use crate::time::Instant;

/// Interval of reads that the step does not make by itself.
// Power, mode and fault change rarely, and each takes a request from the reading that ends the wait.
const PERIOD_MS: u32 = 200;

/// Values seen during one run.
#[derive(Clone, Copy, Debug, Default)]
pub struct WaitGuard {
    /// The motor had power.
    was_enabled: bool,
    /// The drive was ready to power its motor.
    was_ready: bool,
    /// Time at which the other parameters are read next.
    due: Option<Instant>,
}

/// A parameter that is read while a step waits.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum GuardRead {
    /// Power state of the motor.
    Power,
    /// The mode that the plan has waited for before.
    Mode(i64),
    /// Fault state, for a drive that does not report its power state, and for a plan that has ruled out faults.
    Fault,
    /// Reads the fault that took the power.
    FaultWithoutPower,
}

/// Decision of the guard.
#[derive(Debug)]
pub enum GuardVerdict {
    /// The step waits on.
    WaitOn,
    /// This is read first.
    Read(GuardRead, ParameterId),
    /// The wait is in vain.
    Fail(Failure),
}

impl WaitGuard {
    /// Takes a value that a step of the plan has read.
    pub fn note<R: Request, A: Copy + 'static>(
        &mut self,
        slot: &AxisSlot<R, A>,
        id: ParameterId,
        raw: i64,
    ) {
        self.was_enabled |= source(slot, Signal::Enabled, id)
            .and_then(|source| enabled_by(source, raw))
            == Some(true);
        let rule = slot.profile.motion.unpowered.filter(|(rule, _)| *rule == id);
        self.was_ready |= rule.is_some_and(|(_, test)| !test.passes(raw));
    }

    /// Evaluates a value that a wait step read and that fails its test.
    pub fn judge_poll<R: Request, A: Copy + 'static>(
        &mut self,
        now: Instant,
        verb: Verb,
        steps: &[Step],
        slot: &AxisSlot<R, A>,
        id: ParameterId,
        raw: i64,
    ) -> GuardVerdict {
        // These verbs take the power away themselves, or are there to end a fault.
        if verb.is_stop() || matches!(verb, Verb::Disable | Verb::Clear) {
            return GuardVerdict::WaitOn;
        }
        if let Some(power) = source(slot, Signal::Enabled, id)
            && self.was_enabled
            && enabled_by(power, raw) == Some(false)
        {
            return read_fault(slot);
        }
        let rule = slot.profile.motion.unpowered.filter(|(rule, _)| *rule == id);
        if self.was_ready && rule.is_some_and(|(_, test)| test.passes(raw)) {
            return read_fault(slot);
        }
        // The first one a period after the beginning: most waits are over by then.
        let due = *self.due.get_or_insert(now.plus_ms(PERIOD_MS));
        if now < due {
            return GuardVerdict::WaitOn;
        }
        self.due = Some(now.plus_ms(PERIOD_MS));
        next_read(None, id, steps, slot)
    }

    /// Evaluates a value that was read beside the step.
    pub fn judge_read<R: Request, A: Copy + 'static>(
        &mut self,
        read: GuardRead,
        steps: &[Step],
        slot: &AxisSlot<R, A>,
        waited_for: ParameterId,
        id: ParameterId,
        raw: i64,
    ) -> GuardVerdict {
        let failed = match read {
            GuardRead::Power => {
                let power = source(slot, Signal::Enabled, id).and_then(|s| enabled_by(s, raw));
                if self.was_enabled && power == Some(false) {
                    return read_fault(slot);
                }
                self.was_enabled |= power == Some(true);
                None
            }
            GuardRead::Mode(mode) => (raw != mode).then_some(Failure::ModeChanged { mode: raw }),
            GuardRead::Fault => fault_of(slot, id, raw & ruled_out_mask(steps, id)),
            // A drive that lost its power mostly knows why, and the fault is the better answer.
            GuardRead::FaultWithoutPower => {
                Some(fault_of(slot, id, raw).unwrap_or(Failure::PowerLost))
            }
        };
        match failed {
            Some(failure) => GuardVerdict::Fail(failure),
            None => next_read(Some(read), waited_for, steps, slot),
        }
    }
}

/// The bits of a fault parameter that the plan has ruled out before; all of them if it has not looked.
fn ruled_out_mask(steps: &[Step], id: ParameterId) -> i64 {
    steps
        .iter()
        .rev()
        .find_map(|step| match step {
            Step::NoFault { read, mask } if *read == id => Some(*mask),
            _ => None,
        })
        .unwrap_or(-1)
}

/// The signal's source, if it is that parameter.
fn source<R: Request, A: Copy + 'static>(
    slot: &AxisSlot<R, A>,
    signal: Signal,
    id: ParameterId,
) -> Option<&'static SignalSource> {
    slot.profile.signal(signal).filter(|source| source.parameter == id)
}

fn enabled_by(source: &SignalSource, raw: i64) -> Option<bool> {
    source.is_flag().then(|| source.is_set(raw))
}

/// The fault in a value, if it is one that stops the drive.
fn fault_of<R: Request, A: Copy + 'static>(
    slot: &AxisSlot<R, A>,
    id: ParameterId,
    raw: i64,
) -> Option<Failure> {
    let masked = raw & source(slot, Signal::Fault, id)?.mask;
    let code = slot.stopping_fault(masked);
    (code != 0).then_some(Failure::Faulted { code })
}

fn read_fault<R: Request, A: Copy + 'static>(slot: &AxisSlot<R, A>) -> GuardVerdict {
    match slot.profile.signal(Signal::Fault) {
        Some(fault) if !slot.lacks_parameter(fault.parameter) => {
            GuardVerdict::Read(GuardRead::FaultWithoutPower, fault.parameter)
        }
        _ => GuardVerdict::Fail(Failure::PowerLost),
    }
}

/// The parameter to read after `last`, except those that the step itself reads.
fn next_read<R: Request, A: Copy + 'static>(
    last: Option<GuardRead>,
    waited_for: ParameterId,
    steps: &[Step],
    slot: &AxisSlot<R, A>,
) -> GuardVerdict {
    let power = slot.profile.signal(Signal::Enabled);
    let mode = slot.profile.signal(Signal::Mode).and_then(|mode| {
        let wanted = steps.iter().rev().find_map(|step| match step {
            Step::Until { read, test, .. } if *read == mode.parameter => Some(test),
            _ => None,
        });
        let exact = wanted.filter(|test| test.compare == Compare::Equal && test.mask == -1);
        exact.map(|test| (GuardRead::Mode(test.value), mode.parameter))
    });
    let fault = slot.profile.signal(Signal::Fault);
    // If the power can be read, a fault from before the motion is no reason to end it.
    let fault = fault.filter(|source| power.is_none() || is_source_ruled_out(source, steps));
    let reads = [
        power.map(|power| (GuardRead::Power, power.parameter)),
        mode,
        fault.map(|fault| (GuardRead::Fault, fault.parameter)),
    ];
    let passed = last.map_or(0, read_order);
    let mut left = reads.into_iter().flatten().filter(|(read, id)| {
        read_order(*read) > passed && *id != waited_for && !slot.lacks_parameter(*id)
    });
    left.next().map_or(GuardVerdict::WaitOn, |(read, id)| GuardVerdict::Read(read, id))
}

fn read_order(read: GuardRead) -> i32 {
    match read {
        GuardRead::Power => 1,
        GuardRead::Mode(_) => 2,
        GuardRead::Fault | GuardRead::FaultWithoutPower => 3,
    }
}

fn is_source_ruled_out(source: &SignalSource, steps: &[Step]) -> bool {
    // A fault that the plan has ruled out before is a new one.
    let rules_out =
        |step: &Step| matches!(step, Step::NoFault { read, .. } if *read == source.parameter);
    steps.iter().any(rules_out)
}
