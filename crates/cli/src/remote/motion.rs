//! Motion on a server: acquires the lease, powers, starts, waits, stops, releases the lease.

use std::time::Duration;

use polepair::quantity;
use polepair::url::{AxisNumber, shell_word};
use polepair_client::message::{ActiveFault, AxisInfo, AxisState, CommandArguments, SignalValue};
use polepair_client::{GatewayError, Lease, LiveConnection, PendingOperation, display_unit};
use polepair_core::axis::{Command, Verb};
use polepair_core::profile::Signal;
use polepair_core::time::Instant;
use polepair_core::units::Unit;
use polepair_link::clock;

use super::{RemoteSession, format_signal, refusal_problem, signal_unit, unsupported_problem};
use crate::interrupt;
use crate::motion::{ARRIVE_MAX, HoldCheck, MotionMode, command_word, hold_while, late_problem};
use crate::outcome::{self, to_sentence};
use crate::problem::{Exit, Problem, Result};
use crate::terminal::{print_note, print_warning};

/// How long a wait lasts before Ctrl-C and faults are looked for.
const POLL_INTERVAL: Duration = Duration::from_millis(25);
/// What a verb may take that is over when the drive has answered.
pub const ANSWER_MAX: Duration = Duration::from_secs(10);
/// A server answers who says stop within 10 s.
const STOP_MAX: Duration = Duration::from_secs(12);
/// How long a value is waited for that was read after it was asked for.
const FRESH_MAX: Duration = Duration::from_secs(1);
/// How long a drive may be silent while its motor is held in motion. A server tells an axis' state every
/// second, though nothing of it has changed.
const SILENT_MAX: Duration = Duration::from_millis(2500);
/// How long the server may be silent before nothing that it told of a drive is news. It answers twice a
/// second; that it is gone is known later.
const SERVER_SILENT_MAX: Duration = Duration::from_millis(1500);
/// How long a motor whose lease was lost is waited for: who took it, or stopped it, has it stand.
const LOST_MAX: Duration = Duration::from_secs(3);

/// What an axis is to do.
pub struct MotionOrder {
    pub axis: AxisInfo,
    pub verb: Verb,
    pub arguments: CommandArguments,
}

/// Reads an argument of a verb. The server takes SI: without a unit nobody could tell whose is meant.
pub fn parse_argument(axis: &AxisInfo, verb: Verb, name: &str, text: &str) -> Result<f64> {
    let info = axis.verbs.iter().find(|info| info.verb == verb.name());
    let info = info.ok_or_else(|| {
        let what = format!("{} has no `{}`.", axis.profile, command_word(verb));
        Problem::usage("E218", what).why("Its profile has no steps for it.")
    })?;
    let argument = info.arguments.iter().find(|argument| argument.name == name);
    let argument = argument.ok_or_else(|| {
        let what = format!("{} takes no {name} with this verb.", axis.profile);
        Problem::usage("E218", what).why("Its profile does not use it.")
    })?;
    let measure = quantity::parse(text).map_err(outcome::to_problem)?;
    let unit = display_unit(&argument.unit);
    if measure.quantity.is_none() && unit != Unit::Percent && measure.si != 0.0 {
        return Err(Problem::usage("E217", format!("{text:?} has no unit."))
            .why("The default unit of the drive is not known on a server.")
            .hint(format!("{text}{}", argument_unit(axis, name, unit).symbol())));
    }
    measure.si(unit).map_err(outcome::to_problem)
}

/// The unit in which people read what an argument sets.
fn argument_unit(axis: &AxisInfo, argument: &str, unit: Unit) -> Unit {
    let signal = if argument == "target" { Signal::Position.name() } else { argument };
    signal_unit(axis, signal, unit.si_symbol()).unwrap_or(unit)
}

/// An axis that is ours.
struct LeasedAxis<'a> {
    axis: &'a AxisInfo,
    lease: Lease,
    /// It was not powered before.
    enabled_here: bool,
    /// Since when it is ours: a fault that was read before may have been cleared.
    since: Instant,
}

