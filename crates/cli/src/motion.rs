//! What the motion verbs share: the caution, arming, enabling, holding, stopping.

use std::fmt::Write as _;
use std::time::Duration;

use polepair::Axis;
use polepair_core::axis::{Command, Verb};
use polepair_core::plan::Argument;
use polepair_core::profile::{Profile, Severity, Signal, Watchdog};
use polepair_core::time::Instant;
use polepair_link::clock;

use crate::interrupt;
use crate::outcome;
use crate::problem::{Exit, Problem, Result};
use crate::session::{Session, signal, verb_if_any};
use crate::terminal::{self, say};

/// How often a held motion looks for Ctrl-C and its end.
const LOOK_MS: u32 = 25;
/// How often it reads the drive.
const READ_MS: u32 = 250;
/// How far ahead a held motion on an axis with ends looks: reading and stopping take their time.
const AHEAD: Duration = Duration::from_millis(150);
/// How long a stopping motor keeps its power: Ctrl-C ends a verb within a second.
const REST_MAX: Duration = Duration::from_millis(800);
/// How long a move may take unless the user says otherwise.
pub const ARRIVE_MAX: Duration = Duration::from_secs(600);

/// What to do with a motion once it runs.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum Then {
    /// Hold it for some seconds, or until Ctrl-C, and stop it.
    Hold(Option<f64>),
    /// Wait until it has arrived, at most so many seconds.
    Arrive(Option<f64>),
    /// Leave it running.
    Detach,
}

/// Reads an argument in its unit.
pub fn argument(axis: &Axis, verb: Verb, which: Argument, text: &str) -> Result<f64> {
    let Some(unit) = axis.unit_of(verb, which) else {
        let option = match which {
            Argument::Velocity => "--vel",
            Argument::Acceleration => "--acc",
            Argument::Torque => "--torque",
            Argument::JerkTime => "--s-curve",
            Argument::Period => "--period",
            Argument::Target => "VALUE",
        };
        let name = axis.profile().name;
        let what = match axis.profile().plan(verb) {
            None => format!("{name} cannot {}.", verb.name().replace('-', " ")),
            Some(_) => format!("{name} takes no {option} with this verb."),
        };
        return Err(Problem::usage("E218", what)
            .why("Its profile has no steps for that; nothing was sent."));
    };
    let measure = polepair::quantity::parse(text).map_err(outcome::error)?;
    // Why a unit is not the drive's, its parameter's description says best.
    let written = axis.destination(verb, which).flatten();
    let about = written.map_or("", |parameter| parameter.about);
    measure.in_unit(unit).map_err(|wrong| outcome::error(wrong).why(about))
}

/// Says what to watch out for, once per product, before anything moves.
pub fn caution(session: &Session) {
    let mut told: Vec<&str> = Vec::new();
    for axis in session.axes() {
        let profile = axis.profile();
        if told.contains(&profile.name) {
            continue;
        }
        told.push(profile.name);
        if !profile.caution.is_empty() {
            say(&format!("caution: {}: {}", profile.name, profile.caution));
        }
        say(&format!("watchdog: {}", watchdog(profile)));
    }
}

/// What the drive does when the link dies.
pub fn watchdog(profile: &Profile) -> String {
    match profile.watchdog {
        Watchdog::None => {
            "none - the motor keeps doing what it was last told if the link dies".into()
        }
        Watchdog::Fixed { after_ms } => {
            format!("the drive stops {after_ms} ms after the link dies")
        }
        Watchdog::Configurable { parameter } => {
            let name = profile.parameter(parameter).map_or("?", |parameter| parameter.name);
            format!("the drive stops after the time in {name:?} without requests, 0 is never")
        }
    }
}

/// Carries a motion out on every axis of the session, and stops what it started when it ends early.
pub fn run(session: &Session, commands: &[(Axis, Command)], then: Then) -> Result {
    carry_out(session, commands, then, start_each)
}

/// The same with moves that begin at one signal.
pub fn run_together(session: &Session, commands: &[(Axis, Command)], then: Then) -> Result {
    let start = |commands: &[_], _| polepair::start_together(commands).map_err(outcome::error);
    carry_out(session, commands, then, start)
}

