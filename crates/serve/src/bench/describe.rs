//! The list of links and axes as messages. It is constant after opening.

use polepair::LocalAxis;
use polepair_core::axis::Verb;
use polepair_core::plan::{Argument, Step};
use polepair_core::profile::{
    Access, AxisKind, Parameter, ParameterId, Persistence, Signal, SignalSource, Watchdog,
};
use polepair_core::units::Quantity;

use super::drive_log::drive_log_info;
use super::simulated_drive::SimulatedDrive;
use crate::message::{ArgumentInfo, AxisInfo, LimitInfo, ParameterInfo, SignalInfo, VerbInfo};

/// Every argument, with its field in a command.
const ARGUMENTS: [(Argument, &str); 8] = [
    (Argument::Target, "target"),
    (Argument::Velocity, "velocity"),
    (Argument::Acceleration, "acceleration"),
    (Argument::Deceleration, "deceleration"),
    (Argument::Torque, "torque"),
    (Argument::JerkTime, "jerk_time"),
    (Argument::Period, "period"),
    (Argument::Path, "path"),
];
/// Limits of an axis: a verb's argument, and the parameter of the drive for it.
const LIMITS: [(Verb, Argument, &str); 4] = [
    (Verb::MoveTo, Argument::Target, "position"),
    (Verb::Velocity, Argument::Velocity, "velocity"),
    (Verb::Velocity, Argument::Acceleration, "acceleration"),
    (Verb::Torque, Argument::Torque, "torque"),
];
/// Words for what lets motion through; they send nothing.
pub(super) const ARM: &str = "arm";
pub(super) const DISARM: &str = "disarm";

/// An axis.
pub(super) fn axis_info(
    id: u16,
    link: u16,
    axis: &LocalAxis,
    drive: Option<&SimulatedDrive>,
) -> AxisInfo {
    let profile = axis.profile();
    let kind = match profile.axis {
        AxisKind::Rotary => "rotary",
        AxisKind::Linear => "linear",
        AxisKind::Ratio => "ratio",
    };
    AxisInfo {
        id,
        link,
        number: axis.number(),
        name: axis.name().to_owned(),
        label: axis.label(),
        protocol: axis.protocol().to_owned(),
        drive: profile.title.to_owned(),
        profile: profile.name.to_owned(),
        simulated: drive.is_some(),
        kind: kind.to_owned(),
        watchdog: axis.watchdog_rule(),
        watchdog_ms: match profile.watchdog {
            Watchdog::Fixed { after_ms } => Some(after_ms),
            _ => None,
        },
        watchdog_parameter: profile
            .watchdog
            .time_parameter(axis.medium())
            .and_then(|id| profile.parameter(id))
            .map(|parameter| parameter.name.to_owned()),
        caution: profile.caution.to_owned(),
        verbs: verbs(axis),
        limits: LIMITS.iter().filter_map(|limit| limit_info(axis, *limit)).collect(),
        signals: profile.signals.iter().map(|source| signal(axis, source)).collect(),
        address_example: axis.address_example().to_owned(),
        has_program: axis.instruction_language().is_ok(),
        drive_log: drive_log_info(axis),
        acts: drive.map_or_else(Vec::new, SimulatedDrive::acts),
    }
}

/// Returns whether a verb is one that a client may give by itself: what needs a beat, a signal or another axis to go
/// on, or permanent memory, is not.
pub(super) fn is_offered(verb: Verb) -> bool {
    use Verb::{Begin, Begun, GiveTime, PrepareBy, PrepareTo, Store, Unfollow, WithholdTime};
    let others = [Begin, Begun, GiveTime, PrepareBy, PrepareTo, Store, Unfollow, WithholdTime];
    let coupling = [Verb::SendPosition, Verb::WithholdPosition];
    !verb.is_cyclic() && !verb.is_coupled() && !others.contains(&verb) && !coupling.contains(&verb)
}

