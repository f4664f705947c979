//! The check of what a drive lacks of its profile.

use super::CheckResult;
use super::drive::is_absent_error;
use crate::axis::{LocalAxis, is_refusal};
use crate::error::Error;
use polepair_core::plan::{Operand, Plan, Step};
use polepair_core::profile::{Access, ParameterId, Profile};
use polepair_core::verb::Verb;

/// Verbs that a user has by name, with the word.
const VERBS: [(Verb, &str); 8] = [
    (Verb::Enable, "enable"),
    (Verb::Stop, "stop"),
    (Verb::Clear, "clear"),
    (Verb::Velocity, "spin"),
    (Verb::Torque, "torque"),
    (Verb::MoveTo, "move"),
    (Verb::Home, "home"),
    (Verb::Store, "store"),
];

/// Reads every object that the profile's plans and signals name, and lists those that the drive has not. `None` where
/// no refusal means that there is none.
pub(super) fn check_objects(axis: &LocalAxis, about: &str) -> Result<Option<CheckResult>, Error> {
    let profile = axis.profile();
    let needed = needed_parameters(profile);
    if !matches!(profile.protocol, "canopen" | "modbus") || needed.is_empty() {
        return Ok(None);
    }
    let mut absent = Vec::new();
    for id in &needed {
        match axis.read_optional(*id) {
            Ok(Some(_)) => {}
            Ok(None) => absent.push(*id),
            Err(error) if is_absent_error(axis, &error) => absent.push(*id),
            // An object that cannot be read now is there.
            Err(error) if is_refusal(&error) => {}
            Err(error) => return Err(error),
        }
    }
    let total = needed.len();
    if absent.is_empty() {
        let found = format!("has all {total} objects that its profile uses");
        return Ok(Some(CheckResult::ok(about, found)));
    }
    let names: Vec<String> = absent.iter().filter_map(|id| object_name(profile, *id)).collect();
    let lost: Vec<&str> = VERBS
        .iter()
        .filter(|(verb, _)| needs_any(profile, *verb, &absent))
        .map(|(_, word)| *word)
        .collect();
    let found = format!(
        "lacks {} of {total} objects that its profile uses: {}",
        absent.len(),
        names.join(", ")
    );
    let remedy = if absent.len() * 2 > total {
        "is it this drive? Compare a register with its manual".to_owned()
    } else if lost.is_empty() {
        return Ok(Some(CheckResult::ok(about, found)));
    } else {
        format!(
            "without them there is no `{}`; a data sheet (`?eds=FILE`) or a profile of its own has other ones",
            lost.join("`, `")
        )
    };
    Ok(Some(CheckResult::suspicious(about, found, remedy)))
}

fn object_name(profile: &Profile, id: ParameterId) -> Option<String> {
    let parameter = profile.parameter(id)?;
    Some(if parameter.symbol.is_empty() {
        parameter.name.to_owned()
    } else {
        format!("{} ({})", parameter.symbol, parameter.name)
    })
}

/// The parameters that can be read and that a verb or a signal uses.
fn needed_parameters(profile: &'static Profile) -> Vec<ParameterId> {
    let signals = profile.signals.iter().map(|source| source.parameter);
    let steps = profile.plans.iter().flat_map(parameters_of).map(|(id, _)| id);
    let mut needed: Vec<ParameterId> = signals.chain(steps).collect();
    needed.sort_unstable();
    needed.dedup();
    needed.retain(|id| {
        profile.parameter(*id).is_some_and(|parameter| parameter.access != Access::Write)
    });
    needed
}

/// Returns whether a verb cannot be carried out without one of these.
fn needs_any(profile: &Profile, verb: Verb, absent: &[ParameterId]) -> bool {
    let uses = profile.plan(verb).map(parameters_of).unwrap_or_default();
    uses.into_iter().any(|(id, need)| {
        absent.contains(&id)
            && match need {
                Need::Always => true,
                Need::Usual => !profile.optional.contains(&id),
                Need::Never => false,
            }
    })
}

/// Dependence of a plan on a parameter.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Need {
    /// The parameter carries what the caller asked for.
    Always,
    /// Unless the profile counts it among those that not every drive has.
    Usual,
    /// The plan passes it where it is absent.
    Never,
}

fn parameters_of(plan: &Plan) -> Vec<(ParameterId, Need)> {
    let mut uses = Vec::new();
    let mut optional_until = 0;
    for (at, step) in plan.steps.iter().enumerate() {
        let is_optional = at < optional_until;
        let mut add = |id: ParameterId, need: Need| {
            uses.push((id, if is_optional { Need::Never } else { need }));
        };
        for (operand, id) in step.operands() {
            let need = match operand {
                Operand::Constant(_) => Need::Usual,
                _ if operand.is_optional() => Need::Never,
                _ => Need::Always,
            };
            id.into_iter().for_each(|id| add(id, need));
        }
        match *step {
            Step::Ensure(id, _) | Step::WriteBits { id, .. } => add(id, Need::Usual),
            Step::Copy { from, to } => [from, to].into_iter().for_each(|id| add(id, Need::Usual)),
            Step::Require { read, .. } | Step::Until { read, .. } | Step::Homed { read, .. } => {
                add(read, Need::Usual);
            }
            Step::Read(id) | Step::NoFault { read: id, .. } | Step::Skip { read: id, .. } => {
                add(id, Need::Never);
            }
            Step::SkipIfMissing { read, count } => {
                add(read, Need::Never);
                optional_until = at + 1 + usize::from(count);
            }
            _ => {}
        }
    }
    uses
}