fn carry_out(
    session: &Session,
    commands: &[(Axis, Command)],
    then: Then,
    start: impl FnOnce(&[(Axis, Command)], Instant) -> Result<()>,
) -> Result {
    let watched = commands.iter().find(|(axis, command)| axis.has_ends() && lasts(command.verb));
    if let Some((axis, _)) = watched.filter(|_| then == Then::Detach) {
        let what = format!("{} has ends, and nobody would watch them.", axis.label());
        return Err(Problem::usage("E223", what)
            .why("A speed or torque that is left running would pass the limits of its position.")
            .hint("leave --detach out, or give a target: polepair move"));
    }
    caution(session);
    session.listen();
    let mut started: Vec<Started> = Vec::new();
    let within = match then {
        Then::Arrive(Some(seconds)) => Duration::from_secs_f64(seconds),
        _ => ARRIVE_MAX,
    };
    // One span for all of it: homing is part of the command, the way to a target is not.
    let deadline = clock::now() + within;
    let powered = power(commands, &mut started);
    let ended = powered.and_then(|()| start(commands, deadline)).and_then(|()| match then {
        Then::Hold(seconds) => hold(commands, seconds),
        Then::Arrive(_) => arrive(commands, deadline),
        Then::Detach => Ok(()),
    });
    if then == Then::Detach && ended.is_ok() {
        say(&format!("left running; this stops it: polepair stop {}", session.url));
        return Ok(Exit::Ok);
    }
    let arrived = matches!(then, Then::Arrive(_)) && ended.is_ok();
    let stopped = finish(&started, arrived);
    match ended {
        Err(problem) if problem.exit == Exit::Interrupted => {
            stopped?;
            say("interrupted: the motion was stopped");
            Err(Problem::interrupted())
        }
        Err(problem) => Err(problem),
        Ok(()) => stopped.map(|()| Exit::Ok),
    }
}

/// Whether a motion goes on until it is stopped.
const fn lasts(verb: Verb) -> bool {
    matches!(verb, Verb::Velocity | Verb::Torque)
}

/// An axis that this verb set in motion.
struct Started {
    axis: Axis,
    /// It was not powered before.
    enabled_here: bool,
}

/// Powers every axis, before any of them moves.
fn power(commands: &[(Axis, Command)], started: &mut Vec<Started>) -> Result<()> {
    // What the limits of a file refuse is refused before anything has power.
    for (axis, command) in commands {
        axis.prepare(*command).map(drop).map_err(outcome::error)?;
    }
    for (axis, _) in commands {
        let enabled = signal(axis, Signal::Enabled)?.is_some_and(|read| read.raw != 0);
        axis.arm(true);
        started.push(Started { axis: axis.clone(), enabled_here: !enabled });
        if !enabled {
            verb_if_any(axis, Verb::Enable)?;
        }
    }
    Ok(())
}

/// Starts all of them back to back.
fn start_each(commands: &[(Axis, Command)], deadline: Instant) -> Result<()> {
    // Each is on its way before the first is waited for; one that is refused ends all.
    let ready = commands.iter().map(|(axis, command)| axis.prepare(*command));
    let ready: Vec<_> = ready.collect::<std::result::Result<_, _>>().map_err(outcome::error)?;
    let begun = ready.iter().map(polepair::axis::Prepared::start);
    let begun: Vec<_> = begun.collect::<std::result::Result<_, _>>().map_err(outcome::error)?;
    for (mut running, (axis, command)) in begun.into_iter().zip(commands) {
        if running.wait(deadline.since(clock::now())).map_err(outcome::error)?.is_none() {
            return Err(late(axis, command));
        }
    }
    Ok(())
}

fn late(axis: &Axis, command: &Command) -> Problem {
    let what = format!("{}: {} did not end in time.", axis.label(), command.verb.name());
    Problem::new(Exit::Negative, "E101", what)
        .why("The drive took the command, but what was waited for did not come.")
        .hint("give it more time: --timeout")
}

/// Waits, and shows what the drive does where a person looks.
pub fn hold(commands: &[(Axis, Command)], seconds: Option<f64>) -> Result<()> {
    let mut next = clock::now();
    let mut live = Live::new();
    hold_while(seconds, |now| {
        for (axis, _) in commands {
            if let Some(why) = axis.leaving(AHEAD).map_err(outcome::error)? {
                return Err(Problem::new(Exit::Negative, "E105", outcome::sentence(&why))
                    .why("It was stopped.")
                    .hint("hold it for less time: --for; `polepair move` ends by itself"));
            }
        }
        if now >= next {
            next = now.plus_ms(READ_MS);
            for (axis, _) in commands {
                check_fault(axis)?;
            }
            live.show(commands)?;
        }
        Ok(())
    })
}

