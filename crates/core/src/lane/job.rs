//! One job of a lane, and its progress.

use super::guard::{GuardRead, WaitGuard};
use super::slot::AxisSlot;
use super::watch::WatchReads;
use crate::axis::{Command, ExecutionProof, Verb};
use crate::error::{Extent, Failure, Outcome};
use crate::plan::{Operand, STEPS_MAX, Step};
use crate::profile::{Parameter, ParameterId, Persistence, Profile, RamMode};
use crate::program::TransferKind;
use crate::station::{Request, RequestClass, Ticket};
use crate::time::Instant;

#[derive(Clone, Copy, Debug)]
pub struct Job<R> {
    pub ticket: Ticket,
    pub axis: u8,
    pub task: JobTask<R>,
    pub in_flight: InFlight,
    /// A stop arrived during its request: the job ends with that request.
    pub cancelled: bool,
    /// True if its requests are never sent again, whatever their class.
    pub no_retry: bool,
    pub group_result: GroupResult,
    /// Time until which it sleeps.
    pub sleeps_until: Instant,
    /// The drive has been busy since.
    pub busy_since: Option<Instant>,
    pub outcome: Option<Outcome>,
}

impl<R: Request> Job<R> {
    /// Returns whether one of its requests starts a motion.
    pub fn starts_motion<A: Copy + 'static>(
        &self,
        slot: &AxisSlot<R, A>,
        in_flight: InFlight,
    ) -> bool {
        match (&self.task, in_flight) {
            (JobTask::Run(run), InFlight::Write(..) | InFlight::Send(_))
                if run.undo_reason.is_none() =>
            {
                let verb = run.verb.is_some_and(Verb::starts_motion);
                let sets = matches!(in_flight, InFlight::Write(id, ..) if moves_motor(id, slot));
                in_flight.changes_drive() && (verb || run.verb.is_none() && sets)
            }
            (JobTask::Path, InFlight::Send(_)) => in_flight.changes_drive(),
            (JobTask::Raw(request), _) => request.class() == RequestClass::NoRetry,
            _ => false,
        }
    }

    /// Returns whether the axis is at rest, or without power, once the job is done.
    pub fn ends_motion(&self) -> bool {
        match &self.task {
            JobTask::Run(run) => run.verb.is_some_and(Verb::ends_motion),
            JobTask::Raw(request) => request.is_stop(),
            JobTask::Path => true,
            _ => false,
        }
    }
}

fn moves_motor<R: Request, A: Copy + 'static>(id: ParameterId, slot: &AxisSlot<R, A>) -> bool {
    slot.parameter(id).is_some_and(|parameter| parameter.moves)
}

/// Replies so far of the drives of a group to the current request.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum GroupResult {
    None,
    /// All the same.
    Agree(i64),
    /// Not all the same; the last one.
    Differ(i64),
    /// One that does not pass the step's test.
    Fails(i64),
}

impl GroupResult {
    /// With one more.
    pub fn combine(self, raw: i64, passes: bool) -> Self {
        match self {
            Self::Fails(_) => self,
            _ if !passes => Self::Fails(raw),
            Self::None => Self::Agree(raw),
            Self::Agree(other) if raw == other => self,
            Self::Agree(_) | Self::Differ(_) => Self::Differ(raw),
        }
    }
}

#[expect(clippy::large_enum_variant, reason = "lives in the lane's table, which is made once")]
#[derive(Clone, Copy, Debug)]
pub enum JobTask<R> {
    Read(ParameterId),
    Raw(R),
    Run(PlanRun),
    /// The path that the axis' slot holds.
    Path,
    /// The transfer that the axis' slot holds.
    Transfer(TransferKind),
}

/// Purpose of the current request.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum InFlight {
    Nothing,
    /// A parameter that a scale depends on.
    Factor(ParameterId),
    Read(ParameterId),
    /// A reading beside the condition of a wait step.
    Guard(ParameterId),
    /// A reading by which a motion is judged.
    Watch(ParameterId),
    Write(ParameterId, i64, RequestClass),
    /// A read-back after a write without a reply.
    ReadBack(ParameterId, i64),
    /// A reading that shows whether the drive executed a request without a reply.
    Proof(ParameterId),
    Send(RequestClass),
}

