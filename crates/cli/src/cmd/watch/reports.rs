//! `watch --reports`: prints what a drive sends by itself.

use std::time::Duration;

use polepair::{Events, LocalAxis};
use polepair_core::profile::Signal;
use polepair_core::time::Instant;
use polepair_link::clock;

use super::{FIRST_MAX, FRESH_MIN, FRESH_PERIODS, WatchColumn, WatchCommand, normalize_name};
use crate::interrupt;
use crate::outcome;
use crate::problem::{Exit, Problem, Result};
use crate::session::LocalSession;

impl WatchCommand {
    /// Makes the drives send the signals every `interval` seconds, if one is given, shows them, and
    /// ends the sending.
    pub(super) fn print_reports(&self, session: &LocalSession, interval: Option<f64>) -> Result {
        let signals = self.reported_signals(session.axes())?;
        let interval = interval.map(Duration::from_secs_f64);
        let mut started = Vec::new();
        let mut shown = Ok(Exit::Ok);
        let wanted = interval
            .into_iter()
            .flat_map(|interval| session.axes().iter().map(move |axis| (axis, interval)));
        for (axis, interval) in wanted {
            started.push(axis);
            let set = axis.set_reports(&signals, interval);
            shown = shown.and_then(|exit| set.map(|()| exit).map_err(outcome::to_problem));
            if shown.is_err() {
                break;
            }
        }
        // One that refused its setting sends nothing; what else failed may have taken effect.
        if shown.as_ref().is_err_and(|problem| matches!(problem.exit, Exit::Usage | Exit::Refused))
        {
            started.pop();
        }
        if shown.is_ok() {
            shown = self.print_reported(session, &signals, interval);
        }
        started.into_iter().fold(shown, |shown, axis| {
            let ended = axis.set_reports(&[], Duration::ZERO);
            let ended = ended.map_err(|error| {
                let left = format!("{} may continue to send by itself", axis.label());
                outcome::to_problem(error).why(left).hint("try again: set its autosend to 0")
            });
            shown.and_then(|exit| ended.map(|()| exit))
        })
    }

    fn reported_signals(&self, axes: &[LocalAxis]) -> Result<Vec<Signal>> {
        let mut signals = Vec::new();
        for name in self.signal_names() {
            let wanted = normalize_name(name);
            let signal = Signal::from_name(&wanted);
            let has_signal =
                |axis: &LocalAxis| signal.is_some_and(|s| axis.profile().signal(s).is_some());
            match (signal, axes.iter().find(|axis| !has_signal(axis))) {
                (Some(signal), None) => signals.push(signal),
                // The default signals leave out what this drive lacks.
                (Some(_), Some(_)) if self.signals.is_empty() => {}
                (Some(_), Some(axis)) => {
                    let what = format!("{} does not report its {wanted}.", axis.label());
                    return Err(Problem::usage("E213", what));
                }
                (None, _) => {
                    let what = format!(
                        "--reports shows signals only, and `{name}` is not a \
                     signal."
                    );
                    return Err(
                        Problem::usage("E213", what).hint("`polepair watch --help` lists them.")
                    );
                }
            }
        }
        Ok(signals)
    }

    fn print_reported(
        &self,
        session: &LocalSession,
        signals: &[Signal],
        interval: Option<Duration>,
    ) -> Result {
        let events = session.link.events().map_err(outcome::to_problem)?;
        let period = interval.unwrap_or_default().max(Duration::from_secs_f64(1.0 / self.rate));
        let fresh = clock::scale_timeout(FRESH_MIN).max(period.mul_f64(FRESH_PERIODS));
        let began = session.now();
        let mut columns = Vec::new();
        for axis in session.axes() {
            for signal in signals {
                let first = clock::scale_timeout(FIRST_MAX).max(fresh);
                wait_for_report(&events, axis, *signal, began, first)?;
                columns.extend(reported_column(session, axis, *signal, fresh));
            }
        }
        self.print_rows(&columns, |until| read_until(&events, until))
    }
}

/// Reads what the drives send until then.
fn read_until(events: &Events, until: Instant) {
    loop {
        let left = until.since(clock::now());
        if left.is_zero() || interrupt::was_interrupted() {
            return;
        }
        if events.next(left).is_none() && events.in_virtual_time() {
            clock::sleep_until(until);
        }
    }
}

/// Waits until the drive has sent a signal since `began`.
fn wait_for_report(
    events: &Events,
    axis: &LocalAxis,
    signal: Signal,
    began: Instant,
    within: Duration,
) -> Result<()> {
    let end = axis.connection().now() + within;
    while !has_report_come(signal, began, axis) {
        if interrupt::was_interrupted() {
            return Err(Problem::interrupted());
        }
        let left = end.since(axis.connection().now());
        if left.is_zero() {
            let (label, name, within) = (axis.label(), signal.name(), within.as_secs_f64());
            let what = format!("{label} did not send {name} by itself within {within} s.");
            return Err(Problem::new(Exit::NoReply, "E401", what)
                .hint("--reports=100ms makes the drive send the signals, if it can.")
                .hint("Without --reports the drive is polled."));
        }
        let _ = events.next(left);
    }
    Ok(())
}

fn has_report_come(signal: Signal, began: Instant, axis: &LocalAxis) -> bool {
    axis.state().reading(signal).at.is_some_and(|at| at >= began)
}

/// The last value that came, where it is not older than `fresh`.
fn reported_column(
    session: &LocalSession,
    axis: &LocalAxis,
    signal: Signal,
    fresh: Duration,
) -> Option<WatchColumn> {
    let source = axis.profile().signal(signal)?;
    let is_code = source.is_flag() || source.mask != -1;
    let unit = (!is_code).then(|| axis.unit(source.parameter));
    let (number, its) = (axis.number(), axis.clone());
    let si_factor = unit.map_or(1.0, |unit| unit.si_factor());
    let name = format!("{}{}", session.axis_prefix(axis), signal.name());
    let unit = unit.map_or("", |unit| unit.symbol()).to_owned();
    Some(WatchColumn {
        number,
        link: None,
        name,
        unit,
        read: Box::new(move || {
            let reading = its.state().reading(signal);
            let now = its.connection().now();
            let value = reading.at.filter(|at| now.since(*at) <= fresh).map(|_| reading.value);
            Ok(value.map_or(f64::NAN, |value| value / si_factor))
        }),
    })
}
