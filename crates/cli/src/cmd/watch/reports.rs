//! `watch --reports`: prints what a drive sends by itself.

use std::cell::RefCell;
use std::collections::HashMap;
use std::rc::Rc;
use std::time::Duration;

use polepair::events::EventKind;
use polepair::{Event, Events, LocalAxis};
use polepair_core::profile::{ParameterId, Signal};
use polepair_core::time::Instant;
use polepair_link::clock;

use super::{FIRST_MAX, FRESH_MIN, FRESH_PERIODS, WatchColumn, WatchCommand, normalize_name};
use crate::interrupt;
use crate::outcome;
use crate::problem::{Exit, Problem, Result};
use crate::session::LocalSession;

/// A value that a drive sends: a parameter, and the signal that it is the source of.
#[derive(Clone)]
struct ReportedValue {
    /// The axis' place in the link.
    index: usize,
    axis: LocalAxis,
    name: String,
    parameter: ParameterId,
    signal: Option<Signal>,
}

/// When a value arrived, and in the shown unit.
type TimedValue = (Instant, f64);

/// Values of parameters that are no signals, by axis and parameter.
#[derive(Clone, Default)]
struct ReceivedValues(Rc<RefCell<HashMap<(usize, ParameterId), TimedValue>>>);

impl WatchCommand {
    /// Makes the drives send the values every `interval` seconds, if one is given, shows them, and ends the sending.
    pub(super) fn print_reports(&self, session: &LocalSession, interval: Option<f64>) -> Result {
        let values = self.reported_values(session.axes())?;
        let interval = interval.map(Duration::from_secs_f64);
        let mut started = Vec::new();
        let wanted = interval.into_iter().flat_map(|interval| {
            session.axes().iter().enumerate().map(move |(index, axis)| (index, axis, interval))
        });
        for (index, axis, interval) in wanted {
            let own = values.iter().filter(|value| value.index == index);
            let parameters: Vec<ParameterId> = own.map(|value| value.parameter).collect();
            // Those that were started before are set back when they are dropped.
            let reports = axis.start_reports(&parameters, interval);
            started.push((axis, reports.map_err(outcome::to_problem)?));
        }
        let shown = self.print_reported(session, &values, interval);
        started.into_iter().fold(shown, |shown, (axis, reports)| {
            let ended = reports.end().map_err(|error| {
                let left = format!("{} may continue to send by itself", axis.label());
                outcome::to_problem(error).why(left).hint("try again, or switch it off and on")
            });
            shown.and_then(|exit| ended.map(|()| exit))
        })
    }

    /// Finds each name on each axis. The default signals leave out what a drive lacks.
    fn reported_values(&self, axes: &[LocalAxis]) -> Result<Vec<ReportedValue>> {
        let mut values = Vec::new();
        for (index, axis) in axes.iter().enumerate() {
            for name in self.signal_names() {
                let (parameter, signal) = match axis.find_signal_or_parameter(name) {
                    Ok(found) => found,
                    Err(_) if self.signals.is_empty() => continue,
                    Err(_) if Signal::from_name(&normalize_name(name)).is_some() => {
                        let (label, signal) = (axis.label(), normalize_name(name));
                        let what = format!("{label} does not report its {signal}.");
                        return Err(Problem::usage("E213", what));
                    }
                    Err(error) => return Err(outcome::to_problem(error)),
                };
                let signal = signal.or_else(|| source_of(axis, parameter));
                let name = normalize_name(name);
                values.push(ReportedValue { index, axis: axis.clone(), name, parameter, signal });
            }
        }
        Ok(values)
    }

    fn print_reported(
        &self,
        session: &LocalSession,
        values: &[ReportedValue],
        interval: Option<Duration>,
    ) -> Result {
        let events = session.link.events().map_err(outcome::to_problem)?;
        let period = interval.unwrap_or_default().max(Duration::from_secs_f64(1.0 / self.rate));
        let fresh = clock::scale_timeout(FRESH_MIN).max(period.mul_f64(FRESH_PERIODS));
        let began = session.now();
        let received = ReceivedValues::default();
        let mut columns = Vec::new();
        for value in values {
            let first = clock::scale_timeout(FIRST_MAX).max(fresh);
            value.wait(&events, &received, began, first)?;
            columns.push(value.column(session, &received, fresh));
        }
        self.print_rows(&columns, |until| received.read_until(&events, until))
    }
}