impl InFlight {
    /// Returns whether it can change the drive or start a motion.
    pub const fn changes_drive(self) -> bool {
        match self {
            Self::Send(class) => !matches!(class, RequestClass::Idempotent),
            Self::Write(..) => true,
            _ => false,
        }
    }

    /// Returns whether it can change the drive, or checks whether an earlier request did.
    pub const fn may_have_changed(self) -> bool {
        match self {
            Self::Nothing | Self::Factor(_) | Self::Read(_) => false,
            Self::Guard(_) | Self::Watch(_) => false,
            Self::Send(class) => !matches!(class, RequestClass::Idempotent),
            Self::Write(..) | Self::ReadBack(..) | Self::Proof(_) => true,
        }
    }

    pub fn parameter(self) -> Option<ParameterId> {
        match self {
            Self::Factor(id)
            | Self::Read(id)
            | Self::Guard(id)
            | Self::Watch(id)
            | Self::Proof(id)
            | Self::Write(id, ..)
            | Self::ReadBack(id, _) => Some(id),
            Self::Nothing | Self::Send(_) => None,
        }
    }
}

/// Steps with a longer time limit wait for a motion, others for a drive that changes its state.
const MOTION_WAIT_MIN_MS: u32 = 10_000;

/// Limit of repetitions of a step that readings prove not executed.
// The manual of TML asks for a repetition, and names no limit. Two are enough for a bad contact; a third silence has
// another cause.
const RESENDS_MAX: u8 = 2;

/// A walk along steps.
#[derive(Clone, Copy, Debug)]
pub struct PlanRun {
    pub steps: StepSource,
    pub undo: &'static [Step],
    pub command: Command,
    /// True when the steps set something in motion, or stop it.
    pub verb: Option<Verb>,
    pub index: u8,
    pub stage: StepStage,
    /// Results of the steps that were sent.
    pub extent: Extent,
    /// The step before which the drive's own program is ended: behind those that stop the motor, which
    /// are then carried out again, because the program may have moved it in between.
    pub program_end: Option<u8>,
    /// Scales known and arguments in range: from here on bytes are sent.
    pub checked: bool,
    /// The undo steps are running; the job ends for this reason when they are through.
    pub undo_reason: Option<Failure>,
    /// Not every undo step was acknowledged.
    pub undo_failed: bool,
    /// Start of the wait of the current step.
    pub waiting_since: Option<Instant>,
    pub last_value: i64,
    /// Number of times the current step was sent again after a reading showed that it was not executed.
    pub resends: u8,
    /// Values that wait steps check beside their condition.
    pub guard: WaitGuard,
    /// A reading was left out, because no drive of a group may be asked.
    pub unconfirmed: bool,
    /// Readings for the judge of a motion.
    pub watch: WatchReads,
    /// The drive accepted the write of the current step and was not done with it.
    pub accepted: bool,
    /// True if the drive stored the stop as an instruction, and was set to execute requests again.
    pub ended_store: bool,
}

/// Stage of a step that takes several requests.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum StepStage {
    First,
    /// The position of the axis is read, before a motion is started.
    Before,
    /// Readings have to show whether a start without acknowledgement was executed.
    StartProof,
    /// The value read is to be written.
    Write(i64),
    /// A lost write is to be read back.
    ReadBack(ParameterId, i64),
    /// A reading has to show whether the drive executed a step without acknowledgement.
    Proof(ExecutionProof),
    /// The drive did not execute the step; the next reading shows whether it has a fault.
    FaultBeforeResend(ExecutionProof),
    /// Nothing is sent before then.
    Sleep(Instant),
    /// A step that waits looks at something else first.
    Guard(GuardRead, ParameterId),
    /// Reads whether the drive's program is running.
    QueryProgram,
    /// The drive's program is ended.
    EndProgram,
    /// The drive is to execute requests again, and not to store them as instructions.
    EndStore,
}