/// Carries a motion out, and stops what it started when it ends early.
pub fn run_motion(server: &RemoteSession, motions: &[MotionOrder], then: MotionMode) -> Result {
    if then == MotionMode::Detach {
        return Err(unsupported_problem(
            "--detach",
            "Motion of a client is stopped when the client ends.",
        ));
    }
    print_caution(motions);
    interrupt::listen(|| {});
    let live = server.gateway.live().map_err(refusal_problem)?;
    let mut leased = take_leases(&live, motions)?;
    let within = match then {
        MotionMode::Arrive(Some(seconds)) => Duration::from_secs_f64(seconds),
        _ => ARRIVE_MAX,
    };
    let deadline = clock::now() + within;
    let powered = leased.iter_mut().try_for_each(|leased_axis| leased_axis.arm_and_power(server));
    let ended =
        powered.and_then(|()| start_all(&leased, motions, deadline)).and_then(|()| match then {
            MotionMode::Hold(seconds) => hold_motion(&live, &leased, motions, seconds),
            _ => wait_arrival(&leased, motions, deadline),
        });
    let arrived = ended.is_ok() && matches!(then, MotionMode::Arrive(_));
    // Whoever has no link to a drive any more cannot stop it: neither we, nor the server.
    let cut = leased.iter().find_map(|leased_axis| leased_axis.lost_link(&live));
    let ours = leased.iter().all(|leased_axis| leased_axis.lease.check().is_ok());
    let stood = leased.iter().all(LeasedAxis::was_left_standing);
    let stopped = stop_and_release(&live, leased, arrived);
    match (ended, cut) {
        (Ok(()), _) => stopped.map(|()| Exit::Ok),
        (Err(problem), Some(cut)) => {
            let problem = match problem.exit {
                Exit::Interrupted => refusal_problem(cut),
                // The lease ended with the server.
                _ if stood => Problem::new(
                    cut.exit(),
                    cut.code,
                    "The connection to the server is \
                 lost.",
                ),
                _ => problem,
            };
            if stood {
                return Err(Problem { may_turn: false, ..problem }
                    .why("The server stopped the axis before it ended: standstill is confirmed."));
            }
            // A simulated motor is gone with its server.
            let may_turn = motions.iter().any(|motion_order| !motion_order.axis.simulated);
            let problem = Problem { may_turn, ..problem };
            match live.check() {
                // The server opens the link again, and says the stop then.
                Ok(()) => Err(problem),
                Err(_) => Err(hint_direct_stop(server, motions, problem)),
            }
        }
        (Err(problem), None) if problem.exit == Exit::Interrupted => {
            stopped?;
            print_warning("interrupted: the motion was stopped");
            Err(Problem::interrupted())
        }
        // What was feared when it ended is over where the stop was acknowledged. An axis that is ours no
        // more was told none by us.
        (Err(problem), None) => {
            let may_turn = problem.may_turn && (stopped.is_err() || !ours);
            Err(Problem { may_turn, ..problem })
        }
    }
}

/// What is left to do where a server is gone: each motor by itself.
fn hint_direct_stop(server: &RemoteSession, motions: &[MotionOrder], problem: Problem) -> Problem {
    let mut problem = Problem { hints: Vec::new(), ..problem };
    for MotionOrder { axis, .. } in motions {
        let link = server.bench.links.iter().find(|link| link.id == axis.link);
        if let Some(link) = link.filter(|link| !link.simulated) {
            let url = link.url.split('#').next().unwrap_or_default();
            let url = format!("{url}#{}", AxisNumber(axis.number));
            problem = problem.hint(format!(
                "`polepair stop {}` stops it without the server, as soon as the server has \
                 released the port",
                shell_word(&url)
            ));
        }
    }
    problem
}

/// Says what to watch out for, once per product.
fn print_caution(motions: &[MotionOrder]) {
    let mut reports: Vec<&str> = Vec::new();
    for MotionOrder { axis, .. } in motions {
        if reports.contains(&&*axis.profile) {
            continue;
        }
        reports.push(&axis.profile);
        if !axis.caution.is_empty() {
            print_note(&format!("caution: {}: {}", axis.profile, axis.caution));
        }
        print_note(&format!("watchdog: {}", axis.watchdog));
    }
}

/// Takes every axis before any of them moves.
fn take_leases<'a>(
    live: &LiveConnection,
    motions: &'a [MotionOrder],
) -> Result<Vec<LeasedAxis<'a>>> {
    let all = motions.iter().map(|MotionOrder { axis, .. }| {
        let lease = live.acquire_lease(axis.id).map_err(refusal_problem)?;
        Ok(LeasedAxis { axis, lease, enabled_here: false, since: clock::now() })
    });
    all.collect()
}

