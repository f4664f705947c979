//! Common parts of the motion verbs: arming, enabling, waiting, stopping.

mod report;
mod started;

use std::fmt::Write as _;
use std::time::Duration;

use polepair::axis::{STOP_RETRY_MAX, StopNotice, check_together};
use polepair::interface::AxisReadings;
use polepair::interface::{AxisRequest, EndedMotion, MotionMonitor, start_each, stop_each};
use polepair::{Axis, Error, LocalAxis};
use polepair_core::axis::{Command, Verb};
use polepair_core::plan::Argument;
use polepair_core::profile::Signal;
use polepair_core::time::Instant;
use polepair_core::units::{Quantity, Unit};

use crate::interrupt;
use crate::outcome::{self, to_problem};
use crate::problem::{Exit, Problem, Result};
use crate::remote;
use crate::session::{self, Session};
use crate::terminal::{self, print_note, print_warning};
use crate::value;
use started::{StartedAxis, StartedMotion};

pub use report::{print_program_note, print_start_note, signal_lines};

/// Interval of checking a held motion for Ctrl-C and its end, ms.
const POLL_MS: u32 = 25;
/// Interval of showing readings, ms.
const READ_MS: u32 = 250;
/// Length of a wait between two checks for Ctrl-C.
const POLL_INTERVAL: Duration = Duration::from_millis(25);
/// Time limit of a verb that ends with the drive's reply.
const VERB_MAX: Duration = Duration::from_secs(60);
/// Default time limit of a move.
pub const ARRIVE_MAX: Duration = Duration::from_secs(600);

/// Way to stop a motion that is waited for.
const CTRL_C_STOPS: &str = "Ctrl-C stops it";
/// Note for a motion that is not waited for. The way to stop it is printed once it runs.
const LEFT_RUNNING: &str = "it turns on when this command ends";

/// Treatment of a motion once it runs.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum MotionMode {
    /// Hold it for some seconds, or until Ctrl-C, and stop it.
    Hold(Option<f64>),
    /// Wait until it has arrived, at most for this time in seconds.
    Arrive(Option<f64>),
    /// Leave it running.
    Detach,
}

/// Reads an argument in its unit, or as the drive's own number.
pub fn parse_argument(
    axis: &Axis,
    verb: Verb,
    which: Argument,
    text: &str,
    raw: bool,
) -> Result<f64> {
    let Some(unit) = axis.unit_of(verb, which) else {
        return Err(unknown_argument(axis, verb, which));
    };
    if raw {
        let number = value::parse_whole(text).ok_or_else(|| {
            let what = format!("{text:?} is not a whole number.");
            Problem::usage("E217", what).why(outcome::sent_so_far())
        })?;
        let hint = "give the value with its unit";
        let local = axis.require_local("--raw with motion", hint);
        return local.and_then(|axis| axis.raw_argument(verb, which, number)).map_err(to_problem);
    }
    let measure = polepair::quantity::parse(text).map_err(to_problem)?;
    // Zero is the same in every unit, so it needs none.
    let is_bare = measure.quantity.is_none() && measure.si != 0.0;
    let mut written = None;
    if let Some(axis) = axis.local() {
        axis.check_scale(verb, which, text)
            .map_err(|error| to_problem(error).why(outcome::sent_so_far()))?;
        if measure.si != 0.0 {
            axis.check_unit(verb, which, text).map_err(to_problem)?;
        }
        if let Some(turned) = axis.turn_of_length(verb, which, text).map_err(to_problem)? {
            let shown = (turned / unit.si_factor() * 1000.0).round() / 1000.0;
            let label = axis.label();
            print_note(&format!("{label}: {text} is {shown} {} of the motor", unit.symbol()));
            return Ok(turned);
        }
        written = axis.destination(verb, which).flatten();
    } else if is_bare && unit != Unit::Percent && which != Argument::Target {
        return Err(Problem::usage("E217", format!("{text:?} has no unit."))
            .why("The default unit of the drive is not known on a server.")
            .hint(format!("{text}{}", remote::argument_unit(axis, which, unit).symbol())));
    }
    if is_bare && which == Argument::Target && unit != Unit::None {
        return Err(unitless_position(axis, text, unit));
    }
    // The parameter's description explains best why a unit is not the drive's.
    measure.in_unit(unit).map_err(|wrong| match written {
        Some(into) => {
            to_problem(wrong).why(format!("It is written to {:?}: {}", into.name, into.about))
        }
        None => to_problem(wrong),
    })
}

