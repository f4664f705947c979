//! A profile while it is being put together: owned, and naming parameters rather than counting them.
//!
//! That makes `extends` simple: a base profile, from a file or compiled in, becomes a draft, the
//! file's own entries replace those of the same name, and everything is checked once at the end.

use crate::file::{Found, Place};
use polepair_core::axis::Verb;
use polepair_core::plan::Test;
use polepair_core::profile::{
    Access, Ask, AxisKind, Certainty, Encoding, Identity, Persistence, Profile, Scale, Severity,
    Signal, Watchdog,
};
use polepair_core::units::Unit;

/// A parameter by its name, and where the file names it.
pub(crate) type Named = Found<String>;

#[derive(Clone, Debug)]
pub(crate) struct Draft {
    pub(crate) place: Place,
    pub(crate) name: String,
    pub(crate) family: String,
    pub(crate) protocol: String,
    pub(crate) title: String,
    pub(crate) source: String,
    pub(crate) axis: AxisKind,
    pub(crate) reply_timeout_ms: u32,
    pub(crate) caution: String,
    pub(crate) watchdog: DraftWatchdog,
    pub(crate) ram: Option<DraftRam>,
    pub(crate) reach: Vec<Named>,
    pub(crate) optional: Vec<Named>,
    pub(crate) identity: Option<DraftIdentity>,
    pub(crate) parameters: Vec<DraftParameter>,
    pub(crate) faults: Vec<DraftFault>,
    pub(crate) signals: Vec<DraftSignal>,
    pub(crate) plans: Vec<DraftPlan>,
}

#[derive(Clone, Debug)]
pub(crate) enum DraftWatchdog {
    None,
    Fixed(u32),
    Configurable { parameter: Named, on_can: Option<Named> },
    Heartbeat { consumer: Named, reaction: Named },
}

/// What tells the product: a parameter, or the protocol's own text.
#[derive(Clone, Debug)]
pub(crate) struct DraftIdentity {
    pub(crate) parameter: Option<Named>,
    pub(crate) text: String,
    pub(crate) mask: i64,
    pub(crate) equals: i64,
    pub(crate) firmware: i64,
}

/// What keeps writes in RAM: the parameter, the value for RAM, the value for flash.
#[derive(Clone, Debug)]
pub(crate) struct DraftRam {
    pub(crate) parameter: Named,
    pub(crate) ram: i64,
    pub(crate) flash: i64,
}

#[derive(Clone, Debug)]
pub(crate) struct DraftParameter {
    pub(crate) place: Place,
    pub(crate) name: String,
    pub(crate) symbol: String,
    pub(crate) about: String,
    pub(crate) space: u8,
    pub(crate) index: u16,
    pub(crate) encoding: Encoding,
    pub(crate) unit: Unit,
    pub(crate) factor: f64,
    pub(crate) times: Option<Named>,
    pub(crate) over: Option<Named>,
    pub(crate) min: i64,
    pub(crate) max: i64,
    pub(crate) default: Option<i64>,
    pub(crate) access: Access,
    pub(crate) persistence: Persistence,
    pub(crate) certainty: Certainty,
    pub(crate) moves: bool,
    pub(crate) section: String,
    pub(crate) values: Vec<(i64, String)>,
}

#[derive(Clone, Debug)]
pub(crate) struct DraftFault {
    pub(crate) place: Place,
    pub(crate) code: u32,
    pub(crate) name: String,
    pub(crate) text: String,
    pub(crate) cause: String,
    pub(crate) remedy: String,
    pub(crate) severity: Severity,
}

#[derive(Clone, Debug)]
pub(crate) struct DraftSignal {
    pub(crate) signal: Signal,
    pub(crate) parameter: Named,
    pub(crate) mask: i64,
    pub(crate) equals: Option<i64>,
    pub(crate) values: Vec<(i64, String)>,
}

#[derive(Clone, Debug)]
pub(crate) struct DraftPlan {
    pub(crate) place: Place,
    pub(crate) verb: Verb,
    pub(crate) source: String,
    pub(crate) steps: Vec<DraftStep>,
    pub(crate) undo: Vec<DraftStep>,
}

/// [`polepair_core::plan::Step`] with names for numbers.
#[derive(Clone, Debug)]
pub(crate) enum DraftStep {
    Write(Named, polepair_core::plan::Operand, Place),
    Ensure(Named, i64, Place),
    Read(Named),
    Copy { from: Named, to: Named },
    Require { read: Named, test: Test, hint: String },
    Skip { read: Named, test: Test, count: u8 },
    Without { read: Named, count: u8 },
    NoFault { read: Named, mask: i64 },
    Until { read: Named, test: Test, within_ms: u32 },
    Send { function: u8, index: u16, operand: polepair_core::plan::Operand, like: Option<Named> },
    Keep(Named),
    Wait { ms: u32 },
}

