//! Common parts of the motion verbs: caution, arming, enabling, waiting, stopping.

use std::fmt::Write as _;
use std::time::Duration;

use polepair::LocalAxis;
use polepair::axis::{STOP_RETRY_MAX, check_together, stop_with_retry};
use polepair_core::axis::{Command, Verb};
use polepair_core::plan::Argument;
use polepair_core::profile::{Severity, Signal};
use polepair_core::time::Instant;
use polepair_link::clock;

use crate::interrupt;
use crate::outcome;
use crate::problem::{Exit, Problem, Result};
use crate::session::{Session, read_signal, run_optional_verb};
use crate::terminal::{self, print_note, print_warning};
use crate::value;

/// How often a held motion looks for Ctrl-C and its end.
const POLL_MS: u32 = 25;
/// How often it reads the drive.
const READ_MS: u32 = 250;
/// How far ahead a held motion on an axis with ends looks: reading and stopping take their time.
const LOOKAHEAD: Duration = Duration::from_millis(150);
/// Of the speed that was asked for: faster than this share it has turned, slower than that it stands.
const TURNING_SHARE: f64 = 0.5;
const STANDSTILL_SHARE: f64 = 0.02;
/// A motor that is held in motion may stand for so long.
const STANDSTILL_MAX: Duration = Duration::from_secs(1);
/// How long a stopping motor keeps its power: Ctrl-C ends a verb within a second.
const STANDSTILL_WAIT_MAX: Duration = Duration::from_millis(800);
/// How long a move may take unless the user says otherwise.
pub const ARRIVE_MAX: Duration = Duration::from_secs(600);

/// What to do with a motion once it runs.
#[derive(Clone, Copy, PartialEq, Debug)]
pub enum MotionMode {
    /// Hold it for some seconds, or until Ctrl-C, and stop it.
    Hold(Option<f64>),
    /// Wait until it has arrived, at most so many seconds.
    Arrive(Option<f64>),
    /// Leave it running.
    Detach,
}

/// Reads an argument in its unit, or as the drive's own number.
pub fn parse_argument(
    axis: &LocalAxis,
    verb: Verb,
    which: Argument,
    (text, raw): (&str, bool),
) -> Result<f64> {
    let Some(unit) = axis.unit_of(verb, which) else {
        let option = match which {
            Argument::Velocity => "--vel",
            Argument::Acceleration => "--acc",
            Argument::Deceleration => "--dec",
            Argument::Torque => "--torque",
            Argument::JerkTime => "--s-curve",
            Argument::Period => "--period",
            Argument::Target => "VALUE",
        };
        let name = axis.profile().name;
        let what = match axis.profile().plan(verb) {
            None if matches!(verb, Verb::CurveTo | Verb::CurveBy) => {
                format!("{name} takes no --s-curve.")
            }
            None => format!("{name} has no `{}`.", command_word(verb)),
            Some(_) => format!("{name} takes no {option} with this verb."),
        };
        let planned = axis.profile().plan(verb).is_some();
        let missing = axis.missing_for(verb, planned.then_some(which));
        let reason = match missing.is_empty() {
            true => "Its profile has no steps for it.".to_owned(),
            false => format!("The drive has no {missing}."),
        };
        let why = format!("{reason} {}", outcome::sent_so_far());
        return Err(Problem::usage("E218", what).why(why));
    };
    if raw {
        let number = value::parse_whole(text).ok_or_else(|| {
            let what = format!("{text:?} is not a whole number.");
            Problem::usage("E217", what).why(outcome::sent_so_far())
        })?;
        return axis.raw_argument(verb, which, number).map_err(outcome::to_problem);
    }
    let measure = polepair::quantity::parse(text).map_err(outcome::to_problem)?;
    axis.check_scale(verb, which, text)
        .map_err(|error| outcome::to_problem(error).why(outcome::sent_so_far()))?;
    if measure.si != 0.0 {
        axis.check_unit(verb, which, text).map_err(outcome::to_problem)?;
    }
    // Why a unit is not the drive's, its parameter's description says best.
    let written = axis.destination(verb, which).flatten();
    measure.in_unit(unit).map_err(|wrong| {
        let about = written.map(|into| format!("It is written to {:?}: {}", into.name, into.about));
        outcome::to_problem(wrong).why(about.unwrap_or_default())
    })
}

/// The command that a verb of motion is said by.
pub const fn command_word(verb: Verb) -> &'static str {
    match verb {
        Verb::Velocity => "spin",
        Verb::MoveTo | Verb::MoveBy | Verb::MoveOn | Verb::CurveTo | Verb::CurveBy => "move",
        other => other.name(),
    }
}

