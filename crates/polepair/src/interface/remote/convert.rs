//! The gateway's messages as the axis interface's values, and its errors as the library's.

use std::borrow::Cow;
use std::time::Duration;

use polepair_client::display_unit;
use polepair_client::message::{
    ActiveFault as FaultMessage, AxisInfo, AxisState as StateMessage, CommandArguments,
    GatewayError, ParameterChange, ParameterInfo, ParameterInput,
    ParameterReading as ReadingMessage, SignalValue, WatchdogView, WriteParameters,
};
use polepair_core::axis::{Command, Verb};
use polepair_core::plan::Argument;
use polepair_core::profile::{AxisKind, Signal};
use polepair_core::units::Unit;

use crate::amount::Amount;
use crate::axis::{NamedValue, WriteChange};
use crate::error::Error;
use crate::interface::{
    AxisFacts, AxisSnapshot, FaultReport, ParameterDescription, ReadValue, SignalReading,
    WatchdogKind, WatchdogReport, WriteValue, not_on_gateway,
};
use crate::quantity::format_amount;

impl From<GatewayError> for Error {
    fn from(error: GatewayError) -> Self {
        let (exit, exception, sentence) = (error.exit(), error.exception(), error.sentence());
        let GatewayError { code, message: what, hint, executed, may_turn, .. } = error;
        Self::Gateway { code, what, sentence, hint, executed, may_turn, exit, exception }
    }
}

impl From<Error> for GatewayError {
    fn from(error: Error) -> Self {
        let code = match &error {
            Error::Gateway { code, .. } => code.clone(),
            other => Cow::Owned(other.code().to_owned()),
        };
        Self {
            code,
            message: error.brief(),
            hint: error.hint().to_owned(),
            executed: error.executed(),
            may_turn: error.may_turn(),
            server_ms: None,
        }
    }
}

/// The facts of an axis in the gateway's description.
pub(super) fn axis_facts(info: &AxisInfo) -> AxisFacts {
    let verbs = Verb::ALL.into_iter();
    let verbs = verbs.filter(|verb| info.verbs.iter().any(|known| known.verb == verb.name()));
    let signals = Signal::ALL.into_iter();
    let signals =
        signals.filter(|signal| info.signals.iter().any(|known| known.signal == signal.name()));
    AxisFacts {
        number: info.number,
        name: info.name.clone(),
        label: info.label.clone(),
        protocol: info.protocol.clone(),
        profile: info.profile.clone(),
        title: info.drive.clone(),
        kind: match &*info.kind {
            "linear" => AxisKind::Linear,
            "ratio" => AxisKind::Ratio,
            _ => AxisKind::Rotary,
        },
        caution: info.caution.clone(),
        watchdog_rule: info.watchdog.clone(),
        watchdog: match (info.watchdog_ms, info.watchdog_parameter.clone()) {
            (Some(after_ms), _) => WatchdogKind::Fixed(f64::from(after_ms) / 1e3),
            (None, Some(parameter)) => WatchdogKind::Configurable(parameter),
            (None, None) => WatchdogKind::None,
        },
        is_simulated: info.simulated,
        verbs: verbs.collect(),
        signals: signals.collect(),
    }
}

/// The field of a command for an argument.
const fn argument_name(which: Argument) -> &'static str {
    match which {
        Argument::Target => "target",
        Argument::Velocity => "velocity",
        Argument::Acceleration => "acceleration",
        Argument::Deceleration => "deceleration",
        Argument::Torque => "torque",
        Argument::JerkTime => "jerk_time",
        Argument::Period => "period",
        Argument::Path => "path",
    }
}

/// The unit that people use for an argument of a verb; `None` if the verb does not take it.
pub(super) fn argument_unit(info: &AxisInfo, verb: Verb, which: Argument) -> Option<Unit> {
    let verb = info.verbs.iter().find(|known| known.verb == verb.name())?;
    let argument = verb.arguments.iter().find(|known| known.name == argument_name(which))?;
    Some(display_unit(&argument.unit))
}

/// The arguments of a command.
pub(super) const fn command_arguments(command: &Command) -> CommandArguments {
    CommandArguments {
        target: command.target,
        velocity: command.velocity,
        acceleration: command.acceleration,
        deceleration: command.deceleration,
        torque: command.torque,
        jerk_time: command.jerk_time,
        period: command.period,
        path: command.path,
    }
}

pub(super) fn parameter_description(info: &ParameterInfo) -> ParameterDescription {
    let words =
        info.word_values.iter().copied().zip(info.words.iter().map(|word| owned_text(word)));
    ParameterDescription {
        name: owned_text(&info.name),
        symbol: owned_text(&info.symbol),
        about: owned_text(&info.about),
        unit: owned_text(&info.unit),
        kind: owned_text(&info.kind),
        raw_range: (info.raw_min, info.raw_max),
        raw_default: info.raw_default,
        readable: info.readable,
        writable: info.writable,
        persistence: owned_text(&info.persistence),
        moves: info.moves,
        words: words.collect(),
        section: owned_text(&info.group),
    }
}