#[derive(Clone, Copy, Debug)]
pub enum StepSource {
    Plan(&'static [Step]),
    Write(WriteSteps),
}

/// The steps that write one parameter, to RAM or to permanent memory.
#[derive(Clone, Copy, Debug)]
pub struct WriteSteps {
    id: ParameterId,
    raw: i64,
    store: bool,
    ram: Option<RamMode>,
    storable: bool,
    /// True if it is read first.
    reads: bool,
    /// True if the drive was found to keep every write, so that it is left so.
    keeps_mode: bool,
}

impl WriteSteps {
    pub fn new(
        profile: &Profile,
        id: ParameterId,
        parameter: &Parameter,
        raw: i64,
        store: bool,
        reads: bool,
    ) -> Self {
        let spares = parameter.persistence == Persistence::UnlessRam;
        // Drives that keep every write get their RAM mode first, unless the value is to be kept.
        let ram = profile.ram.filter(|ram| spares && ram.parameter != id);
        let storable = parameter.persistence == Persistence::Storable;
        Self { id, raw, store, ram, storable, reads, keeps_mode: false }
    }

    fn step(&self, at: u8) -> Option<Step> {
        let at = match (self.reads, at) {
            (true, 0) => return Some(Step::Read(self.id)),
            (reads, at) => at - u8::from(reads),
        };
        let write = Step::Write(self.id, Operand::Constant(self.raw));
        match (self.ram, at) {
            (Some(ram), 0) if self.store => Some(Step::Ensure(ram.parameter, ram.flash)),
            (Some(ram), 0) => Some(Step::Ensure(ram.parameter, ram.ram)),
            (Some(_), 1) | (None, 0) => Some(write),
            (Some(ram), 2) if self.store && !self.keeps_mode => {
                Some(Step::Ensure(ram.parameter, ram.ram))
            }
            (None, 1) if self.store && self.storable => Some(Step::Store(self.id)),
            _ => None,
        }
    }

    /// Returns whether this writes to the permanent memory of a drive that has a RAM mode.
    pub fn stores_past_ram(&self) -> bool {
        self.store && self.ram.is_some()
    }
}

impl StepSource {
    pub fn step(&self, at: u8) -> Option<Step> {
        match self {
            Self::Plan(steps) => steps.get(usize::from(at)).copied(),
            Self::Write(write) => write.step(at),
        }
    }
}

impl PlanRun {
    pub fn new(
        steps: StepSource,
        undo: &'static [Step],
        command: Command,
        verb: Option<Verb>,
    ) -> Self {
        Self {
            steps,
            undo,
            command,
            verb,
            index: 0,
            stage: StepStage::First,
            extent: Extent::default(),
            program_end: None,
            checked: false,
            undo_reason: None,
            undo_failed: false,
            waiting_since: None,
            last_value: 0,
            resends: 0,
            guard: WaitGuard::default(),
            unconfirmed: false,
            watch: WatchReads::default(),
            accepted: false,
            ended_store: false,
        }
    }

    /// The drive keeps every write already: a write to permanent memory leaves it so.
    pub fn note_ram_mode(&mut self) {
        if let StepSource::Write(write) = &mut self.steps {
            write.keeps_mode |= write.stores_past_ram();
        }
    }

    pub fn current_step(&self) -> Option<Step> {
        match self.undo_reason {
            Some(_) if !self.is_stop() => self.undo.get(usize::from(self.index)).copied(),
            _ => self.steps.step(self.index),
        }
    }

    /// Returns whether the drive's program must be ended before the plan starts.
    pub fn is_program_end_due(&self) -> bool {
        self.program_end == Some(self.index)
    }

    /// Returns whether the readings before the start of a motion are under way.
    pub fn is_before_start(&self) -> bool {
        self.stage == StepStage::Before
    }

    /// Returns whether all of a homing's start was sent, so that readings show whether it runs.
    pub fn is_homing_under_way(&self) -> bool {
        // A drive reports a finished homing before its motor is at standstill; until then the readings belong to the
        // judge.
        let left = (self.index..=u8::MAX).map_while(|at| self.steps.step(at));
        let next = left.into_iter().find(|step| step.may_change_drive() || step.is_judged());
        self.verb == Some(Verb::Home)
            && matches!(self.current_step(), Some(Step::Until { .. }))
            && matches!(next, Some(Step::Homed { .. }))
    }

    /// Returns whether the current step is the last one.
    pub fn is_last_step(&self) -> bool {
        let next = self.index.saturating_add(1);
        self.undo_reason.is_none()
            && self.steps.step(next).is_none()
            && self.program_end != Some(next)
            && !self.is_program_end_due()
    }

