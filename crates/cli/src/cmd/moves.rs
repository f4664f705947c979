//! `polepair spin|move|torque|home|jog URL VALUE[unit]`

use std::time::Duration;

use clap::Args;
use polepair::Axis;
use polepair_core::axis::{Command, Verb};
use polepair_core::plan::Argument;
use polepair_core::profile::Signal;

use crate::data_output::DataOutput;
use crate::motion::{self, MotionMode, parse_argument};
use crate::problem::Result;
use crate::remote::ServerArgs;
use crate::session::Session;
use crate::target::DriveArgs;
use crate::terminal::print_note;
use crate::value;

/// Path that moves overwrite where no other one is chosen (profile of the SYNTRON TS).
const MOVE_PATH: u8 = 32;
/// Speed of a jog without a given one.
const JOG_SPEED: &str = "60 rpm";

/// Options of a motion without a target.
#[derive(Args, Debug)]
struct HoldArgs {
    /// Stop after this time instead of at Ctrl-C: 2s, 500ms, 1min
    #[arg(long = "for", value_name = "TIME", value_parser = value::parse_span)]
    seconds: Option<f64>,
    /// Leave the motor running, and print the command that stops it
    #[arg(long, conflicts_with = "seconds")]
    detach: bool,
    /// Values are raw numbers of the drive, without units
    #[arg(long)]
    raw: bool,
    /// Print the frames, and send nothing
    #[arg(long)]
    dry_run: bool,
}

/// Options of a motion to a target.
#[derive(Args, Debug)]
struct ArrivalArgs {
    /// Return at once, and print the command that stops the motor
    #[arg(long)]
    detach: bool,
    /// Wait until the target is reached (the default)
    #[arg(long, conflicts_with = "detach", hide = true)]
    wait: bool,
    /// Stop waiting after this time; the motor is stopped
    #[arg(long, value_name = "TIME", value_parser = value::parse_span)]
    timeout: Option<f64>,
    /// Values are raw numbers of the drive, without units
    #[arg(long)]
    raw: bool,
    /// Print the frames, and send nothing
    #[arg(long)]
    dry_run: bool,
}

/// Turns a motor at constant speed until Ctrl-C.
///
/// The motor is powered during the command, and stopped at its end.
#[derive(Args, Debug)]
#[command(
    allow_negative_numbers = true,
    after_help = "\
Examples:
  polepair spin tmcl+serial:///dev/ttyUSB0#1 350rpm
  polepair spin sim:tmcl --for 2s -- -20rad/s
  polepair spin sim:modbus-rtu 200rpm --dry-run"
)]
pub struct Spin {
    #[command(flatten)]
    target: DriveArgs,
    /// Speed [default unit: that of the drive's profile]
    #[arg(value_name = "SPEED", allow_hyphen_values = true)]
    speed: String,
    /// Acceleration
    #[arg(long, value_name = "VALUE")]
    acc: Option<String>,
    /// Deceleration, if the drive has a separate one
    #[arg(long, value_name = "VALUE")]
    dec: Option<String>,
    #[command(flatten)]
    lasting: HoldArgs,
}

/// Turns a motor slowly until Ctrl-C.
#[derive(Args, Debug)]
#[command(after_help = "Example:\n  polepair jog tmcl+serial:///dev/ttyUSB0#1 30rpm --for 1s")]
pub struct Jog {
    #[command(flatten)]
    target: DriveArgs,
    /// Speed [default: 60 rpm; default unit: that of the drive's profile]
    #[arg(value_name = "SPEED", allow_hyphen_values = true)]
    speed: Option<String>,
    #[command(flatten)]
    lasting: HoldArgs,
}

/// Turns a motor with constant torque until Ctrl-C.
#[derive(Args, Debug)]
#[command(after_help = "Example:\n  polepair torque tmcl+serial:///dev/ttyUSB0#1 0.5A --for 1s")]
pub struct Torque {
    #[command(flatten)]
    target: DriveArgs,
    /// Torque in Nm, or the drive's substitute for it in A or %
    #[arg(value_name = "TORQUE", allow_hyphen_values = true)]
    torque: String,
    #[command(flatten)]
    lasting: HoldArgs,
}

/// Moves an axis to a position and waits until it arrives.
#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  polepair move tmcl+serial:///dev/ttyUSB0#1 90deg --vel 200rpm
  polepair move sim:tmcl --rel 2turn --timeout 5s
  polepair move tml+serial:///dev/ttyUSB0#1 90deg --s-curve 50ms
  polepair move canopen+socketcan://can0#2,3 1turn --sync")]
