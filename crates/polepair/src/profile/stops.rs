//! Ensures that motion can be stopped: a profile without a stop gets that of its family. If the family has
//! none either, verbs that start motion are removed.

use super::draft::{Draft, DraftPlan, DraftSignal, ParameterName};
use super::missing_parameters::{AvailableParameters, step_parameters_mut};
use crate::spelling::fold;
use polepair_core::axis::Verb;
use polepair_core::profile::{Profile, Signal};

/// The draft with a stop, or without motion.
pub(super) fn with_stop(mut draft: Draft) -> Draft {
    for verb in [Verb::Stop, Verb::QuickStop, Verb::Disable] {
        if !has_plan(&draft, verb) {
            let Some((plan, signals)) = family_plan(&draft, verb) else { continue };
            draft.plans.push(plan);
            // By these its standstill is measured.
            for signal in signals {
                if !draft.signals.iter().any(|own| own.signal == signal.signal) {
                    draft.signals.push(signal);
                }
            }
        }
    }
    if !has_plan(&draft, Verb::Stop) {
        let off = has_plan(&draft, Verb::Disable);
        draft.plans.retain(|plan| is_kept_verb(plan.verb, off));
    }
    draft
}

fn is_kept_verb(verb: Verb, off: bool) -> bool {
    !verb.needs_arming() || (verb == Verb::Enable && off)
}

fn has_plan(draft: &Draft, verb: Verb) -> bool {
    draft.plans.iter().any(|plan| plan.verb == verb)
}

/// The family's plan for a verb, by this draft's names for what lies at the same places. Of several
/// products it is the one with the most functions that this one has.
fn family_plan(draft: &Draft, verb: Verb) -> Option<(DraftPlan, Vec<DraftSignal>)> {
    let generic = crate::registry::protocols().into_iter().map(|protocol| protocol.generic);
    let generic = generic.filter(|profile| profile.protocol == draft.protocol);
    let mut products: Vec<&'static Profile> = polepair_drives::profiles()
        .iter()
        .copied()
        .filter(|profile| profile.family == draft.family && profile.protocol == draft.protocol)
        .collect();
    products.sort_by_key(|profile| std::cmp::Reverse(shared_plans(profile, &draft.plans)));
    let there = AvailableParameters::from_draft(draft);
    products.into_iter().chain(generic).find_map(|profile| {
        let base = Draft::from_profile(profile);
        let plan = base.plans.iter().find(|plan| plan.verb == verb)?;
        let plan = there.adapt_plan(rename_parameters(plan.clone(), &base, draft))?;
        let measured =
            |signal: &&DraftSignal| matches!(signal.signal, Signal::Velocity | Signal::Position);
        let signals = base.signals.iter().filter(measured).cloned().filter_map(|mut signal| {
            rename_parameter(&mut signal.parameter, &base, draft);
            there.reads(&signal.parameter).then_some(signal)
        });
        Some((plan, signals.collect()))
    })
}

fn shared_plans(profile: &&'static Profile, draft_plans: &[DraftPlan]) -> usize {
    draft_plans.iter().filter(|plan| profile.plan(plan.verb).is_some()).count()
}

/// The plan with the draft's names for what the base's plan names.
fn rename_parameters(mut plan: DraftPlan, base: &Draft, draft: &Draft) -> DraftPlan {
    for name in plan.steps.iter_mut().chain(&mut plan.undo).flat_map(step_parameters_mut) {
        rename_parameter(name, base, draft);
    }
    plan
}

/// The draft's name for what the base's name means.
fn rename_parameter(name: &mut ParameterName, base: &Draft, draft: &Draft) {
    let known = base.parameters.iter().find(|p| fold(&p.name) == fold(&name.value));
    let same = known.and_then(|known| {
        draft.parameters.iter().find(|p| (p.space, p.index) == (known.space, known.index))
    });
    match same {
        Some(parameter) => name.value.clone_from(&parameter.name),
        // Nothing lies there: the name must not mean something else.
        None => name.value.clear(),
    }
}
