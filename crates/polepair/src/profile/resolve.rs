//! Converts a draft to a profile: replaces names by ids, and checks everything.

use super::draft::{
    Draft, DraftCoupling, DraftFault, DraftIdentity, DraftMotion, DraftParameter, DraftPlan,
    DraftRam, DraftSignal, DraftStep, DraftWatchdog, ParameterName,
};
use super::read::MEMORY_PROTOCOL;
use super::step;
use super::stops::with_stop;
use super::{bits, digits};
use crate::spelling::{fold, suggestion};
use crate::toml_file::{FileError, FileLocation};
use polepair_core::axis::Verb;
use polepair_core::plan::{Argument, Compare, Operand, ParameterTest, Plan, STEPS_MAX, Step};
use polepair_core::profile::{
    Access, CouplingParameters, Encoding, Fault, Identity, IdentityQuery, MotionRules, Parameter,
    ParameterId, Profile, RamMode, Scale, Signal, SignalSource, Watchdog,
};
use std::collections::HashMap;

/// Longest wait for an arrival whose plan states none.
const ARRIVAL_MAX_MS: u32 = 600_000;

/// Checks the draft and makes a static profile of it.
pub(crate) fn resolve_profile(draft: &Draft) -> Result<&'static Profile, FileError> {
    let draft = &with_stop(sort_memory(draft));
    let names = NameResolver::number_parameters(draft)?;
    draft.parameters.iter().try_for_each(check_parameter)?;
    check_faults(&draft.faults)?;
    let parameters = draft.parameters.iter().map(|p| names.parameter(p));
    let signals = draft.signals.iter().map(|s| names.signal(s));
    let mut plans: Vec<&DraftPlan> = draft.plans.iter().collect();
    // In the order of the verbs, so that the same profile gives the same bytes whatever its file's order.
    plans.sort_by_key(|plan| plan.verb);
    let plans = plans.into_iter().map(|plan| names.plan(plan));
    let mut signals = signals.collect::<Result<Vec<_>, _>>()?;
    signals.sort_by_key(|source| source.signal);
    // A profile lives as long as the program: axes of all threads refer to it.
    Ok(Box::leak(Box::new(Profile {
        name: leak_text(&draft.name),
        family: leak_text(&draft.family),
        protocol: leak_text(&draft.protocol),
        title: leak_text(&draft.title),
        source: leak_text(&draft.source),
        axis: draft.axis,
        motors: draft.motors,
        further_motors: draft.further_motors.clone().leak(),
        lists_motors: draft.lists_motors,
        parameters: parameters.collect::<Result<Vec<_>, _>>()?.leak(),
        faults: draft.faults.iter().map(resolve_fault).collect::<Vec<_>>().leak(),
        signals: signals.leak(),
        plans: plans.collect::<Result<Vec<_>, _>>()?.leak(),
        motion: names.motion(&draft.motion)?,
        ram: draft.ram.as_ref().map(|ram| names.ram(ram)).transpose()?,
        link_settings: names.reach(&draft.reach)?.leak(),
        optional: names.optional(&draft.optional)?.leak(),
        identity: draft.identity.as_ref().map(|it| names.identity(it)).transpose()?,
        watchdog: names.watchdog(&draft.watchdog)?,
        reply_timeout_ms: draft.reply_timeout_ms,
        multiple_writes: draft.multiple_writes,
        line: draft.line,
        caution: leak_text(&draft.caution),
    })))
}

/// Sorts a memory by address, the described name first among equal addresses, so a name is found by binary
/// search.
fn sort_memory(draft: &Draft) -> Draft {
    let mut draft = draft.clone();
    if draft.protocol == MEMORY_PROTOCOL {
        draft.parameters.sort_by_key(|p| (p.space, p.index, p.about.is_empty()));
    }
    draft
}

fn leak_text(text: &str) -> &'static str {
    if text.is_empty() { "" } else { text.to_owned().leak() }
}

fn resolve_fault(f: &DraftFault) -> Fault {
    Fault {
        code: f.code,
        name: leak_text(&f.name),
        text: leak_text(&f.text),
        cause: leak_text(&f.cause),
        remedy: leak_text(&f.remedy),
        severity: f.severity,
    }
}