/// Says what to watch out for, once per product, before anything moves.
pub fn print_caution(session: &Session) {
    let mut reports: Vec<&str> = Vec::new();
    for axis in session.axes() {
        let profile = axis.profile();
        if reports.contains(&profile.name) {
            continue;
        }
        reports.push(profile.name);
        if !profile.caution.is_empty() {
            print_note(&format!("caution: {}: {}", profile.name, profile.caution));
        }
        print_note(&format!("watchdog: {}", axis.watchdog_rule()));
    }
}

/// Carries a motion out on every axis of the session, and stops what it started when it ends early.
pub fn run_motion(
    session: &Session,
    commands: &[(LocalAxis, Command)],
    then: MotionMode,
) -> Result {
    let check = |commands: &[(LocalAxis, Command)]| {
        commands.iter().try_for_each(|(axis, command)| {
            axis.rehearse(*command).map(drop).map_err(outcome::to_problem)
        })
    };
    execute_motion(session, commands, then, (check, start_each))
}

/// The same with moves that begin at one signal.
pub fn run_together(
    session: &Session,
    commands: &[(LocalAxis, Command)],
    then: MotionMode,
) -> Result {
    let check = |commands: &[_]| check_together(commands).map_err(outcome::to_problem);
    let start = |commands: &[_], _| polepair::start_together(commands).map_err(outcome::to_problem);
    execute_motion(session, commands, then, (check, start))
}

fn execute_motion(
    session: &Session,
    commands: &[(LocalAxis, Command)],
    then: MotionMode,
    (check, start): (
        impl FnOnce(&[(LocalAxis, Command)]) -> Result<()>,
        impl FnOnce(&[(LocalAxis, Command)], Instant) -> Result<()>,
    ),
) -> Result {
    let watched = commands
        .iter()
        .find(|(axis, command)| axis.has_position_limits() && is_lasting(command.verb));
    if let Some((axis, _)) = watched.filter(|_| then == MotionMode::Detach) {
        let what = format!("{} has limits that would not be checked.", axis.label());
        return Err(Problem::usage("E223", what)
            .why("A speed or torque that keeps running would exceed its position limits.")
            .hint("remove --detach, or give a target: polepair move"));
    }
    print_caution(session);
    session.listen_for_interrupts();
    let mut started_motion = StartedMotion::new(&session.arguments);
    let within = match then {
        MotionMode::Arrive(Some(seconds)) => Duration::from_secs_f64(seconds),
        _ => ARRIVE_MAX,
    };
    // One span for all of it: homing is part of the command, the way to a target is not.
    let deadline = session.now() + within;
    // What is refused is refused before anything has power.
    let ended = check(commands)
        .and_then(|()| power_axes(commands, &mut started_motion))
        .and_then(|()| {
            started_motion.mark_moved();
            start(commands, deadline)
        })
        .and_then(|()| match then {
            MotionMode::Hold(seconds) => hold_motion(session, commands, seconds),
            MotionMode::Arrive(_) => wait_arrival(commands, deadline),
            MotionMode::Detach => Ok(()),
        });
    if then == MotionMode::Detach && ended.is_ok() {
        started_motion.detach();
        print_warning(&match session.link.simulation() {
            Some(_) => "left running; the simulation ends with this program".to_owned(),
            None => format!("left running; to stop it: polepair stop {}", session.arguments),
        });
        return Ok(Exit::Ok);
    }
    let arrived = matches!(then, MotionMode::Arrive(_)) && ended.is_ok();
    let quiet = started_motion.stopped_text();
    conclude(ended, started_motion.finish(arrived), quiet)
}

/// What a verb tells that has ended a motion: why it ended, and what became of its stop.
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
        // Why it ended is told last; that it was not stopped is no less true.
        (Err(problem), Err(stop)) => {
            terminal::draw(&stop.render(terminal::colour_err()));
            Err(problem)
        }
    }
}

/// Arms and powers an axis for a motion that ends by itself, and stops it at its end, whatever that
/// was.
pub fn run_powered(
    session: &Session,
    axis: &LocalAxis,
    motion: impl FnOnce() -> Result<()>,
) -> Result {
    let mut started_motion = StartedMotion::new(&session.arguments);
    let ended = started_motion.power(axis, true, None).and_then(|()| {
        started_motion.mark_moved();
        motion()
    });
    let quiet = started_motion.stopped_text();
    conclude(ended, started_motion.finish(false), quiet)
}

