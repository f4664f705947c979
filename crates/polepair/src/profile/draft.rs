//! A profile under construction: owned, with parameters by name.
//!
//! This makes `extends` simple: a base profile becomes a draft, the file's entries replace those with the
//! same name, and everything is checked once at the end.

use super::blocks::Fragment;
use super::plan_text::WrittenPlan;
use super::{bits, digits};
use crate::toml_file::{FileLocation, Located};
use polepair_core::axis::Verb;
use polepair_core::medium::SerialLine;
use polepair_core::plan::{Argument, Operand, ParameterTest};
use polepair_core::profile::{
    Access, AxisKind, Certainty, Encoding, Identity, IdentityQuery, ParameterId, Persistence,
    Profile, RelativeBase, Scale, ScaleRule, Severity, Signal, Watchdog,
};
use polepair_core::units::Unit;

/// Parameters, faults, or repetitions of one, that a profile may have at most.
pub(crate) const ENTRIES_MAX: usize = 4096;

/// A parameter by its name, and where the file names it.
pub(crate) type ParameterName = Located<String>;

#[derive(Clone, Debug)]
pub(crate) struct Draft {
    pub(crate) location: FileLocation,
    pub(crate) name: String,
    pub(crate) family: String,
    pub(crate) protocol: String,
    pub(crate) title: String,
    pub(crate) source: String,
    pub(crate) axis: AxisKind,
    pub(crate) motors: u8,
    /// The profiles of the motors behind the first one, where they are not at its places.
    pub(crate) further_motors: Vec<&'static Profile>,
    /// Each motor has places of its own.
    pub(crate) lists_motors: bool,
    pub(crate) reply_timeout_ms: u32,
    pub(crate) multiple_writes: bool,
    pub(crate) line: Option<SerialLine>,
    pub(crate) caution: String,
    pub(crate) watchdog: DraftWatchdog,
    pub(crate) ram: Option<DraftRam>,
    pub(crate) reach: Vec<ParameterName>,
    pub(crate) optional: Vec<ParameterName>,
    pub(crate) identity: Option<DraftIdentity>,
    pub(crate) parameters: Vec<DraftParameter>,
    pub(crate) faults: Vec<DraftFault>,
    pub(crate) signals: Vec<DraftSignal>,
    pub(crate) plans: Vec<DraftPlan>,
    /// The plans as they were written, for a profile that changes their fragments.
    pub(crate) plan_texts: Vec<WrittenPlan>,
    pub(crate) fragments: Vec<Fragment>,
    pub(crate) motion: DraftMotion,
}

/// Rules for judging the end of a motion: [`MotionRules`](polepair_core::profile::MotionRules) with names.
#[derive(Clone, Debug)]
pub(crate) struct DraftMotion {
    pub(crate) window: Option<ParameterName>,
    pub(crate) relative_from: RelativeBase,
    pub(crate) halted: Option<(ParameterName, ParameterTest)>,
    pub(crate) stalled: Option<(ParameterName, ParameterTest)>,
    pub(crate) unpowered: Option<(ParameterName, ParameterTest)>,
    pub(crate) coupling: Option<DraftCoupling>,
}

/// [`CouplingParameters`](polepair_core::profile::CouplingParameters) by name.
#[derive(Clone, Debug)]
pub(crate) struct DraftCoupling {
    pub(crate) follower: ParameterName,
    pub(crate) master_position: ParameterName,
    pub(crate) ratio: ParameterName,
    pub(crate) numerator: ParameterName,
    pub(crate) denominator: ParameterName,
    pub(crate) cam: ParameterName,
}

impl DraftMotion {
    /// Rules of a drive without such parameters.
    pub(crate) const fn new() -> Self {
        Self {
            window: None,
            relative_from: RelativeBase::Either,
            halted: None,
            stalled: None,
            unpowered: None,
            coupling: None,
        }
    }
}

#[derive(Clone, Debug)]
pub(crate) enum DraftWatchdog {
    None,
    Fixed(u32),
    Configurable {
        parameter: ParameterName,
        on_can: Option<ParameterName>,
    },
    Heartbeat {
        consumer: ParameterName,
        reaction: Option<ParameterName>,
        life_guarding: Option<[ParameterName; 2]>,
    },
    LifeGuarding {
        objects: [ParameterName; 2],
        reaction: Option<ParameterName>,
    },
}