impl LeasedAxis<'_> {
    fn arm_and_power(&mut self, server: &RemoteSession) -> Result<()> {
        let enabled = fresh_state(server, self.axis)?.enabled;
        self.run_verb("arm")?;
        if enabled != Some(true) && self.has_verb(Verb::Enable) {
            self.enabled_here = true;
            self.run_verb(Verb::Enable.name())?;
        }
        Ok(())
    }

    /// Why nobody can stop it from here: the server, or the axis' link there, is gone.
    fn lost_link(&self, live: &LiveConnection) -> Option<GatewayError> {
        live.check_link(self.axis.id).err().map(|why| GatewayError { executed: None, ..why })
    }

    /// Whether the last that the server said of it is that it stands, and commanded by nobody.
    fn was_left_standing(&self) -> bool {
        self.lease.state().is_some_and(|state| {
            state.lease.is_none() && state.owed.is_none() && state.moving == Some(false)
        })
    }

    fn has_verb(&self, verb: Verb) -> bool {
        self.axis.verbs.iter().any(|info| info.verb == verb.name())
    }

    /// Carries out a verb without arguments.
    fn run_verb(&self, verb: &str) -> Result<()> {
        self.lease.run(verb, CommandArguments::default(), ANSWER_MAX).map_err(refusal_problem)
    }
}