/// Whether a motion goes on until it is stopped.
const fn is_lasting(verb: Verb) -> bool {
    matches!(verb, Verb::Velocity | Verb::Torque)
}

/// Axes that this verb powers and sets in motion. Whatever ends it stops them, a panic too.
struct StartedMotion {
    started: Vec<StartedAxis>,
    _holding: interrupt::HoldGuard,
}

/// An axis that this verb set in motion.
struct StartedAxis {
    axis: LocalAxis,
    /// It was not powered before.
    enabled_here: bool,
    /// A motion was asked for, whether it was heard or not.
    moved: bool,
}

impl StartedMotion {
    fn new(url: &str) -> Self {
        Self { started: Vec::new(), _holding: interrupt::hold_motion(url) }
    }

    /// Arms an axis, and powers it in the mode of the verb that follows.
    fn power(&mut self, axis: &LocalAxis, powers: bool, verb: Option<Verb>) -> Result<()> {
        axis.arm(true);
        self.started.push(StartedAxis { axis: axis.clone(), enabled_here: powers, moved: false });
        if !powers {
            return Ok(());
        }
        let prepared = verb.map_or(Ok(()), |verb| axis.prepare_mode(verb));
        prepared.map_err(outcome::to_problem)?;
        run_optional_verb(axis, Verb::Enable).map(drop)
    }

    /// A motion is asked for.
    fn mark_moved(&mut self) {
        self.started.iter_mut().for_each(|one| one.moved = true);
    }

    /// What is told of it once all of it was stopped.
    fn stopped_text(&self) -> &'static str {
        match self.started.iter().any(|one| one.moved) {
            true => "the motion was stopped",
            false => "no motion was started",
        }
    }

    /// The motion goes on without this process.
    fn detach(mut self) {
        self.started.clear();
    }

    /// Stops what was started, all at once, and takes the power off that was put on.
    fn finish(mut self, arrived: bool) -> Result<()> {
        stop_started(&std::mem::take(&mut self.started), arrived)
    }
}

impl Drop for StartedMotion {
    fn drop(&mut self) {
        if !self.started.is_empty() {
            let _ = stop_started(&std::mem::take(&mut self.started), false);
        }
    }
}

/// Powers every axis, before any of them moves.
fn power_axes(commands: &[(LocalAxis, Command)], started_motion: &mut StartedMotion) -> Result<()> {
    for (axis, command) in commands {
        let enabled = read_signal(axis, Signal::Enabled)?.is_some_and(|read| read.raw != 0);
        started_motion.power(axis, !enabled, Some(command.verb))?;
    }
    Ok(())
}

/// Starts all of them back to back.
fn start_each(commands: &[(LocalAxis, Command)], deadline: Instant) -> Result<()> {
    // Each is on its way before the first is waited for; one that is refused ends all.
    let ready = commands.iter().map(|(axis, command)| axis.prepare(*command));
    let ready: Vec<_> =
        ready.collect::<std::result::Result<_, _>>().map_err(outcome::to_problem)?;
    let started = ready.iter().map(polepair::axis::PreparedCommand::start);
    let started_at: Vec<_> =
        started.collect::<std::result::Result<_, _>>().map_err(outcome::to_problem)?;
    for (mut running, (axis, command)) in started_at.into_iter().zip(commands) {
        let left = deadline.since(axis.connection().now());
        if running.wait(left).map_err(outcome::to_problem)?.is_none() {
            return Err(late_problem(&axis.label(), command.verb).hint("increase --timeout"));
        }
    }
    Ok(())
}

/// What a verb waited for did not come.
pub fn late_problem(label: &str, verb: Verb) -> Problem {
    let what = format!("{label}: {} did not end in time.", verb.name());
    Problem::new(Exit::Negative, "E101", what).why("The expected state was not reached in time.")
}

/// Waits, and shows what the drive does where a person looks.
pub fn hold_motion(
    session: &Session,
    commands: &[(LocalAxis, Command)],
    seconds: Option<f64>,
) -> Result<()> {
    let mut next = session.now();
    let mut live = LiveLine::new();
    let mut held: Vec<_> =
        commands.iter().map(|(axis, c)| HoldCheck::new(axis.label(), c)).collect();
    let pause = |until: Instant| session.link.sleep(until.since(session.now()));
    hold_while(seconds, (&|| session.now(), &pause), |now| {
        for (axis, _) in commands {
            if let Some(why) =
                axis.predict_limit_violation(LOOKAHEAD).map_err(outcome::to_problem)?
            {
                return Err(Problem::new(Exit::Negative, "E105", outcome::to_sentence(&why))
                    .hint("use a shorter time: --for; `polepair move` ends by itself"));
            }
        }
        if now >= next {
            next = now.plus_ms(READ_MS);
            for ((axis, _), held) in commands.iter().zip(&mut held) {
                check_fault(axis)?;
                let enabled = read_signal(axis, Signal::Enabled)?.map(|read| read.raw != 0);
                let velocity = match held.needs_velocity() {
                    true => read_signal(axis, Signal::Velocity)?,
                    false => None,
                };
                held.check(now, enabled, velocity.map(|read| read.value * read.unit.si_factor()))?;
            }
            live.show(commands)?;
        }
        Ok(())
    })
}