/// The signal whose value is the whole parameter: it comes as that signal.
fn source_of(axis: &LocalAxis, parameter: ParameterId) -> Option<Signal> {
    Signal::ALL.into_iter().find(|signal| {
        let source = axis.profile().signal(*signal);
        source.is_some_and(|s| s.parameter == parameter && !s.is_flag() && s.mask == -1)
    })
}

impl ReceivedValues {
    fn note(&self, event: &Event) {
        if let EventKind::Parameter { parameter, value, .. } = event.kind {
            self.0.borrow_mut().insert((event.index, parameter), (event.at, value));
        }
    }

    /// Reads what the drives send until then.
    fn read_until(&self, events: &Events, until: Instant) {
        loop {
            let left = until.since(clock::now());
            if left.is_zero() || interrupt::was_interrupted() {
                return;
            }
            match events.next(left) {
                Some(event) => self.note(&event),
                None if events.in_virtual_time() => clock::sleep_until(until),
                None => {}
            }
        }
    }
}

impl ReportedValue {
    /// Waits until the drive has sent the value since `began`.
    fn wait(
        &self,
        events: &Events,
        received: &ReceivedValues,
        began: Instant,
        within: Duration,
    ) -> Result<()> {
        let axis = &self.axis;
        let end = axis.connection().now() + within;
        while self.last(received).is_none_or(|(at, _)| at < began) {
            if interrupt::was_interrupted() {
                return Err(Problem::interrupted());
            }
            let left = end.since(axis.connection().now());
            if left.is_zero() {
                let (label, name, within) = (axis.label(), &self.name, within.as_secs_f64());
                let what = format!("{label} did not send {name} by itself within {within} s.");
                return Err(Problem::new(Exit::NoReply, "E401", what)
                    .hint("--reports=100ms makes the drive send the values, if it can.")
                    .hint("Without --reports the drive is polled."));
            }
            if let Some(event) = events.next(left) {
                received.note(&event);
            }
        }
        Ok(())
    }

    /// The last value that came, in the shown unit, and when.
    fn last(&self, received: &ReceivedValues) -> Option<TimedValue> {
        match self.signal {
            Some(signal) => {
                let reading = self.axis.state().reading(signal);
                Some((reading.at?, reading.value / self.si_factor()))
            }
            None => received.0.borrow().get(&(self.index, self.parameter)).copied(),
        }
    }

    /// Returns whether the value has a unit: flags, codes and modes have none.
    fn has_unit(&self) -> bool {
        let source = self.signal.and_then(|signal| self.axis.profile().signal(signal));
        source.is_none_or(|source| !source.is_flag() && source.mask == -1)
    }

    fn si_factor(&self) -> f64 {
        if self.has_unit() { self.axis.unit(self.parameter).si_factor() } else { 1.0 }
    }

    /// The last value that came, where it is not older than `fresh`.
    fn column(
        &self,
        session: &LocalSession,
        received: &ReceivedValues,
        fresh: Duration,
    ) -> WatchColumn {
        let (value, received) = (self.clone(), received.clone());
        let unit = if self.has_unit() { self.axis.unit(self.parameter).symbol() } else { "" };
        WatchColumn {
            number: self.axis.number(),
            link: None,
            name: format!("{}{}", session.axis_prefix(&self.axis), self.name),
            unit: unit.to_owned(),
            read: Box::new(move || {
                let now = value.axis.connection().now();
                let last = value.last(&received).filter(|(at, _)| now.since(*at) <= fresh);
                Ok(last.map_or(f64::NAN, |(_, number)| number))
            }),
        }
    }
}
