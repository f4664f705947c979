//! Values that are read from an axis, and written to it.

use std::borrow::Cow;
use std::fmt;
use std::time::Duration;

use polepair_core::escape::EscapedText;
use polepair_core::profile::{Encoding, Fault, Parameter, Severity, Signal};
use polepair_core::time::Instant;

use crate::amount::format_raw;
use crate::axis::ParameterValue;
use crate::error::{Error, Exit};

/// A parameter that was read: a number, text or bytes.
#[derive(Clone, PartialEq, Debug)]
pub struct ReadValue {
    /// The parameter's name.
    pub name: Cow<'static, str>,
    /// Designation in the manual: `AP 6`, `1018h:1`.
    pub symbol: Cow<'static, str>,
    /// The raw value; `None` for text and bytes. An unsigned one of 64 bits may be negative here:
    /// [`raw_text`](Self::raw_text) has it as it is.
    pub raw: Option<i64>,
    /// Encoding of the raw value on the wire; `None` on a gateway.
    pub encoding: Option<Encoding>,
    /// Value in [`unit`](Self::unit); NaN if the scale is unknown.
    pub value: f64,
    /// Symbol of the unit that the profile shows the value in; empty without one.
    pub unit: Cow<'static, str>,
    /// The value's word, if it has one.
    pub word: Option<Cow<'static, str>>,
    /// The value with its unit, with no more digits than the drive has. Text is as the drive sent it, with control
    /// characters if it has any; bytes are in hexadecimal.
    pub text: String,
}

impl ReadValue {
    /// The raw value in decimal digits; `None` for text and bytes.
    #[must_use]
    pub fn raw_text(&self) -> Option<String> {
        let raw = self.raw?;
        Some(self.encoding.map_or_else(|| raw.to_string(), |encoding| format_raw(encoding, raw)))
    }

    /// The raw value.
    ///
    /// # Errors
    /// [`Error::Usage`] `E213` for text and bytes.
    pub fn require_raw(&self, name: &str) -> Result<i64, Error> {
        self.raw.ok_or_else(|| not_a_number(name))
    }
}

impl fmt::Display for ReadValue {
    /// The text, with control characters escaped.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        EscapedText(&self.text).fmt(f)
    }
}

impl ReadValue {
    /// The value of a parameter of a drive on a wire of this program.
    pub(super) fn of(parameter: &Parameter, value: &ParameterValue) -> Self {
        let number = value.number();
        Self {
            name: parameter.name.into(),
            symbol: parameter.symbol.into(),
            raw: number.map(|number| number.raw),
            encoding: number.map(|number| number.encoding),
            value: number.map_or(f64::NAN, |number| number.value),
            unit: number.map_or("", |number| number.unit.symbol()).into(),
            word: number.and_then(|number| number.word).map(Cow::Borrowed),
            text: match value {
                ParameterValue::Text(text) => text.clone(),
                ParameterValue::Number(_) | ParameterValue::Bytes(_) => value.to_string(),
            },
        }
    }
}

/// The error for a parameter that holds text or bytes.
fn not_a_number(name: &str) -> Error {
    Error::usage("E213", format!("`{name}` is no number"), "read it as text, or as bytes")
}

/// A signal that was read.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct SignalReading {
    /// Signal of the axis.
    pub signal: Signal,
    /// SI; flags are 0 or 1, codes and modes are themselves. NaN if the scale is not known.
    pub value: f64,
    /// Time since its reply arrived.
    pub age: Duration,
}

/// The last known state of an axis. No value is newer than its age.
#[derive(Clone, PartialEq, Debug)]
pub struct AxisSnapshot {
    /// Mode of operation in words; `None` while it is not known.
    pub mode: Option<String>,
    /// The motor has power; `None` while that is not known.
    pub enabled: Option<bool>,
    /// True if motion commands are allowed.
    pub armed: bool,
    /// The motor moves; `None` while that is not known.
    pub moving: Option<bool>,
    /// Each signal that was read.
    pub signals: Vec<SignalReading>,
    /// The client with the lease, on a gateway.
    pub owner: Option<String>,
}

impl AxisSnapshot {
    /// The last reading of a signal; `None` before the first.
    #[must_use]
    pub fn signal(&self, signal: Signal) -> Option<SignalReading> {
        self.signals.iter().find(|reading| reading.signal == signal).copied()
    }
}

/// An active fault or warning of a drive.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct FaultReport {
    /// The drive's code.
    pub code: u32,
    /// The manual's short name.
    pub name: Cow<'static, str>,
    /// Name in words.
    pub text: Cow<'static, str>,
    /// Usual cause.
    pub cause: Cow<'static, str>,
    /// Remedy.
    pub remedy: Cow<'static, str>,
    /// The drive continues.
    pub is_warning: bool,
}

impl FaultReport {
    /// The error for a motion that this fault has ended: `E801`.
    #[must_use]
    pub fn to_error(&self, label: &str) -> Error {
        Error::MotionEnded {
            code: "E801",
            what: format!("{label} reports a fault: {} ({})", self.text, self.name),
            why: self.cause.clone().into_owned(),
            hint: self.remedy.clone().into_owned(),
            exit: Exit::DriveFault,
        }
    }
}

impl From<&'static Fault> for FaultReport {
    fn from(fault: &'static Fault) -> Self {
        Self {
            code: fault.code,
            name: fault.name.into(),
            text: fault.text.into(),
            cause: fault.cause.into(),
            remedy: fault.remedy.into(),
            is_warning: fault.severity != Severity::Fault,
        }
    }
}

/// Setting of a drive's watchdog.
#[derive(Clone, PartialEq, Debug)]
pub struct WatchdogReport {
    /// The setting in words.
    pub text: String,
    /// Time without a message of the host after which the drive stops. `None` if it does not stop, or does not
    /// report it.
    pub after: Option<Duration>,
    /// The parameter that is written to set it. `None` for a drive without one, or whose firmware lacks it.
    pub parameter: Option<String>,
    /// Caution before it is set; may be empty.
    pub caution: String,
}

/// The reply to a request.
#[derive(Clone, PartialEq, Debug)]
pub enum Reply {
    /// The last raw value that was read; 0 for a request without a value.
    Raw(i64),
    /// A parameter as a gateway read it.
    Reading(ReadValue),
}

impl Reply {
    /// The raw value of the reply; `name` is for the error.
    ///
    /// # Errors
    /// [`Error::Usage`] `E213` if the parameter holds text or bytes.
    pub fn raw(&self, name: &str) -> Result<i64, Error> {
        match self {
            Self::Raw(raw) => Ok(*raw),
            Self::Reading(reading) => reading.raw.ok_or_else(|| not_a_number(name)),
        }
    }
}

/// Readings that show whether a motor still follows its command.
#[derive(Clone, PartialEq, Debug, Default)]
pub struct MotionState {
    /// The fault that stopped it.
    pub fault: Option<FaultReport>,
    /// The motor has power; `None` while that is not known.
    pub enabled: Option<bool>,
    /// rad/s, or m/s on a linear axis; `None` while it is not known.
    pub velocity: Option<f64>,
    /// rad, or m on a linear axis; `None` while it is not known.
    pub position: Option<f64>,
    /// The name of the limit that holds the motor; `None` for none, or while that is not known.
    pub limit: Option<String>,
    /// The last error that the drive reported by itself since the motion began, and the time of its message. The drive
    /// may go on all the same. `None` for none, and always on a server.
    pub emergency: Option<(Instant, String)>,
}
