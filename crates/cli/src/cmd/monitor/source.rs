//! The trait of the screen's data sources: a link, or a server.

use polepair::url::without_axes;
use std::time::Duration;

use polepair::axis::{StopProgress, StopSupervisor};
use polepair::url::shell_word;
use polepair_core::profile::Signal;

use super::local_printer::{trouble_counts, trouble_lines};
use super::model::Monitor;
use super::monitored_axis::{AxisActivity, DisplayValue, MonitoredAxis};
use super::traffic::TrafficLog;
use crate::problem::Result;

/// Source of a monitor: its frames and axes, and the commands to them.
pub trait MonitorSource {
    /// Connection string or name that the user gave.
    fn url(&self) -> &str;
    /// Time since the monitor started.
    fn age(&self) -> Duration;
    /// When it was begun, in nanoseconds since 1970, as frames have it.
    fn started_ns(&self) -> u64;
    /// The frames that pass.
    fn traffic(&self) -> &TrafficLog;
    /// Mutable access to the log, to clear it.
    fn traffic_mut(&mut self) -> &mut TrafficLog;
    /// Number of axes.
    fn count(&self) -> usize;
    /// Row of axis `n`, from 0.
    fn axis(&self, n: usize) -> AxisRow;
    /// Index of the chosen axis.
    fn chosen(&self) -> usize;
    /// Chooses one.
    fn choose(&mut self, n: usize);
    /// Returns whether it only listens: nothing can be stopped from here.
    fn is_listen_only(&self) -> bool;
    /// Reason why no values arrive, in one line.
    fn trouble(&self) -> Option<String>;
    /// Reason why motion is locked, in one line.
    fn lock(&self) -> Option<String>;
    /// Links that are not open, and what is missing of them, a line each.
    fn link_troubles(&self) -> Vec<String>;
    /// Counts of flaws of frames, by their words.
    fn flaw_counts(&self) -> Vec<(u64, &'static str)>;
    /// Text for no flaws.
    fn no_flaws_text(&self) -> &'static str;
    /// Takes received frames and values; waits for nothing.
    ///
    /// # Errors
    /// When it is gone and does not come back.
    fn poll(&mut self) -> Result<()>;
    /// Stops every axis.
    fn stop(&mut self);
    /// Reason why the stop could not be requested, in a line.
    fn stop_problem(&self) -> Option<String>;
    /// Notes for a user who leaves.
    fn exit_notes(&mut self) -> Vec<String>;
}

/// An axis.
pub struct AxisRow {
    /// Short, for the table.
    pub name: String,
    /// Label for people.
    pub label: String,
    /// The drive's word, and its full name.
    pub drive: [String; 2],
    /// Activity of the axis.
    pub activity: AxisActivity,
    /// Progress of its stop, once it was requested.
    pub stop: Option<StopSummary>,
    /// Mode of operation.
    pub mode: Option<ShownValue>,
    pub position: Option<ShownValue>,
    pub velocity: Option<ShownValue>,
    /// Torque, or the current in its place.
    pub effort: Option<ShownValue>,
    /// The age of the oldest value of the table.
    pub age: Option<Duration>,
    /// Troubles, a line each, and whether it stopped the drive.
    pub troubles: Vec<(String, bool)>,
    /// Further values of the selected axis, with or without a word.
    pub facts: Vec<(&'static str, ShownValue)>,
}

/// A value as it is written.
#[derive(Clone, Debug)]
pub struct ShownValue {
    pub text: String,
    pub age: Duration,
}

/// Progress of a stop.
pub struct StopSummary {
    pub state: StopState,
    /// After how long.
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

impl MonitorSource for Monitor {
    fn link_troubles(&self) -> Vec<String> {
        Vec::new()
    }

    fn url(&self) -> &str {
        &self.url
    }

    fn age(&self) -> Duration {
        self.age()
    }

    fn started_ns(&self) -> u64 {
        self.started_ns()
    }

    fn traffic(&self) -> &TrafficLog {
        &self.traffic
    }