fn verbs(axis: &LocalAxis) -> Vec<VerbInfo> {
    let of_drive = Verb::ALL.into_iter().filter(|verb| is_offered(*verb)).filter_map(|verb| {
        axis.profile().plan(verb)?;
        let arguments = ARGUMENTS.iter().filter_map(|which| argument(axis, verb, *which));
        Some(VerbInfo {
            arguments: arguments.collect(),
            ..bare_verb(verb.name(), verb.needs_arming())
        })
    });
    [bare_verb(ARM, true), bare_verb(DISARM, false)].into_iter().chain(of_drive).collect()
}

fn bare_verb(verb: &str, moves: bool) -> VerbInfo {
    VerbInfo { verb: verb.to_owned(), arguments: vec![], moves }
}

fn argument(axis: &LocalAxis, verb: Verb, argument: (Argument, &str)) -> Option<ArgumentInfo> {
    let (which, name) = argument;

    if !verb.accepts(which) {
        return None;
    }
    let unit = axis.unit_of(verb, which)?.si_symbol().to_owned();
    let steps = axis.profile().plan(verb)?.steps;
    let mut operands = steps.iter().flat_map(Step::operands);
    let required = operands.any(|(operand, _)| operand.requires(which));
    Some(ArgumentInfo { name: name.to_owned(), unit, required })
}

fn limit_info(axis: &LocalAxis, limit: (Verb, Argument, &str)) -> Option<LimitInfo> {
    let (verb, which, name) = limit;

    let parameter = axis.destination(verb, which)??;
    // The time of a ramp limits no acceleration.
    if parameter.unit.quantity() == Quantity::Time {
        return None;
    }
    let id = axis.profile().find_parameter(parameter.name)?;
    let unit = axis.unit(id);
    let si_of =
        |raw| Some(axis.value(id, raw).ok()?.value * unit.si_factor()).filter(|v| v.is_finite());
    let (min, max) = (si_of(parameter.min), si_of(parameter.max));
    // A drive that is given amperes where others are given a torque has a limit of its current.
    let name = if unit.quantity() == Quantity::Current { Signal::Current.name() } else { name };
    Some(LimitInfo { name: name.to_owned(), unit: unit.si_symbol().to_owned(), min, max })
}

fn signal(axis: &LocalAxis, source: &SignalSource) -> SignalInfo {
    SignalInfo {
        signal: source.signal.name().to_owned(),
        unit: axis.signal_unit(source.signal).to_owned(),
        pushed: false,
    }
}

/// A parameter, without its value. Its limits are known as far as its scale is.
pub(super) fn parameter_info(
    axis: &LocalAxis,
    id: ParameterId,
    parameter: &Parameter,
) -> ParameterInfo {
    let known = |raw: i64| {
        let value = parameter.scale.is_constant().then(|| axis.value(id, raw).ok()).flatten();
        value.map(|value| value.value).filter(|value| value.is_finite())
    };
    let writable = parameter.access != Access::Read && !parameter.moves;
    ParameterInfo {
        name: parameter.name.to_owned(),
        symbol: parameter.symbol.to_owned(),
        group: parameter.section.to_owned(),
        about: parameter.about.to_owned(),
        unit: axis.unit(id).symbol().to_owned(),
        min: known(parameter.min),
        max: known(parameter.max),
        default: parameter.default.and_then(known),
        readable: parameter.access != Access::Write,
        writable,
        kept: parameter.persistence == Persistence::Always,
        moves: parameter.moves,
        words: parameter.values.iter().map(|(_, word)| (*word).to_owned()).collect(),
        word_values: parameter.values.iter().map(|(raw, _)| *raw).collect(),
        raw_min: parameter.min,
        raw_max: parameter.max,
        raw_default: parameter.default,
        persistence: parameter.persistence.name().to_owned(),
        kind: parameter.encoding.kind().to_owned(),
    }
}
