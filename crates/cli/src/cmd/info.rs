//! `polepair info URL`

use clap::Args;
use polepair::axis::DeviceDetail;
use polepair::doctor::{ABSENT_TEXT, is_absent_error};
use polepair::interface::FaultReport;
use polepair::remote::{RemoteAxis, format_signal};
use polepair::{Axis, LocalAxis};
use polepair_client::message::{AxisState, SignalValue};
use polepair_core::profile::{Signal, SignalSource};

use crate::cmd::watchdog::watchdog_text;
use crate::data_output::DataOutput;
use crate::outcome;
use crate::problem::{Exit, Problem, Result};
use crate::remote::ServerArgs;
use crate::session::read_signal;
use crate::target::DriveArgs;
use crate::terminal::{TextTable, print_note, print_warning};

/// Shows the identity of a drive, its state, and its faults in words.
#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  polepair info tmcl+serial:///dev/ttyUSB0:9600#1
  polepair info sim:modbus-rtu")]
pub struct Info {
    #[command(flatten)]
    target: DriveArgs,
}

impl Info {
    /// Shows the axes of a link of this program, or of a server.
    pub fn run(self, server: ServerArgs) -> Result {
        let (session, mut failed) = self.target.connect_present(server)?;
        session.listen_for_interrupts();
        let mut out = DataOutput::stdout();
        let mut shown = 0;
        for axis in session.axes() {
            let report = match (axis.local(), axis.remote()) {
                (Some(local), _) => AxisReport::read(axis, local),
                (None, Some(remote)) => AxisReport::read_remote(axis, remote),
                (None, None) => continue,
            };
            match report {
                Ok(report) => {
                    out.buffer().extend_from_slice(report.text().as_bytes());
                    match report.silent {
                        Some(problem) => failed.push(problem),
                        None => shown += 1,
                    }
                }
                // Without its link no further axis can be read.
                Err(problem) if matches!(problem.exit, Exit::Adapter | Exit::Interrupted) => {
                    out.flush()?;
                    return Err(problem);
                }
                Err(problem) => failed.push(problem),
            }
        }
        out.flush()?;
        session.print_link_troubles();
        tally_result(failed, shown, session.link.remote().is_some())
    }
}

/// Result for several axes of which some did not reply. A server has old values of those.
fn tally_result(mut failed: Vec<Problem>, shown: usize, of_server: bool) -> Result {
    match (failed.len(), shown) {
        (0, _) => Ok(Exit::Ok),
        (_, 0) => Err(failed.remove(0)),
        (count, _) => {
            failed.iter().for_each(|problem| print_warning(problem.render(false).trim_end()));
            let what = format!("{count} of {} axes could not be read.", count + shown);
            let why = if of_server { "Their values are old." } else { "The others are shown." };
            Err(Problem::new(Exit::Partial, "E704", what).why(why))
        }
    }
}

/// Age above which a value is shown with it, ms.
const OLD_MS: f64 = 1500.0;

/// Identity, state and faults of an axis.
struct AxisReport {
    title: String,
    /// Words and values.
    rows: Vec<(String, String)>,
    faults: Vec<FaultReport>,
    /// The axis has a stop whose standstill is not confirmed.
    has_pending_stop: bool,
    caution: String,
    /// Reason why the values are old.
    silent: Option<Problem>,
}

impl AxisReport {
    fn new(axis: &Axis) -> Self {
        let facts = axis.facts();
        let profile = format!("{} ({})", facts.profile, facts.protocol);
        Self {
            title: format!("{}: {}", axis.label(), facts.title),
            rows: vec![("profile".to_owned(), profile)],
            faults: Vec::new(),
            has_pending_stop: false,
            caution: facts.caution.clone(),
            silent: None,
        }
    }

    fn push(&mut self, word: &str, value: String) {
        self.rows.push((word.to_owned(), value));
    }

    fn push_details(&mut self, details: Vec<DeviceDetail>) {
        self.rows.extend(details.into_iter().map(|detail| (detail.name.into(), detail.text)));
    }

    /// Reads an axis on a link of this program.
    fn read(axis: &Axis, local: &LocalAxis) -> Result<Self> {
        let mut report = Self::new(axis);
        report.push("known", local.identified().to_string());
        report.push_details(local.device_details().map_err(outcome::to_problem)?);
        for signal in Signal::ALL {
            if signal == Signal::Fault {
                continue;
            }
            match signal_text(local, signal) {
                Ok(Some(shown)) => report.push(signal.name(), shown),
                Ok(None) => {}
                Err(problem) => report.push(signal.name(), absent_text(local, signal, problem)?),
            }
        }
        for (kind, text) in local.describe_units().map_err(outcome::to_problem)? {
            report.push(&format!("{kind} unit"), text);
        }
        report.push("watchdog", watchdog_text(&axis.watchdog().map_err(outcome::to_problem)?));
        match axis.faults().map_err(outcome::to_problem) {
            Ok(faults) => report.faults = faults,
            Err(problem) => {
                let why = absent_text(local, Signal::Fault, problem)?;
                report.push("faults", format!("not known: {why}"));
                return Ok(report);
            }
        }
        if report.faults.is_empty() {
            report.push("faults", "none".to_owned());
        }
        Ok(report)
    }