/// What tells of a motor that is held in motion whether it still is: another program, an input or the drive
/// itself may have ended that.
pub struct HoldCheck {
    label: String,
    /// The speed that was asked for, rad/s or m/s.
    velocity: Option<f64>,
    was_enabled: bool,
    has_turned: bool,
    stands_since: Option<Instant>,
}

impl HoldCheck {
    pub fn new(label: String, command: &Command) -> Self {
        let velocity = command.velocity.filter(|si| command.verb == Verb::Velocity && *si != 0.0);
        Self { label, velocity, was_enabled: false, has_turned: false, stands_since: None }
    }

    /// Whether its speed tells something.
    pub fn needs_velocity(&self) -> bool {
        self.velocity.is_some()
    }

    /// Takes what was read: whether it has power, and its speed in SI. `E102` when it has none any more, and
    /// when it stands though it turned before.
    pub fn check(&mut self, now: Instant, enabled: Option<bool>, si: Option<f64>) -> Result<()> {
        let ended =
            |what: &str, why: &str| {
                Err(Problem::new(Exit::Negative, "E102", format!("{} {what}.", self.label))
                .why(why)
                .hint("`polepair info URL` shows its state; check whether another master controls \
                 it"))
            };
        self.was_enabled |= enabled == Some(true);
        if self.was_enabled && enabled == Some(false) {
            return ended(
                "has lost its power during the motion",
                "Another program, an input or the drive itself switched it off.",
            );
        }
        let (Some(requested), Some(si)) = (self.velocity, si) else { return Ok(()) };
        self.has_turned |= si.abs() > requested.abs() * TURNING_SHARE;
        let stands = self.has_turned && si.abs() < requested.abs() * STANDSTILL_SHARE;
        self.stands_since = stands.then(|| self.stands_since.unwrap_or(now));
        match self.stands_since {
            Some(since) if now.since(since) >= clock::scale_timeout(STANDSTILL_MAX) => {
                ended("stopped during the motion", "Another program stopped it, or it is blocked.")
            }
            _ => Ok(()),
        }
    }
}

/// The clock that is waited on: what it shows, and who waits until an instant of it.
pub type ClockFns<'a> = (&'a dyn Fn() -> Instant, &'a dyn Fn(Instant));

/// Waits for so many seconds, or until Ctrl-C, for as long as each look finds nothing wrong.
pub fn hold_while(
    seconds: Option<f64>,
    (now, pause): ClockFns<'_>,
    mut query: impl FnMut(Instant) -> Result<()>,
) -> Result<()> {
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
    let Some(value) = read_signal(axis, Signal::Fault)? else { return Ok(()) };
    let code = u32::try_from(value.raw).unwrap_or(0);
    let faults = outcome::faults(axis.profile(), code);
    let Some(fault) = faults.iter().find(|fault| fault.severity == Severity::Fault) else {
        return Ok(());
    };
    let what = format!("{} reports a fault: {} ({})", axis.label(), fault.text, fault.name);
    Err(Problem::new(Exit::DriveFault, "E801", outcome::to_sentence(&what))
        .why(fault.cause)
        .hint_if(Some(fault.remedy).filter(|remedy| !remedy.is_empty())))
}

/// Waits until the drives say that they have arrived.
fn wait_arrival(commands: &[(LocalAxis, Command)], deadline: Instant) -> Result<()> {
    for (axis, command) in commands {
        // Homing ends when the reference is found.
        if command.verb == Verb::Home {
            continue;
        }
        if axis.profile().plan(Verb::Reached).is_none() {
            print_note(&format!(
                "{} does not report its arrival; the motion was started",
                axis.label()
            ));
            continue;
        }
        axis.wait(deadline.since(axis.connection().now())).map_err(outcome::to_problem)?;
    }
    Ok(())
}

