//! Adapts a profile to a drive that lacks some parameters: removes readings, steps and plans.
//!
//! A step is removed if its plan works without it, see [`Profile::optional`]. Otherwise the plan is
//! removed, because a partly executed verb is worse than none. A stop keeps all steps that stop the motor,
//! even if standstill cannot be read.
//!
//! [`Profile::optional`]: polepair_core::profile::Profile::optional

use super::draft::{Draft, DraftParameter, DraftPlan, DraftStep, DraftWatchdog, ParameterName};
use crate::spelling::fold;
use polepair_core::axis::Verb;
use polepair_core::convert::saturating;
use polepair_core::plan::Operand;
use polepair_core::profile::{Access, Encoding};
use polepair_core::units::Unit;
use std::collections::{HashMap, HashSet};

/// Shows values raw if their scale depends on a parameter that this drive lacks, and drops readings, steps and plans
/// that cannot be without it.
pub(crate) fn remove_missing(draft: &mut Draft) {
    unscale_missing(draft);
    let there = AvailableParameters::from_draft(draft);
    draft.reach.retain(|name| there.supports(name, ParameterUse::Write));
    draft.signals.retain(|signal| there.supports(&signal.parameter, ParameterUse::Read));
    draft.plans = draft.plans.drain(..).filter_map(|plan| there.adapt_plan(plan)).collect();
    draft.identity = draft.identity.take().filter(|it| {
        it.parameter.as_ref().is_none_or(|name| there.supports(name, ParameterUse::Read))
    });
    let reads = |name: &ParameterName| there.supports(name, ParameterUse::Read);
    draft.motion.window = draft.motion.window.take().filter(reads);
    let motion = &mut draft.motion;
    for rule in [&mut motion.halted, &mut motion.stalled, &mut motion.unpowered] {
        *rule = rule.take().filter(|(name, _)| reads(name));
    }
    motion.coupling = motion.coupling.take().filter(|coupling| {
        let written =
            [&coupling.follower, &coupling.ratio, &coupling.numerator, &coupling.denominator];
        supports_both(&coupling.master_position, &there)
            && written.into_iter().chain([&coupling.cam]).all(|name| supports_both(name, &there))
    });
    let watchdog = match &draft.watchdog {
        DraftWatchdog::None | DraftWatchdog::Fixed(_) => true,
        DraftWatchdog::Configurable { parameter, on_can } => {
            let mut names = [Some(parameter), on_can.as_ref()].into_iter().flatten();
            names.all(|name| there.supports(name, ParameterUse::Write))
        }
        DraftWatchdog::Heartbeat { consumer, reaction, .. } => {
            supports_both(consumer, &there)
                && reaction.as_ref().is_none_or(|name| supports_both(name, &there))
        }
        DraftWatchdog::LifeGuarding { .. } => true,
    };
    let guards = |objects: &[ParameterName; 2]| {
        objects.iter().all(|name| there.supports(name, ParameterUse::Read))
    };
    draft.watchdog = match std::mem::replace(&mut draft.watchdog, DraftWatchdog::None) {
        DraftWatchdog::Heartbeat { consumer, reaction, life_guarding } if watchdog => {
            let life_guarding = life_guarding.filter(guards);
            DraftWatchdog::Heartbeat { consumer, reaction, life_guarding }
        }
        DraftWatchdog::Heartbeat { reaction, life_guarding: Some(objects), .. }
        | DraftWatchdog::LifeGuarding { reaction, objects }
            if guards(&objects) =>
        {
            let reaction = reaction.filter(|name| supports_both(name, &there));
            DraftWatchdog::LifeGuarding { objects, reaction }
        }
        DraftWatchdog::Heartbeat { .. } | DraftWatchdog::LifeGuarding { .. } => DraftWatchdog::None,
        other if watchdog => other,
        _ => DraftWatchdog::None,
    };
    draft.ram = draft.ram.take().filter(|ram| supports_both(&ram.parameter, &there));
    draft.optional.retain(|name| there.access.contains_key(&fold(&name.value)));
}

fn supports_both(name: &ParameterName, there: &AvailableParameters) -> bool {
    there.supports(name, ParameterUse::Read) && there.supports(name, ParameterUse::Write)
}

