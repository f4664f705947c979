//! Facts on an axis and on its parameters, known without a request.

use std::borrow::Cow;

use polepair_core::axis::Verb;
use polepair_core::profile::{Access, AxisKind, Parameter, Signal, same_name};

/// Facts on an axis, known without a request.
#[derive(Clone, PartialEq, Debug)]
pub struct AxisFacts {
    /// The drive's address on the wire, or a group, as in [`AxisNumber`](crate::url::AxisNumber).
    pub number: u32,
    /// Name in a rack file; empty without one.
    pub name: String,
    /// `axis 1`, or `axis 1 (x)` if it has a name.
    pub label: String,
    /// The protocol's word.
    pub protocol: String,
    /// The profile's word: `tmcm-170`.
    pub profile: String,
    /// The product's full name.
    pub title: String,
    /// Rotary, linear or ratio.
    pub kind: AxisKind,
    /// Checks before the first motion; may be empty.
    pub caution: String,
    /// Reaction of the drive when its host falls silent, in a sentence.
    pub watchdog_rule: String,
    /// The kind of its watchdog.
    pub watchdog: WatchdogKind,
    /// The drive is simulated.
    pub is_simulated: bool,
    /// Verbs of the axis.
    pub verbs: Vec<Verb>,
    /// The signals that it reports.
    pub signals: Vec<Signal>,
}

/// Protection of a drive against a silent host.
#[derive(Clone, PartialEq, Debug)]
pub enum WatchdogKind {
    /// Nothing.
    None,
    /// The drive stops after this time, in seconds.
    Fixed(f64),
    /// A parameter has the time.
    Configurable(String),
    /// The drive watches a heartbeat; the parameter states its sender. `None` if this link sends none.
    Heartbeat(Option<String>),
}

/// A parameter, without its value.
#[derive(Clone, PartialEq, Debug)]
pub struct ParameterDescription {
    /// The name that users type.
    pub name: Cow<'static, str>,
    /// Designation in the manual.
    pub symbol: Cow<'static, str>,
    /// Description of the parameter.
    pub about: Cow<'static, str>,
    /// Unit; empty for none.
    pub unit: Cow<'static, str>,
    /// `number`, `text` or `bytes`.
    pub kind: Cow<'static, str>,
    /// Least and greatest raw value.
    pub raw_range: (i64, i64),
    /// Raw value from the factory.
    pub raw_default: Option<i64>,
    /// True if it can be read.
    pub readable: bool,
    /// True if it can be written.
    pub writable: bool,
    /// Persistence of a written value: `volatile`, `storable`, `always`, `unless-ram`.
    pub persistence: Cow<'static, str>,
    /// Writing it may move the motor.
    pub moves: bool,
    /// Names of raw values.
    pub words: Vec<(i64, Cow<'static, str>)>,
    /// The part of the manual that it belongs to.
    pub section: Cow<'static, str>,
}

impl ParameterDescription {
    /// Returns whether this is its name or its symbol, as users type it.
    #[must_use]
    pub fn is_called(&self, name: &str) -> bool {
        same_name(&self.name, name) || same_name(&self.symbol, name)
    }
}

impl From<&Parameter> for ParameterDescription {
    fn from(parameter: &Parameter) -> Self {
        let words = parameter.values.iter().map(|(raw, word)| (*raw, Cow::Borrowed(*word)));
        Self {
            name: parameter.name.into(),
            symbol: parameter.symbol.into(),
            about: parameter.about.into(),
            unit: parameter.unit.symbol().into(),
            kind: parameter.encoding.kind().into(),
            raw_range: (parameter.min, parameter.max),
            raw_default: parameter.default,
            readable: parameter.access != Access::Write,
            writable: parameter.access != Access::Read,
            persistence: parameter.persistence.name().into(),
            moves: parameter.moves,
            words: words.collect(),
            section: parameter.section.into(),
        }
    }
}