/// Identification of the product: a parameter, or a text request.
#[derive(Clone, Debug)]
pub(crate) struct DraftIdentity {
    pub(crate) parameter: Option<ParameterName>,
    pub(crate) text: String,
    pub(crate) mask: i64,
    pub(crate) equals: i64,
    pub(crate) firmware: i64,
}

/// Switch that keeps writes in RAM: the parameter, the value for RAM, the value for flash.
#[derive(Clone, Debug)]
pub(crate) struct DraftRam {
    pub(crate) parameter: ParameterName,
    pub(crate) ram: i64,
    pub(crate) flash: i64,
}

#[derive(Clone, Debug)]
pub(crate) struct DraftParameter {
    pub(crate) location: FileLocation,
    pub(crate) name: String,
    pub(crate) symbol: String,
    pub(crate) about: String,
    pub(crate) space: u8,
    pub(crate) index: u16,
    pub(crate) encoding: Encoding,
    pub(crate) unit: Unit,
    pub(crate) factor: f64,
    pub(crate) times: Option<ParameterName>,
    pub(crate) over: Option<ParameterName>,
    pub(crate) rule: Option<&'static ScaleRule>,
    pub(crate) negative: Option<(ParameterName, ParameterTest)>,
    pub(crate) min: i64,
    pub(crate) max: i64,
    pub(crate) default: Option<i64>,
    pub(crate) access: Access,
    pub(crate) persistence: Persistence,
    pub(crate) certainty: Certainty,
    pub(crate) moves: bool,
    pub(crate) section: String,
    pub(crate) values: Vec<(i64, String)>,
    pub(crate) digits: Vec<DraftDigits>,
    pub(crate) bits: Vec<DraftBits>,
}

/// A pattern of bits with a name of its own.
#[derive(Clone, Debug)]
pub(crate) struct DraftBits {
    pub(crate) mask: i64,
    pub(crate) value: i64,
    pub(crate) name: String,
}

/// Digits of a value with a meaning of their own.
#[derive(Clone, Debug)]
pub(crate) struct DraftDigits {
    pub(crate) name: String,
    pub(crate) places: u32,
    pub(crate) max: i64,
    pub(crate) values: Vec<(i64, String)>,
}

#[derive(Clone, Debug)]
pub(crate) struct DraftFault {
    pub(crate) location: FileLocation,
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
    pub(crate) parameter: ParameterName,
    pub(crate) mask: i64,
    pub(crate) equals: Option<i64>,
    pub(crate) values: Vec<(i64, String)>,
}

#[derive(Clone, Debug)]
pub(crate) struct DraftPlan {
    pub(crate) location: FileLocation,
    pub(crate) verb: Verb,
    pub(crate) source: String,
    pub(crate) steps: Vec<DraftStep>,
    pub(crate) undo: Vec<DraftStep>,
}

/// [`polepair_core::plan::Step`] with names for numbers.
#[derive(Clone, Debug)]
pub(crate) enum DraftStep {
    Write(ParameterName, polepair_core::plan::Operand, FileLocation),
    Ensure(ParameterName, i64, FileLocation),
    /// Each with its value and the place of that.
    WriteTogether(Vec<(ParameterName, Operand, FileLocation)>),
    WriteBits {
        name: ParameterName,
        mask: i64,
        raw: i64,
    },
    SkipBySign {
        argument: Argument,
        if_negative: bool,
        count: u8,
    },
    Read(ParameterName),
    Copy {
        from: ParameterName,
        to: ParameterName,
    },
    Require {
        read: ParameterName,
        test: ParameterTest,
        hint: String,
    },
    Skip {
        read: ParameterName,
        test: ParameterTest,
        count: u8,
    },
    Without {
        read: ParameterName,
        count: u8,
    },
    NoFault {
        read: ParameterName,
        mask: i64,
    },
    Until {
        read: ParameterName,
        test: ParameterTest,
        within_ms: u32,
        required: bool,
    },
    Send {
        function: u8,
        index: u16,
        operand: polepair_core::plan::Operand,
        like: Option<ParameterName>,
    },
    Keep(ParameterName),
    Wait {
        ms: u32,
    },
    Standstill {
        within_ms: u32,
    },
    Homed {
        read: ParameterName,
        test: ParameterTest,
        within_ms: u32,
    },
    Arrival {
        flag: Option<(ParameterName, ParameterTest)>,
        within_ms: u32,
    },
}