fn check_faults(faults: &[DraftFault]) -> Result<(), FileError> {
    for (at, fault) in faults.iter().enumerate() {
        if faults[..at].iter().any(|other| other.code == fault.code) {
            let reason = format!("a second fault of code {:#x}: `{}`", fault.code, fault.name);
            return Err(fault.location.error(reason));
        }
    }
    Ok(())
}

fn check_parameter(p: &DraftParameter) -> Result<(), FileError> {
    let (min_value, max_value) = p.encoding.raw_range();
    let name = &p.name;
    let is_number = p.encoding.is_number();
    if is_number && p.encoding.number(p.min) > p.encoding.number(p.max) {
        let reason = format!("`{name}`: min {} is greater than max {}", p.min, p.max);
        return Err(p.location.error(reason));
    }
    if !fits_range(p.min, min_value, max_value, &p.encoding)
        || !fits_range(p.max, min_value, max_value, &p.encoding)
    {
        let reason = format!("`{name}`: {} to {} does not fit its encoding", p.min, p.max);
        return Err(p.location.error(reason));
    }
    let written = p.access != Access::Read;
    if let Some(default) = p.default.filter(|d| written && !p.encoding.is_between(*d, p.min, p.max))
    {
        let reason = format!("`{name}`: default {default} is not within {} to {}", p.min, p.max);
        return Err(p.location.error(reason));
    }
    if let Some((raw, word)) =
        p.values.iter().find(|(raw, _)| !fits_range(*raw, min_value, max_value, &p.encoding))
    {
        let reason = format!("`{name}`: value {raw} (`{word}`) does not fit its encoding");
        return Err(p.location.error(reason));
    }
    Ok(())
}

fn fits_range(raw: i64, min_value: i64, max_value: i64, p_encoding: &Encoding) -> bool {
    p_encoding.is_between(raw, min_value, max_value)
}

/// Access that a step or a signal needs.
#[derive(Clone, Copy, PartialEq, Eq)]
enum RequiredAccess {
    Read,
    Write,
}

struct NameResolver<'a> {
    draft: &'a Draft,
    ids: HashMap<String, u16>,
}

impl<'a> NameResolver<'a> {
    /// Numbers the parameters; two may share neither name, nor symbol, nor, but in a memory, place on
    /// the wire.
    fn number_parameters(draft: &'a Draft) -> Result<Self, FileError> {
        let mut ids = HashMap::new();
        let mut wires = HashMap::new();
        for (at, p) in draft.parameters.iter().enumerate() {
            let id = u16::try_from(at).map_err(|_| p.location.error("too many parameters"))?;
            // One register under two names would have two limits. Memory is excepted: bits and words overlap there. So
            // are words of requests, whose meaning depends on where the request begins.
            let other = wires.insert((p.space, p.index), p);
            let are_words = |other: &DraftParameter| [p.access, other.access] == [Access::Write; 2];
            let other =
                other.filter(|other| draft.protocol != MEMORY_PROTOCOL && !are_words(other));
            if let Some(DraftParameter { name: other, .. }) = other {
                let reason = format!("`{}` has the space and index of `{other}`", p.name);
                return Err(p.location.error(reason));
            }
            let mut labels = vec![fold(&p.name), fold(&p.symbol)];
            labels.dedup();
            for label in labels.into_iter().filter(|label| !label.is_empty()) {
                if let Some(other) = ids.insert(label, id) {
                    let other = &draft.parameters[usize::from(other)].name;
                    let reason = format!("`{}` ({}) is called as `{other}` is", p.name, p.symbol);
                    return Err(p.location.error(reason));
                }
            }
        }
        Ok(Self { draft, ids })
    }

    fn id(&self, name: &ParameterName) -> Result<ParameterId, FileError> {
        let known = self.ids.get(&fold(&name.value));
        known.copied().map(ParameterId).ok_or_else(|| {
            let names = self.draft.parameters.iter().map(|p| p.name.as_str());
            let hint = suggestion(&name.value, names);
            name.location.error(format!("no parameter is called `{}`{hint}", name.value))
        })
    }

    fn draft_parameter(&self, id: ParameterId) -> &DraftParameter {
        &self.draft.parameters[usize::from(id.0)]
    }