    fn traffic_mut(&mut self) -> &mut TrafficLog {
        &mut self.traffic
    }

    fn count(&self) -> usize {
        self.axes.len()
    }

    fn axis(&self, n: usize) -> AxisRow {
        axis_row(&self.axes[n], n == self.chosen)
    }

    fn chosen(&self) -> usize {
        self.chosen
    }

    fn choose(&mut self, n: usize) {
        self.chosen = n;
    }

    fn is_listen_only(&self) -> bool {
        self.is_listening()
    }

    fn trouble(&self) -> Option<String> {
        let (since, error) = self.trouble()?;
        Some(format!("LINK DOWN for {} s: {error}. Trying to open it again.", since.as_secs()))
    }

    fn lock(&self) -> Option<String> {
        None
    }

    fn flaw_counts(&self) -> Vec<(u64, &'static str)> {
        trouble_counts(self, self.traffic.counts().1).into()
    }

    fn no_flaws_text(&self) -> &'static str {
        "none lost, late, foreign, corrupt or unanswered"
    }

    fn poll(&mut self) -> Result<()> {
        self.poll(&mut |_| ()).map(drop)
    }

    fn stop(&mut self) {
        self.stop();
    }

    fn stop_problem(&self) -> Option<String> {
        let link = shell_word(without_axes(&self.url));
        let output = format!("NOT STOPPED: this view only listens; polepair stop {link}");
        self.is_listening().then_some(output)
    }

    fn exit_notes(&mut self) -> Vec<String> {
        self.exit_notes()
    }
}

fn axis_row(watched: &MonitoredAxis, chosen: bool) -> AxisRow {
    let profile = watched.axis.profile();
    let details = [
        ("target", Signal::TargetPosition),
        ("target", Signal::TargetVelocity),
        ("supply", Signal::Voltage),
        ("", Signal::Temperature),
    ];
    let facts = details.into_iter().filter(|_| chosen);
    AxisRow {
        name: watched.name(),
        label: watched.axis.label(),
        drive: [profile.name.to_owned(), profile.title.to_owned()],
        activity: watched.activity(),
        stop: watched.stopping.as_ref().map(stop_summary),
        mode: signal_value(Signal::Mode, watched),
        position: signal_value(Signal::Position, watched),
        velocity: signal_value(Signal::Velocity, watched),
        effort: watched.effort().map(|shown| shown_value(&shown)),
        age: watched.age(),
        troubles: if chosen { trouble_lines(watched) } else { Vec::new() },
        facts: facts
            .filter_map(|(word, signal)| Some((word, signal_value(signal, watched)?)))
            .collect(),
    }
}

fn signal_value(signal: Signal, watched: &MonitoredAxis) -> Option<ShownValue> {
    watched.display_value(signal).map(|shown| shown_value(&shown))
}

fn stop_summary(stopping: &StopSupervisor) -> StopSummary {
    let class = match stopping.progress() {
        StopProgress::Sent => match stopping.failure() {
            Some(why) => StopState::Failed(why.to_string()),
            None => StopState::Sent,
        },
        StopProgress::Acknowledged => StopState::Acknowledged,
        StopProgress::Standstill => StopState::Standstill,
        StopProgress::Unobservable => StopState::Unobservable,
        StopProgress::Failed(why) => StopState::Failed(why.to_string()),
    };
    StopSummary { state: class, elapsed: stopping.elapsed() }
}

fn shown_value(shown: &DisplayValue) -> ShownValue {
    let text = match shown.word {
        Some(word) => word.to_owned(),
        None => format_steady(shown.value, shown.unit),
    };
    ShownValue { text, age: shown.age }
}

/// A value with as many decimals whatever it is, so that the eye finds it in its place.
pub fn format_steady(value: f64, unit: &str) -> String {
    match unit {
        "" => crate::value::format_number(value),
        "A" | "V" => format!("{value:.2} {unit}"),
        _ => format!("{value:.1} {unit}"),
    }
}