/// Stops what was started, all at once, and takes the power off that was put on. A stop that was lost
/// is said again for a while: nobody else would.
fn stop_started(started: &[StartedAxis], arrived: bool) -> Result<()> {
    let pending: Vec<&StartedAxis> = started.iter().filter(|_| !arrived).collect();
    let mut stopped = stop_started_axes(&pending).into_iter();
    let mut ended = Ok(());
    for one @ StartedAxis { axis, enabled_here, .. } in started {
        let stopped = stopped.next().unwrap_or(Ok(()));
        // Also after a stop that failed: a motor without power at least does not drive.
        let off = if *enabled_here { run_optional_verb(axis, Verb::Disable) } else { Ok(None) };
        axis.arm(false);
        let is_off = *enabled_here && off.is_ok();
        if stopped.is_err() && !is_off {
            print_warning(&format!("{} may {}: cut its supply", axis.label(), one.risk_text()));
        } else if off.is_err() {
            print_warning(&format!("{} may still be powered", axis.label()));
        }
        ended = ended.and(stopped).and(off.map(drop));
    }
    ended
}

impl StartedAxis {
    /// What a motor may do whose stop nobody confirmed.
    const fn risk_text(&self) -> &'static str {
        if self.moved { "still turn" } else { "still be powered" }
    }
}

/// Stops axes.
fn stop_started_axes(started: &[&StartedAxis]) -> Vec<Result<()>> {
    let axes: Vec<LocalAxis> = started.iter().map(|one| one.axis.clone()).collect();
    let mut stop_retry_notice = StopRetryNotice::new();
    let ended = stop_with_retry(&axes, STOP_RETRY_MAX, |axis, _| {
        let one = started.iter().find(|one| one.axis.number() == axis.number());
        stop_retry_notice.report_retry(axis, one.map_or("still turn", |one| one.risk_text()))
    });
    let reports =
        axes.iter().zip(ended).map(|(axis, ended)| stop_retry_notice.report_end(axis, ended));
    reports.collect()
}

/// What is said of stops that were lost.
pub struct StopRetryNotice {
    reported: Vec<String>,
    /// So many signals that ask for a stop leave it: one asks for it, whenever that comes.
    interrupt_limit: u32,
}

impl StopRetryNotice {
    pub fn new() -> Self {
        Self { reported: Vec::new(), interrupt_limit: interrupt::count().max(1) + 1 }
    }

    /// Says once of an axis that its stop is said again; false when somebody wants this to end.
    pub fn report_retry(&mut self, axis: &LocalAxis, may: &str) -> bool {
        let label = axis.label();
        if !self.reported.contains(&label) {
            print_warning(&format!(
                "{label} may {may}: cut its supply. Its stop was not confirmed, and is repeated \
                 for \
                 {} s",
                STOP_RETRY_MAX.as_secs()
            ));
            self.reported.push(label);
        }
        interrupt::count() < self.interrupt_limit
    }

    /// Says of an axis that its stop was confirmed after all.
    pub fn report_end(
        &self,
        axis: &LocalAxis,
        ended: std::result::Result<(), polepair::Error>,
    ) -> Result<()> {
        if ended.is_ok() && self.reported.contains(&axis.label()) {
            print_note(&format!("{} is stopped", axis.label()));
        }
        ended.map_err(outcome::to_problem)
    }
}

/// Waits until a motor that was told to stop stands still: without power it would coast.
pub fn wait_standstill(axis: &LocalAxis) -> Result<()> {
    let now = || axis.connection().now();
    let end = now() + clock::scale_timeout(STANDSTILL_WAIT_MAX);
    while let Some(velocity) = read_signal(axis, Signal::Velocity)?
        && velocity.raw.abs() > 1
        && now() < end
    {
        axis.sleep(Duration::from_millis(POLL_MS.into()));
    }
    Ok(())
}

/// One line on a terminal, drawn again and again.
struct LiveLine {
    shown: bool,
}

impl LiveLine {
    fn new() -> Self {
        use std::io::IsTerminal as _;
        Self { shown: std::io::stderr().is_terminal() && terminal::colour_err() }
    }

    fn show(&mut self, commands: &[(LocalAxis, Command)]) -> Result<()> {
        if !self.shown {
            return Ok(());
        }
        let mut line = String::new();
        for (axis, _) in commands {
            let _ = write!(line, "{}", axis.label());
            for wanted in [Signal::Velocity, Signal::Position, Signal::Current] {
                if let Some(value) = read_signal(axis, wanted)? {
                    let _ = write!(line, "  {} {value}", wanted.name());
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
