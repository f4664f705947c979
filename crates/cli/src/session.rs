//! An open link for the verbs: interruptible, with errors as texts.

use polepair::remote::RemoteLink;
use polepair::url::AxisNumber;
use polepair::url::shell_word;
use polepair::{Axis, Link, LocalAxis, LocalLink, Value};
use polepair_core::axis::{Command, Verb};
use polepair_core::profile::{Encoding, ParameterId, Signal};
use polepair_core::time::Instant;
use polepair_core::units::Unit;

use crate::outcome;
use crate::problem::Result;
use crate::remote;
use crate::terminal::print_note;

/// A link, of this program or of a server, and how the user named it.
pub struct Session {
    pub link: Link,
    /// Arguments that name it to another verb.
    pub arguments: String,
    local: Option<LocalSession>,
}

impl From<LocalSession> for Session {
    fn from(session: LocalSession) -> Self {
        let (link, arguments) = (session.link.clone().into(), session.arguments.clone());
        Self { link, arguments, local: Some(session) }
    }
}

impl Session {
    /// The axes of a server.
    pub fn of_server(link: RemoteLink, words: &str) -> Self {
        let address = format!("{}#{words}", link.gateway().url());
        let arguments = shell_word(&address).into_owned();
        Self { link: link.into(), arguments, local: None }
    }

    /// Makes Ctrl-C end what waits.
    pub fn listen_for_interrupts(&self) {
        match &self.local {
            Some(session) => session.listen_for_interrupts(),
            // Waits for a server end by themselves.
            None => crate::interrupt::listen(|| {}),
        }
    }

    /// The present time of the link: a simulation has a clock of its own.
    pub fn now(&self) -> Instant {
        self.axes().first().map_or(Instant::ZERO, Axis::now)
    }

    /// Every axis.
    pub fn axes(&self) -> &[Axis] {
        self.link.axes()
    }

    /// `#1 ` before what concerns an axis, where there are several.
    pub fn axis_prefix(&self, axis: &Axis) -> String {
        let links = self.link.remote().map_or(1, |link| link.bench().links.len());
        let link = axis.remote().filter(|_| links > 1).map(|axis| axis.info().link);
        match (self.axes().len(), axis.name(), link) {
            (0 | 1, ..) => String::new(),
            (_, "", Some(link)) => format!("{link}#{} ", AxisNumber(axis.number())),
            (_, "", None) => format!("#{} ", AxisNumber(axis.number())),
            (_, name, _) => format!("{name} "),
        }
    }
}

/// A link of this program, and how the user named it.
pub struct LocalSession {
    pub link: LocalLink,
    /// Arguments that name it to another verb: its URL, and the profile's file if one was given.
    pub arguments: String,
}

impl LocalSession {
    /// Makes Ctrl-C end what waits.
    pub fn listen_for_interrupts(&self) {
        let interrupters = self.link.interrupters();
        crate::interrupt::listen(move || {
            interrupters.iter().for_each(polepair_link::Interrupter::interrupt);
        });
    }

    /// The present time of the link: a simulation has a clock of its own.
    pub fn now(&self) -> Instant {
        self.axes().first().map_or(Instant::ZERO, |axis| axis.connection().now())
    }

    /// Every axis.
    pub fn axes(&self) -> &[LocalAxis] {
        self.link.axes()
    }

    /// `#1 ` before what concerns an axis, where there are several.
    pub fn axis_prefix(&self, axis: &LocalAxis) -> String {
        match (self.axes().len(), axis.name()) {
            (0 | 1, _) => String::new(),
            (_, "") => format!("#{} ", AxisNumber(axis.number())),
            (_, name) => format!("{name} "),
        }
    }
}