    fn resolve_use(
        &self,
        name: &ParameterName,
        uses: &[RequiredAccess],
    ) -> Result<ParameterId, FileError> {
        let id = self.id(name)?;
        let access = self.draft_parameter(id).access;
        // Found when the file is read, not when the motor is to stop.
        if uses.contains(&RequiredAccess::Write) && access == Access::Read {
            return Err(name.location.error(format!("`{}` can only be read", name.value)));
        }
        if uses.contains(&RequiredAccess::Read) && access == Access::Write {
            return Err(name.location.error(format!("`{}` can only be written", name.value)));
        }
        Ok(id)
    }

    fn parameter(&self, p: &DraftParameter) -> Result<Parameter, FileError> {
        let (times, over) = (self.resolve_reference(&p.times)?, self.resolve_reference(&p.over)?);
        let negative = match &p.negative {
            None => None,
            Some((name, _)) if p.access != Access::Read || p.encoding.is_signed() => {
                let why = "`negative` is for a magnitude that can only be read";
                return Err(name.location.error(why));
            }
            Some((name, test)) => Some((self.resolve_use(name, &[RequiredAccess::Read])?, *test)),
        };
        let scale = Scale { factor: p.factor, times, over, rule: p.rule, negative };
        Ok(Parameter {
            name: leak_text(&p.name),
            symbol: leak_text(&p.symbol),
            about: leak_text(&p.about),
            space: p.space,
            index: p.index,
            encoding: p.encoding,
            unit: p.unit,
            scale,
            min: p.min,
            max: p.max,
            default: p.default,
            access: p.access,
            persistence: p.persistence,
            certainty: p.certainty,
            moves: p.moves,
            section: leak_text(&p.section),
            values: leak_words(&p.values),
            digits: digits::leak(&p.digits),
            bits: bits::leak(&p.bits),
        })
    }

    fn resolve_reference(
        &self,
        name: &Option<ParameterName>,
    ) -> Result<Option<ParameterId>, FileError> {
        name.as_ref().map(|name| self.resolve_use(name, &[RequiredAccess::Read])).transpose()
    }

    fn signal(&self, s: &DraftSignal) -> Result<SignalSource, FileError> {
        let parameter = self.resolve_use(&s.parameter, &[RequiredAccess::Read])?;
        if s.equals.is_some_and(|value| value & !s.mask != 0) {
            return Err(s.parameter.location.error("`equals` has bits that `mask` takes away"));
        }
        if let Some((raw, word)) = s.values.iter().find(|(raw, _)| raw & !s.mask != 0) {
            let what = format!("`{word}` names {raw:#x}, which has bits that `mask` takes away");
            return Err(s.parameter.location.error(what));
        }
        let (mask, equals, values) = (s.mask, s.equals, leak_words(&s.values));
        Ok(SignalSource { signal: s.signal, parameter, mask, equals, values })
    }

    fn identity(&self, identity: &DraftIdentity) -> Result<Identity, FileError> {
        let identity_query = match &identity.parameter {
            Some(name) => {
                IdentityQuery::Parameter(self.resolve_use(name, &[RequiredAccess::Read])?)
            }
            None => IdentityQuery::Text(leak_text(&identity.text)),
        };
        let DraftIdentity { mask, equals, firmware, .. } = *identity;
        Ok(Identity { query: identity_query, mask, equals, firmware })
    }

    fn ram(&self, mode: &DraftRam) -> Result<RamMode, FileError> {
        let parameter =
            self.resolve_use(&mode.parameter, &[RequiredAccess::Read, RequiredAccess::Write])?;
        self.check_range(parameter, mode.ram, &mode.parameter.location)?;
        self.check_range(parameter, mode.flash, &mode.parameter.location)?;
        Ok(RamMode { parameter, ram: mode.ram, flash: mode.flash })
    }

    fn reach(&self, reach: &[ParameterName]) -> Result<Vec<ParameterId>, FileError> {
        reach.iter().map(|name| self.resolve_use(name, &[RequiredAccess::Write])).collect()
    }

    fn optional(&self, optional: &[ParameterName]) -> Result<Vec<ParameterId>, FileError> {
        optional.iter().map(|name| self.id(name)).collect()
    }