/// Starts all of them back to back.
fn start_all(leased: &[LeasedAxis<'_>], motions: &[MotionOrder], deadline: Instant) -> Result<()> {
    let started = leased.iter().zip(motions).map(|(leased_axis, motion)| {
        leased_axis.lease.start(motion.verb.name(), motion.arguments).map_err(refusal_problem)
    });
    let started_at = started.collect::<Result<Vec<_>>>()?;
    let mut all = started_at.into_iter().zip(leased.iter().zip(motions));
    all.try_for_each(|(pending, (leased_axis, motion))| {
        wait_command(pending, leased_axis, motion.verb, deadline)
    })
}

/// Waits for the end of a command, Ctrl-C or the deadline.
fn wait_command(
    mut pending: PendingOperation,
    leased: &LeasedAxis<'_>,
    verb: Verb,
    deadline: Instant,
) -> Result<()> {
    loop {
        if interrupt::was_interrupted() {
            return Err(Problem::interrupted());
        }
        match pending.wait(POLL_INTERVAL) {
            Ok(Some(())) => return Ok(()),
            Ok(None) if clock::now() >= deadline => {
                return Err(late_problem(&leased.axis.label, verb).hint("increase --timeout"));
            }
            Ok(None) => {}
            Err(error) => return Err(refusal_problem(error)),
        }
        leased.lease.check().map_err(refusal_problem)?;
    }
}

fn hold_motion(
    live: &LiveConnection,
    leased: &[LeasedAxis<'_>],
    motions: &[MotionOrder],
    seconds: Option<f64>,
) -> Result<()> {
    let held = |motion: &MotionOrder| {
        let command = Command { velocity: motion.arguments.velocity, ..Command::new(motion.verb) };
        HoldCheck::new(motion.axis.label.clone(), &command)
    };
    let mut held: Vec<_> = motions.iter().map(held).collect();
    let started_at = clock::now();
    hold_while(seconds, (&clock::now, &clock::sleep_until), |now| {
        for (leased_axis, held) in leased.iter().zip(&mut held) {
            check_lease(live, leased_axis)?;
            live.check_link(leased_axis.axis.id).map_err(refusal_problem)?;
            check_responding(live, leased_axis)?;
            check_fault(leased_axis)?;
            let Some(state) = leased_axis.lease.state() else { continue };
            let newest = |signal: Signal| {
                let signal_value = state
                    .signals
                    .iter()
                    .find(|signal_value| signal_value.signal == signal.name())?;
                let since = now.since(started_at).as_secs_f64() * 1e3;
                signal_value.value.filter(|_| signal_value.age_ms < since)
            };
            let enabled = newest(Signal::Enabled).map(|value| value != 0.0);
            held.check(now, enabled, newest(Signal::Velocity))?;
        }
        Ok(())
    })
}

/// Ends when the axis is ours no more. The server stops it then; whether it stands is looked for.
fn check_lease(live: &LiveConnection, leased: &LeasedAxis<'_>) -> Result<()> {
    let Err(why) = leased.lease.check() else { return Ok(()) };
    let may_turn = !wait_rest(live, leased);
    Err(Problem { may_turn, ..refusal_problem(why) })
}

/// Whether an axis that is ours no more stands by what was read since, or is somebody else's.
fn wait_rest(live: &LiveConnection, leased: &LeasedAxis<'_>) -> bool {
    let started_at = clock::now();
    loop {
        let is_last = clock::now().since(started_at) >= clock::scale_timeout(LOST_MAX)
            || live.check().is_err();
        let since = clock::now().since(started_at).as_secs_f64() * 1e3;
        let is_over = leased.lease.state().is_some_and(|state| {
            let newest = newest_ms(&state);
            let stands =
                state.lease.is_none() && state.owed.is_none() && state.moving != Some(true);
            let of_another = state.lease.is_some_and(|lease| lease.epoch != leased.lease.epoch());
            of_another || stands && newest < since
        });
        if is_over || is_last {
            return is_over || leased.was_left_standing();
        }
        clock::sleep_until(clock::now() + POLL_INTERVAL);
    }
}

/// Ends when the drive has been silent for too long, by what the server says.
fn check_responding(live: &LiveConnection, leased: &LeasedAxis<'_>) -> Result<()> {
    let is_news = live.silence() < clock::scale_timeout(SERVER_SILENT_MAX);
    if !is_news || clock::now().since(leased.since) < clock::scale_timeout(SILENT_MAX) {
        return Ok(());
    }
    let silent = leased.lease.state().and_then(|state| silent_problem(leased.axis, &state));
    silent.map_or(Ok(()), |problem| Err(Problem { may_turn: true, ..problem }))
}

/// What is wrong with a drive that the server has not heard lately.
pub fn silent_problem(axis: &AxisInfo, state: &AxisState) -> Option<Problem> {
    is_silent(state).then(|| {
        let seconds = newest_ms(state) / 1e3;
        let what = format!("{} has not answered for {seconds:.1} s.", axis.label);
        Problem::new(Exit::NoReply, "E401", what)
            .why("The state of the motor is unknown.")
            .hint("check the supply, the wire and the adapter between the server and the drive")
    })
}

/// Whether nothing of what is known was heard lately.
fn is_silent(state: &AxisState) -> bool {
    !state.signals.is_empty()
        && newest_ms(state) > clock::scale_timeout(SILENT_MAX).as_secs_f64() * 1e3
}

/// How old the newest of what is known is, ms.
fn newest_ms(state: &AxisState) -> f64 {
    state.signals.iter().map(|value| value.age_ms).fold(f64::MAX, f64::min)
}

/// Ends with the drive's fault, if the server has read one since the axis is ours.
fn check_fault(leased: &LeasedAxis<'_>) -> Result<()> {
    let state = leased.lease.state();
    let ours = clock::now().since(leased.since);
    let Some(fault) = state.as_ref().and_then(|state| fault_within(state, ours)) else {
        return Ok(());
    };
    let what = format!("{} reports a fault: {}", leased.axis.label, fault.name);
    Err(Problem::new(Exit::DriveFault, "E801", to_sentence(&what))
        .why(&*fault.cause)
        .hint_if(Some(&*fault.remedy).filter(|remedy| !remedy.is_empty())))
}

/// The fault that stands by a value that is no older than this.
fn fault_within(state: &AxisState, age: Duration) -> Option<&ActiveFault> {
    let value = state.signals.iter().find(|value| value.signal == Signal::Fault.name())?;
    let is_new = value.age_ms < age.as_secs_f64() * 1e3;
    state.faults.first().filter(|_| is_new)
}

/// Waits until the drives say that they have arrived.
fn wait_arrival(
    leased: &[LeasedAxis<'_>],
    motions: &[MotionOrder],
    deadline: Instant,
) -> Result<()> {
    for (leased_axis, motion) in leased.iter().zip(motions) {
        // Homing ends when the reference is found.
        if motion.verb == Verb::Home {
            continue;
        }
        if !leased_axis.has_verb(Verb::Reached) {
            print_note(&format!(
                "{} does not report its arrival; the motion was started",
                leased_axis.axis.label
            ));
            continue;
        }
        let result = leased_axis.lease.start(Verb::Reached.name(), CommandArguments::default());
        wait_command(result.map_err(refusal_problem)?, leased_axis, motion.verb, deadline)?;
    }
    Ok(())
}

/// Stops what was started, takes the power off that was put on, and gives all back. An axis that is
/// ours no more is its next owner's: the end of the lease has stopped it.
fn stop_and_release(
    live: &LiveConnection,
    leased: Vec<LeasedAxis<'_>>,
    arrived: bool,
) -> Result<()> {
    let ours = |leased_axis: &LeasedAxis<'_>| leased_axis.lease.check().is_ok();
    let stop = |leased_axis: &LeasedAxis<'_>| {
        let stops = !arrived && ours(leased_axis) && leased_axis.has_verb(Verb::Stop);
        stops.then(|| leased_axis.lease.start(Verb::Stop.name(), CommandArguments::default()))
    };
    // Every stop is sent before the first is waited for.
    let stops: Vec<_> = leased.iter().map(stop).collect();
    let mut ended = Ok(());
    for (leased_axis, stop) in leased.into_iter().zip(stops) {
        let stopped =
            stop.map_or(Ok(()), |stop| match stop.and_then(|mut stop| stop.wait(STOP_MAX)) {
                Ok(Some(())) => Ok(()),
                Ok(None) => Err(late_problem(&leased_axis.axis.label, Verb::Stop)),
                Err(error) => Err(refusal_problem(error)),
            });
        // Who took it, or said stop, has it stand: that is no stop of ours any more.
        let lost = |problem: &Problem| ["gateway.lease", "gateway.busy"].contains(&&*problem.code);
        let is_lost = stopped.as_ref().is_err_and(|problem| lost(problem) || !ours(&leased_axis));
        let left = is_lost && wait_rest(live, &leased_axis);
        let stopped = if left { Ok(()) } else { stopped };
        if stopped.is_err() {
            let label = &leased_axis.axis.label;
            print_warning(&format!(
                "{label} did not confirm its stop and may still turn: cut its supply"
            ));
        }
        if !ours(&leased_axis) {
            ended = ended.and(stopped);
            continue;
        }
        let off = match leased_axis.enabled_here && leased_axis.has_verb(Verb::Disable) {
            true => leased_axis.run_verb(Verb::Disable.name()),
            false => Ok(()),
        };
        let back = leased_axis.lease.release().map_err(refusal_problem);
        ended = ended.and(stopped).and(off).and(back);
    }
    ended
}

/// An axis as the server saw it since it was asked for, or as it is known where that takes too long.
pub fn fresh_state(server: &RemoteSession, axis: &AxisInfo) -> Result<AxisState> {
    let started_at = clock::now();
    loop {
        let state = server.gateway.axis_state(axis.id).map_err(refusal_problem)?;
        let since = clock::now().since(started_at);
        let is_new = |read: &SignalValue| read.age_ms <= since.as_secs_f64() * 1e3;
        let all = state.signals.len() >= axis.signals.len() && state.signals.iter().all(is_new);
        if all || since >= FRESH_MAX {
            return Ok(state);
        }
        clock::sleep_until(clock::now() + POLL_INTERVAL);
    }
}

/// A signal as it is now, in SI.
pub fn read_fresh(
    server: &RemoteSession,
    axis: &AxisInfo,
    signal: Signal,
) -> Result<Option<SignalValue>> {
    read_since(server, axis, signal, clock::now() + clock::scale_timeout(FRESH_MAX))
}

/// A signal as it is now, with its unit.
pub fn fresh_text(
    server: &RemoteSession,
    axis: &AxisInfo,
    signal: Signal,
) -> Result<Option<String>> {
    let read = read_fresh(server, axis, signal)?;
    let value = read.as_ref().and_then(|read| Some((read.value?, &*read.unit)));
    Ok(value.map(|(value, unit)| format_signal(axis, signal.name(), value, unit)))
}

/// A signal that the server read since it was asked for, or what it has at the end.
fn read_since(
    server: &RemoteSession,
    axis: &AxisInfo,
    signal: Signal,
    end: Instant,
) -> Result<Option<SignalValue>> {
    let started_at = clock::now();
    loop {
        let state = server.gateway.axis_state(axis.id).map_err(refusal_problem)?;
        let read = state.signals.into_iter().find(|read| read.signal == signal.name());
        let age = clock::now().since(started_at).as_secs_f64() * 1e3;
        if clock::now() >= end || read.as_ref().is_none_or(|read| read.age_ms <= age) {
            return Ok(read);
        }
        clock::sleep_until(clock::now() + POLL_INTERVAL);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fault_that_was_read_before_it_was_cleared_ends_nothing() {
        let word = || "overvoltage".to_owned();
        let fault = ActiveFault {
            code: 4,
            name: word(),
            symbol: word(),
            cause: word(),
            remedy: word(),
            warning: false,
        };
        let signal = Signal::Fault.name().to_owned();
        let read = SignalValue { signal, value: Some(4.0), unit: String::new(), age_ms: 80.0 };
        let state = AxisState {
            id: 0,
            mode: None,
            enabled: Some(true),
            armed: true,
            moving: None,
            signals: vec![read],
            faults: vec![fault.clone()],
            lease: None,
            owed: None,
            panel: None,
        };
        let within = |ms| fault_within(&state, Duration::from_millis(ms));
        assert_eq!((within(50), within(100)), (None, Some(&fault)));
        let aged = |age_ms| {
            let signals = vec![SignalValue { age_ms, ..state.signals[0].clone() }];
            is_silent(&AxisState { signals, ..state.clone() })
        };
        assert_eq!((aged(2400.0), aged(2600.0)), (false, true));
    }
}
