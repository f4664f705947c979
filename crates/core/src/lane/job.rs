//! One thing a lane was asked to do, and how far it is.

use super::transfer::TransferKind;
use crate::axis::{Command, Verb};
use crate::error::{Extent, Failure, Outcome};
use crate::plan::{Operand, Step};
use crate::profile::{Parameter, ParameterId, Persistence, Profile, RamMode};
use crate::station::{Class, Request, Ticket};
use crate::time::Instant;

#[derive(Clone, Copy, Debug)]
pub struct Job<R> {
    pub ticket: Ticket,
    pub axis: u8,
    pub task: Task<R>,
    pub asked: Asked,
    /// A stop came by while its request was out: it ends when that request does.
    pub cancelled: bool,
    /// No request of it is sent again, whatever its class.
    pub once: bool,
    pub parts: Parts,
    /// It sleeps until then.
    pub until: Instant,
    pub outcome: Option<Outcome>,
}

impl<R: Request> Job<R> {
    /// Whether a request of it sets the axis going.
    pub fn sets_going(&self, profile: &Profile, asked: Asked) -> bool {
        let moves = |id| profile.parameter(id).is_some_and(|parameter| parameter.moves);
        match (&self.task, asked) {
            (Task::Run(run), Asked::Write(..) | Asked::Send(_)) if run.undoing.is_none() => {
                let verb = run.verb.is_some_and(Verb::sets_going);
                let sets = matches!(asked, Asked::Write(id, ..) if moves(id));
                asked.commands() && (verb || run.verb.is_none() && sets)
            }
            (Task::Path, Asked::Send(_)) => asked.commands(),
            (Task::Raw(request), _) => request.class() == Class::Never,
            _ => false,
        }
    }

    /// Whether the axis stands, or has no power, once it is done.
    pub fn ends_going(&self) -> bool {
        match &self.task {
            Task::Run(run) => run.verb.is_some_and(Verb::ends_going),
            Task::Raw(request) => request.is_stop(),
            Task::Path => true,
            _ => false,
        }
    }
}

/// What the drives of a group answered so far to the request that is out.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Parts {
    None,
    /// All the same.
    Agree(i64),
    /// Not all the same; the last one.
    Differ(i64),
    /// One that does not pass the step's test.
    Fails(i64),
}

impl Parts {
    /// With one more.
    pub fn and(self, raw: i64, passes: bool) -> Self {
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
pub enum Task<R> {
    Read(ParameterId),
    Raw(R),
    Run(Run),
    /// The path that the axis' slot holds.
    Path,
    /// The transfer that the axis' slot holds.
    Transfer(TransferKind),
}

/// What the request that is out asks.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum Asked {
    Nothing,
    /// A parameter that a scale depends on.
    Factor(ParameterId),
    Read(ParameterId),
    Write(ParameterId, i64, Class),
    /// Whether a write whose answer was lost arrived.
    Confirm(ParameterId, i64),
    Send(Class),
}

impl Asked {
    /// Whether it can change the drive or set it going.
    pub const fn commands(self) -> bool {
        match self {
            Self::Send(class) => !matches!(class, Class::Idempotent),
            Self::Write(..) => true,
            _ => false,
        }
    }

    /// Whether it could change the drive, or asks whether something did.
    pub const fn changes(self) -> bool {
        match self {
            Self::Nothing | Self::Factor(_) | Self::Read(_) => false,
            Self::Send(class) => !matches!(class, Class::Idempotent),
            Self::Write(..) | Self::Confirm(..) => true,
        }
    }

    pub fn parameter(self) -> Option<ParameterId> {
        match self {
            Self::Factor(id) | Self::Read(id) | Self::Write(id, ..) | Self::Confirm(id, _) => {
                Some(id)
            }
            Self::Nothing | Self::Send(_) => None,
        }
    }
}

/// A walk along steps.
#[derive(Clone, Copy, Debug)]
pub struct Run {
    pub steps: Steps,
    pub undo: &'static [Step],
    pub command: Command,
    /// True when the steps set something in motion, or stop it.
    pub verb: Option<Verb>,
    pub at: u8,
    pub stage: Stage,
    /// What became of the steps that were sent.
    pub extent: Extent,
    /// Steps that lie before the first of `undo`, where that is the rest of a stop.
    pub base: u8,
    /// Scales known and arguments in range: from here on bytes are sent.
    pub checked: bool,
    /// The undo steps are running; the job ends for this reason when they are through.
    pub undoing: Option<Failure>,
    /// Not every undo step was acknowledged.
    pub undo_failed: bool,
    /// When the step in hand began to wait.
    pub since: Option<Instant>,
    pub last: i64,
}

/// Where a step that takes more than one request is.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum Stage {
    First,
    /// The value read is to be written.
    Write(i64),
    /// A lost write is to be read back.
    Confirm(ParameterId, i64),
    /// Nothing is sent before then.
    Sleep(Instant),
}