    fn watchdog(&self, watchdog: &DraftWatchdog) -> Result<Watchdog, FileError> {
        Ok(match watchdog {
            DraftWatchdog::None => Watchdog::None,
            DraftWatchdog::Fixed(after_ms) => Watchdog::Fixed { after_ms: *after_ms },
            DraftWatchdog::Configurable { parameter, on_can } => Watchdog::Configurable {
                parameter: self.resolve_use(parameter, &[RequiredAccess::Write])?,
                on_can: on_can
                    .as_ref()
                    .map(|name| self.resolve_use(name, &[RequiredAccess::Write]))
                    .transpose()?,
            },
            DraftWatchdog::Heartbeat { consumer, reaction, life_guarding } => Watchdog::Heartbeat {
                consumer: self
                    .resolve_use(consumer, &[RequiredAccess::Read, RequiredAccess::Write])?,
                reaction: self.watchdog_reaction(reaction.as_ref())?,
                life_guarding: match life_guarding {
                    Some(objects) => Some(self.life_guarding(objects)?),
                    None => None,
                },
            },
            DraftWatchdog::LifeGuarding { objects, reaction } => Watchdog::LifeGuarding {
                objects: self.life_guarding(objects)?,
                reaction: self.watchdog_reaction(reaction.as_ref())?,
            },
        })
    }

    fn watchdog_reaction(
        &self,
        reaction: Option<&ParameterName>,
    ) -> Result<Option<ParameterId>, FileError> {
        let uses = [RequiredAccess::Read, RequiredAccess::Write];
        reaction.map(|name| self.resolve_use(name, &uses)).transpose()
    }

    fn life_guarding(&self, objects: &[ParameterName; 2]) -> Result<[ParameterId; 2], FileError> {
        let [period, factor] = objects;
        Ok([
            self.resolve_use(period, &[RequiredAccess::Read])?,
            self.resolve_use(factor, &[RequiredAccess::Read])?,
        ])
    }