impl Draft {
    /// A draft with the content of a profile.
    pub(crate) fn from_profile(profile: &Profile) -> Self {
        let location = FileLocation::built_in(&format!("profile {}", profile.name));
        let names = NameLookup { profile, location: &location };
        Self {
            name: profile.name.into(),
            family: profile.family.into(),
            protocol: profile.protocol.into(),
            title: profile.title.into(),
            source: profile.source.into(),
            axis: profile.axis,
            motors: profile.motors,
            further_motors: Vec::new(),
            lists_motors: false,
            reply_timeout_ms: profile.reply_timeout_ms,
            multiple_writes: profile.multiple_writes,
            line: profile.line,
            caution: profile.caution.into(),
            watchdog: match profile.watchdog {
                Watchdog::None => DraftWatchdog::None,
                Watchdog::Fixed { after_ms } => DraftWatchdog::Fixed(after_ms),
                Watchdog::Configurable { parameter, on_can } => DraftWatchdog::Configurable {
                    parameter: names.name_of(parameter),
                    on_can: on_can.map(|id| names.name_of(id)),
                },
                Watchdog::LifeGuarding { objects, reaction } => DraftWatchdog::LifeGuarding {
                    objects: objects.map(|id| names.name_of(id)),
                    reaction: reaction.map(|id| names.name_of(id)),
                },
                Watchdog::Heartbeat { consumer, reaction, life_guarding } => {
                    DraftWatchdog::Heartbeat {
                        consumer: names.name_of(consumer),
                        reaction: reaction.map(|id| names.name_of(id)),
                        life_guarding: life_guarding.map(|ids| ids.map(|id| names.name_of(id))),
                    }
                }
            },
            identity: profile.identity.map(|identity| names.identity(&identity)),
            ram: profile.ram.map(|mode| {
                let parameter = names.name_of(mode.parameter);
                DraftRam { parameter, ram: mode.ram, flash: mode.flash }
            }),
            reach: profile.link_settings.iter().map(|id| names.name_of(*id)).collect(),
            optional: profile.optional.iter().map(|id| names.name_of(*id)).collect(),
            parameters: profile.parameters.iter().map(|p| names.parameter(p)).collect(),
            faults: profile.faults.iter().map(|f| names.fault(f)).collect(),
            signals: profile.signals.iter().map(|s| names.signal(s)).collect(),
            plans: profile.plans.iter().map(|p| names.plan(p)).collect(),
            plan_texts: Vec::new(),
            fragments: Vec::new(),
            motion: DraftMotion {
                window: profile.motion.window.map(|id| names.name_of(id)),
                relative_from: profile.motion.relative_from,
                halted: profile.motion.halted.map(|(id, test)| (names.name_of(id), test)),
                stalled: profile.motion.stalled.map(|(id, test)| (names.name_of(id), test)),
                unpowered: profile.motion.unpowered.map(|(id, test)| (names.name_of(id), test)),
                coupling: profile.motion.coupling.map(|it| DraftCoupling {
                    follower: names.name_of(it.follower),
                    master_position: names.name_of(it.master_position),
                    ratio: names.name_of(it.ratio),
                    numerator: names.name_of(it.numerator),
                    denominator: names.name_of(it.denominator),
                    cam: names.name_of(it.cam),
                }),
            },
            location,
        }
    }
}

/// Turns the numbers of a finished profile back into names.
struct NameLookup<'a> {
    profile: &'a Profile,
    location: &'a FileLocation,
}