/// Shows values raw that are scaled by a parameter which this drive lacks.
fn unscale_missing(draft: &mut Draft) {
    let there = AvailableParameters::from_draft(draft);
    for p in &mut draft.parameters {
        if lacks_read(&p.times, &there) || lacks_read(&p.over, &there) {
            (p.times, p.over, p.unit) = (None, None, Unit::None);
            p.factor = if p.encoding == Encoding::Fixed { 1.0 / 65536.0 } else { 1.0 };
        }
    }
}

fn lacks_read(name: &Option<ParameterName>, there: &AvailableParameters) -> bool {
    name.as_ref().is_some_and(|name| !there.supports(name, ParameterUse::Read))
}

/// Use of a parameter by a step.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum ParameterUse {
    Read,
    Write,
    /// Only its scale and its limits count.
    Scale,
}

/// Parameters of a drive.
pub(super) struct AvailableParameters {
    /// Access by name and by symbol.
    access: HashMap<String, Access>,
    optional: HashSet<String>,
}

impl AvailableParameters {
    pub(super) fn from_draft(draft: &Draft) -> Self {
        let known = draft.parameters.iter();
        let access = known.flat_map(|p| folded_labels(p).map(|label| (label, p.access)));
        let access = access.filter(|(label, _)| !label.is_empty()).collect();
        let optional = draft.optional.iter().map(|name| fold(&name.value)).collect();
        Self { access, optional }
    }

    fn supports(&self, name: &ParameterName, how: ParameterUse) -> bool {
        match self.access.get(&fold(&name.value)) {
            None => false,
            Some(Access::Read) => how != ParameterUse::Write,
            Some(Access::Write) => how != ParameterUse::Read,
            Some(Access::ReadWrite) => true,
        }
    }

    /// Returns whether the drive has the parameter and lets it be read.
    pub(super) fn reads(&self, name: &ParameterName) -> bool {
        self.supports(name, ParameterUse::Read)
    }

    /// The plan for this drive; `None` where it cannot be carried out.
    pub(super) fn adapt_plan(&self, plan: DraftPlan) -> Option<DraftPlan> {
        let steps = self.adapt_steps(plan.verb, plan.steps)?;
        // What is undone is done as far as it can be, as a stop is.
        let undo = self.adapt_steps(Verb::Stop, plan.undo)?;
        if plan.verb.is_stop() && !steps.iter().any(is_sending) {
            return None;
        }
        Some(DraftPlan { steps, undo, ..plan })
    }

    fn adapt_steps(&self, verb: Verb, mut steps: Vec<DraftStep>) -> Option<Vec<DraftStep>> {
        let mut keep = vec![true; steps.len()];
        for at in 0..steps.len() {
            let step = &steps[at];
            if !keep[at]
                || step_parameters(step).iter().all(|(name, how)| self.supports(name, *how))
            {
                continue;
            }
            if !self.may_drop(verb, step) {
                return None;
            }
            keep[at] = false;
            if let DraftStep::Without { count, .. } = step {
                skipped_steps(at, *count, &mut keep).fill(false);
            }
        }
        // From the end, so that a step that leaves out nothing any more is not counted itself.
        for at in (0..steps.len()).rev() {
            if let DraftStep::Skip { count, .. } | DraftStep::Without { count, .. } = &mut steps[at]
            {
                let left =
                    skipped_steps(at, *count, &mut keep).iter().filter(|keep| **keep).count();
                *count = saturating(left);
                keep[at] &= left > 0;
            }
        }
        let mut keep = keep.into_iter();
        steps.retain(|_| keep.next().unwrap_or(true));
        Some(steps)
    }