/// Waits for so many seconds, or until Ctrl-C, for as long as each look finds nothing wrong.
pub fn hold_while(seconds: Option<f64>, mut look: impl FnMut(Instant) -> Result<()>) -> Result<()> {
    let begun = clock::now();
    let end = seconds.map(|seconds| begun.plus_ns((seconds * 1e9) as u64));
    if seconds.is_none() {
        say("holding; Ctrl-C stops it");
    }
    loop {
        let now = clock::now();
        if interrupt::came() {
            return Err(Problem::interrupted());
        }
        if end.is_some_and(|end| now >= end) {
            return Ok(());
        }
        look(now)?;
        let until = now.plus_ms(LOOK_MS);
        clock::sleep_until(end.map_or(until, |end| until.min(end)));
    }
}

/// Ends with the drive's fault, if it has one that stops it.
pub fn check_fault(axis: &Axis) -> Result<()> {
    let Some(value) = signal(axis, Signal::Fault)? else { return Ok(()) };
    let code = u32::try_from(value.raw).unwrap_or(0);
    let faults = outcome::faults(axis.profile(), code);
    let Some(fault) = faults.iter().find(|fault| fault.severity == Severity::Fault) else {
        return Ok(());
    };
    let what = format!("{} reports a fault: {} ({})", axis.label(), fault.text, fault.name);
    Err(Problem::new(Exit::DriveFault, "E801", outcome::sentence(&what))
        .why(fault.cause)
        .hint_if(Some(fault.remedy).filter(|remedy| !remedy.is_empty())))
}

/// Waits until the drives say that they have arrived.
fn arrive(commands: &[(Axis, Command)], deadline: Instant) -> Result<()> {
    for (axis, command) in commands {
        // Homing ends when the reference is found.
        if command.verb == Verb::Home {
            continue;
        }
        if axis.profile().plan(Verb::Reached).is_none() {
            say(&format!("{} cannot tell when it arrives; it was started", axis.label()));
            continue;
        }
        axis.wait(deadline.since(clock::now())).map_err(outcome::error)?;
    }
    Ok(())
}

/// Stops what was started, all at once, and takes the power off that was put on.
fn finish(started: &[Started], arrived: bool) -> Result<()> {
    let stop = |one: &Started| {
        let plan = one.axis.profile().plan(Verb::Stop).filter(|_| !arrived);
        plan.map(|_| one.axis.start(Command::new(Verb::Stop)))
    };
    // Every stop is sent before the first is waited for.
    let stops: Vec<_> = started.iter().map(stop).collect();
    let mut ended = Ok(());
    for (Started { axis, enabled_here }, stop) in started.iter().zip(stops) {
        let stopped = stop.map_or(Ok(()), |stop| {
            stop.and_then(|mut stop| stop.finish().map(drop)).map_err(outcome::error)
        });
        let rested = match &stopped {
            Ok(()) if *enabled_here && !arrived => rest(axis),
            _ => Ok(()),
        };
        // Also after a stop that failed: a motor without power at least does not drive.
        let off = if *enabled_here { verb_if_any(axis, Verb::Disable) } else { Ok(None) };
        axis.arm(false);
        ended = ended.and(stopped).and(rested).and(off.map(drop));
    }
    ended
}

/// Waits until a motor that was told to stop stands still: without power it would coast.
pub fn rest(axis: &Axis) -> Result<()> {
    let end = clock::now() + REST_MAX;
    while let Some(velocity) = signal(axis, Signal::Velocity)?
        && velocity.raw.abs() > 1
        && clock::now() < end
    {
        clock::sleep_until(clock::now().plus_ms(LOOK_MS));
    }
    Ok(())
}

/// One line on a terminal, drawn again and again.
struct Live {
    shown: bool,
}

impl Live {
    fn new() -> Self {
        use std::io::IsTerminal as _;
        Self { shown: std::io::stderr().is_terminal() && terminal::colour_err() }
    }

    fn show(&mut self, commands: &[(Axis, Command)]) -> Result<()> {
        if !self.shown {
            return Ok(());
        }
        let mut line = String::new();
        for (axis, _) in commands {
            let _ = write!(line, "{}", axis.label());
            for wanted in [Signal::Velocity, Signal::Position, Signal::Current] {
                if let Some(value) = signal(axis, wanted)? {
                    let _ = write!(line, "  {} {value}", wanted.name());
                }
            }
            line.push_str("   ");
        }
        eprint!("\r\x1b[K{line}");
        Ok(())
    }
}

impl Drop for Live {
    fn drop(&mut self) {
        if self.shown {
            eprint!("\r\x1b[K");
        }
    }
}