impl Drop for LocalSession {
    /// Prints a write to a drive's permanent memory in any case.
    fn drop(&mut self) {
        for axis in self.link.axes() {
            // Printed at the end whatever happened: a script in a loop wears the memory out within a day.
            let writes = axis.state().flash_writes;
            let profile = axis.profile();
            let ram = profile.ram.and_then(|ram| profile.parameter(ram.parameter));
            let why = ram.map_or_else(String::new, |p| {
                format!(" ({}: the drive always stores {})", p.symbol, p.name)
            });
            if writes > 0 {
                let label = axis.label();
                print_note(&format!(
                    "{label}: writes to the drive's permanent memory: {writes}{why}"
                ));
            }
        }
    }
}

/// Reads a parameter in its unit.
pub fn read_parameter(axis: &LocalAxis, id: ParameterId) -> Result<Value> {
    axis.read(id).and_then(|raw| axis.value(id, raw)).map_err(outcome::to_problem)
}

/// Carries out a verb without arguments.
pub fn run_verb(axis: &LocalAxis, verb: Verb) -> Result<i64> {
    axis.run(Command::new(verb)).map_err(outcome::to_problem)
}

/// Returns whether the motor has power, as far as the drive reports it.
pub fn is_enabled(axis: &Axis) -> Result<bool> {
    match axis.local() {
        Some(axis) => Ok(read_signal(axis, Signal::Enabled)?.is_some_and(|read| read.raw != 0)),
        None => Ok(read_remote(axis, Signal::Enabled)?.is_some_and(|value| value != 0.0)),
    }
}

/// A signal as it is now, as people read it.
pub fn signal_text(axis: &Axis, signal: Signal) -> Result<Option<String>> {
    match axis.local() {
        Some(axis) => Ok(read_signal(axis, signal)?.map(|value| value.to_string())),
        None => {
            Ok(read_remote(axis, signal)?.map(|value| remote::signal_text(axis, signal, value)))
        }
    }
}

/// A value of a signal in SI, as people read it: in the drive's unit, with the digits that it resolves. `None` for
/// what the drive does not report, or in an unknown scale.
pub fn format_signal(axis: &Axis, signal: Signal, si: f64) -> Option<String> {
    let Some(local) = axis.local() else {
        return Some(remote::signal_text(axis, signal, si));
    };
    let source = local.profile().signal(signal)?;
    Some(local.value_of_si(source.parameter, si).ok()?.to_string())
}

/// A signal that a server reads now, in SI.
fn read_remote(axis: &Axis, signal: Signal) -> Result<Option<f64>> {
    if !axis.has_signal(signal) {
        return Ok(None);
    }
    let read = axis.signals(&[signal]).map_err(outcome::to_problem)?;
    Ok(read.first().map(|reading| reading.value).filter(|value| !value.is_nan()))
}

/// Reads a signal, if the drive has it. Flags are 0 or 1, without a unit.
pub fn read_signal(axis: &LocalAxis, signal: Signal) -> Result<Option<Value>> {
    let Some(source) = axis.profile().signal(signal) else { return Ok(None) };
    let id = source.parameter;
    let Some(raw) = axis.read_optional(id).map_err(outcome::to_problem)? else { return Ok(None) };
    let value = axis.value(id, raw).map_err(outcome::to_problem)?;
    outcome::note_missing_unit(axis, id);
    let masked = value.raw & source.mask;
    Ok(Some(match source.equals {
        Some(equals) if masked != equals && signal == Signal::Moving => {
            // The flag often means that a target is not reached: the speed shows it, too.
            if let Some(source) = axis.profile().signal(Signal::Velocity) {
                axis.read_optional(source.parameter).map_err(outcome::to_problem)?;
            }
            plain_value(i64::from(axis.moving(&axis.state()) == Some(true)), value.encoding)
        }
        Some(equals) => plain_value(i64::from(masked == equals), value.encoding),
        None if source.mask == -1 => value,
        None => {
            let named = source.values.iter().find(|(raw, _)| *raw == masked);
            Value { word: named.map(|(_, word)| *word), ..plain_value(masked, value.encoding) }
        }
    }))
}

fn plain_value(raw: i64, encoding: Encoding) -> Value {
    Value {
        raw,
        value: raw as f64,
        step: 1.0,
        unit: Unit::None,
        word: None,
        encoding,
        is_raw: true,
    }
}