/// The error for a position without a unit: 90 is degrees on one drive and turns on the next, and a motor that turns
/// 360 times too far can hurt someone.
fn unitless_position(axis: &Axis, text: &str, unit: Unit) -> Problem {
    let examples = match unit.quantity() {
        _ if unit.is_linear() => format!("{text}mm or {text}cm"),
        Quantity::Position => format!("{text}deg or {text}turn"),
        _ => format!("{text}{}", unit.symbol()),
    };
    let raw = if axis.local().is_some() { "; --raw for the drive's own number" } else { "" };
    Problem::usage("E217", format!("{text:?} has no unit."))
        .why(format!("A position is never guessed. {}", outcome::sent_so_far()))
        .hint(format!("write {examples}{raw}"))
}

/// The error for an argument that the verb, or a verb that the drive, does not have.
fn unknown_argument(axis: &Axis, verb: Verb, which: Argument) -> Problem {
    let option = match which {
        Argument::Velocity => "--vel",
        Argument::Acceleration => "--acc",
        Argument::Deceleration => "--dec",
        Argument::Torque => "--torque",
        Argument::JerkTime => "--s-curve",
        Argument::Period => "--period",
        Argument::Path => "--path",
        Argument::Target => "VALUE",
    };
    let (name, has_verb) = (&axis.facts().profile, axis.has_verb(verb));
    let what = if has_verb {
        format!("{name} takes no {option} with this verb.")
    } else if matches!(verb, Verb::CurveTo | Verb::CurveBy) {
        format!("{name} takes no --s-curve.")
    } else {
        format!("{name} has no `{}`.", command_word(verb))
    };
    let missing = axis.local().map(|axis| axis.missing_for(verb, has_verb.then_some(which)));
    let reason = match missing.filter(|missing| !missing.is_empty()) {
        None => "Its profile has no steps for it.".to_owned(),
        Some(missing) => format!("The drive has no {missing}."),
    };
    let way_out = axis.local().filter(|_| !has_verb).map(|axis| axis.way_out(verb));
    let problem = Problem::usage("E218", what).why(format!("{reason} {}", outcome::sent_so_far()));
    match way_out.filter(|way_out| !way_out.is_empty()) {
        Some(way_out) => problem.hint(way_out),
        None => problem,
    }
}

/// Command line word of a verb of motion.
pub const fn command_word(verb: Verb) -> &'static str {
    match verb {
        Verb::Velocity => "spin",
        Verb::MoveTo | Verb::MoveBy | Verb::MoveOn | Verb::CurveTo | Verb::CurveBy => "move",
        other => other.name(),
    }
}

/// Runs a motion on each axis, and stops all of them if it ends early.
pub fn run_motion(session: &Session, commands: &[(Axis, Command)], then: MotionMode) -> Result {
    execute_motion(session, commands, then, check_commands, start_commands)
}

/// Runs moves that `record` starts at its moment: after the start it goes on, and the arrival is waited for
/// afterwards.
pub fn run_recorded(
    session: &Session,
    commands: &[(Axis, Command)],
    record: impl FnOnce(&mut dyn FnMut() -> Result<()>) -> Result<()>,
) -> Result {
    execute_motion(
        session,
        commands,
        MotionMode::Arrive(None),
        check_commands,
        |commands: &[_], deadline, unconfirmed: &mut _| {
            record(&mut || start_commands(commands, deadline, unconfirmed))
        },
    )
}

fn check_commands(commands: &[(Axis, Command)]) -> Result<()> {
    commands
        .iter()
        .try_for_each(|(axis, command)| axis.interface().check_command(*command))
        .map_err(to_problem)
}

/// Runs moves that begin at one signal.
pub fn run_together(session: &Session, commands: &[(Axis, Command)], then: MotionMode) -> Result {
    let hint = "remove --sync: the moves then start one after the other";
    let local = |(axis, command): &(Axis, Command)| {
        Ok((axis.require_local("--sync", hint)?.clone(), *command))
    };
    let local = commands.iter().map(local).collect::<std::result::Result<Vec<_>, Error>>();
    let local = local.map_err(to_problem)?;
    execute_motion(
        session,
        commands,
        then,
        |_: &[_]| check_together(&local).map_err(to_problem),
        |_: &[_], _, _| polepair::start_together(&local).map_err(to_problem),
    )
}