impl Draft {
    /// A draft that says what a finished profile says.
    pub(crate) fn of(profile: &Profile) -> Self {
        let place = Place::built_in(&format!("profile {}", profile.name));
        let names = Names { profile, place: &place };
        Self {
            name: profile.name.into(),
            family: profile.family.into(),
            protocol: profile.protocol.into(),
            title: profile.title.into(),
            source: profile.source.into(),
            axis: profile.axis,
            reply_timeout_ms: profile.reply_timeout_ms,
            caution: profile.caution.into(),
            watchdog: match profile.watchdog {
                Watchdog::None => DraftWatchdog::None,
                Watchdog::Fixed { after_ms } => DraftWatchdog::Fixed(after_ms),
                Watchdog::Configurable { parameter, on_can } => DraftWatchdog::Configurable {
                    parameter: names.of(parameter),
                    on_can: on_can.map(|id| names.of(id)),
                },
                Watchdog::Heartbeat { consumer, reaction } => DraftWatchdog::Heartbeat {
                    consumer: names.of(consumer),
                    reaction: names.of(reaction),
                },
            },
            identity: profile.identity.map(|identity| names.identity(&identity)),
            ram: profile.ram.map(|mode| {
                let parameter = names.of(mode.parameter);
                DraftRam { parameter, ram: mode.ram, flash: mode.flash }
            }),
            reach: profile.reach.iter().map(|id| names.of(*id)).collect(),
            optional: profile.optional.iter().map(|id| names.of(*id)).collect(),
            parameters: profile.parameters.iter().map(|p| names.parameter(p)).collect(),
            faults: profile.faults.iter().map(|f| names.fault(f)).collect(),
            signals: profile.signals.iter().map(|s| names.signal(s)).collect(),
            plans: profile.plans.iter().map(|p| names.plan(p)).collect(),
            place,
        }
    }
}

/// Turns the numbers of a finished profile back into names.
struct Names<'a> {
    profile: &'a Profile,
    place: &'a Place,
}

impl Names<'_> {
    fn of(&self, id: polepair_core::profile::ParameterId) -> Named {
        let name = self.profile.parameters.get(usize::from(id.0)).map_or("", |p| p.name);
        Found { value: name.into(), place: self.place.clone() }
    }

    fn identity(&self, identity: &Identity) -> DraftIdentity {
        let (parameter, text) = match identity.ask {
            Ask::Parameter(id) => (Some(self.of(id)), String::new()),
            Ask::Text(text) => (None, text.into()),
        };
        let Identity { mask, equals, firmware, .. } = *identity;
        DraftIdentity { parameter, text, mask, equals, firmware }
    }

    fn parameter(&self, p: &polepair_core::profile::Parameter) -> DraftParameter {
        let Scale { factor, times, over } = p.scale;
        DraftParameter {
            place: self.place.clone(),
            name: p.name.into(),
            symbol: p.symbol.into(),
            about: p.about.into(),
            space: p.space,
            index: p.index,
            encoding: p.encoding,
            unit: p.unit,
            factor,
            times: times.map(|id| self.of(id)),
            over: over.map(|id| self.of(id)),
            min: p.min,
            max: p.max,
            default: p.default,
            access: p.access,
            persistence: p.persistence,
            certainty: p.certainty,
            moves: p.moves,
            section: p.section.into(),
            values: p.values.iter().map(|&(raw, name)| (raw, name.into())).collect(),
        }
    }

    fn fault(&self, f: &polepair_core::profile::Fault) -> DraftFault {
        DraftFault {
            place: self.place.clone(),
            code: f.code,
            name: f.name.into(),
            text: f.text.into(),
            cause: f.cause.into(),
            remedy: f.remedy.into(),
            severity: f.severity,
        }
    }

    fn signal(&self, s: &polepair_core::profile::SignalSource) -> DraftSignal {
        let parameter = self.of(s.parameter);
        let values = s.values.iter().map(|&(raw, name)| (raw, name.into())).collect();
        DraftSignal { signal: s.signal, parameter, mask: s.mask, equals: s.equals, values }
    }

    fn plan(&self, plan: &polepair_core::plan::Plan) -> DraftPlan {
        DraftPlan {
            place: self.place.clone(),
            verb: plan.verb,
            source: plan.source.into(),
            steps: plan.steps.iter().map(|step| self.step(step)).collect(),
            undo: plan.undo.iter().map(|step| self.step(step)).collect(),
        }
    }

    fn step(&self, step: &polepair_core::plan::Step) -> DraftStep {
        use polepair_core::plan::Step;
        match *step {
            Step::Write(id, operand) => DraftStep::Write(self.of(id), operand, self.place.clone()),
            Step::Ensure(id, raw) => DraftStep::Ensure(self.of(id), raw, self.place.clone()),
            Step::Read(id) => DraftStep::Read(self.of(id)),
            Step::Copy { from, to } => DraftStep::Copy { from: self.of(from), to: self.of(to) },
            Step::Require { read, test, hint } => {
                DraftStep::Require { read: self.of(read), test, hint: hint.into() }
            }
            Step::Skip { read, test, count } => {
                DraftStep::Skip { read: self.of(read), test, count }
            }
            Step::Without { read, count } => DraftStep::Without { read: self.of(read), count },
            Step::NoFault { read, mask } => DraftStep::NoFault { read: self.of(read), mask },
            Step::Until { read, test, within_ms } => {
                DraftStep::Until { read: self.of(read), test, within_ms }
            }
            Step::Send { function, index, operand, like } => {
                let like = like.map(|id| self.of(id));
                DraftStep::Send { function, index, operand, like }
            }
            Step::Keep(id) => DraftStep::Keep(self.of(id)),
            Step::Wait { ms } => DraftStep::Wait { ms },
        }
    }
}
