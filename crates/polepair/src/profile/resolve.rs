//! From a draft to a profile: names become numbers, and whatever does not fit is refused.

use super::draft::{
    Draft, DraftFault, DraftIdentity, DraftParameter, DraftPlan, DraftRam, DraftSignal, DraftStep,
    DraftWatchdog, Named,
};
use super::read::{MEMORY, encoding_range};
use super::step;
use super::stops::with_stop;
use crate::file::{FileError, Place};
use crate::words::{folded, hint};
use polepair_core::plan::{Compare, Operand, Plan, STEPS_MAX, Step, Test};
use polepair_core::profile::{
    Access, Ask, Fault, Identity, Parameter, ParameterId, Profile, RamMode, Scale, SignalSource,
    Watchdog,
};
use std::collections::HashMap;

/// Checks the draft and leaks what it says.
pub(crate) fn profile(draft: &Draft) -> Result<&'static Profile, FileError> {
    let draft = &with_stop(in_order(draft));
    let names = Names::of(draft)?;
    draft.parameters.iter().try_for_each(check_parameter)?;
    check_faults(&draft.faults)?;
    let parameters = draft.parameters.iter().map(|p| names.parameter(p));
    let signals = draft.signals.iter().map(|s| names.signal(s));
    let mut plans: Vec<&DraftPlan> = draft.plans.iter().collect();
    plans.sort_by_key(|plan| plan.verb);
    let plans = plans.into_iter().map(|plan| names.plan(plan));
    let mut signals = signals.collect::<Result<Vec<_>, _>>()?;
    signals.sort_by_key(|source| source.signal);
    Ok(Box::leak(Box::new(Profile {
        name: kept(&draft.name),
        family: kept(&draft.family),
        protocol: kept(&draft.protocol),
        title: kept(&draft.title),
        source: kept(&draft.source),
        axis: draft.axis,
        parameters: parameters.collect::<Result<Vec<_>, _>>()?.leak(),
        faults: draft.faults.iter().map(fault).collect::<Vec<_>>().leak(),
        signals: signals.leak(),
        plans: plans.collect::<Result<Vec<_>, _>>()?.leak(),
        ram: draft.ram.as_ref().map(|ram| names.ram(ram)).transpose()?,
        reach: names.reach(&draft.reach)?.leak(),
        optional: names.optional(&draft.optional)?.leak(),
        identity: draft.identity.as_ref().map(|it| names.identity(it)).transpose()?,
        watchdog: names.watchdog(&draft.watchdog)?,
        reply_timeout_ms: draft.reply_timeout_ms,
        caution: kept(&draft.caution),
    })))
}

/// A memory in the order of its addresses, of names that share one the described first: whoever has
/// an address finds its name by halving.
fn in_order(draft: &Draft) -> Draft {
    let mut draft = draft.clone();
    if draft.protocol == MEMORY {
        draft.parameters.sort_by_key(|p| (p.space, p.index, p.about.is_empty()));
    }
    draft
}

fn kept(text: &str) -> &'static str {
    if text.is_empty() { "" } else { text.to_owned().leak() }
}

fn fault(f: &DraftFault) -> Fault {
    Fault {
        code: f.code,
        name: kept(&f.name),
        text: kept(&f.text),
        cause: kept(&f.cause),
        remedy: kept(&f.remedy),
        severity: f.severity,
    }
}

fn check_faults(faults: &[DraftFault]) -> Result<(), FileError> {
    for (at, fault) in faults.iter().enumerate() {
        if faults[..at].iter().any(|other| other.code == fault.code) {
            let reason = format!("a second fault of code {:#x}: `{}`", fault.code, fault.name);
            return Err(fault.place.error(reason));
        }
    }
    Ok(())
}

fn check_parameter(p: &DraftParameter) -> Result<(), FileError> {
    let (least, most) = encoding_range(p.encoding);
    let name = &p.name;
    if p.min > p.max {
        let reason = format!("`{name}`: min {} is greater than max {}", p.min, p.max);
        return Err(p.place.error(reason));
    }
    if p.min < least || p.max > most {
        let reason = format!("`{name}`: {} to {} does not fit its encoding", p.min, p.max);
        return Err(p.place.error(reason));
    }
    let written = p.access != Access::Read;
    if let Some(default) = p.default.filter(|d| written && !(p.min..=p.max).contains(d)) {
        let reason = format!("`{name}`: default {default} is not within {} to {}", p.min, p.max);
        return Err(p.place.error(reason));
    }
    if let Some((raw, word)) = p.values.iter().find(|(raw, _)| !(least..=most).contains(raw)) {
        let reason = format!("`{name}`: value {raw} (`{word}`) does not fit its encoding");
        return Err(p.place.error(reason));
    }
    Ok(())
}

/// What a step or a signal does with a parameter.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Use {
    Read,
    Write,
}

struct Names<'a> {
    draft: &'a Draft,
    ids: HashMap<String, u16>,
}

