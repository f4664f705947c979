//! `polepair spin|move|torque|home|jog URL VALUE[unit]`

use std::time::Duration;

use clap::Args;
use polepair::LocalAxis;
use polepair_client::message::{AxisInfo, CommandArguments};
use polepair_core::axis::{Command, Verb};
use polepair_core::plan::Argument;
use polepair_core::profile::Signal;

use crate::cmd::info;
use crate::motion::{self, MotionMode, parse_argument};
use crate::problem::Result;
use crate::remote::{self, MotionOrder, RemoteSession};
use crate::session::Session;
use crate::target::DriveArgs;
use crate::terminal::DataOutput;
use crate::value;

/// What a jog does unless a speed is given.
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
    /// Target position [default unit: that of the drive's profile]
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
    /// It is written to a parameter of the drive, which keeps it until power-off: `homing speed` (TML; the
    /// sign selects the limit switch: --vel=-10rpm) or `homing speed switch` (CANopen). TMCL modules (100
    /// rpm) and SYNTRON drives on Modbus have no such parameter.
    #[arg(long, value_name = "VALUE")]
    vel: Option<String>,
    #[command(flatten)]
    arriving: ArrivalArgs,
}

impl Spin {
    pub fn run(self) -> Result {
        let raw = self.lasting.raw;
        let command = |axis: &LocalAxis| {
            let mut command = Command { raw, ..Command::new(Verb::Velocity) };
            command.velocity =
                Some(parse_argument(axis, Verb::Velocity, Argument::Velocity, (&self.speed, raw))?);
            command.acceleration =
                optional_argument(axis, Verb::Velocity, Argument::Acceleration, (&self.acc, raw))?;
            command.deceleration =
                optional_argument(axis, Verb::Velocity, Argument::Deceleration, (&self.dec, raw))?;
            Ok(command)
        };
        run_lasting(&self.target, &self.lasting, command)
    }

    /// The same by a server.
    pub fn run_on_server(self, server: &RemoteSession) -> Result {
        run_lasting_remote(server, &self.target, &self.lasting, Verb::Velocity, |axis| {
            let velocity =
                Some(remote::parse_argument(axis, Verb::Velocity, "velocity", &self.speed)?);
            let acceleration = remote_argument(axis, Verb::Velocity, "acceleration", &self.acc)?;
            let deceleration = remote_argument(axis, Verb::Velocity, "deceleration", &self.dec)?;
            Ok(CommandArguments {
                velocity,
                acceleration,
                deceleration,
                ..CommandArguments::default()
            })
        })
    }
}

impl Jog {
    pub fn run(self) -> Result {
        let (speed, raw) = (self.speed.as_deref().unwrap_or(JOG_SPEED), self.lasting.raw);
        let command = |axis: &LocalAxis| {
            let mut command = Command { raw, ..Command::new(Verb::Velocity) };
            command.velocity =
                Some(parse_argument(axis, Verb::Velocity, Argument::Velocity, (speed, raw))?);
            Ok(command)
        };
        run_lasting(&self.target, &self.lasting, command)
    }

    /// The same by a server.
    pub fn run_on_server(self, server: &RemoteSession) -> Result {
        let speed = self.speed.as_deref().unwrap_or(JOG_SPEED);
        run_lasting_remote(server, &self.target, &self.lasting, Verb::Velocity, |axis| {
            let velocity = Some(remote::parse_argument(axis, Verb::Velocity, "velocity", speed)?);
            Ok(CommandArguments { velocity, ..CommandArguments::default() })
        })
    }
}

impl Torque {
    pub fn run(self) -> Result {
        let raw = self.lasting.raw;
        let command = |axis: &LocalAxis| {
            let mut command = Command { raw, ..Command::new(Verb::Torque) };
            command.torque =
                Some(parse_argument(axis, Verb::Torque, Argument::Torque, (&self.torque, raw))?);
            Ok(command)
        };
        run_lasting(&self.target, &self.lasting, command)
    }