pub struct Move {
    #[command(flatten)]
    target: DriveArgs,
    /// Target position with its unit: 90deg, 2turn, 10mm, 40%
    #[arg(value_name = "POSITION", allow_hyphen_values = true)]
    position: String,
    /// Move relative to the actual position
    #[arg(long)]
    rel: bool,
    /// With --rel: relative to the last target, even if it was not reached
    #[arg(long, requires = "rel", conflicts_with = "s_curve")]
    additive: bool,
    /// Use an S-curve with this acceleration build-up time: 50ms
    #[arg(long, value_name = "TIME")]
    s_curve: Option<String>,
    /// Speed
    #[arg(long, value_name = "VALUE")]
    vel: Option<String>,
    /// Acceleration
    #[arg(long, value_name = "VALUE")]
    acc: Option<String>,
    /// Deceleration, if the drive has a separate one
    #[arg(long, value_name = "VALUE")]
    dec: Option<String>,
    /// Overwrite this stored path instead of path 32; drives that move by stored paths need one
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..=32))]
    #[arg(conflicts_with_all = ["additive", "sync"])]
    path: Option<u8>,
    /// Prepare all drives first, then start them together by one SYNC
    #[arg(long, conflicts_with_all = ["additive", "s_curve", "dry_run"])]
    sync: bool,
    #[command(flatten)]
    arriving: ArrivalArgs,
}

/// Searches the reference position of an axis and waits until it is found.
#[derive(Args, Debug)]
#[command(
    after_help = "Example:\n  polepair home modbus-rtu+serial:///dev/ttyUSB0#1 --timeout 30s"
)]
pub struct Home {
    #[command(flatten)]
    target: DriveArgs,
    /// Search speed with its unit: 10rpm, 0.5rad/s [default: the drive's setting]
    ///
    /// The speed is written to a parameter of the drive, which keeps it until power-off: `homing speed` (TML, where the
    /// sign selects the limit switch: --vel=-10rpm; SYNTRON drives on Modbus) or `homing speed switch` (CANopen). TMCL
    /// modules (100 rpm) have no such parameter.
    #[arg(long, value_name = "VALUE")]
    vel: Option<String>,
    #[command(flatten)]
    arriving: ArrivalArgs,
}

impl Spin {
    pub fn run(self, server: ServerArgs) -> Result {
        let raw = self.lasting.raw;
        run_lasting(&self.target, server, &self.lasting, |axis| {
            let argument = Arguments { axis, verb: Verb::Velocity, raw };
            Ok(Command {
                velocity: Some(argument.parse(Argument::Velocity, &self.speed)?),
                acceleration: argument.parse_if(Argument::Acceleration, &self.acc)?,
                deceleration: argument.parse_if(Argument::Deceleration, &self.dec)?,
                raw,
                ..Command::new(Verb::Velocity)
            })
        })
    }
}

impl Jog {
    pub fn run(self, server: ServerArgs) -> Result {
        let (speed, raw) = (self.speed.as_deref().unwrap_or(JOG_SPEED), self.lasting.raw);
        run_lasting(&self.target, server, &self.lasting, |axis| {
            let argument = Arguments { axis, verb: Verb::Velocity, raw };
            let velocity = Some(argument.parse(Argument::Velocity, speed)?);
            Ok(Command { velocity, raw, ..Command::new(Verb::Velocity) })
        })
    }
}

impl Torque {
    pub fn run(self, server: ServerArgs) -> Result {
        let raw = self.lasting.raw;
        run_lasting(&self.target, server, &self.lasting, |axis| {
            let argument = Arguments { axis, verb: Verb::Torque, raw };
            let torque = Some(argument.parse(Argument::Torque, &self.torque)?);
            Ok(Command { torque, raw, ..Command::new(Verb::Torque) })
        })
    }
}

impl Move {
    pub fn run(self, server: ServerArgs) -> Result {
        let (verb, raw) = (self.verb(), self.arriving.raw);
        let run = if self.sync { motion::run_together } else { motion::run_motion };
        run_arriving(&self.target, server, &self.arriving, run, |axis| {
            let argument = Arguments { axis, verb, raw };
            let path = self.path.map(|path| path.to_string());
            let command = Command {
                path: argument.parse_if(Argument::Path, &path)?,
                target: Some(argument.parse(Argument::Target, &self.position)?),
                velocity: argument.parse_if(Argument::Velocity, &self.vel)?,
                acceleration: argument.parse_if(Argument::Acceleration, &self.acc)?,
                deceleration: argument.parse_if(Argument::Deceleration, &self.dec)?,
                jerk_time: argument.parse_if(Argument::JerkTime, &self.s_curve)?,
                raw,
                ..Command::new(verb)
            };
            self.note_path(axis, verb);
            Ok(command)
        })
    }

