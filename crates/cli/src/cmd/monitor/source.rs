//! Axes and links as a monitor shows them, and the trait of where they come from: a link of this program, or a
//! server.

use std::borrow::Cow;
use std::fmt;
use std::time::Duration;

use polepair::interface::FaultReport;
use polepair::url::AxisNumber;
use polepair_capture::DecodedFrame;
use polepair_core::profile::Signal;
use polepair_core::time::Instant;

use super::traffic::{FrameRow, TrafficLog};
use crate::problem::Result;
use crate::value;

/// Signals of the table of axes.
pub const TABLE_SIGNALS: [Signal; 8] = [
    Signal::Position,
    Signal::Velocity,
    Signal::Fault,
    Signal::Enabled,
    Signal::Moving,
    Signal::Torque,
    Signal::Current,
    Signal::Mode,
];
/// Further signals of the selected axis, with the words before their values.
const DETAILS: [(&str, Signal); 4] = [
    ("target", Signal::TargetPosition),
    ("target", Signal::TargetVelocity),
    ("supply", Signal::Voltage),
    ("", Signal::Temperature),
];

/// Receives each frame.
pub type FrameSink<'a> = dyn FnMut(ShownFrame<'_>) + 'a;

/// A frame as its source explains it.
pub enum ShownFrame<'a> {
    /// Decoded by this program.
    Decoded(&'a DecodedFrame<'a>),
    /// Decoded by a server, which sends its meaning in a line.
    Explained {
        row: &'a FrameRow,
        /// Name of its link.
        link: &'a str,
    },
}

/// Source of the axes and frames of a monitor, which also carries out its stop.
pub trait MonitorSource {
    /// The present time of the source's clock: a simulation has its own.
    fn now(&self) -> Instant;

    /// Lets time pass on the source's clock.
    fn sleep(&self, span: Duration);

    /// Takes received frames into the log, and values of the axes. Returns whether a round of values is to be
    /// printed.
    ///
    /// # Errors
    /// The link or the server is lost and does not come back.
    fn poll(
        &mut self,
        chosen: usize,
        traffic: &mut TrafficLog,
        show: &mut FrameSink<'_>,
    ) -> Result<bool>;

    /// Every axis.
    fn axes(&self) -> Vec<AxisRow>;

    /// Condition of the links.
    fn status(&self) -> SourceStatus;

    /// Stops every axis.
    fn stop(&mut self);

    /// Notes for a user who leaves: stops that are not confirmed, and motors that turn.
    fn exit_notes(&mut self) -> Vec<String>;
}

/// Condition of the links of a source.
#[derive(Default)]
pub struct SourceStatus {
    /// True if the source only listens: nothing can be stopped from here.
    pub is_listen_only: bool,
    /// Reason why no values arrive, in one line.
    pub trouble: Option<String>,
    /// Reason why motion is locked, in one line.
    pub lock: Option<String>,
    /// Links of a server.
    pub links: Vec<LinkReport>,
    /// Counts of flaws that the source's hosts and adapters found, with their words.
    pub flaws: Vec<(u64, &'static str)>,
    /// Units that were received and could not be handed on.
    pub lost: u64,
    /// Reason why the stop could not be requested, in a line.
    pub stop_problem: Option<String>,
}

/// Condition of one link of a server.
pub struct LinkReport {
    /// The server's number of the link.
    pub id: u16,
    /// Connection string of the link.
    pub url: String,
    /// `open`, `lost` or `not_open`.
    pub state: &'static str,
    /// Code of the error that closed it; empty without one.
    pub code: String,
    /// Troubles, a line each.
    pub troubles: Vec<String>,
}

/// An axis.
pub struct AxisRow {
    /// Address of the drive.
    pub number: u32,
    /// The link of a server that it is on.
    pub link: Option<u16>,
    /// Name in a rack file; empty without one.
    pub name: String,
    /// Label for people.
    pub label: String,
    /// Word of the protocol.
    pub protocol: String,
    /// Word of the drive's profile.
    pub profile: String,
    /// The product's full name.
    pub title: String,
    /// Activity of the axis.
    pub activity: AxisActivity,
    /// Progress of its stop, once it was requested.
    pub stop: Option<StopSummary>,
    /// Last value of each signal.
    pub signals: Vec<SignalRow>,
    /// Troubles, a line each.
    pub troubles: Vec<Trouble>,
    /// The client that controls it, on a server.
    pub owner: Option<String>,
}

impl AxisRow {
    /// Address and name for the table: `5 x`, on a server `0#5 x`.
    pub fn short_name(&self) -> String {
        let number = AxisNumber(self.number);
        let number = match self.link {
            Some(link) => format!("{link}#{number}"),
            None => number.to_string(),
        };
        if self.name.is_empty() { number } else { format!("{number} {}", self.name) }
    }

    /// The last value of a signal.
    pub fn signal(&self, signal: Signal) -> Option<&SignalRow> {
        self.signals.iter().find(|row| row.signal == signal)
    }

    /// Torque, or the current in its place.
    pub fn effort(&self) -> Option<&SignalRow> {
        self.signal(Signal::Torque).or_else(|| self.signal(Signal::Current))
    }

    /// Age of the oldest value of the table.
    pub fn age(&self) -> Option<Duration> {
        let shown = self.signals.iter().filter(|row| TABLE_SIGNALS.contains(&row.signal));
        shown.map(|row| row.age).max()
    }