    fn plan(&self, plan: &DraftPlan) -> Result<Plan, FileError> {
        if plan.steps.len() + plan.undo.len() > STEPS_MAX {
            let reason = format!("`{}` has more than {STEPS_MAX} steps", plan.verb.name());
            return Err(plan.location.error(reason));
        }
        for step in plan.steps.iter().chain(&plan.undo) {
            let arguments: Vec<Argument> = match step {
                DraftStep::Write(_, operand, _) | DraftStep::Send { operand, .. } => {
                    operand.argument().into_iter().collect()
                }
                DraftStep::WriteTogether(writes) => {
                    writes.iter().filter_map(|(_, operand, _)| operand.argument()).collect()
                }
                DraftStep::SkipBySign { argument, .. } => vec![*argument],
                _ => Vec::new(),
            };
            let foreign = arguments.into_iter().find(|argument| !plan.verb.accepts(*argument));
            if let Some(argument) = foreign {
                let (verb, word) = (plan.verb.name(), step::argument_word(argument));
                return Err(plan.location.error(format!("`{verb}` is never given a `{{{word}}}`")));
            }
        }
        debug_assert!(
            plan.steps.len() + plan.undo.len() <= 64,
            "an outcome has a bit for each step"
        );
        let steps = |drafts: &[DraftStep]| -> Result<&'static [Step], FileError> {
            Ok(drafts.iter().map(|step| self.step(step)).collect::<Result<Vec<_>, _>>()?.leak())
        };
        let (steps, undo) = match plan.verb {
            Verb::Reached => (steps(&judged_arrival(&plan.steps))?, steps(&plan.undo)?),
            verb if verb.is_stop() => {
                (steps(&judged_standstill(&plan.steps, self.draft))?, steps(&plan.undo)?)
            }
            _ => (steps(&plan.steps)?, steps(&plan.undo)?),
        };
        Ok(Plan { verb: plan.verb, source: leak_text(&plan.source), steps, undo })
    }

    fn step(&self, step: &DraftStep) -> Result<Step, FileError> {
        let both = [RequiredAccess::Read, RequiredAccess::Write];
        Ok(match step {
            DraftStep::Write(name, operand, location) => {
                let id = self.resolve_use(name, &[RequiredAccess::Write])?;
                if let Operand::Constant(raw) = operand {
                    self.check_range(id, *raw, location)?;
                }
                Step::Write(id, *operand)
            }
            DraftStep::WriteTogether(writes) => {
                let one = |(name, operand, location): &(ParameterName, Operand, FileLocation)| {
                    let id = self.resolve_use(name, &[RequiredAccess::Write])?;
                    if let Operand::Constant(raw) = operand {
                        self.check_range(id, *raw, location)?;
                    }
                    Ok((id, *operand))
                };
                let resolved = writes.iter().map(one).collect::<Result<Vec<_>, FileError>>()?;
                self.check_neighbours(writes, &resolved)?;
                Step::WriteTogether(resolved.leak())
            }
            DraftStep::Ensure(name, raw, location) => {
                let id = self.resolve_use(name, &both)?;
                self.check_range(id, *raw, location)?;
                Step::Ensure(id, *raw)
            }
            DraftStep::WriteBits { name, mask, raw } => {
                Step::WriteBits { id: self.resolve_use(name, &both)?, mask: *mask, raw: *raw }
            }
            DraftStep::SkipBySign { argument, if_negative, count } => {
                Step::SkipBySign { argument: *argument, if_negative: *if_negative, count: *count }
            }
            DraftStep::Read(name) => Step::Read(self.resolve_use(name, &[RequiredAccess::Read])?),
            DraftStep::Copy { from, to } => {
                let from = self.resolve_use(from, &[RequiredAccess::Read])?;
                Step::Copy { from, to: self.resolve_use(to, &[RequiredAccess::Write])? }
            }
            DraftStep::Require { read, test, hint } => {
                let id = self.resolve_test(read, test)?;
                Step::Require { read: id, test: *test, hint: leak_text(hint) }
            }
            DraftStep::Skip { read, test, count } => {
                let id = self.resolve_test(read, test)?;
                Step::Skip { read: id, test: *test, count: *count }
            }
            DraftStep::Without { read, count } => Step::SkipIfMissing {
                read: self.resolve_use(read, &[RequiredAccess::Read])?,
                count: *count,
            },
            DraftStep::NoFault { read, mask } => Step::NoFault {
                read: self.resolve_use(read, &[RequiredAccess::Read])?,
                mask: *mask,
            },
            DraftStep::Until { read, test, within_ms, required } => {
                let id = self.resolve_test(read, test)?;
                Step::Until { read: id, test: *test, within_ms: *within_ms, required: *required }
            }
            DraftStep::Send { function, index, operand, like } => {
                let like = like.as_ref().map(|name| self.id(name)).transpose()?;
                Step::Send { function: *function, index: *index, operand: *operand, like }
            }
            DraftStep::Keep(name) => Step::Store(self.id(name)?),
            DraftStep::Wait { ms } => Step::Wait { ms: *ms },
            DraftStep::Standstill { within_ms } => Step::Standstill { within_ms: *within_ms },
            DraftStep::Homed { read, test, within_ms } => {
                let id = self.resolve_test(read, test)?;
                Step::Homed { read: id, test: *test, within_ms: *within_ms }
            }
            DraftStep::Arrival { flag, within_ms } => {
                Step::Arrival { flag: self.condition(flag)?, within_ms: *within_ms }
            }
        })
    }

    /// Refuses to write registers with one request that do not follow each other.
    fn check_neighbours(
        &self,
        writes: &[(ParameterName, Operand, FileLocation)],
        resolved: &[(ParameterId, Operand)],
    ) -> Result<(), FileError> {
        let mut next = None;
        for ((name, ..), (id, _)) in writes.iter().zip(resolved) {
            let p = self.draft_parameter(*id);
            let is_next = next.is_none_or(|next| u32::from(p.index) == next);
            if self.draft.protocol != "modbus" || p.space != 0 || !is_next {
                let reason = format!(
                    "`{}` is not the next holding register: only neighbours are written together",
                    p.name
                );
                return Err(name.location.error(reason));
            }
            next = Some(u32::from(p.index) + u32::from(p.encoding.size()).div_ceil(2));
        }
        Ok(())
    }

    fn condition(
        &self,
        condition: &Option<(ParameterName, ParameterTest)>,
    ) -> Result<Option<(ParameterId, ParameterTest)>, FileError> {
        condition
            .as_ref()
            .map(|(name, test)| self.resolve_test(name, test).map(|id| (id, *test)))
            .transpose()
    }

    fn motion(&self, motion: &DraftMotion) -> Result<MotionRules, FileError> {
        let window = motion.window.as_ref();
        Ok(MotionRules {
            window: window
                .map(|name| self.resolve_use(name, &[RequiredAccess::Read]))
                .transpose()?,
            relative_from: motion.relative_from,
            halted: self.condition(&motion.halted)?,
            stalled: self.condition(&motion.stalled)?,
            unpowered: self.condition(&motion.unpowered)?,
            coupling: motion.coupling.as_ref().map(|it| self.coupling(it)).transpose()?,
        })
    }

    fn coupling(&self, coupling: &DraftCoupling) -> Result<CouplingParameters, FileError> {
        let (read, write) = ([RequiredAccess::Read], [RequiredAccess::Write]);
        Ok(CouplingParameters {
            follower: self.resolve_use(&coupling.follower, &write)?,
            master_position: self.resolve_use(&coupling.master_position, &read)?,
            ratio: self.resolve_use(&coupling.ratio, &write)?,
            numerator: self.resolve_use(&coupling.numerator, &write)?,
            denominator: self.resolve_use(&coupling.denominator, &write)?,
            cam: self.resolve_use(&coupling.cam, &write)?,
        })
    }

    fn check_range(
        &self,
        id: ParameterId,
        raw: i64,
        location: &FileLocation,
    ) -> Result<(), FileError> {
        let p = self.draft_parameter(id);
        if (p.min..=p.max).contains(&raw) {
            return Ok(());
        }
        Err(location.error(format!("{raw} is not within {} to {} of `{}`", p.min, p.max, p.name)))
    }

    /// A test that no value can pass is a mistake in the file.
    fn resolve_test(
        &self,
        name: &ParameterName,
        test: &ParameterTest,
    ) -> Result<ParameterId, FileError> {
        let id = self.resolve_use(name, &[RequiredAccess::Read])?;
        let never = match test.compare {
            Compare::Equal => test.value & !test.mask != 0,
            Compare::NotEqual | Compare::Above => false,
            Compare::Within => test.value < 0,
            Compare::Among => test.value == 0,
        };
        if never {
            let reason = format!("nothing that is masked so can be {:#x}", test.value);
            return Err(name.location.error(reason));
        }
        Ok(id)
    }
}

