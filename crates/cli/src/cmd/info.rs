//! `polepair info URL`

use clap::Args;
use polepair::axis::DeviceDetail;
use polepair::doctor::{ABSENT_TEXT, is_absent_error};
use polepair::remote::RemoteLink;
use polepair::{AxisInterface, LocalAxis};
use polepair_client::message::{AxisInfo, AxisState, SignalValue};
use polepair_core::profile::Signal;

use crate::cmd::watchdog::watchdog_text;
use crate::outcome;
use crate::problem::{Exit, Problem, Result};
use crate::remote::{self, ServerArgs};
use crate::session::read_signal;
use crate::target::DriveArgs;
use crate::terminal::{DataOutput, TextTable, print_note, print_warning};

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
    pub fn run(self) -> Result {
        let (session, mut failed) = self.target.open_present()?;
        session.listen_for_interrupts();
        let mut out = DataOutput::stdout();
        let mut shown = 0;
        for axis in session.axes() {
            match axis_text(axis) {
                Ok(text) => {
                    out.buffer().extend_from_slice(text.as_bytes());
                    shown += 1;
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
        missing_result(failed, shown)
    }
}

/// Result for several axes of which some could not be read.
fn missing_result(mut failed: Vec<Problem>, shown: usize) -> Result {
    match (failed.len(), shown) {
        (0, _) => Ok(Exit::Ok),
        (_, 0) => Err(failed.remove(0)),
        (count, _) => {
            failed.iter().for_each(|problem| print_warning(problem.render(false).trim_end()));
            let what = format!("{count} of {} axes could not be read.", count + shown);
            Err(Problem::new(Exit::Partial, "E704", what).why("The others are shown."))
        }
    }
}

impl Info {
    /// Runs the verb on a server.
    pub fn run_on_server(self, join: ServerArgs) -> Result {
        let mut out = DataOutput::stdout();
        let server = join.link(self.target.remote_axes()?)?;
        let (mut failed, mut shown) = (Vec::new(), 0);
        for axis in server.axes() {
            let state = axis.fresh_state().map_err(outcome::to_problem)?;
            let silent = axis.silent_error(&state);
            // A silent drive is not read any further.
            let watchdog = match silent {
                Some(_) => axis.info().watchdog.clone(),
                None => axis
                    .watchdog()
                    .map_or_else(|_| axis.info().watchdog.clone(), |report| watchdog_text(&report)),
            };
            let details = match silent {
                Some(_) => Vec::new(),
                None => axis.device_details().unwrap_or_else(|error| {
                    print_note(&format!("its details cannot be read: {error}"));
                    Vec::new()
                }),
            };
            let text = remote_text(axis.info(), &state, &details, watchdog);
            out.buffer().extend_from_slice(text.as_bytes());
            match silent {
                Some(error) => failed.push(outcome::to_problem(error)),
                None => shown += 1,
            }
        }
        out.flush()?;
        let links = server.bench().links.iter();
        for link in links.filter(|link| is_link_shown(link.id, &server)) {
            remote::link_troubles(link).iter().for_each(|line| print_note(line));
        }
        match failed.len() {
            0 => Ok(Exit::Ok),
            _ if shown == 0 => Err(failed.remove(0)),
            count => {
                failed.iter().for_each(|problem| print_warning(problem.render(false).trim_end()));
                let what = format!("{count} of {} axes do not answer.", count + shown);
                Err(Problem::new(Exit::Partial, "E704", what).why("Their values are old."))
            }
        }
    }
}

fn is_link_shown(link: u16, server: &RemoteLink) -> bool {
    server.axes().iter().any(|axis| axis.info().link == link)
}

/// Age above which a value is shown with it, ms.
const OLD_MS: f64 = 1500.0;

/// Knowledge of a server about an axis.
fn remote_text(
    axis: &AxisInfo,
    state: &AxisState,
    details: &[DeviceDetail],
    watchdog: String,
) -> String {
    let mut table = TextTable::default();
    let mut row = |word: &str, value: String| table.add_row([format!("  {word}"), value]);
    row("profile", format!("{} ({})", axis.profile, axis.protocol));
    details.iter().for_each(|detail| row(&detail.name, detail.text.clone()));
    for read in state.signals.iter().filter(|read| read.signal != Signal::Fault.name()) {
        let flag = [Signal::Enabled, Signal::Moving, Signal::Reached];
        let shown = match read.value {
            None => "not known".to_owned(),
            // The speed shows it as well as the drive's own flag.
            Some(_) if read.signal == Signal::Moving.name() => match state.moving {
                Some(true) => "yes".to_owned(),
                _ => "no".to_owned(),
            },
            Some(value) if flag.iter().any(|flag| flag.name() == read.signal) => {
                if value != 0.0 { "yes" } else { "no" }.to_owned()
            }
            Some(_) if read.signal == Signal::Mode.name() => state.mode.clone().unwrap_or_default(),
            Some(value) => remote::format_signal(axis, &read.signal, value, &read.unit),
        };
        row(&read.signal, shown + &age_note(read));
    }
    row("armed", if state.armed { "yes" } else { "no" }.to_owned());
    let owner = state.lease.as_ref().map_or("no client", |lease| &lease.owner);
    row("controlled by", owner.to_owned());
    row("watchdog", watchdog);
    if state.faults.is_empty() {
        let read = state.signals.iter().find(|read| read.signal == Signal::Fault.name());
        row("faults", "none".to_owned() + &read.map_or_else(String::new, age_note));
    }
    let mut text = format!("{}: {}\n{}", axis.label, axis.drive, table.render(false));
    if state.pending_stop.is_some() {
        text.push_str(
            "  MAY BE TURNING: it received a stop, but its standstill is not confirmed; cut its \
             supply\n",
        );
    }
    for fault in &state.faults {
        text.push_str(&format!("  FAULT {}\n", fault.name));
        text.push_str(&cause_and_remedy(&fault.cause, &fault.remedy));
    }
    text + &caution_text(&axis.caution)
}

/// Age of a value, if it is old.
fn age_note(read: &SignalValue) -> String {
    if read.age_ms > OLD_MS { format!(" ({:.1} s old)", read.age_ms / 1e3) } else { String::new() }
}

fn axis_text(axis: &LocalAxis) -> Result<String> {
    let profile = axis.profile();
    let mut table = TextTable::default();
    let mut row = |word: &str, value: String| table.add_row([format!("  {word}"), value]);
    row("profile", format!("{} ({})", profile.name, axis.protocol()));
    row("known", axis.identified().to_string());
    for detail in axis.device_details().map_err(outcome::to_problem)? {
        row(&detail.name, detail.text);
    }
    for signal in Signal::ALL {
        if signal == Signal::Fault {
            continue;
        }
        match signal_text(axis, signal) {
            Ok(Some(shown)) => row(signal.name(), shown),
            Ok(None) => {}
            Err(problem) => row(signal.name(), absent_text(axis, signal, problem)?),
        }
    }
    for (kind, text) in axis.describe_units().map_err(outcome::to_problem)? {
        row(&format!("{kind} unit"), text);
    }
    let watchdog = AxisInterface::watchdog(axis).map_err(outcome::to_problem)?;
    row("watchdog", watchdog_text(&watchdog));
    let faults = match faults_text(axis) {
        Ok(faults) => {
            if faults.is_empty() {
                row("faults", "none".to_owned());
            }
            faults
        }
        Err(problem) => {
            row("faults", format!("not told: {}", absent_text(axis, Signal::Fault, problem)?));
            String::new()
        }
    };
    let title = format!("{}: {}", axis.label(), profile.title);
    Ok(format!("{title}\n{}{faults}{}", table.render(false), caution_text(profile.caution)))
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
    let flag = axis.profile().signal(wanted).is_some_and(|source| source.equals.is_some());
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

/// Faults and warnings with cause and remedy; empty without any.
fn faults_text(axis: &LocalAxis) -> Result<String> {
    let Some(value) = read_signal(axis, Signal::Fault)? else { return Ok(String::new()) };
    let mut text = String::new();
    for fault in polepair::active_faults(axis.profile(), value.raw) {
        let word = if fault.is_warning { "warning" } else { "FAULT" };
        text.push_str(&format!("  {word} {}: {}\n", fault.name, fault.text));
        text.push_str(&cause_and_remedy(&fault.cause, &fault.remedy));
    }
    Ok(text)
}

fn cause_and_remedy(cause: &str, remedy: &str) -> String {
    let both = [("cause", cause), ("remedy", remedy)].into_iter();
    let sentences = both.filter(|(_, sentence)| !sentence.is_empty());
    sentences.map(|(word, sentence)| format!("    {word:<7} {sentence}\n")).collect()
}