fn execute_motion(
    session: &Session,
    commands: &[(Axis, Command)],
    then: MotionMode,
    check: impl FnOnce(&[(Axis, Command)]) -> Result<()>,
    start: impl FnOnce(&[(Axis, Command)], Instant, &mut Option<Problem>) -> Result<()>,
) -> Result {
    if then == MotionMode::Detach {
        check_detach(session, commands)?;
    }
    session.listen_for_interrupts();
    let stops = if then == MotionMode::Detach { LEFT_RUNNING } else { CTRL_C_STOPS };
    print_start_note(session.axes().iter().cloned(), &session.arguments, stops);
    let mut started_motion = StartedMotion::new(&session.arguments);
    let within = match then {
        MotionMode::Arrive(Some(seconds)) => Duration::from_secs_f64(seconds),
        _ => ARRIVE_MAX,
    };
    // One span for all of it: homing is part of the command, the way to a target is not.
    let begin = session.now();
    let deadline = begin + within;
    let mut measured = report::MeasuredMotion::default();
    let mut unconfirmed = None;
    // Refusals come before anything has power.
    debug_assert!(!commands.is_empty());
    let ended = check(commands)
        .and_then(|()| started_motion.power_all(commands, &mut unconfirmed))
        .and_then(|()| {
            started_motion.mark_moved();
            start(commands, deadline, &mut unconfirmed)
        })
        .and_then(|()| match then {
            MotionMode::Hold(seconds) => {
                let mut monitors = start_monitors(commands);
                let held = watch_motion(commands, seconds, &mut monitors);
                measured.note_speeds(session, commands, &monitors);
                if held.is_ok() {
                    measured.read_others(session, commands);
                }
                held.and_then(|()| unconfirmed.take().map_or(Ok(()), Err))
            }
            MotionMode::Arrive(_) => {
                wait_arrival(commands, deadline)?;
                measured.note_emergencies(commands, begin);
                Ok(())
            }
            MotionMode::Detach => Ok(()),
        });
    if then == MotionMode::Detach && ended.is_ok() {
        started_motion.detach();
        print_warning(&match session.link.simulation() {
            Some(_) => "left running; the simulation ends with this program".to_owned(),
            None => format!("left running; to stop it: polepair stop {}", session.arguments),
        });
        return unconfirmed.map_or(Ok(Exit::Ok), Err);
    }
    let arrived = matches!(then, MotionMode::Arrive(_)) && ended.is_ok();
    let quiet = started_motion.stopped_text();
    let stopped = started_motion.finish(arrived);
    // After the stop: a full pipe must not hold it up.
    measured.print()?;
    conclude(ended, stopped, quiet)
}

/// Refuses to leave a motion running that nothing would watch, or that its gateway stops.
fn check_detach(session: &Session, commands: &[(Axis, Command)]) -> Result<()> {
    if session.link.local().is_none() {
        return Err(remote::unsupported_problem(
            "--detach",
            "Motion of a client is stopped when the client ends.",
        ));
    }
    let limited = commands.iter().find(|(axis, command)| {
        matches!(command.verb, Verb::Velocity | Verb::Torque) && has_axis_limits(axis)
    });
    match limited {
        None => Ok(()),
        Some((axis, _)) => {
            let what = format!("{} has limits that would not be checked.", axis.label());
            Err(Problem::usage("E223", what)
                .why("A speed or torque that keeps running would exceed its position limits.")
                .hint("remove --detach, or give a target: polepair move"))
        }
    }
}

fn has_axis_limits(axis: &Axis) -> bool {
    axis.local().is_some_and(LocalAxis::has_position_limits)
}

/// Result of a verb that has ended a motion: the reason of the end, and the result of its stop.
pub fn conclude(ended: Result<()>, stopped: Result<()>, quiet: &str) -> Result {
    match (ended, stopped) {
        (Ok(()), stopped) => stopped.map(|()| Exit::Ok),
        (Err(problem), Ok(())) if problem.exit == Exit::Interrupted => {
            print_warning(&format!("interrupted: {quiet}"));
            Err(Problem::interrupted())
        }
        (Err(problem), Err(stop)) if problem.exit == Exit::Interrupted => Err(stop),
        // Whatever was feared when it ended, the stop was acknowledged.
        (Err(problem), Ok(())) => Err(Problem { may_turn: false, ..problem }),
        // The cause of both is one: the link is lost.
        (Err(problem), Err(stop)) if problem.code == stop.code => {
            let may_turn = problem.may_turn || stop.may_turn;
            Err(Problem { may_turn, ..join_problems(problem, stop) })
        }
        // The reason of the end comes last; a failed stop is no less true.
        (Err(problem), Err(stop)) => {
            terminal::draw(&stop.render(terminal::colour_err()));
            Err(Problem { may_turn: problem.may_turn || stop.may_turn, ..problem })
        }
    }
}

