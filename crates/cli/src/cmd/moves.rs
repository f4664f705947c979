//! `polepair spin|move|torque|home|jog URL VALUE[unit]`

use clap::Args;
use polepair::Axis;
use polepair_client::message::{Arguments, AxisInfo};
use polepair_core::axis::{Command, Verb};
use polepair_core::plan::Argument;
use polepair_core::profile::Signal;

use crate::cmd::info;
use crate::joined::{self, Joined, Order};
use crate::motion::{self, Then, argument};
use crate::problem::Result;
use crate::session::Session;
use crate::target::Target;
use crate::terminal::Output;
use crate::value;

/// What a jog does unless a speed is given.
const JOG: &str = "60 rpm";

/// How a motion that lasts is ended.
#[derive(Args, Debug)]
struct Lasting {
    /// Stop after this time instead of at Ctrl-C: 2s, 500ms, 1min
    #[arg(long = "for", value_name = "TIME", value_parser = value::span)]
    seconds: Option<f64>,
    /// Leave the motor running, and print what stops it
    #[arg(long, conflicts_with = "seconds")]
    detach: bool,
    /// Values are the drive's own numbers, without a unit
    #[arg(long)]
    raw: bool,
    /// Print the frames of the motion and send none of them
    #[arg(long)]
    dry_run: bool,
}

/// How a motion that arrives is ended.
#[derive(Args, Debug)]
struct Arriving {
    /// Return at once and print what would stop it
    #[arg(long)]
    detach: bool,
    /// Wait until it has arrived (the default)
    #[arg(long, conflicts_with = "detach", hide = true)]
    wait: bool,
    /// Give up waiting after this time
    #[arg(long, value_name = "TIME", value_parser = value::span)]
    timeout: Option<f64>,
    /// Values are the drive's own numbers, without a unit
    #[arg(long)]
    raw: bool,
    /// Print the frames of the motion and send none of them
    #[arg(long)]
    dry_run: bool,
}

/// Turns a motor at a speed until Ctrl-C.
///
/// The axis is armed and powered for as long, and stopped at the end.
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
    target: Target,
    /// Speed with a unit; without one, in the unit that the drive's profile has
    #[arg(value_name = "SPEED", allow_hyphen_values = true)]
    speed: String,
    /// Acceleration
    #[arg(long, value_name = "VALUE")]
    acc: Option<String>,
    #[command(flatten)]
    lasting: Lasting,
}

/// Turns a motor slowly until Ctrl-C.
#[derive(Args, Debug)]
#[command(after_help = "Example:\n  polepair jog tmcl+serial:///dev/ttyUSB0#1 30rpm --for 1s")]
pub struct Jog {
    #[command(flatten)]
    target: Target,
    /// Speed with a unit; without one, in the unit that its profile has [default: 60 rpm]
    #[arg(value_name = "SPEED", allow_hyphen_values = true)]
    speed: Option<String>,
    #[command(flatten)]
    lasting: Lasting,
}

/// Turns a motor with a torque until Ctrl-C.
#[derive(Args, Debug)]
#[command(after_help = "Example:\n  polepair torque tmcl+serial:///dev/ttyUSB0#1 0.5A --for 1s")]
pub struct Torque {
    #[command(flatten)]
    target: Target,
    /// Torque, or what stands for it in this drive: Nm, A or %
    #[arg(value_name = "TORQUE", allow_hyphen_values = true)]
    torque: String,
    #[command(flatten)]
    lasting: Lasting,
}

/// Moves an axis to a position and waits until it is there.
#[derive(Args, Debug)]
#[command(after_help = "\
Examples:
  polepair move tmcl+serial:///dev/ttyUSB0#1 90deg --vel 200rpm
  polepair move sim:tmcl --rel 2turn --timeout 5s
  polepair move tml+serial:///dev/ttyUSB0#1 90deg --s-curve 50ms
  polepair move canopen+socketcan://can0#2,3 1turn --sync")]
pub struct Move {
    #[command(flatten)]
    target: Target,
    /// Position with a unit; without one, in the unit that the drive's profile has
    #[arg(value_name = "POSITION", allow_hyphen_values = true)]
    position: String,
    /// By so far, from where it is
    #[arg(long)]
    rel: bool,
    /// With --rel: from the last target, whether that was reached or not
    #[arg(long, requires = "rel", conflicts_with = "s_curve")]
    additive: bool,
    /// Along an S-curve, whose acceleration takes so long to build up: 50ms
    #[arg(long, value_name = "TIME")]
    s_curve: Option<String>,
    /// Speed
    #[arg(long, value_name = "VALUE")]
    vel: Option<String>,
    /// Acceleration
    #[arg(long, value_name = "VALUE")]
    acc: Option<String>,
    /// Make every drive ready first, then start all on one SYNC
    #[arg(long, conflicts_with_all = ["additive", "s_curve", "dry_run"])]
    sync: bool,
    #[command(flatten)]
    arriving: Arriving,
}