    /// The same by a server.
    pub fn run_on_server(self, server: &RemoteSession) -> Result {
        run_lasting_remote(server, &self.target, &self.lasting, Verb::Torque, |axis| {
            let torque = Some(remote::parse_argument(axis, Verb::Torque, "torque", &self.torque)?);
            Ok(CommandArguments { torque, ..CommandArguments::default() })
        })
    }
}

impl Move {
    pub fn run(self) -> Result {
        let (verb, raw) = (self.verb(), self.arriving.raw);
        let command = |axis: &LocalAxis| {
            let mut command = Command { raw, ..Command::new(verb) };
            command.target =
                Some(parse_argument(axis, verb, Argument::Target, (&self.position, raw))?);
            command.velocity = optional_argument(axis, verb, Argument::Velocity, (&self.vel, raw))?;
            command.acceleration =
                optional_argument(axis, verb, Argument::Acceleration, (&self.acc, raw))?;
            command.deceleration =
                optional_argument(axis, verb, Argument::Deceleration, (&self.dec, raw))?;
            command.jerk_time =
                optional_argument(axis, verb, Argument::JerkTime, (&self.s_curve, raw))?;
            Ok(command)
        };
        let run = if self.sync { motion::run_together } else { motion::run_motion };
        run_arriving(&self.target, &self.arriving, run, command)
    }