/// Arms and powers an axis for a motion that ends by itself, and stops it at its end, whatever that
/// was.
pub fn run_powered(arguments: &str, axis: &Axis, motion: impl FnOnce() -> Result<()>) -> Result {
    let mut started_motion = StartedMotion::new(arguments);
    let ended = started_motion
        .arm(axis)
        .and_then(|()| run_optional_verb(axis, Verb::Enable))
        .and_then(|()| {
            started_motion.started.iter_mut().for_each(|one| one.enabled_here = true);
            started_motion.mark_moved();
            motion()
        });
    let quiet = started_motion.stopped_text();
    conclude(ended, started_motion.finish(false), quiet)
}

/// Starts all of them back to back, and waits until each verb has ended.
fn start_commands(
    commands: &[(Axis, Command)],
    deadline: Instant,
    unconfirmed: &mut Option<Problem>,
) -> Result<()> {
    // All are started before the first is waited for.
    let started = start_each(commands).map_err(to_problem)?;
    let mut started = started.into_iter().zip(commands);
    started.try_for_each(|(mut request, (axis, command))| {
        let started = wait_request(axis, command.verb, &mut request, deadline);
        keep_unconfirmed(started, unconfirmed)
    })
}

/// Goes on after a command that was sent and that nothing confirms. The last such problem is the result of the verb.
pub fn keep_unconfirmed(result: Result<()>, kept: &mut Option<Problem>) -> Result<()> {
    match result {
        Err(problem) if problem.exit == Exit::Unconfirmed => {
            *kept = Some(problem);
            Ok(())
        }
        result => result,
    }
}

/// Waits for the end of a request, Ctrl-C or the deadline.
fn wait_request(
    axis: &Axis,
    verb: Verb,
    request: &mut AxisRequest,
    deadline: Instant,
) -> Result<()> {
    loop {
        if interrupt::was_interrupted() {
            return Err(Problem::interrupted());
        }
        let left = deadline.since(axis.now());
        if request.wait(left.min(POLL_INTERVAL)).map_err(to_problem)?.is_some() {
            return Ok(());
        }
        // After the poll: what ended in the last moment has ended.
        if axis.now() >= deadline {
            return Err(late_problem(axis.label(), verb).hint("increase --timeout"));
        }
        // Control of a server's axis may be lost while it moves; another client then decides.
        axis.interface().check_control().map_err(to_problem)?;
    }
}

/// Runs a verb without arguments if the drive has it.
pub fn run_optional_verb(axis: &Axis, verb: Verb) -> Result<()> {
    if !axis.has_verb(verb) {
        return Ok(());
    }
    let mut request = axis.start(Command::new(verb)).map_err(to_problem)?;
    wait_request(axis, verb, &mut request, axis.now() + VERB_MAX)
}

/// Problem of a wait that was in vain.
pub fn late_problem(label: &str, verb: Verb) -> Problem {
    let what = format!("{label}: {} did not end in time.", verb.name());
    Problem::new(Exit::Negative, "E101", what).why("The expected state was not reached in time.")
}

/// Waits, and shows what the drive does where a person looks.
pub fn hold_motion(commands: &[(Axis, Command)], seconds: Option<f64>) -> Result<()> {
    watch_motion(commands, seconds, &mut start_monitors(commands))
}

fn start_monitors(commands: &[(Axis, Command)]) -> Vec<MotionMonitor> {
    commands.iter().map(|(axis, command)| MotionMonitor::new(axis, command)).collect()
}