#[derive(Clone, Copy, Debug)]
pub enum Steps {
    Plan(&'static [Step]),
    Write(Write),
}

/// The steps that write one parameter: permanent memory is spared, or asked for.
#[derive(Clone, Copy, Debug)]
pub struct Write {
    id: ParameterId,
    raw: i64,
    keep: bool,
    ram: Option<RamMode>,
    storable: bool,
}

impl Write {
    pub fn new(profile: &Profile, id: ParameterId, raw: i64, keep: bool) -> Self {
        let persistence = profile.parameter(id).map(|p| p.persistence);
        let spares = persistence == Some(Persistence::UnlessRam);
        let ram = profile.ram.filter(|ram| spares && ram.parameter != id);
        Self { id, raw, keep, ram, storable: persistence == Some(Persistence::Storable) }
    }

    fn step(&self, at: u8) -> Option<Step> {
        let write = Step::Write(self.id, Operand::Is(self.raw));
        match (self.ram, at) {
            (Some(ram), 0) if self.keep => Some(Step::Ensure(ram.parameter, ram.flash)),
            (Some(ram), 0) => Some(Step::Ensure(ram.parameter, ram.ram)),
            (Some(_), 1) | (None, 0) => Some(write),
            (Some(ram), 2) if self.keep => Some(Step::Ensure(ram.parameter, ram.ram)),
            (None, 1) if self.keep && self.storable => Some(Step::Keep(self.id)),
            _ => None,
        }
    }
}

impl Steps {
    pub fn step(&self, at: u8) -> Option<Step> {
        match self {
            Self::Plan(steps) => steps.get(usize::from(at)).copied(),
            Self::Write(write) => write.step(at),
        }
    }

    /// What is left behind step `at`, of a plan.
    pub fn rest(&self, at: u8) -> &'static [Step] {
        match self {
            Self::Plan(steps) => steps.get(usize::from(at) + 1..).unwrap_or(&[]),
            Self::Write(_) => &[],
        }
    }
}

impl Run {
    pub fn new(steps: Steps, undo: &'static [Step], command: Command, verb: Option<Verb>) -> Self {
        Self {
            steps,
            undo,
            command,
            verb,
            at: 0,
            stage: Stage::First,
            extent: Extent::default(),
            base: 0,
            checked: false,
            undoing: None,
            undo_failed: false,
            since: None,
            last: 0,
        }
    }

    pub fn step(&self) -> Option<Step> {
        match self.undoing {
            Some(_) => self.undo.get(usize::from(self.at)).copied(),
            None => self.steps.step(self.at),
        }
    }

    pub fn is_stop(&self) -> bool {
        self.verb.is_some_and(Verb::is_stop)
    }

    /// Notes what became of a step that can change the drive, once that is over: until then `asked`
    /// tells. A request that a stop overtook, or that the protocol's rules forbid, was never sent.
    pub fn note(&mut self, asked: Asked, raw: Result<i64, Failure>) {
        if self.undoing.is_some() && !self.is_stop() {
            let whole = raw.is_ok() || !asked.changes();
            self.undo_failed |= !whole;
            return;
        }
        let bit = 1u64.checked_shl(u32::from(self.base) + u32::from(self.at)).unwrap_or(0);
        let extent = &mut self.extent;
        match (asked, raw) {
            (Asked::Confirm(_, value), Ok(raw)) => {
                extent.unknown &= !bit;
                *(if raw == value { &mut extent.done } else { &mut extent.refused }) |= bit;
            }
            (Asked::Send(Class::Idempotent) | Asked::Confirm(..), _) => {}
            (Asked::Write(..) | Asked::Send(_), Ok(_)) => extent.done |= bit,
            (Asked::Write(..) | Asked::Send(_), Err(Failure::Refused { .. })) => {
                extent.refused |= bit;
            }
            (
                Asked::Write(..) | Asked::Send(_),
                Err(Failure::Silent | Failure::Misbehaved | Failure::LinkDown),
            ) => extent.unknown |= bit,
            _ => {}
        }
    }

    /// How it ends for this reason, as far as it went.
    pub fn ended(&self, failure: Failure) -> Outcome {
        self.extent.outcome(failure)
    }

    /// True for what sets the axis in motion or powers it.
    pub fn moves(&self) -> bool {
        self.verb.is_some_and(Verb::needs_arming)
    }

    /// What a write within this run is held to.
    pub fn class(&self, parameter: &Parameter) -> Class {
        if self.is_stop() {
            Class::Stop
        } else if parameter.moves || parameter.persistence == Persistence::Always {
            Class::Never
        } else {
            Class::Confirm
        }
    }

    /// On to the next step.
    pub fn advance(&mut self, raw: i64) {
        self.at += 1;
        self.stage = Stage::First;
        self.since = None;
        self.last = raw;
    }
}