/// Steps of a plan that waits for the arrival: its condition gives the time of the check, and the position decides.
fn judged_arrival(steps: &[DraftStep]) -> Vec<DraftStep> {
    let mut steps: Vec<DraftStep> = steps
        .iter()
        .map(|step| match step {
            DraftStep::Until { read, test, within_ms, required: true } => {
                DraftStep::Arrival { flag: Some((read.clone(), *test)), within_ms: *within_ms }
            }
            other => other.clone(),
        })
        .collect();
    if !steps.iter().any(|step| matches!(step, DraftStep::Arrival { .. })) {
        // A plan may not end with a drive's bit alone: where the motor is, only its position shows.
        steps.push(DraftStep::Arrival { flag: None, within_ms: ARRIVAL_MAX_MS });
    }
    steps
}

/// The steps of a plan that stops: a limit of the speed in a drive's own numbers gives way to the one in
/// units.
fn judged_standstill(steps: &[DraftStep], draft: &Draft) -> Vec<DraftStep> {
    let speed = draft.signals.iter().find(|signal| signal.signal == Signal::Velocity);
    steps
        .iter()
        .map(|step| match step {
            DraftStep::Until { read, within_ms, required: true, .. }
                if is_speed_parameter(read, speed) =>
            {
                DraftStep::Standstill { within_ms: *within_ms }
            }
            other => other.clone(),
        })
        .collect()
}

fn is_speed_parameter(name: &ParameterName, speed: Option<&DraftSignal>) -> bool {
    speed.is_some_and(|signal| fold(&signal.parameter.value) == fold(&name.value))
}

pub(super) fn leak_words(values: &[(i64, String)]) -> &'static [(i64, &'static str)] {
    let words: Vec<_> = values.iter().map(|(raw, word)| (*raw, leak_text(word))).collect();
    words.leak()
}