fn watch_motion(
    commands: &[(Axis, Command)],
    seconds: Option<f64>,
    monitors: &mut [MotionMonitor],
) -> Result<()> {
    let Some((clock, _)) = commands.first() else { return Ok(()) };
    let mut live = LiveLine::new();
    let pause = |until: Instant| clock.sleep(until.since(clock.now()));
    hold_while(seconds, (&|| clock.now(), &pause), |now| {
        monitors.iter_mut().try_for_each(MotionMonitor::check).map_err(to_problem)?;
        monitors.iter_mut().flat_map(MotionMonitor::take_notes).for_each(|note| print_note(&note));
        live.show(now, commands)
    })?;
    for monitor in monitors {
        if let Some(note) = monitor.finish().map_err(to_problem)? {
            print_note(&note);
        }
    }
    Ok(())
}

/// The clock of waits: its time, and a sleep until an instant of it.
pub type ClockFns<'a> = (&'a dyn Fn() -> Instant, &'a dyn Fn(Instant));

/// Waits for `seconds`, or until Ctrl-C, as long as `query` finds no error.
pub fn hold_while(
    seconds: Option<f64>,
    (now, pause): ClockFns<'_>,
    mut query: impl FnMut(Instant) -> Result<()>,
) -> Result<()> {
    debug_assert!(seconds.is_none_or(|seconds| seconds >= 0.0));
    let end = seconds.map(|seconds| now().plus_ns((seconds * 1e9) as u64));
    if seconds.is_none() {
        print_note("running; Ctrl-C stops it");
    }
    loop {
        let now = now();
        if interrupt::was_interrupted() {
            return Err(Problem::interrupted());
        }
        if end.is_some_and(|end| now >= end) {
            return Ok(());
        }
        query(now)?;
        let until = now.plus_ms(POLL_MS);
        pause(end.map_or(until, |end| until.min(end)));
    }
}

/// Ends with the drive's fault, if it has one that stops it.
pub fn check_fault(axis: &LocalAxis) -> Result<()> {
    let faults = AxisReadings::faults(axis).map_err(to_problem)?;
    match faults.iter().find(|fault| !fault.is_warning) {
        None => Ok(()),
        Some(fault) => Err(to_problem(fault.to_error(&axis.label()))),
    }
}

/// The error for a command whose effect nothing shows.
pub fn unconfirmed_problem(label: &str, what: &str) -> Problem {
    let what = format!("{label}: {what} was sent; nothing confirms it on this wire.");
    Problem::new(Exit::Unconfirmed, "E901", what)
        .hint("name the axes instead of the group, so that each is asked, or look at the motors")
}

/// Waits until the arrival of each axis was measured.
fn wait_arrival(commands: &[(Axis, Command)], deadline: Instant) -> Result<()> {
    for (axis, command) in commands {
        // Homing ends when the reference is found.
        if command.verb == Verb::Home {
            continue;
        }
        if !axis.has_verb(Verb::Reached) {
            return Err(unconfirmed_problem(axis.label(), "the motion"));
        }
        match axis.local() {
            Some(axis) => axis.wait(deadline.since(axis.connection().now())).map_err(to_problem)?,
            None => {
                let mut request = axis.start(Command::new(Verb::Reached)).map_err(to_problem)?;
                wait_request(axis, command.verb, &mut request, deadline)?;
            }
        }
    }
    Ok(())
}

/// Stops a motion that something else started, and takes the power off if `power_off`.
pub fn end_motion(axis: Axis, power_off: bool) -> Result<()> {
    stop_started(&[StartedAxis { axis, enabled_here: power_off, moved: true }], false)
}

/// Stops the started axes, all at once, and removes the power that was switched on. A lost stop is repeated for a
/// while: no other program would.
fn stop_started(started: &[StartedAxis], arrived: bool) -> Result<()> {
    let is_ours = |one: &StartedAxis| one.axis.interface().check_control().is_ok();
    let mut ended_motions = if arrived { Vec::new() } else { end_motions(started) }.into_iter();
    let mut ended = Ok(());
    for one @ StartedAxis { axis, enabled_here, .. } in started {
        // An axis that this program no longer controls is left to its gateway.
        let is_ours = is_ours(one);
        let EndedMotion { stopped, power_off } = ended_motions.next().unwrap_or_else(|| {
            let switches = *enabled_here && is_ours && axis.has_verb(Verb::Disable);
            EndedMotion { stopped: Ok(()), power_off: switches.then(|| axis.disable()) }
        });
        let is_off = power_off == Some(Ok(()));
        let stopped = stopped.map_err(to_problem);
        let off = power_off.unwrap_or(Ok(())).map_err(to_problem);
        let disarmed = if is_ours { axis.disarm().map_err(to_problem) } else { Ok(()) };
        if stopped.is_err() && !is_off {
            print_warning(&format!("{} may {}: cut its supply", axis.label(), one.risk_text()));
        } else if off.is_err() {
            print_warning(&format!("{} may still be powered", axis.label()));
        }
        ended = match (ended, stopped.and(off).and(disarmed)) {
            (Err(first), Err(second)) => Err(join_problems(first, second)),
            (first, second) => first.and(second),
        };
    }
    ended
}

