//! Polls the values of the axes without blocking.

use std::borrow::Cow;
use std::time::Duration;

use polepair::axis::{
    STOP_RETRY_MAX, StopOptions, StopPersistence, StopProgress, StopSupervisor, WireAirtime,
};
use polepair::interface::FaultReport;
use polepair::url::shell_word;
use polepair::{Error, LocalAxis, RunningRequest, active_faults};
use polepair_core::error::Failure;
use polepair_core::profile::{ParameterId, Signal};
use polepair_core::time::Instant;

use super::source::{
    ActivityReadings, AxisActivity, AxisRow, SignalRow, StopState, StopSummary, TABLE_SIGNALS,
    Trouble, fault_lines, turning_note,
};

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

/// An axis, and its open query.
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

    /// Sends the next query, and takes replies. Waits for nothing. True when a
    /// round of queries begins.
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

    /// Stops the axis. Its open query is forgotten: the stop goes first.
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
        for signal in TABLE_SIGNALS.iter().chain(details) {
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
    pub fn signal_row(&self, wanted: Signal) -> Option<SignalRow> {
        let profile = self.axis.profile();
        let source = profile.signal(wanted)?;
        let parameter = profile.parameter(source.parameter)?;
        let reading = self.axis.state().reading(wanted);
        let age = self.axis.connection().now().since(reading.at?);
        let names = if source.values.is_empty() { parameter.values } else { source.values };
        let word = names.iter().find(|(raw, _)| *raw == reading.raw).map(|(_, word)| *word);
        let value = reading.value / parameter.unit.si_factor();
        let scaled = value.is_finite() && !source.is_flag();
        Some(SignalRow {
            signal: wanted,
            value: if scaled { value } else { reading.raw as f64 },
            unit: if scaled { parameter.unit.symbol() } else { "" }.into(),
            word: word.map(Cow::Borrowed),
            age,
        })
    }

    /// The axis as it is shown.
    pub fn row(&self) -> AxisRow {
        let profile = self.axis.profile();
        let faults = self.faults();
        let silence =
            self.silent.as_ref().map(|(_, why)| Trouble { line: why.clone(), stops: true });
        AxisRow {
            number: self.axis.number(),
            link: None,
            name: self.axis.name().to_owned(),
            label: self.axis.label(),
            protocol: self.axis.protocol().to_owned(),
            profile: profile.name.to_owned(),
            title: profile.title.to_owned(),
            activity: AxisActivity::from_readings(&ActivityReadings {
                is_silent: self.silent.is_some(),
                has_values: self.has_readings(),
                faults: &faults,
                is_turning: self.axis.is_turning(),
                is_enabled: self.raw(Signal::Enabled).map(|raw| raw != 0),
            }),
            stop: self.stopping.as_ref().map(stop_summary),
            signals: Signal::ALL.into_iter().filter_map(|signal| self.signal_row(signal)).collect(),
            troubles: silence.into_iter().chain(fault_lines(&faults)).collect(),
            owner: None,
        }
    }

    /// Faults and warnings.
    fn faults(&self) -> Vec<FaultReport> {
        let word = self.raw(Signal::Fault);
        word.map_or_else(Vec::new, |word| active_faults(self.axis.profile(), word))
    }

    /// Raw value of a signal; `None` before the first, or if the drive does not report it.
    fn raw(&self, wanted: Signal) -> Option<i64> {
        self.axis.profile().signal(wanted)?;
        let reading = self.axis.state().reading(wanted);
        reading.at.map(|_| reading.raw)
    }

    /// Stops that are not confirmed, and a motor that turns, for a user who leaves. Waits for a running stop, at most
    /// for this time.
    pub fn exit_note(&mut self, url: &str, within: Duration) -> Option<String> {
        let label = self.axis.label();
        if let Some(stopping) = &mut self.stopping {
            let mut airtime = WireAirtime::default();
            stopping.give_up();
            while stopping.wait(&mut airtime, within).is_some() {}
            let failed = match stopping.result() {
                Some(ended) => ended.standstill.as_ref().err(),
                None => stopping.failure(),
            };
            if let Some(why) = failed {
                return Some(format!("{label} may not have stopped: {why}"));
            }
        }
        let stop = format!("polepair stop {}", shell_word(url));
        let velocity = self.signal_row(Signal::Velocity);
        self.axis.is_turning()?.then(|| turning_note(&label, velocity.as_ref(), &stop))
    }
}

fn stop_summary(stopping: &StopSupervisor) -> StopSummary {
    let state = match stopping.progress() {
        StopProgress::Sent => match stopping.failure() {
            Some(why) => StopState::Failed(why.to_string()),
            None => StopState::Sent,
        },
        StopProgress::Acknowledged => StopState::Acknowledged,
        StopProgress::Standstill => StopState::Standstill,
        StopProgress::Unobservable => StopState::Unobservable,
        StopProgress::Failed(why) => StopState::Failed(why.to_string()),
    };
    StopSummary { state, elapsed: stopping.elapsed() }
}