    /// Notes which stored path a move overwrites, on a drive that moves by such paths alone.
    fn note_path(&self, axis: &Axis, verb: Verb) {
        if axis.unit_of(verb, Argument::Path).is_some() {
            let (label, path) = (axis.label(), self.path.unwrap_or(MOVE_PATH));
            print_note(&format!(
                "{label}: overwrites the stored path {path}, until the next power-on; --path \
                 chooses another"
            ));
        }
    }

    const fn verb(&self) -> Verb {
        match (self.rel, self.s_curve.is_some()) {
            (true, false) if self.additive => Verb::MoveOn,
            (true, false) => Verb::MoveBy,
            (false, false) => Verb::MoveTo,
            (true, true) => Verb::CurveBy,
            (false, true) => Verb::CurveTo,
        }
    }
}

impl Home {
    pub fn run(self, server: ServerArgs) -> Result {
        let raw = self.arriving.raw;
        run_arriving(&self.target, server, &self.arriving, motion::run_motion, |axis| {
            let argument = Arguments { axis, verb: Verb::Home, raw };
            let velocity = argument.parse_if(Argument::Velocity, &self.vel)?;
            Ok(Command { velocity, raw, ..Command::new(Verb::Home) })
        })
    }
}

/// Reads the arguments of a verb on an axis.
struct Arguments<'a> {
    axis: &'a Axis,
    verb: Verb,
    raw: bool,
}

impl Arguments<'_> {
    fn parse(&self, which: Argument, text: &str) -> Result<f64> {
        parse_argument(self.axis, self.verb, which, text, self.raw)
    }

    fn parse_if(&self, which: Argument, text: &Option<String>) -> Result<Option<f64>> {
        text.as_deref().map(|text| self.parse(which, text)).transpose()
    }
}

fn run_lasting(
    target: &DriveArgs,
    server: ServerArgs,
    how: &HoldArgs,
    command: impl Fn(&Axis) -> Result<Command>,
) -> Result {
    if how.dry_run {
        server.refuse_dry_run()?;
        return target.rehearse_motion(command);
    }
    let session = target.connect(server)?;
    let commands = commands_for_each(session.axes(), command)?;
    let then = if how.detach { MotionMode::Detach } else { MotionMode::Hold(how.seconds) };
    motion::run_motion(&session, &commands, then)
}

fn run_arriving(
    target: &DriveArgs,
    server: ServerArgs,
    how: &ArrivalArgs,
    run: fn(&Session, &[(Axis, Command)], MotionMode) -> Result,
    command: impl Fn(&Axis) -> Result<Command>,
) -> Result {
    if how.dry_run {
        server.refuse_dry_run()?;
        return target.rehearse_motion(command);
    }
    let session = target.connect(server)?;
    let mut commands = commands_for_each(session.axes(), command)?;
    if let Some(timeout) = how.timeout.and_then(|s| Duration::try_from_secs_f64(s).ok()) {
        commands.iter_mut().for_each(|(_, command)| *command = command.limited(timeout));
    }
    let then = if how.detach { MotionMode::Detach } else { MotionMode::Arrive(how.timeout) };
    let exit = run(&session, &commands, then)?;
    // Measured after the end, because a target is no position.
    if then != MotionMode::Detach {
        let mut out = DataOutput::stdout();
        for axis in session.axes() {
            for (prefix, position) in motion::signal_lines(&session, axis, Signal::Position)? {
                out.write_line(&format!("{prefix}position = {position}"));
            }
        }
        out.flush()?;
    }
    Ok(exit)
}

/// The command of each axis: all of them are read before the first axis moves.
fn commands_for_each(
    axes: &[Axis],
    command: impl Fn(&Axis) -> Result<Command>,
) -> Result<Vec<(Axis, Command)>> {
    let one = |axis: &Axis| match axes.len() {
        // With one axis its name in front of each error is noise.
        1 => command(axis),
        _ => command(axis).map_err(|problem| problem.about(axis.label())),
    };
    axes.iter().map(|axis| one(axis).map(|command| (axis.clone(), command))).collect()
}