impl<'a> Names<'a> {
    /// Numbers the parameters; two may share neither name, nor symbol, nor, but in a memory, place on
    /// the wire.
    fn of(draft: &'a Draft) -> Result<Self, FileError> {
        let mut ids = HashMap::new();
        let mut wires = HashMap::new();
        for (at, p) in draft.parameters.iter().enumerate() {
            let id = u16::try_from(at).map_err(|_| p.place.error("too many parameters"))?;
            let other = wires.insert((p.space, p.index), &p.name);
            if let Some(other) = other.filter(|_| draft.protocol != MEMORY) {
                let reason = format!("`{}` has the space and index of `{other}`", p.name);
                return Err(p.place.error(reason));
            }
            let mut labels = vec![folded(&p.name), folded(&p.symbol)];
            labels.dedup();
            for label in labels.into_iter().filter(|label| !label.is_empty()) {
                if let Some(other) = ids.insert(label, id) {
                    let other = &draft.parameters[usize::from(other)].name;
                    let reason = format!("`{}` ({}) is called as `{other}` is", p.name, p.symbol);
                    return Err(p.place.error(reason));
                }
            }
        }
        Ok(Self { draft, ids })
    }

    fn id(&self, name: &Named) -> Result<ParameterId, FileError> {
        let known = self.ids.get(&folded(&name.value));
        known.copied().map(ParameterId).ok_or_else(|| {
            let names = self.draft.parameters.iter().map(|p| p.name.as_str());
            let hint = hint(&name.value, names);
            name.place.error(format!("no parameter is called `{}`{hint}", name.value))
        })
    }

    fn entry(&self, id: ParameterId) -> &DraftParameter {
        &self.draft.parameters[usize::from(id.0)]
    }

    fn used(&self, name: &Named, uses: &[Use]) -> Result<ParameterId, FileError> {
        let id = self.id(name)?;
        let access = self.entry(id).access;
        if uses.contains(&Use::Write) && access == Access::Read {
            return Err(name.place.error(format!("`{}` can only be read", name.value)));
        }
        if uses.contains(&Use::Read) && access == Access::Write {
            return Err(name.place.error(format!("`{}` can only be written", name.value)));
        }
        Ok(id)
    }

    fn parameter(&self, p: &DraftParameter) -> Result<Parameter, FileError> {
        let reference = |name: &Option<Named>| {
            name.as_ref().map(|name| self.used(name, &[Use::Read])).transpose()
        };
        let scale =
            Scale { factor: p.factor, times: reference(&p.times)?, over: reference(&p.over)? };
        Ok(Parameter {
            name: kept(&p.name),
            symbol: kept(&p.symbol),
            about: kept(&p.about),
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
            section: kept(&p.section),
            values: words(&p.values),
        })
    }

    fn signal(&self, s: &DraftSignal) -> Result<SignalSource, FileError> {
        let parameter = self.used(&s.parameter, &[Use::Read])?;
        if s.equals.is_some_and(|value| value & !s.mask != 0) {
            return Err(s.parameter.place.error("`equals` has bits that `mask` takes away"));
        }
        if let Some((raw, word)) = s.values.iter().find(|(raw, _)| raw & !s.mask != 0) {
            let what = format!("`{word}` names {raw:#x}, which has bits that `mask` takes away");
            return Err(s.parameter.place.error(what));
        }
        let (mask, equals, values) = (s.mask, s.equals, words(&s.values));
        Ok(SignalSource { signal: s.signal, parameter, mask, equals, values })
    }

    fn identity(&self, identity: &DraftIdentity) -> Result<Identity, FileError> {
        let ask = match &identity.parameter {
            Some(name) => Ask::Parameter(self.used(name, &[Use::Read])?),
            None => Ask::Text(kept(&identity.text)),
        };
        let DraftIdentity { mask, equals, firmware, .. } = *identity;
        Ok(Identity { ask, mask, equals, firmware })
    }

    fn ram(&self, mode: &DraftRam) -> Result<RamMode, FileError> {
        let parameter = self.used(&mode.parameter, &[Use::Read, Use::Write])?;
        self.in_range(parameter, mode.ram, &mode.parameter.place)?;
        self.in_range(parameter, mode.flash, &mode.parameter.place)?;
        Ok(RamMode { parameter, ram: mode.ram, flash: mode.flash })
    }

    fn reach(&self, reach: &[Named]) -> Result<Vec<ParameterId>, FileError> {
        reach.iter().map(|name| self.used(name, &[Use::Write])).collect()
    }

    fn optional(&self, optional: &[Named]) -> Result<Vec<ParameterId>, FileError> {
        optional.iter().map(|name| self.id(name)).collect()
    }