/// Finds an axis' reference position and waits until it is found.
#[derive(Args, Debug)]
#[command(
    after_help = "Example:\n  polepair home modbus-rtu+serial:///dev/ttyUSB0#1 --timeout 30s"
)]
pub struct Home {
    #[command(flatten)]
    target: Target,
    /// Speed of the search for the switch, with its unit: 10rpm, 0.5rad/s [default: the drive's own]
    ///
    /// It is written to the drive's own parameter, which keeps it until power-off: `homing speed` (TML;
    /// its sign tells to which limit switch: --vel=-10rpm), `homing speed switch` (CANopen). TMCL modules
    /// (100 rpm) and SYNTRON drives on Modbus take none.
    #[arg(long, value_name = "VALUE")]
    vel: Option<String>,
    #[command(flatten)]
    arriving: Arriving,
}

impl Spin {
    pub fn run(self) -> Result {
        let raw = self.lasting.raw;
        let command = |axis: &Axis| {
            let mut command = Command::new(Verb::Velocity);
            command.velocity =
                Some(argument(axis, Verb::Velocity, Argument::Velocity, (&self.speed, raw))?);
            command.acceleration =
                given(axis, Verb::Velocity, Argument::Acceleration, (&self.acc, raw))?;
            Ok(command)
        };
        lasting(&self.target, &self.lasting, command)
    }

    /// The same by a server.
    pub fn joined(self, server: &Joined) -> Result {
        lasting_by(server, &self.target, &self.lasting, Verb::Velocity, |axis| {
            let velocity = Some(joined::argument(axis, Verb::Velocity, "velocity", &self.speed)?);
            let acceleration = told(axis, Verb::Velocity, "acceleration", &self.acc)?;
            Ok(Arguments { velocity, acceleration, ..Arguments::default() })
        })
    }
}

impl Jog {
    pub fn run(self) -> Result {
        let (speed, raw) = (self.speed.as_deref().unwrap_or(JOG), self.lasting.raw);
        let command = |axis: &Axis| {
            let mut command = Command::new(Verb::Velocity);
            command.velocity =
                Some(argument(axis, Verb::Velocity, Argument::Velocity, (speed, raw))?);
            Ok(command)
        };
        lasting(&self.target, &self.lasting, command)
    }

    /// The same by a server.
    pub fn joined(self, server: &Joined) -> Result {
        let speed = self.speed.as_deref().unwrap_or(JOG);
        lasting_by(server, &self.target, &self.lasting, Verb::Velocity, |axis| {
            let velocity = Some(joined::argument(axis, Verb::Velocity, "velocity", speed)?);
            Ok(Arguments { velocity, ..Arguments::default() })
        })
    }
}

impl Torque {
    pub fn run(self) -> Result {
        let raw = self.lasting.raw;
        let command = |axis: &Axis| {
            let mut command = Command::new(Verb::Torque);
            command.torque =
                Some(argument(axis, Verb::Torque, Argument::Torque, (&self.torque, raw))?);
            Ok(command)
        };
        lasting(&self.target, &self.lasting, command)
    }

    /// The same by a server.
    pub fn joined(self, server: &Joined) -> Result {
        lasting_by(server, &self.target, &self.lasting, Verb::Torque, |axis| {
            let torque = Some(joined::argument(axis, Verb::Torque, "torque", &self.torque)?);
            Ok(Arguments { torque, ..Arguments::default() })
        })
    }
}

impl Move {
    pub fn run(self) -> Result {
        let (verb, raw) = (self.verb(), self.arriving.raw);
        let command = |axis: &Axis| {
            let mut command = Command::new(verb);
            command.target = Some(argument(axis, verb, Argument::Target, (&self.position, raw))?);
            command.velocity = given(axis, verb, Argument::Velocity, (&self.vel, raw))?;
            command.acceleration = given(axis, verb, Argument::Acceleration, (&self.acc, raw))?;
            command.jerk_time = given(axis, verb, Argument::JerkTime, (&self.s_curve, raw))?;
            Ok(command)
        };
        let run = if self.sync { motion::run_together } else { motion::run };
        arriving(&self.target, &self.arriving, run, command)
    }

