//! Lines printed before a motion and after it.

use polepair::Axis;
use polepair::interface::MotionMonitor;
use polepair::url::AxisNumber;
use polepair_core::axis::{Command, Verb};
use polepair_core::plan::Argument;
use polepair_core::profile::Signal;
use polepair_core::time::Instant;

use super::{CTRL_C_STOPS, LEFT_RUNNING};
use crate::data_output::DataOutput;
use crate::outcome::to_problem;
use crate::problem::Result;
use crate::session::{self, LocalSession, Session};
use crate::terminal::{is_quiet, print_note};

/// Prints one line for each product before anything moves: the way to stop the motor, and the drive's reaction when its
/// host falls silent. Its watchdog is read for that, because a setting is more certain than a rule. The cautions of the
/// manual are in `info`, which a person reads once instead of before every motion.
pub fn print_start_note(axes: impl IntoIterator<Item = Axis>, arguments: &str, stops: &str) {
    if is_quiet() {
        return;
    }
    let mut printed: Vec<String> = Vec::new();
    for axis in axes {
        let facts = axis.facts();
        let is_group = AxisNumber(axis.number()).is_group();
        let read = if is_group { None } else { axis.watchdog().ok() };
        let watchdog = read.map_or_else(|| facts.watchdog_rule.clone(), |report| report.text);
        let note = format!("{}: {stops}; watchdog {watchdog}", facts.profile);
        if !printed.contains(&note) {
            print_note(&format!("{note}; more: polepair info {arguments}"));
            printed.push(note);
        }
    }
}

/// Prints the note of a program or a path on a link of this program. `detached` is left running.
pub fn print_program_note(session: &LocalSession, detached: bool) {
    let stops = if detached { LEFT_RUNNING } else { CTRL_C_STOPS };
    let axes = session.axes().iter().cloned().map(Axis::from);
    print_start_note(axes, &session.arguments, stops);
}

/// A signal of an axis as it is now, or of each drive of a group, with what names it.
pub fn signal_lines(
    session: &Session,
    axis: &Axis,
    signal: Signal,
) -> Result<Vec<(String, String)>> {
    let Some(group) = axis.local().filter(|axis| AxisNumber(axis.number()).is_group()) else {
        let text = session::signal_text(axis, signal)?;
        return Ok(text.into_iter().map(|text| (session.axis_prefix(axis), text)).collect());
    };
    let Some(source) = group.profile().signal(signal) else { return Ok(Vec::new()) };
    let read = group.read_each(source.parameter).map_err(to_problem)?;
    let shown = read.into_iter().map(|(number, raw)| {
        let value = group.value(source.parameter, raw).map_err(to_problem)?;
        Ok((format!("#{} ", AxisNumber(number)), value.to_string()))
    });
    shown.collect()
}

/// Measurements at the end of a motion, in lines that are printed once the motor is stopped: a full pipe must not delay
/// a stop.
#[derive(Default)]
pub struct MeasuredMotion {
    lines: Vec<String>,
    notes: Vec<String>,
}

impl MeasuredMotion {
    /// Notes the last speeds. Where a signal ends the motion, nothing more is asked: the stop comes first.
    pub fn note_speeds(
        &mut self,
        session: &Session,
        commands: &[(Axis, Command)],
        monitors: &[MotionMonitor],
    ) {
        for ((axis, command), monitor) in commands.iter().zip(monitors) {
            let shown = |si| axis.interface().format_signal(Signal::Velocity, si);
            if command.verb == Verb::Velocity
                && let Some(velocity) = monitor.last_velocity().and_then(shown)
            {
                let target = command.velocity.and_then(shown);
                self.add("velocity", (session.axis_prefix(axis), velocity), target);
            }
        }
    }

    /// Notes the errors that drives reported by themselves on a way that they finished.
    pub fn note_emergencies(&mut self, commands: &[(Axis, Command)], begin: Instant) {
        for axis in commands.iter().filter_map(|(axis, _)| axis.local()) {
            if let Some((_, emergency)) = axis.emergency_since(begin) {
                self.notes.push(format!("{} sent {emergency}, and arrived", axis.label()));
            }
        }
    }

    /// Reads what monitors do not measure: the speeds of a group's drives, and torque or current.
    pub fn read_others(&mut self, session: &Session, commands: &[(Axis, Command)]) {
        for (axis, command) in commands {
            let is_group = axis.local().is_some_and(|axis| AxisNumber(axis.number()).is_group());
            let (signal, target) = match command.verb {
                Verb::Velocity if is_group => (Signal::Velocity, command.velocity),
                Verb::Torque if axis.has_signal(Signal::Torque) => (Signal::Torque, command.torque),
                Verb::Torque => (Signal::Current, command.torque),
                _ => continue,
            };
            // A drive that is commanded in a share and reports amperes has nothing to compare.
            let set = axis.unit_of(command.verb, argument_of(command.verb));
            let is_same =
                set.is_some_and(|unit| unit.si_symbol() == axis.interface().signal_unit(signal));
            let target = target.filter(|_| is_same);
            let target = target.and_then(|si| axis.interface().format_signal(signal, si));
            // The motion ends well without it.
            for line in signal_lines(session, axis, signal).unwrap_or_default() {
                self.add(signal.name(), line, target.clone());
            }
        }
    }

    fn add(&mut self, name: &str, line: (String, String), target: Option<String>) {
        let (prefix, value) = line;

        let target = target.map_or_else(String::new, |target| format!(" (target {target})"));
        self.lines.push(format!("{prefix}{name} reached = {value}{target}"));
    }

    /// Prints the lines.
    pub fn print(&self) -> Result<()> {
        self.notes.iter().for_each(|note| print_note(note));
        let mut out = DataOutput::stdout();
        self.lines.iter().for_each(|line| out.write_line(line));
        out.flush()
    }
}

const fn argument_of(verb: Verb) -> Argument {
    match verb {
        Verb::Torque => Argument::Torque,
        _ => Argument::Velocity,
    }
}