    /// On with the stop, from the first of its steps again where the drive's program may have run.
    pub fn resume_stop(&mut self, again: bool) {
        self.program_end = None;
        self.stage = StepStage::First;
        if again {
            self.index = 0;
        }
    }

    /// The steps of the plan up to and including the current one.
    pub fn passed_steps(&self) -> &'static [Step] {
        match self.steps {
            StepSource::Plan(steps) => &steps[..steps.len().min(usize::from(self.index))],
            StepSource::Write(_) => &[],
        }
    }

    /// Time limit of a wait step: the caller's own limit replaces the limit of a whole motion.
    pub fn wait_limit_ms(&self, within_ms: u32) -> u32 {
        match self.command.limit_ms {
            Some(limit_ms) if within_ms >= MOTION_WAIT_MIN_MS => limit_ms,
            _ => within_ms,
        }
    }

    pub fn is_stop(&self) -> bool {
        self.verb.is_some_and(Verb::is_stop)
    }

    /// Records the result of a step that can change the drive, once it has ended. A request that a stop
    /// overtook, or that the protocol's rules forbid, was never sent.
    pub fn record_result(&mut self, in_flight: InFlight, raw: Result<i64, Failure>) {
        if self.undo_reason.is_some() && !self.is_stop() {
            let whole = raw.is_ok() || !in_flight.may_have_changed();
            self.undo_failed |= !whole;
            return;
        }
        let bit = self.extent_bit();
        let extent = &mut self.extent;
        match (in_flight, raw) {
            (InFlight::ReadBack(_, value), Ok(raw)) => {
                self.record_proof(raw == value);
                self.extent.refused |= if raw == value { 0 } else { bit };
            }
            (
                InFlight::Send(RequestClass::Idempotent)
                | InFlight::ReadBack(..)
                | InFlight::Proof(_),
                _,
            ) => {}
            (InFlight::Write(..) | InFlight::Send(_), Ok(_)) => self.record_proof(true),
            (InFlight::Write(..) | InFlight::Send(_), Err(Failure::Refused { .. })) => {
                extent.refused |= bit;
            }
            (
                InFlight::Write(..) | InFlight::Send(_),
                Err(Failure::Silent | Failure::Misbehaved | Failure::LinkDown),
            ) => extent.unknown |= bit,
            _ => {}
        }
    }

    /// The outcome for this failure at the present progress.
    pub fn outcome_for(&self, failure: Failure) -> Outcome {
        self.extent.outcome(failure)
    }

    /// True for what sets the axis in motion or powers it.
    pub fn needs_arming(&self) -> bool {
        self.verb.is_some_and(Verb::needs_arming)
    }

    /// The bit of the current step in an extent.
    fn extent_bit(&self) -> u64 {
        debug_assert!(usize::from(self.index) < STEPS_MAX, "an extent has a bit for each step");
        1 << self.index
    }

    /// Records the result of a reading for the current step.
    pub fn record_proof(&mut self, executed: bool) {
        let bit = self.extent_bit();
        let extent = &mut self.extent;
        debug_assert!(bit != 0);
        extent.unknown &= !bit;
        extent.refused &= !bit;
        extent.done = if executed { extent.done | bit } else { extent.done & !bit };
    }

    /// Returns whether the current step may be sent once more after a reading showed that it was not executed.
    pub fn may_resend(&mut self) -> bool {
        // A stop is repeated as a whole by its supervisor, and the way back is not worth a delay.
        let allowed = self.resends < RESENDS_MAX && !self.is_stop() && self.undo_reason.is_none();
        self.resends += u8::from(allowed);
        allowed
    }

    /// The class of a write in this run.
    pub fn write_class(&self, parameter: &Parameter) -> RequestClass {
        if self.is_stop() {
            RequestClass::Stop
        // Flash wears with each write, and a motion must not be begun twice: neither is ever sent again.
        } else if parameter.moves || parameter.persistence == Persistence::Always {
            RequestClass::NoRetry
        } else {
            RequestClass::ReadBack
        }
    }

    /// On to the next step.
    pub fn advance(&mut self, raw: i64) {
        debug_assert!(self.index < u8::MAX, "a plan is shorter than its index");
        self.index += 1;
        self.stage = StepStage::First;
        self.waiting_since = None;
        self.resends = 0;
        self.watch = WatchReads::default();
        self.accepted = false;
        self.last_value = raw;
    }
}