    /// Reads the state that a server has of an axis. A silent drive is not read any further.
    fn read_remote(axis: &Axis, remote: &RemoteAxis) -> Result<Self> {
        let mut report = Self::new(axis);
        let state = remote.fresh_state().map_err(outcome::to_problem)?;
        report.silent = remote.silent_error(&state).map(outcome::to_problem);
        let mut watchdog = remote.info().watchdog.clone();
        if report.silent.is_none() {
            match axis.device_details() {
                Ok(details) => report.push_details(details),
                Err(error) => print_note(&format!("its details cannot be read: {error}")),
            }
            watchdog = axis.watchdog().map_or(watchdog, |read| watchdog_text(&read));
        }
        for read in state.signals.iter().filter(|read| read.signal != Signal::Fault.name()) {
            report.push(&read.signal, remote_signal_text(remote, &state, read) + &age_note(read));
        }
        report.push("armed", if state.armed { "yes" } else { "no" }.to_owned());
        let owner = state.lease.as_ref().map_or("no client", |lease| &lease.owner);
        report.push("controlled by", owner.to_owned());
        report.push("watchdog", watchdog);
        if state.faults.is_empty() {
            let read = state.signals.iter().find(|read| read.signal == Signal::Fault.name());
            report.push("faults", "none".to_owned() + &read.map_or_else(String::new, age_note));
        }
        report.has_pending_stop = state.pending_stop.is_some();
        report.faults = state.faults.into_iter().map(FaultReport::from).collect();
        Ok(report)
    }

    fn text(&self) -> String {
        let mut table = TextTable::default();
        for (word, value) in &self.rows {
            table.add_row([format!("  {word}"), value.clone()]);
        }
        let mut text = format!("{}\n{}", self.title, table.render(false));
        if self.has_pending_stop {
            text.push_str(
                "  MAY BE TURNING: it received a stop, but its standstill is not confirmed; cut \
                 its supply\n",
            );
        }
        for fault in &self.faults {
            let word = if fault.is_warning { "warning" } else { "FAULT" };
            text.push_str(&format!("  {word} {}: {}\n", fault.name, fault.text));
            for (word, sentence) in [("cause", &fault.cause), ("remedy", &fault.remedy)] {
                if !sentence.is_empty() {
                    text.push_str(&format!("    {word:<7} {sentence}\n"));
                }
            }
        }
        text + &caution_text(&self.caution)
    }
}

/// A signal as a server reported it.
fn remote_signal_text(axis: &RemoteAxis, state: &AxisState, read: &SignalValue) -> String {
    let flags = [Signal::Enabled, Signal::Moving, Signal::Reached];
    let Some(value) = read.value else { return "not known".to_owned() };
    if read.signal == Signal::Moving.name() {
        // The speed shows it as well as the drive's own flag.
        return if state.moving == Some(true) { "yes" } else { "no" }.to_owned();
    }
    if flags.iter().any(|flag| flag.name() == read.signal) {
        return if value != 0.0 { "yes" } else { "no" }.to_owned();
    }
    if read.signal == Signal::Mode.name() {
        return state.mode.clone().unwrap_or_default();
    }
    format_signal(axis.info(), &read.signal, value, &read.unit)
}

/// Age of a value, if it is old.
fn age_note(read: &SignalValue) -> String {
    if read.age_ms > OLD_MS { format!(" ({:.1} s old)", read.age_ms / 1e3) } else { String::new() }
}

/// Checks before the first motion, in lines of a terminal's width.
fn caution_text(caution: &str) -> String {
    const WIDTH: usize = 96;
    let mut lines: Vec<String> = Vec::new();
    for word in caution.split_whitespace() {
        match lines.last_mut().filter(|line| line.chars().count() + word.len() < WIDTH) {
            Some(line) => line.extend([" ", word]),
            None => lines.push(word.to_owned()),
        }
    }
    if lines.is_empty() {
        String::new()
    } else {
        format!("  caution\n    {}\n", lines.join("\n    "))
    }
}

/// Text for a signal that could not be read, if this drive lacks it.
fn absent_text(axis: &LocalAxis, wanted: Signal, problem: Problem) -> Result<String> {
    let source = axis.profile().signal(wanted).filter(|_| problem.exit == Exit::Refused);
    let Some(source) = source else { return Err(problem) };
    match axis.read(source.parameter) {
        Err(error) if is_absent_error(axis, &error) => Ok(ABSENT_TEXT.to_owned()),
        _ => Err(problem),
    }
}

/// A signal's value in words or in its unit.
pub fn signal_text(axis: &LocalAxis, wanted: Signal) -> Result<Option<String>> {
    let flag = axis.profile().signal(wanted).is_some_and(SignalSource::is_flag);
    let value = read_signal(axis, wanted)?;
    Ok(value.map(|value| match (wanted, flag) {
        (Signal::Moving, _) => if is_axis_moving(axis) { "yes" } else { "no" }.to_owned(),
        (_, true) => if value.raw != 0 { "yes" } else { "no" }.to_owned(),
        (_, false) => value.to_string(),
    }))
}

fn is_axis_moving(axis: &LocalAxis) -> bool {
    // The speed, which was read before, shows motion as well as the drive's own flag.
    axis.moving(&axis.state()) == Some(true)
}