    /// Returns whether a plan works without this step. The lane uses the same rule for a drive that lacks an object.
    fn may_drop(&self, verb: Verb, step: &DraftStep) -> bool {
        let names = step_parameters(step);
        let lacking = names.iter().filter(|(name, how)| !self.supports(name, *how));
        let mut lacking = lacking.map(|(name, _)| fold(&name.value));
        let optional = lacking.all(|name| self.optional.contains(&name));
        match step {
            DraftStep::Read(_)
            | DraftStep::NoFault { .. }
            | DraftStep::Until { .. }
            | DraftStep::Arrival { .. } => optional || verb.is_stop(),
            // A caller without the argument needs no step for it.
            DraftStep::Write(
                _,
                Operand::OptionalArgument(_) | Operand::OptionalRampTime { .. },
                _,
            ) => true,
            DraftStep::Write(_, Operand::Constant(_), _)
            | DraftStep::Ensure(..)
            | DraftStep::WriteBits { .. }
            | DraftStep::Copy { .. }
            | DraftStep::Skip { .. } => optional,
            DraftStep::Without { .. } => true,
            _ => false,
        }
    }
}

fn folded_labels(p: &DraftParameter) -> [String; 2] {
    [fold(&p.name), fold(&p.symbol)]
}

/// Steps that a skip may leave out.
fn skipped_steps(at: usize, count: u8, keep: &mut [bool]) -> &mut [bool] {
    let end = (at + 1 + usize::from(count)).min(keep.len());
    &mut keep[at + 1..end]
}

/// Returns whether a step writes to the drive.
fn is_sending(step: &DraftStep) -> bool {
    matches!(
        step,
        DraftStep::Write(..)
            | DraftStep::WriteTogether(_)
            | DraftStep::Ensure(..)
            | DraftStep::WriteBits { .. }
            | DraftStep::Copy { .. }
            | DraftStep::Send { .. }
    )
}

/// Parameters that a step names, each with its use.
fn step_parameters(step: &DraftStep) -> Vec<(&ParameterName, ParameterUse)> {
    match step {
        DraftStep::Write(name, ..) | DraftStep::Keep(name) => vec![(name, ParameterUse::Write)],
        DraftStep::WriteTogether(writes) => {
            writes.iter().map(|(name, ..)| (name, ParameterUse::Write)).collect()
        }
        DraftStep::Ensure(name, ..) | DraftStep::WriteBits { name, .. } => {
            vec![(name, ParameterUse::Read), (name, ParameterUse::Write)]
        }
        DraftStep::Copy { from, to } => vec![(from, ParameterUse::Read), (to, ParameterUse::Write)],
        DraftStep::Read(read)
        | DraftStep::Require { read, .. }
        | DraftStep::Skip { read, .. }
        | DraftStep::Without { read, .. }
        | DraftStep::NoFault { read, .. }
        | DraftStep::Until { read, .. }
        | DraftStep::Homed { read, .. } => vec![(read, ParameterUse::Read)],
        DraftStep::Arrival { flag, .. } => {
            flag.iter().map(|(read, _)| (read, ParameterUse::Read)).collect()
        }
        DraftStep::Send { like, .. } => {
            like.iter().map(|name| (name, ParameterUse::Scale)).collect()
        }
        DraftStep::Wait { .. } | DraftStep::Standstill { .. } | DraftStep::SkipBySign { .. } => {
            Vec::new()
        }
    }
}

/// [`step_parameters`] with mutable names.
pub(super) fn step_parameters_mut(step: &mut DraftStep) -> Vec<&mut ParameterName> {
    match step {
        DraftStep::Write(name, ..)
        | DraftStep::Keep(name)
        | DraftStep::Ensure(name, ..)
        | DraftStep::WriteBits { name, .. } => vec![name],
        DraftStep::WriteTogether(writes) => writes.iter_mut().map(|(name, ..)| name).collect(),
        DraftStep::Copy { from, to } => vec![from, to],
        DraftStep::Read(read)
        | DraftStep::Require { read, .. }
        | DraftStep::Skip { read, .. }
        | DraftStep::Without { read, .. }
        | DraftStep::NoFault { read, .. }
        | DraftStep::Until { read, .. }
        | DraftStep::Homed { read, .. } => vec![read],
        DraftStep::Arrival { flag, .. } => flag.iter_mut().map(|(read, _)| read).collect(),
        DraftStep::Send { like, .. } => like.iter_mut().collect(),
        DraftStep::Wait { .. } | DraftStep::Standstill { .. } | DraftStep::SkipBySign { .. } => {
            Vec::new()
        }
    }
}
