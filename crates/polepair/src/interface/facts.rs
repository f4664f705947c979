//! What is known of an axis and of its parameters without a request.

use std::borrow::Cow;

use polepair_core::axis::Verb;
use polepair_core::profile::{Access, AxisKind, Parameter, Signal, same_name};

/// What is known of an axis without a request.
#[derive(Clone, PartialEq, Debug)]
pub struct AxisFacts {
    /// The drive's address on the wire, or a group, as in [`AxisNumber`](crate::url::AxisNumber).
    pub number: u32,
    /// Its name in a rack file; empty without one.
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
    /// What to check before the first motion; empty if there is nothing.
    pub caution: String,
    /// What the drive does when its host falls silent, in a sentence.
    pub watchdog_rule: String,
    /// The kind of its watchdog.
    pub watchdog: WatchdogKind,
    /// The drive is simulated.
    pub is_simulated: bool,
    /// Its verbs.
    pub verbs: Vec<Verb>,
    /// The signals that it reports.
    pub signals: Vec<Signal>,
}

/// What a drive has against a silent host.
#[derive(Clone, PartialEq, Debug)]
pub enum WatchdogKind {
    /// Nothing.
    None,
    /// It stops after this time, in seconds.
    Fixed(f64),
    /// A parameter has the time.
    Configurable(String),
    /// It watches a heartbeat; the parameter states whose. `None` if this link sends none.
    Heartbeat(Option<String>),
}

/// A parameter, without its value.
#[derive(Clone, PartialEq, Debug)]
pub struct ParameterDescription {
    /// The name that users type.
    pub name: Cow<'static, str>,
    /// What the manual calls it.
    pub symbol: Cow<'static, str>,
    /// What it does.
    pub about: Cow<'static, str>,
    /// Its unit; empty for none.
    pub unit: Cow<'static, str>,
    /// `number`, `text` or `bytes`.
    pub kind: Cow<'static, str>,
    /// Least and greatest raw value.
    pub raw_range: (i64, i64),
    /// Raw value from the factory.
    pub raw_default: Option<i64>,
    /// It can be read.
    pub readable: bool,
    /// It can be written.
    pub writable: bool,
    /// What a written value survives: `volatile`, `storable`, `always`, `unless-ram`.
    pub persistence: Cow<'static, str>,
    /// Writing it may move the motor.
    pub moves: bool,
    /// Names of raw values.
    pub words: Vec<(i64, Cow<'static, str>)>,
    /// The part of the manual that it belongs to.
    pub section: Cow<'static, str>,
}

impl ParameterDescription {
    /// Whether this is its name or its symbol, as users type it.
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