    /// The same by a server.
    pub fn joined(self, server: &Joined) -> Result {
        if self.sync {
            return Err(joined::cannot("--sync", "It starts moves back to back."));
        }
        let verb = self.verb();
        arriving_by(server, &self.target, &self.arriving, verb, |axis| {
            Ok(Arguments {
                target: Some(joined::argument(axis, verb, "target", &self.position)?),
                velocity: told(axis, verb, "velocity", &self.vel)?,
                acceleration: told(axis, verb, "acceleration", &self.acc)?,
                jerk_time: told(axis, verb, "jerk_time", &self.s_curve)?,
                ..Arguments::default()
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
        let command = |axis: &Axis| {
            let mut command = Command::new(Verb::Home);
            command.velocity = given(axis, Verb::Home, Argument::Velocity, (&self.vel, raw))?;
            Ok(command)
        };
        arriving(&self.target, &self.arriving, motion::run, command)
    }

    /// The same by a server.
    pub fn joined(self, server: &Joined) -> Result {
        arriving_by(server, &self.target, &self.arriving, Verb::Home, |axis| {
            let velocity = told(axis, Verb::Home, "velocity", &self.vel)?;
            Ok(Arguments { velocity, ..Arguments::default() })
        })
    }
}

fn given(
    axis: &Axis,
    verb: Verb,
    which: Argument,
    (text, raw): (&Option<String>, bool),
) -> Result<Option<f64>> {
    text.as_deref().map(|text| argument(axis, verb, which, (text, raw))).transpose()
}

fn lasting(target: &Target, how: &Lasting, command: impl Fn(&Axis) -> Result<Command>) -> Result {
    if how.dry_run {
        return target.rehearse_motion(command);
    }
    let session = target.open()?;
    let commands = each(session.axes(), command)?;
    let then = if how.detach { Then::Detach } else { Then::Hold(how.seconds) };
    motion::run(&session, &commands, then)
}

fn arriving(
    target: &Target,
    how: &Arriving,
    run: fn(&Session, &[(Axis, Command)], Then) -> Result,
    command: impl Fn(&Axis) -> Result<Command>,
) -> Result {
    if how.dry_run {
        return target.rehearse_motion(command);
    }
    let session = target.open()?;
    let commands = each(session.axes(), command)?;
    let then = if how.detach { Then::Detach } else { Then::Arrive(how.timeout) };
    let exit = run(&session, &commands, then)?;
    if then != Then::Detach {
        let mut out = Output::stdout();
        for axis in session.axes() {
            if let Some(position) = info::shown(axis, Signal::Position)? {
                out.line(&format!("{}position = {position}", session.who(axis)));
            }
        }
        out.flush()?;
    }
    Ok(exit)
}

fn each(axes: &[Axis], command: impl Fn(&Axis) -> Result<Command>) -> Result<Vec<(Axis, Command)>> {
    let one = |axis: &Axis| match axes.len() {
        1 => command(axis),
        _ => command(axis).map_err(|problem| problem.of(&axis.label())),
    };
    axes.iter().map(|axis| one(axis).map(|command| (axis.clone(), command))).collect()
}

fn told(axis: &AxisInfo, verb: Verb, name: &str, text: &Option<String>) -> Result<Option<f64>> {
    text.as_deref().map(|text| joined::argument(axis, verb, name, text)).transpose()
}

fn lasting_by(
    server: &Joined,
    target: &Target,
    how: &Lasting,
    verb: Verb,
    arguments: impl Fn(&AxisInfo) -> Result<Arguments>,
) -> Result {
    joined::no_dry_run(how.dry_run)?;
    joined::no_raw(how.raw)?;
    let then = if how.detach { Then::Detach } else { Then::Hold(how.seconds) };
    joined::run(server, &orders(server, target, verb, arguments)?, then)
}

fn arriving_by(
    server: &Joined,
    target: &Target,
    how: &Arriving,
    verb: Verb,
    arguments: impl Fn(&AxisInfo) -> Result<Arguments>,
) -> Result {
    joined::no_dry_run(how.dry_run)?;
    joined::no_raw(how.raw)?;
    let then = if how.detach { Then::Detach } else { Then::Arrive(how.timeout) };
    let orders = orders(server, target, verb, arguments)?;
    let exit = joined::run(server, &orders, then)?;
    let axes: Vec<AxisInfo> = orders.into_iter().map(|order| order.axis).collect();
    let mut out = Output::stdout();
    for axis in &axes {
        if let Some(position) = joined::fresh(server, axis, Signal::Position)? {
            out.line(&format!("{}position = {position}", server.who(&axes, axis)));
        }
    }
    out.flush()?;
    Ok(exit)
}

/// What each axis is to do: all of it is read before the first is told.
fn orders(
    server: &Joined,
    target: &Target,
    verb: Verb,
    arguments: impl Fn(&AxisInfo) -> Result<Arguments>,
) -> Result<Vec<Order>> {
    let axes = server.pick(target)?;
    let alone = axes.len() == 1;
    let all = axes.into_iter().map(|axis| {
        let arguments = arguments(&axis);
        let arguments = if alone { arguments } else { arguments.map_err(|p| p.of(&axis.label)) };
        Ok(Order { verb, arguments: arguments?, axis })
    });
    all.collect()
}
