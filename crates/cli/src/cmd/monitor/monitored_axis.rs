//! Polls the values of the axes without blocking.

use std::time::Duration;

use polepair::axis::{STOP_RETRY_MAX, StopOptions, StopPersistence, StopSupervisor, WireAirtime};
use polepair::interface::FaultReport;
use polepair::{Error, LocalAxis, RunningRequest, active_faults};
use polepair_core::error::Failure;
use polepair_core::profile::{ParameterId, Signal};
use polepair_core::time::Instant;

use crate::value;

/// Signals of every axis; the first that it has is read alone, to see whether it replies.
const SIGNALS: [Signal; 8] = [
    Signal::Position,
    Signal::Velocity,
    Signal::Fault,
    Signal::Enabled,
    Signal::Moving,
    Signal::Torque,
    Signal::Current,
    Signal::Mode,
];
/// Further signals of the selected axis.
const DETAILS: [Signal; 5] = [
    Signal::TargetPosition,
    Signal::TargetVelocity,
    Signal::Voltage,
    Signal::Temperature,
    Signal::Reached,
];
/// Questions to one axis that wait for their answers at once.
const IN_FLIGHT_MAX: usize = 4;
/// Pause after an axis did not reply.
const SILENT_PAUSE: Duration = Duration::from_secs(1);

/// An axis, and what is being asked of it.
pub struct MonitoredAxis {
    /// The axis.
    pub axis: LocalAxis,
    /// Stop of the axis, once it was requested.
    pub stopping: Option<StopSupervisor>,
    /// Begin and cause of its silence.
    pub silent: Option<(Instant, String)>,
    /// Parameters that it refuses.
    refused: Vec<ParameterId>,
    queue: Vec<ParameterId>,
    in_flight: Vec<(ParameterId, RunningRequest)>,
    next_round: Instant,
}

/// A value of an axis.
#[derive(Clone, Copy, PartialEq, Debug)]
pub struct DisplayValue {
    /// Value in its unit, or raw if its scale is unknown.
    pub value: f64,
    /// Raw.
    pub raw: i64,
    /// The unit's symbol; empty without one.
    pub unit: &'static str,
    /// The value's name, where it has one.
    pub word: Option<&'static str>,
    /// Age of the value.
    pub age: Duration,
}

/// Activity of an axis, in one word.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum AxisActivity {
    /// No value was received yet.
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

impl AxisActivity {
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

impl MonitoredAxis {
    /// An axis of which nothing was asked yet.
    pub fn new(axis: LocalAxis) -> Self {
        Self {
            axis,
            stopping: None,
            silent: None,
            refused: Vec::new(),
            queue: Vec::new(),
            in_flight: Vec::new(),
            next_round: Instant::ZERO,
        }
    }

    /// Asks what is to be asked now, and takes what was answered. Waits for nothing. True when a
    /// round of questions begins.
    pub fn poll(&mut self, period: Duration, chosen: bool) -> bool {
        let now = self.axis.connection().now();
        if let Some(stopping) = &mut self.stopping {
            // How far it came is on the screen.
            let _ = stopping.poll(&mut WireAirtime::default());
            if stopping.is_under_way() {
                return false;
            }
        }
        self.collect_answers();
        let due = self.in_flight.is_empty() && self.queue.is_empty() && now >= self.next_round;
        if due {
            self.queue_round(chosen);
            // Rounds that the drive was too slow for are left out, not caught up with.
            let on_time = self.next_round + period;
            self.next_round = if on_time > now { on_time } else { now + period };
        }
        self.start_reads();
        due
    }

    /// Waits for all outstanding reads. Ends early on an interrupt.
    pub fn wait_answers(&mut self) {
        while !(self.in_flight.is_empty() && self.queue.is_empty()) {
            let Some((_, running)) = self.in_flight.first_mut() else { return };
            if matches!(running.finish(), Err(Error::Interrupted { .. })) {
                return;
            }
            self.collect_answers();
            self.start_reads();
        }
    }

    /// Stops the axis. What was asked of it is forgotten: the stop goes first.
    pub fn stop(&mut self) {
        self.queue.clear();
        self.in_flight.clear();
        let persistence = StopPersistence::Within(STOP_RETRY_MAX);
        self.stopping =
            Some(StopSupervisor::begin(&self.axis, StopOptions::default(), persistence));
        self.next_round = Instant::ZERO;
    }

    fn queue_round(&mut self, chosen: bool) {
        let details = if chosen { &DETAILS[..] } else { &[] };
        for signal in SIGNALS.iter().chain(details) {
            let Some(source) = self.axis.profile().signal(*signal) else { continue };
            let id = source.parameter;
            if !self.queue.contains(&id) && !self.refused.contains(&id) {
                self.queue.push(id);
            }
        }
    }