impl NameLookup<'_> {
    fn name_of(&self, id: polepair_core::profile::ParameterId) -> ParameterName {
        let name = self.profile.parameters.get(usize::from(id.0)).map_or("", |p| p.name);
        Located { value: name.into(), location: self.location.clone() }
    }

    fn identity(&self, identity: &Identity) -> DraftIdentity {
        let (parameter, text) = match identity.query {
            IdentityQuery::Parameter(id) => (Some(self.name_of(id)), String::new()),
            IdentityQuery::Text(text) => (None, text.into()),
        };
        let Identity { mask, equals, firmware, .. } = *identity;
        DraftIdentity { parameter, text, mask, equals, firmware }
    }

    fn parameter(&self, p: &polepair_core::profile::Parameter) -> DraftParameter {
        let Scale { factor, times, over, rule, negative } = p.scale;
        DraftParameter {
            location: self.location.clone(),
            name: p.name.into(),
            symbol: p.symbol.into(),
            about: p.about.into(),
            space: p.space,
            index: p.index,
            encoding: p.encoding,
            unit: p.unit,
            factor,
            times: times.map(|id| self.name_of(id)),
            over: over.map(|id| self.name_of(id)),
            rule,
            negative: negative.map(|(id, test)| (self.name_of(id), test)),
            min: p.min,
            max: p.max,
            default: p.default,
            access: p.access,
            persistence: p.persistence,
            certainty: p.certainty,
            moves: p.moves,
            section: p.section.into(),
            values: own_words(p.values),
            digits: p.digits.iter().map(digits::copy).collect(),
            bits: p.bits.iter().map(bits::copy).collect(),
        }
    }

    fn fault(&self, f: &polepair_core::profile::Fault) -> DraftFault {
        DraftFault {
            location: self.location.clone(),
            code: f.code,
            name: f.name.into(),
            text: f.text.into(),
            cause: f.cause.into(),
            remedy: f.remedy.into(),
            severity: f.severity,
        }
    }

    fn signal(&self, s: &polepair_core::profile::SignalSource) -> DraftSignal {
        let parameter = self.name_of(s.parameter);
        let values = own_words(s.values);
        DraftSignal { signal: s.signal, parameter, mask: s.mask, equals: s.equals, values }
    }

    fn plan(&self, plan: &polepair_core::plan::Plan) -> DraftPlan {
        DraftPlan {
            location: self.location.clone(),
            verb: plan.verb,
            source: plan.source.into(),
            steps: plan.steps.iter().map(|step| self.step(step)).collect(),
            undo: plan.undo.iter().map(|step| self.step(step)).collect(),
        }
    }

    fn step(&self, step: &polepair_core::plan::Step) -> DraftStep {
        use polepair_core::plan::Step;
        match *step {
            Step::Write(id, operand) => {
                DraftStep::Write(self.name_of(id), operand, self.location.clone())
            }
            Step::Ensure(id, raw) => {
                DraftStep::Ensure(self.name_of(id), raw, self.location.clone())
            }
            Step::WriteTogether(writes) => {
                let one = |&(id, operand): &(ParameterId, Operand)| {
                    (self.name_of(id), operand, self.location.clone())
                };
                DraftStep::WriteTogether(writes.iter().map(one).collect())
            }
            Step::WriteBits { id, mask, raw } => {
                DraftStep::WriteBits { name: self.name_of(id), mask, raw }
            }
            Step::SkipBySign { argument, if_negative, count } => {
                DraftStep::SkipBySign { argument, if_negative, count }
            }
            Step::Read(id) => DraftStep::Read(self.name_of(id)),
            Step::Copy { from, to } => {
                DraftStep::Copy { from: self.name_of(from), to: self.name_of(to) }
            }
            Step::Require { read, test, hint } => {
                DraftStep::Require { read: self.name_of(read), test, hint: hint.into() }
            }
            Step::Skip { read, test, count } => {
                DraftStep::Skip { read: self.name_of(read), test, count }
            }
            Step::SkipIfMissing { read, count } => {
                DraftStep::Without { read: self.name_of(read), count }
            }
            Step::NoFault { read, mask } => DraftStep::NoFault { read: self.name_of(read), mask },
            Step::Until { read, test, within_ms, required } => {
                DraftStep::Until { read: self.name_of(read), test, within_ms, required }
            }
            Step::Send { function, index, operand, like } => {
                let like = like.map(|id| self.name_of(id));
                DraftStep::Send { function, index, operand, like }
            }
            Step::Store(id) => DraftStep::Keep(self.name_of(id)),
            Step::Wait { ms } => DraftStep::Wait { ms },
            Step::Standstill { within_ms } => DraftStep::Standstill { within_ms },
            Step::Homed { read, test, within_ms } => {
                DraftStep::Homed { read: self.name_of(read), test, within_ms }
            }
            Step::Arrival { flag, within_ms } => {
                let flag = flag.map(|(id, test)| (self.name_of(id), test));
                DraftStep::Arrival { flag, within_ms }
            }
        }
    }
}

pub(super) fn own_words(values: &[(i64, &str)]) -> Vec<(i64, String)> {
    values.iter().map(|&(raw, name)| (raw, name.into())).collect()
}