/// The unit in which people read a signal: that of the drive's profile, if this program has the profile and it measures
/// the same as the gateway.
#[must_use]
pub fn drive_unit(axis: &AxisInfo, signal: &str, si: &str) -> Option<Unit> {
    let profile = crate::profile::find_shipped(&axis.profile)?;
    let source = profile.signals.iter().find(|source| source.signal.name() == signal)?;
    let unit = profile.parameter(source.parameter)?.unit;
    (!source.is_flag() && !si.is_empty() && unit.si_symbol() == si).then_some(unit)
}

/// A value of a signal, which a gateway gives in SI, as people read it.
#[must_use]
pub fn format_signal(axis: &AxisInfo, signal: &str, value: f64, si: &str) -> String {
    match drive_unit(axis, signal, si) {
        Some(unit) => format_amount(value / unit.si_factor(), unit.symbol()),
        None => format_amount(value, si),
    }
}

fn owned_text(text: &str) -> Cow<'static, str> {
    Cow::Owned(text.to_owned())
}

/// A value as a gateway takes it, and whether it is raw.
pub(super) fn parameter_input(value: &WriteValue) -> (ParameterInput, bool) {
    match value {
        WriteValue::Amount(Amount::Number(number) | Amount::Either(number)) => {
            (ParameterInput::Number(*number), false)
        }
        WriteValue::Amount(Amount::Text(text) | Amount::Own(text)) => {
            (ParameterInput::Text(text.clone()), false)
        }
        // A whole number that a double does not hold is sent as text.
        WriteValue::Raw(raw) if raw.unsigned_abs() <= 1 << 53 => {
            (ParameterInput::Number(*raw as f64), true)
        }
        WriteValue::Raw(raw) => (ParameterInput::Text(raw.to_string()), true),
    }
}

/// The request to write several values, without a lease.
pub(super) fn write_request(values: &[NamedValue], keep: bool) -> Result<WriteParameters, Error> {
    let inputs = values.iter().map(|named| (named.name.clone(), parameter_input(&named.value)));
    let inputs: Vec<_> = inputs.collect();
    let raw = inputs.iter().any(|(_, (_, raw))| *raw);
    if inputs.iter().any(|(_, (_, own))| *own != raw) {
        let what = "raw values and values with units together";
        return Err(not_on_gateway(what, "write the raw values by themselves"));
    }
    let values = inputs.into_iter().map(|(name, (input, _))| (name, input)).collect();
    Ok(WriteParameters { values, keep, dry_run: false, raw, epoch: 0 })
}

/// A change that a gateway made or would make.
pub(super) fn write_change(change: ParameterChange, parameters: &[ParameterInfo]) -> WriteChange {
    let known = parameters.iter().find(|known| known.name == change.name);
    WriteChange {
        is_readable: known.is_some_and(|known| known.readable),
        name: change.name,
        from: change.from,
        from_text: change.from_text,
        to: change.to,
        to_text: change.to_text,
        raw: None,
        unit: change.unit,
        is_changed: change.changed,
    }
}

pub(super) fn parameter_reading(read: ReadingMessage) -> ReadValue {
    ReadValue {
        name: read.name.into(),
        symbol: read.symbol.into(),
        raw: read.raw,
        encoding: None,
        value: read.value.unwrap_or(f64::NAN),
        unit: read.unit.into(),
        word: read.word.map(Cow::Owned),
        text: read.text,
    }
}

/// A signal that the gateway read; `None` for one that this version does not know.
pub(super) fn signal_reading(read: &SignalValue) -> Option<SignalReading> {
    let signal = Signal::from_name(&read.signal)?;
    let age = Duration::try_from_secs_f64(read.age_ms / 1e3).unwrap_or(Duration::ZERO);
    Some(SignalReading { signal, value: read.value.unwrap_or(f64::NAN), age })
}

pub(super) fn axis_state(state: StateMessage) -> AxisSnapshot {
    AxisSnapshot {
        mode: state.mode,
        enabled: state.enabled,
        armed: state.armed,
        moving: state.moving,
        signals: state.signals.iter().filter_map(signal_reading).collect(),
        owner: state.lease.map(|lease| lease.owner),
    }
}

impl From<FaultMessage> for FaultReport {
    fn from(fault: FaultMessage) -> Self {
        Self {
            code: fault.code,
            name: fault.symbol.into(),
            text: fault.name.into(),
            cause: fault.cause.into(),
            remedy: fault.remedy.into(),
            is_warning: fault.warning,
        }
    }
}

pub(super) fn watchdog_report(view: WatchdogView) -> WatchdogReport {
    let after = view.after_ms.and_then(|ms| Duration::try_from_secs_f64(ms / 1e3).ok());
    WatchdogReport { text: view.text, after, parameter: view.parameter, caution: view.caution }
}