    /// The same by a server.
    pub fn run_on_server(self, server: &RemoteSession) -> Result {
        if self.sync {
            return Err(remote::unsupported_problem(
                "--sync",
                "It starts moves one after the \
             other.",
            ));
        }
        let verb = self.verb();
        run_arriving_remote(server, &self.target, &self.arriving, verb, |axis| {
            Ok(CommandArguments {
                target: Some(remote::parse_argument(axis, verb, "target", &self.position)?),
                velocity: remote_argument(axis, verb, "velocity", &self.vel)?,
                acceleration: remote_argument(axis, verb, "acceleration", &self.acc)?,
                deceleration: remote_argument(axis, verb, "deceleration", &self.dec)?,
                jerk_time: remote_argument(axis, verb, "jerk_time", &self.s_curve)?,
                ..CommandArguments::default()
            })
        })
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
    pub fn run(self) -> Result {
        let raw = self.arriving.raw;
        let command = |axis: &LocalAxis| {
            let mut command = Command { raw, ..Command::new(Verb::Home) };
            command.velocity =
                optional_argument(axis, Verb::Home, Argument::Velocity, (&self.vel, raw))?;
            Ok(command)
        };
        run_arriving(&self.target, &self.arriving, motion::run_motion, command)
    }

    /// The same by a server.
    pub fn run_on_server(self, server: &RemoteSession) -> Result {
        run_arriving_remote(server, &self.target, &self.arriving, Verb::Home, |axis| {
            let velocity = remote_argument(axis, Verb::Home, "velocity", &self.vel)?;
            Ok(CommandArguments { velocity, ..CommandArguments::default() })
        })
    }
}

fn optional_argument(
    axis: &LocalAxis,
    verb: Verb,
    which: Argument,
    (text, raw): (&Option<String>, bool),
) -> Result<Option<f64>> {
    text.as_deref().map(|text| parse_argument(axis, verb, which, (text, raw))).transpose()
}

fn run_lasting(
    target: &DriveArgs,
    how: &HoldArgs,
    command: impl Fn(&LocalAxis) -> Result<Command>,
) -> Result {
    if how.dry_run {
        return target.rehearse_motion(command);
    }
    let session = target.open()?;
    let commands = commands_for_each(session.axes(), command)?;
    let then = if how.detach { MotionMode::Detach } else { MotionMode::Hold(how.seconds) };
    motion::run_motion(&session, &commands, then)
}

fn run_arriving(
    target: &DriveArgs,
    how: &ArrivalArgs,
    run: fn(&Session, &[(LocalAxis, Command)], MotionMode) -> Result,
    command: impl Fn(&LocalAxis) -> Result<Command>,
) -> Result {
    if how.dry_run {
        return target.rehearse_motion(command);
    }
    let session = target.open()?;
    let mut commands = commands_for_each(session.axes(), command)?;
    if let Some(timeout) = how.timeout.and_then(|s| Duration::try_from_secs_f64(s).ok()) {
        commands.iter_mut().for_each(|(_, command)| *command = command.limited(timeout));
    }
    let then = if how.detach { MotionMode::Detach } else { MotionMode::Arrive(how.timeout) };
    let exit = run(&session, &commands, then)?;
    if then != MotionMode::Detach {
        let mut out = DataOutput::stdout();
        for axis in session.axes() {
            if let Some(position) = info::signal_text(axis, Signal::Position)? {
                out.write_line(&format!("{}position = {position}", session.axis_prefix(axis)));
            }
        }
        out.flush()?;
    }
    Ok(exit)
}

fn commands_for_each(
    axes: &[LocalAxis],
    command: impl Fn(&LocalAxis) -> Result<Command>,
) -> Result<Vec<(LocalAxis, Command)>> {
    let one = |axis: &LocalAxis| match axes.len() {
        1 => command(axis),
        _ => command(axis).map_err(|problem| problem.about(&axis.label())),
    };
    axes.iter().map(|axis| one(axis).map(|command| (axis.clone(), command))).collect()
}

fn remote_argument(
    axis: &AxisInfo,
    verb: Verb,
    name: &str,
    text: &Option<String>,
) -> Result<Option<f64>> {
    text.as_deref().map(|text| remote::parse_argument(axis, verb, name, text)).transpose()
}

fn run_lasting_remote(
    server: &RemoteSession,
    target: &DriveArgs,
    how: &HoldArgs,
    verb: Verb,
    arguments: impl Fn(&AxisInfo) -> Result<CommandArguments>,
) -> Result {
    remote::refuse_dry_run(how.dry_run)?;
    remote::refuse_raw(how.raw)?;
    let then = if how.detach { MotionMode::Detach } else { MotionMode::Hold(how.seconds) };
    remote::run_motion(server, &remote_orders(server, target, verb, arguments)?, then)
}

fn run_arriving_remote(
    server: &RemoteSession,
    target: &DriveArgs,
    how: &ArrivalArgs,
    verb: Verb,
    arguments: impl Fn(&AxisInfo) -> Result<CommandArguments>,
) -> Result {
    remote::refuse_dry_run(how.dry_run)?;
    remote::refuse_raw(how.raw)?;
    let then = if how.detach { MotionMode::Detach } else { MotionMode::Arrive(how.timeout) };
    let motions = remote_orders(server, target, verb, arguments)?;
    let exit = remote::run_motion(server, &motions, then)?;
    let axes: Vec<AxisInfo> = motions.into_iter().map(|motion| motion.axis).collect();
    let mut out = DataOutput::stdout();
    for axis in &axes {
        if let Some(position) = remote::fresh_text(server, axis, Signal::Position)? {
            out.write_line(&format!("{}position = {position}", server.axis_prefix(&axes, axis)));
        }
    }
    out.flush()?;
    Ok(exit)
}

/// What each axis is to do: all of it is read before the first is told.
fn remote_orders(
    server: &RemoteSession,
    target: &DriveArgs,
    verb: Verb,
    arguments: impl Fn(&AxisInfo) -> Result<CommandArguments>,
) -> Result<Vec<MotionOrder>> {
    let axes = server.axes_of(target)?;
    let alone = axes.len() == 1;
    let all = axes.into_iter().map(|axis| {
        let arguments = arguments(&axis);
        let arguments = if alone { arguments } else { arguments.map_err(|p| p.about(&axis.label)) };
        Ok(MotionOrder { verb, arguments: arguments?, axis })
    });
    all.collect()
}