    fn watchdog(&self, watchdog: &DraftWatchdog) -> Result<Watchdog, FileError> {
        Ok(match watchdog {
            DraftWatchdog::None => Watchdog::None,
            DraftWatchdog::Fixed(after_ms) => Watchdog::Fixed { after_ms: *after_ms },
            DraftWatchdog::Configurable { parameter, on_can } => Watchdog::Configurable {
                parameter: self.used(parameter, &[Use::Write])?,
                on_can: on_can.as_ref().map(|name| self.used(name, &[Use::Write])).transpose()?,
            },
            DraftWatchdog::Heartbeat { consumer, reaction } => Watchdog::Heartbeat {
                consumer: self.used(consumer, &[Use::Read, Use::Write])?,
                reaction: self.used(reaction, &[Use::Read, Use::Write])?,
            },
        })
    }

    fn plan(&self, plan: &DraftPlan) -> Result<Plan, FileError> {
        if plan.steps.len() + plan.undo.len() > STEPS_MAX {
            let reason = format!("`{}` has more than {STEPS_MAX} steps", plan.verb.name());
            return Err(plan.place.error(reason));
        }
        for step in plan.steps.iter().chain(&plan.undo) {
            let (DraftStep::Write(_, operand, _) | DraftStep::Send { operand, .. }) = step else {
                continue;
            };
            if let Operand::Argument(argument) | Operand::Given(argument) = *operand
                && !plan.verb.takes(argument)
            {
                let (verb, word) = (plan.verb.name(), step::word(argument));
                return Err(plan.place.error(format!("`{verb}` is never given a `{{{word}}}`")));
            }
        }
        let steps = |drafts: &[DraftStep]| -> Result<&'static [Step], FileError> {
            Ok(drafts.iter().map(|step| self.step(step)).collect::<Result<Vec<_>, _>>()?.leak())
        };
        let (steps, undo) = (steps(&plan.steps)?, steps(&plan.undo)?);
        Ok(Plan { verb: plan.verb, source: kept(&plan.source), steps, undo })
    }

    fn step(&self, step: &DraftStep) -> Result<Step, FileError> {
        let both = [Use::Read, Use::Write];
        Ok(match step {
            DraftStep::Write(name, operand, place) => {
                let id = self.used(name, &[Use::Write])?;
                if let Operand::Is(raw) = operand {
                    self.in_range(id, *raw, place)?;
                }
                Step::Write(id, *operand)
            }
            DraftStep::Ensure(name, raw, place) => {
                let id = self.used(name, &both)?;
                self.in_range(id, *raw, place)?;
                Step::Ensure(id, *raw)
            }
            DraftStep::Read(name) => Step::Read(self.used(name, &[Use::Read])?),
            DraftStep::Copy { from, to } => {
                let from = self.used(from, &[Use::Read])?;
                Step::Copy { from, to: self.used(to, &[Use::Write])? }
            }
            DraftStep::Require { read, test, hint } => {
                let id = self.tested(read, test)?;
                Step::Require { read: id, test: *test, hint: kept(hint) }
            }
            DraftStep::Skip { read, test, count } => {
                let id = self.tested(read, test)?;
                Step::Skip { read: id, test: *test, count: *count }
            }
            DraftStep::Without { read, count } => {
                Step::Without { read: self.used(read, &[Use::Read])?, count: *count }
            }
            DraftStep::NoFault { read, mask } => {
                Step::NoFault { read: self.used(read, &[Use::Read])?, mask: *mask }
            }
            DraftStep::Until { read, test, within_ms } => {
                let id = self.tested(read, test)?;
                Step::Until { read: id, test: *test, within_ms: *within_ms }
            }
            DraftStep::Send { function, index, operand, like } => {
                let like = like.as_ref().map(|name| self.id(name)).transpose()?;
                Step::Send { function: *function, index: *index, operand: *operand, like }
            }
            DraftStep::Keep(name) => Step::Keep(self.id(name)?),
            DraftStep::Wait { ms } => Step::Wait { ms: *ms },
        })
    }

    fn in_range(&self, id: ParameterId, raw: i64, place: &Place) -> Result<(), FileError> {
        let p = self.entry(id);
        if (p.min..=p.max).contains(&raw) {
            return Ok(());
        }
        Err(place.error(format!("{raw} is not within {} to {} of `{}`", p.min, p.max, p.name)))
    }

    /// A test that no value can pass is a mistake in the file.
    fn tested(&self, name: &Named, test: &Test) -> Result<ParameterId, FileError> {
        let id = self.used(name, &[Use::Read])?;
        let never = match test.compare {
            Compare::Equal => test.value & !test.mask != 0,
            Compare::NotEqual => false,
            Compare::Within => test.value < 0,
            Compare::Among => test.value == 0,
        };
        if never {
            let reason = format!("nothing that is masked so can be {:#x}", test.value);
            return Err(name.place.error(reason));
        }
        Ok(id)
    }
}

fn words(values: &[(i64, String)]) -> &'static [(i64, &'static str)] {
    let words: Vec<_> = values.iter().map(|(raw, word)| (*raw, kept(word))).collect();
    words.leak()
}