/// The first of two problems, with the advice of both.
fn join_problems(mut first: Problem, second: Problem) -> Problem {
    for hint in second.hints {
        if !first.hints.contains(&hint) {
            first.hints.push(hint);
        }
    }
    first
}

/// Stops axes, and takes the power off that was put on.
fn end_motions(started: &[StartedAxis]) -> Vec<EndedMotion> {
    let axes: Vec<(Axis, bool)> =
        started.iter().map(|one| (one.axis.clone(), one.enabled_here)).collect();
    let mut report = StopPrinter::new();
    let ended = stop_each(&axes, |axis, notice| {
        let one = started.iter().find(|one| one.axis.number() == axis.number());
        let risk = one.map_or("still turn", |one| one.risk_text());
        report.report_notice(axis.label(), notice, risk)
    });
    for ((axis, _), ended) in axes.iter().zip(&ended) {
        report.report_end(axis.label(), ended.stopped.is_ok());
    }
    ended
}

/// Note of a quick stop that was not requested.
pub fn quick_stop_text(label: &str) -> String {
    format!("{label}: the stop had no effect; a quick stop was sent")
}

/// Printer of pending stops.
pub struct StopPrinter {
    reported: Vec<String>,
    /// Number of signals that end the wait for a stop: the first one, at any time, requests it.
    interrupt_limit: u32,
}

impl StopPrinter {
    pub fn new() -> Self {
        Self { reported: Vec::new(), interrupt_limit: interrupt::count().max(1) + 1 }
    }

    /// Prints news of a stop, once per axis that it is repeated. False if the user ends it.
    pub fn report_notice(&mut self, label: &str, notice: &StopNotice, may: &str) -> bool {
        match notice {
            StopNotice::Unconfirmed(_) => self.report_retry(label, may),
            StopNotice::QuickStop => {
                print_warning(&quick_stop_text(label));
                true
            }
            StopNotice::Waiting => true,
        }
    }

    /// Prints once for an axis that its stop is repeated. False if the user ends it.
    pub fn report_retry(&mut self, label: &str, may: &str) -> bool {
        if !self.reported.iter().any(|reported| reported == label) {
            print_warning(&format!(
                "{label} may {may}: cut its supply. Its stop was not confirmed, and is repeated \
                 for \
                 {} s",
                STOP_RETRY_MAX.as_secs()
            ));
            self.reported.push(label.to_owned());
        }
        // The first interrupt began the stop, and does not end it.
        interrupt::count() < self.interrupt_limit
    }

    /// Prints of an axis that its stop was confirmed after all.
    pub fn report_end(&self, label: &str, is_stopped: bool) {
        if is_stopped && self.reported.iter().any(|reported| reported == label) {
            print_note(&format!("{label} is stopped"));
        }
    }
}

/// One line on a terminal, drawn again and again.
struct LiveLine {
    shown: bool,
    next: Instant,
}

impl LiveLine {
    fn new() -> Self {
        use std::io::IsTerminal as _;
        let shown = std::io::stderr().is_terminal() && terminal::colour_err();
        Self { shown, next: Instant::ZERO }
    }

    fn show(&mut self, now: Instant, commands: &[(Axis, Command)]) -> Result<()> {
        if !self.shown || now < self.next {
            return Ok(());
        }
        self.next = now.plus_ms(READ_MS);
        let mut line = String::new();
        for (axis, _) in commands {
            let _ = write!(line, "{}", axis.label());
            for wanted in [Signal::Velocity, Signal::Position, Signal::Current] {
                if let Some(text) = session::signal_text(axis, wanted)? {
                    let _ = write!(line, "  {} {text}", wanted.name());
                }
            }
            line.push_str("   ");
        }
        terminal::draw(&format!("\r\x1b[K{line}"));
        Ok(())
    }
}

impl Drop for LiveLine {
    fn drop(&mut self) {
        if self.shown {
            terminal::draw("\r\x1b[K");
        }
    }
}