    fn start_reads(&mut self) {
        // While it is unknown whether it replies, one question is enough.
        let known = self.silent.is_none() && self.has_readings();
        let max = if known { IN_FLIGHT_MAX } else { 1 };
        while self.in_flight.len() < max && !self.queue.is_empty() {
            match self.axis.start_read(self.queue[0]) {
                Ok(running) => self.in_flight.push((self.queue.remove(0), running)),
                Err(Error::Unsupported {
                    why: polepair_core::error::Unsupported::Busy, ..
                }) => break,
                Err(_) => self.refused.push(self.queue.remove(0)),
            }
        }
    }

    fn has_readings(&self) -> bool {
        let state = self.axis.state();
        Signal::ALL.iter().any(|signal| state.reading(*signal).at.is_some())
    }

    fn collect_answers(&mut self) {
        let mut at = 0;
        while at < self.in_flight.len() {
            let (id, running) = &mut self.in_flight[at];
            match running.poll() {
                Ok(None) => at += 1,
                Ok(Some(_)) => {
                    drop(self.in_flight.remove(at));
                    self.silent = None;
                }
                Err(error) => {
                    let id = *id;
                    drop(self.in_flight.remove(at));
                    self.handle_failure(id, &error);
                    at = 0;
                }
            }
        }
    }

    fn handle_failure(&mut self, id: ParameterId, error: &Error) {
        let failure = match error {
            Error::Failed { outcome, .. } => outcome.failure().unwrap_or(Failure::Cancelled),
            _ => Failure::Cancelled,
        };
        match failure {
            Failure::Silent | Failure::LinkDown | Failure::Misbehaved => {
                let now = self.axis.connection().now();
                let since = self.silent.as_ref().map_or(now, |(since, _)| *since);
                self.silent = Some((since, error.to_string()));
                self.queue.clear();
                self.in_flight.clear();
                self.next_round = now + SILENT_PAUSE;
            }
            Failure::Refused { .. } | Failure::Impossible(_) => self.refused.push(id),
            _ => {}
        }
    }

    /// The last value of a signal.
    pub fn display_value(&self, wanted: Signal) -> Option<DisplayValue> {
        let profile = self.axis.profile();
        let source = profile.signal(wanted)?;
        let parameter = profile.parameter(source.parameter)?;
        let reading = self.axis.state().reading(wanted);
        let age = self.axis.connection().now().since(reading.at?);
        let names = if source.values.is_empty() { parameter.values } else { source.values };
        let word = names.iter().find(|(raw, _)| *raw == reading.raw).map(|(_, word)| *word);
        let value = reading.value / parameter.unit.si_factor();
        let scaled = value.is_finite() && source.equals.is_none();
        Some(DisplayValue {
            value: if scaled { value } else { reading.raw as f64 },
            raw: reading.raw,
            unit: if scaled { parameter.unit.symbol() } else { "" },
            word,
            age,
        })
    }

    /// State of a flag; `None` if the drive does not report it.
    pub fn flag(&self, wanted: Signal) -> Option<bool> {
        self.display_value(wanted).map(|shown| shown.raw != 0)
    }

    /// Faults and warnings.
    pub fn faults(&self) -> Vec<FaultReport> {
        let shown = self.display_value(Signal::Fault);
        shown.map_or_else(Vec::new, |shown| active_faults(self.axis.profile(), shown.raw))
    }

    /// Activity of the axis.
    pub fn activity(&self) -> AxisActivity {
        let faults = self.faults();
        match self.flag(Signal::Enabled) {
            _ if self.silent.is_some() => AxisActivity::Silent,
            _ if !self.has_readings() => AxisActivity::Unknown,
            _ if faults.iter().any(|fault| !fault.is_warning) => AxisActivity::Fault,
            _ if self.is_turning() => AxisActivity::Turning,
            _ if !faults.is_empty() => AxisActivity::Warning,
            Some(true) => AxisActivity::Holding,
            Some(false) => AxisActivity::Off,
            // Nothing was measured that shows standstill.
            None if self.axis.is_turning().is_none() => AxisActivity::Unknown,
            None => AxisActivity::Standing,
        }
    }

    /// Returns whether it turned when its velocity was last read.
    pub fn is_turning(&self) -> bool {
        self.axis.is_turning() == Some(true)
    }

    /// The current, or the torque in its place.
    pub fn effort(&self) -> Option<DisplayValue> {
        self.display_value(Signal::Torque).or_else(|| self.display_value(Signal::Current))
    }

    /// The age of the oldest value that the table shows.
    pub fn age(&self) -> Option<Duration> {
        let shown = SIGNALS.iter().filter_map(|signal| self.display_value(*signal));
        shown.map(|shown| shown.age).max()
    }

    /// `5 x`: its number, and its name where it has one.
    pub fn name(&self) -> String {
        let number = polepair::url::AxisNumber(self.axis.number());
        match self.axis.name() {
            "" => number.to_string(),
            name => format!("{number} {name}"),
        }
    }
}

impl std::fmt::Display for DisplayValue {
    /// Formats the word, or the number with its unit.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match (self.word, self.unit) {
            (Some(word), _) => f.write_str(word),
            (None, "") => f.write_str(&value::format_number(self.value)),
            (None, unit) => write!(f, "{} {unit}", value::format_number(self.value)),
        }
    }
}