    /// Further values, each with the word before it.
    pub fn details(&self) -> impl Iterator<Item = (&'static str, &SignalRow)> {
        DETAILS.into_iter().filter_map(|(word, signal)| Some((word, self.signal(signal)?)))
    }
}

/// A line about a trouble of an axis.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Trouble {
    pub line: String,
    /// True if the trouble stopped the drive.
    pub stops: bool,
}

/// The last value of a signal.
#[derive(Clone, PartialEq, Debug)]
pub struct SignalRow {
    pub signal: Signal,
    /// Value in [`unit`](Self::unit), or raw if its scale is unknown; NaN if the value is unknown.
    pub value: f64,
    /// Symbol of the unit; empty without one.
    pub unit: Cow<'static, str>,
    /// The value's word, if it has one.
    pub word: Option<Cow<'static, str>>,
    /// Time since the value was read.
    pub age: Duration,
}

impl SignalRow {
    /// A value with the same number of decimals for any value, so that the eye finds it in its place.
    pub fn steady_text(&self) -> String {
        match (&self.word, &*self.unit) {
            (Some(word), _) => word.clone().into_owned(),
            (None, "") => value::format_number(self.value),
            (None, unit @ ("A" | "V")) => format!("{:.2} {unit}", self.value),
            (None, unit) => format!("{:.1} {unit}", self.value),
        }
    }
}

impl fmt::Display for SignalRow {
    /// Formats the word, or the number with its unit.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.word {
            Some(word) => f.write_str(word),
            None => f.write_str(&value::format_amount(self.value, &self.unit)),
        }
    }
}

/// Activity of an axis, in one word.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum AxisActivity {
    /// No value was received yet, or none that shows motion.
    Unknown,
    /// The drive does not reply.
    Silent,
    /// A fault stopped it.
    Fault,
    /// Powered or not, with a warning.
    Warning,
    /// Turning.
    Turning,
    /// Powered and at standstill.
    Holding,
    /// At standstill, with unknown power.
    Standing,
    /// Without power.
    Off,
}

/// Readings that decide the activity of an axis.
pub struct ActivityReadings<'a> {
    /// The drive does not reply.
    pub is_silent: bool,
    /// A value was received.
    pub has_values: bool,
    pub faults: &'a [FaultReport],
    /// `None` if no reading shows it.
    pub is_turning: Option<bool>,
    /// `None` if no reading shows it.
    pub is_enabled: Option<bool>,
}

impl AxisActivity {
    /// The activity that readings show.
    pub fn from_readings(readings: &ActivityReadings<'_>) -> Self {
        let ActivityReadings { is_silent, has_values, faults, is_turning, is_enabled } = *readings;
        match is_enabled {
            _ if is_silent => Self::Silent,
            _ if !has_values => Self::Unknown,
            _ if faults.iter().any(|fault| !fault.is_warning) => Self::Fault,
            _ if is_turning == Some(true) => Self::Turning,
            _ if !faults.is_empty() => Self::Warning,
            Some(true) => Self::Holding,
            Some(false) => Self::Off,
            // No reading shows standstill.
            None if is_turning.is_none() => Self::Unknown,
            None => Self::Standing,
        }
    }

    /// The word.
    pub const fn word(self) -> &'static str {
        match self {
            Self::Unknown => "?",
            Self::Silent => "no answer",
            Self::Fault => "FAULT",
            Self::Warning => "warning",
            Self::Turning => "turns",
            Self::Holding => "holds",
            Self::Standing => "stopped",
            Self::Off => "off",
        }
    }
}

/// Lines for faults, with cause and remedy.
pub fn fault_lines(faults: &[FaultReport]) -> Vec<Trouble> {
    let mut lines = Vec::new();
    for fault in faults {
        let word = if fault.is_warning { "warning" } else { "FAULT" };
        let line = format!("{word} {}: {}", fault.name, fault.text);
        lines.push(Trouble { line, stops: !fault.is_warning });
        for (word, sentence) in [("cause", &fault.cause), ("remedy", &fault.remedy)] {
            if !sentence.is_empty() {
                lines.push(Trouble { line: format!("  {word}: {sentence}"), stops: false });
            }
        }
    }
    lines
}

/// Note for a user who leaves a motor that turned at its last reading.
pub fn turning_note(label: &str, velocity: Option<&SignalRow>, stop_command: &str) -> String {
    format!(
        "{label} turned{} at the last reading and was not stopped; to stop it: {stop_command}",
        speed_text(velocity)
    )
}

/// ` at 60 rpm`; empty without a reading.
pub fn speed_text(velocity: Option<&SignalRow>) -> String {
    velocity.map_or_else(String::new, |velocity| format!(" at {velocity}"))
}

/// Progress of a stop.
pub struct StopSummary {
    pub state: StopState,
    /// Time since the stop was requested, or until it was confirmed.
    pub elapsed: Duration,
}

/// Certain state of a stop.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum StopState {
    Sent,
    Acknowledged,
    Standstill,
    /// The drive acknowledged all of the stop, and reports nothing that would confirm standstill.
    Unobservable,
    Failed(String),
}

impl StopState {
    /// Returns whether it is an alarm.
    pub const fn is_failed(&self) -> bool {
        matches!(self, Self::Failed(_))
    }
}

/// An age for people.
pub fn format_age(age: Duration) -> String {
    match age.as_millis() {
        ms @ 0..1000 => format!("{ms} ms"),
        ms @ 1000..100_000 => format!("{:.1} s", ms as f64 / 1e3),
        ms => format!("{} s", ms / 1000),
    }
}
