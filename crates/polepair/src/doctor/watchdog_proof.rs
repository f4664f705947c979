//! Test of a drive's watchdog: turns the motor, stops sending, and checks that the motor stops.

use super::{CheckResult, read_watchdog};
use crate::axis::{
    LocalAxis, STOP_RETRY_MAX, StopNotice, StopOptions, StopResult, WatchdogState, stop_axes,
};
use crate::error::{Error, Exit, MAY_TURN};
use polepair_core::axis::Verb;
use polepair_core::profile::{AxisKind, ParameterId, Persistence, Signal, Watchdog};
use polepair_core::time::Instant;
use polepair_link::clock;
use std::fmt;
use std::time::Duration;

/// Time limit until the motor is seen to turn.
const SPIN_UP_MAX: Duration = Duration::from_secs(3);
/// Time limit of braking from such a slow speed.
const BRAKING_MAX: Duration = Duration::from_secs(2);
/// Time for which a host's heartbeat continues after the program's last request.
const HEARTBEAT_LEASE: Duration = Duration::from_secs(1);
/// Time of requests before that ends: longer than a heartbeat's usual period.
const HOST_ALIVE_TIME: Duration = Duration::from_millis(500);
/// Between two looks whether it turns.
const POLL_INTERVAL: Duration = Duration::from_millis(20);
/// The longest watchdog that is waited for.
const WATCHDOG_MAX: Duration = Duration::from_secs(60);

/// The speed at which [`prove_watchdog`] turns an axis: slow, and not too slow for any drive.
#[must_use]
pub const fn proving_speed(kind: AxisKind) -> &'static str {
    match kind {
        AxisKind::Linear => "5 mm/s",
        AxisKind::Rotary | AxisKind::Ratio => "60 rpm",
    }
}

/// Observer of a proof. A closure that takes checks is one that never ends it.
pub trait ProofObserver {
    /// Takes each finding as soon as it is made.
    fn report_check(&mut self, check: CheckResult);

    /// Returns whether it is to end now: the motor is then stopped at once. It is asked all the time.
    fn is_cancelled(&self) -> bool {
        false
    }

    /// Called if a stop was not confirmed; returns whether it is repeated. `turns` is false if standstill
    /// was confirmed, or the motor was never started.
    fn retry_stop(&mut self, axis: &LocalAxis, turns: bool) -> bool {
        let _ = (axis, turns);
        true
    }
}

impl<F: FnMut(CheckResult)> ProofObserver for F {
    fn report_check(&mut self, check: CheckResult) {
        self(check);
    }
}

/// Reason why nothing was proven.
#[derive(Clone, PartialEq, Debug)]
pub struct ProofError {
    /// Error of the proof; [`Error::Interrupted`] if the observer ended it.
    pub error: Box<Error>,
    /// The motor was started.
    pub moved: bool,
    /// True if standstill was not measured since.
    pub may_turn: bool,
}

impl From<Error> for ProofError {
    fn from(error: Error) -> Self {
        Self { may_turn: error.may_turn(), moved: false, error: error.into() }
    }
}

impl fmt::Display for ProofError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.error.sentence())?;
        if self.may_turn { write!(f, "; {MAY_TURN}") } else { Ok(()) }
    }
}

impl std::error::Error for ProofError {}

/// Turns the motor at [`proving_speed`], sends nothing for the time of the watchdog and the deceleration,
/// and then checks standstill. With `after` the watchdog is set first, and restored at the end, unless the
/// motor may still turn, because the watchdog may stop it. The motor is stopped and switched off in any
/// case; a lost stop is repeated for [`STOP_RETRY_MAX`]. The motor must be free to turn.
///
/// # Errors
/// [`ProofError`]: by source, with the state of the motor.
pub fn prove_watchdog(
    axis: &LocalAxis,
    after: Option<Duration>,
    witness: &mut dyn ProofObserver,
) -> Result<(), ProofError> {
    let Some(after) = after else { return run_proof(axis, read_watchdog(axis)?, witness) };
    if let Watchdog::None | Watchdog::Fixed { .. } = axis.profile().watchdog {
        return Ok(axis.set_watchdog(Some(after)).map(drop)?);
    }
    // The firmware may have none, although its profile does.
    if read_watchdog(axis)? == WatchdogState::None {
        return run_proof(axis, WatchdogState::None, witness);
    }
    // Read before it is changed, because it is put back at the end.
    let before = axis.watchdog_setting()?;
    check_cancelled(axis, witness)?;
    let proven = match axis.set_watchdog(Some(after)) {
        Ok(state) => run_proof(axis, state, witness),
        // It takes no such time: nothing was sent.
        Err(error) if error.exit() == Exit::Usage => return Err(error.into()),
        Err(error) => Err(error.into()),
    };
    let may_turn = proven.as_ref().is_err_and(|unproven| unproven.may_turn);
    witness.report_check(if may_turn {
        // It may be what stops a motor that was not seen to stand.
        let text = "its watchdog stays set: the standstill of the motor is not confirmed";
        CheckResult::suspicious(&axis.label(), text, "`polepair watchdog URL off`, or a time")
    } else {
        restore_watchdog(axis, before)
    });
    proven
}

/// Restores the watchdog's setting, if it is known.
fn restore_watchdog(axis: &LocalAxis, before: Option<Vec<(ParameterId, i64)>>) -> CheckResult {
    let about = axis.label();
    let Some(before) = before else {
        let text = "its watchdog stays set: the drive does not report its earlier setting";
        return CheckResult::suspicious(&about, text, "`polepair watchdog URL off`, or a time");
    };
    let memory = if before.iter().any(|(id, _)| is_stored_parameter(id, axis)) {
        ", in its permanent memory"
    } else {
        ""
    };
    let put = || axis.restore_settings(&before).and_then(|()| axis.watchdog());
    let put = match put() {
        // Who ends the proof has it put back, too.
        Err(Error::Interrupted { .. }) => put(),
        done => done,
    };
    match put {
        Ok(state) => {
            let state = axis.describe_watchdog(state);
            CheckResult::ok(&about, format!("its watchdog is restored{memory}: {state}"))
        }
        Err(error) => CheckResult::wrong(
            &about,
            error.exit(),
            format!("its watchdog could not be restored{memory}: {error}"),
            "`polepair watchdog URL` shows and sets it",
        ),
    }
}

fn is_stored_parameter(id: &ParameterId, axis: &LocalAxis) -> bool {
    let parameter = axis.parameter(*id);
    parameter.is_some_and(|found| found.persistence == Persistence::Always)
}

/// Observation of a motor whose host fell silent.
enum MotorObservation {
    /// The motor had not turned before.
    NeverTurned,
    StandingStill,
    StillTurning,
}

fn run_proof(
    axis: &LocalAxis,
    state: WatchdogState,
    witness: &mut dyn ProofObserver,
) -> Result<(), ProofError> {
    let about = axis.label();
    let after = match state {
        WatchdogState::On(after) if after <= WATCHDOG_MAX => after,
        other => {
            let text = format!("its watchdog is {other}: nothing was tested, and nothing moved");
            let remedy = match other {
                WatchdogState::None => "install an emergency stop that works without a computer",
                _ => "--prove-watchdog=500ms sets it first",
            };
            witness.report_check(CheckResult::wrong(&about, Exit::Negative, text, remedy));
            return Ok(());
        }
    };
    let beats = matches!(axis.profile().watchdog, Watchdog::Heartbeat { .. });
    if beats && !axis.connection().with_axes(|axes, _| axes.sends_keepalive()) {
        let output = "it watches a heartbeat, and this connection sends none: nothing was tested";
        let remedy = "add heartbeat=100 to the connection";
        witness.report_check(CheckResult::wrong(&about, Exit::Negative, output, remedy));
        return Ok(());
    }
    if !axis.provides_signal(Signal::Velocity)? {
        let output = "it does not report its speed: nothing was tested, and nothing moved";
        let remedy = "watch the shaft while the program ends";
        witness.report_check(CheckResult::wrong(&about, Exit::Negative, output, remedy));
        return Ok(());
    }
    let silence = after
        + clock::scale_timeout(BRAKING_MAX)
        + if beats { HEARTBEAT_LEASE } else { Duration::ZERO };
    check_cancelled(axis, witness)?;
    // The end of another caller's block must not stop the motor: that would pass for the watchdog's work.
    axis.arm_exclusively()?;
    let mut motor = ArmedMotor { axis, moved: false, released: false };
    let seen = motor.power_up().and_then(|()| motor.observe_silence(silence, witness));
    let moved = motor.moved;
    // Noted before the release, whose own stop would bring any motor to rest.
    let stands = matches!(seen, Ok(MotorObservation::StandingStill));
    let released = motor.release(stands, witness);
    let may_turn = moved && !(stands || released.at_standstill);
    let seen = match (seen, &released.result) {
        (Ok(seen), _) => seen,
        // The observer that ended it learns that the motor was not stopped.
        (Err(Error::Interrupted { .. }), Err(stop)) => {
            return unproven_error(stop.clone(), may_turn, moved);
        }
        (Err(error), _) => return unproven_error(error, may_turn, moved),
    };
    let seconds = silence.as_secs_f64();
    witness.report_check(match seen {
        MotorObservation::NeverTurned => {
            let output = "the motor did not turn: nothing was tested";
            CheckResult::wrong(&about, Exit::Negative, output, "`polepair spin` shows the reason")
        }
        MotorObservation::StandingStill => CheckResult::ok(
            &about,
            format!("its watchdog works: the motor was at standstill after {seconds} s of silence"),
        ),
        MotorObservation::StillTurning => CheckResult::wrong(
            &about,
            Exit::Negative,
            format!(
                "its watchdog did not stop it: the motor still turned after {seconds} s of \
             silence"
            ),
            "install an emergency stop that works without a computer; check whether this firmware \
             has a watchdog",
        ),
    });
    match released.result {
        // A drive that its watchdog has stopped may have a fault from it, which is no news.
        Err(error) if stands && !is_communication_error(&error) => Ok(()),
        Err(error) => unproven_error(error, may_turn, moved),
        Ok(()) => Ok(()),
    }
}

fn unproven_error(error: Error, may_turn: bool, moved: bool) -> Result<(), ProofError> {
    let may_turn = may_turn || !moved && error.may_turn();
    Err(ProofError { error: error.into(), moved, may_turn })
}

fn is_communication_error(error: &Error) -> bool {
    matches!(error.exit(), Exit::NoReply | Exit::Corrupt | Exit::Adapter)
}

/// Fails if the caller has cancelled.
fn check_cancelled(axis: &LocalAxis, witness: &dyn ProofObserver) -> Result<(), Error> {
    if witness.is_cancelled() {
        Err(Error::Interrupted { what: format!("{}: proving its watchdog", axis.label()) })
    } else {
        Ok(())
    }
}

/// Waits, unless the caller cancels.
fn sleep_unless_cancelled(
    axis: &LocalAxis,
    span: Duration,
    witness: &dyn ProofObserver,
) -> Result<(), Error> {
    let end = axis_now(axis) + span;
    loop {
        check_cancelled(axis, witness)?;
        let left = end.since(axis_now(axis));
        if left.is_zero() {
            return Ok(());
        }
        axis.sleep(left.min(POLL_INTERVAL));
    }
}

fn axis_now(axis: &LocalAxis) -> Instant {
    axis.connection().now()
}

/// Reads whether it turns.
fn poll_turning(axis: &LocalAxis) -> Result<bool, Error> {
    axis.signals(&[Signal::Velocity])?;
    Ok(axis.is_turning() == Some(true))
}

/// An armed motor. Whatever ends the proof stops it, a panic too.
struct ArmedMotor<'a> {
    axis: &'a LocalAxis,
    /// The start was sent, with or without a reply.
    moved: bool,
    released: bool,
}

/// Result of stopping a motor and switching it off.
struct ReleaseResult {
    result: Result<(), Error>,
    /// True if standstill was measured.
    at_standstill: bool,
}

impl ArmedMotor<'_> {
    fn power_up(&self) -> Result<(), Error> {
        match self.axis.profile().plan(Verb::Enable) {
            Some(_) => self.axis.enable(),
            None => Ok(()),
        }
    }

    /// Turns the motor, and reads its state after this time of silence.
    fn observe_silence(
        &mut self,
        silence: Duration,
        witness: &dyn ProofObserver,
    ) -> Result<MotorObservation, Error> {
        let axis = self.axis;
        check_cancelled(axis, witness)?;
        self.moved = true;
        axis.velocity(proving_speed(axis.profile().axis))?;
        let end = axis_now(axis) + clock::scale_timeout(SPIN_UP_MAX);
        while !poll_turning(axis)? {
            if axis_now(axis) >= end {
                return Ok(MotorObservation::NeverTurned);
            }
            sleep_unless_cancelled(axis, POLL_INTERVAL, witness)?;
        }
        // A watch begins with the first word, or heartbeat, behind its setting.
        let end = axis_now(axis) + HOST_ALIVE_TIME;
        while axis_now(axis) < end {
            poll_turning(axis)?;
            sleep_unless_cancelled(axis, POLL_INTERVAL, witness)?;
        }
        // Not a byte is sent here: any request would feed the watchdog.
        sleep_unless_cancelled(axis, silence, witness)?;
        poll_turning(axis)?;
        // Only a measured standstill counts; an unknown speed is not one.
        Ok(if axis.is_turning() == Some(false) {
            MotorObservation::StandingStill
        } else {
            MotorObservation::StillTurning
        })
    }

    /// Stops it, switches it off and disarms it.
    fn release(mut self, stands: bool, witness: &mut dyn ProofObserver) -> ReleaseResult {
        let turns = self.moved && !stands;
        self.stop_and_disarm(&mut |axis| witness.retry_stop(axis, turns))
    }

    fn stop_and_disarm(&mut self, again: &mut dyn FnMut(&LocalAxis) -> bool) -> ReleaseResult {
        self.released = true;
        let axis = self.axis;
        let one = std::slice::from_ref(axis);
        let options = StopOptions { power_off: true, ..StopOptions::default() };
        let stopped = stop_axes(one, options, STOP_RETRY_MAX, |axis, notice| match notice {
            StopNotice::Unconfirmed(_) => again(axis),
            StopNotice::QuickStop | StopNotice::Waiting => true,
        });
        axis.arm(false);
        let is_off = stopped.iter().all(|stop| stop.power_off == Some(Ok(())));
        // A drive whose watchdog tripped may refuse the stop and stand all the same.
        let coasted =
            || axis.signals(&[Signal::Velocity]).is_ok() && axis.is_turning() == Some(false);
        let stands = stopped.iter().all(|stop| stop.standstill.is_ok()) || is_off && coasted();
        let result = stopped.into_iter().try_for_each(StopResult::into_result);
        ReleaseResult { result, at_standstill: stands }
    }
}

impl Drop for ArmedMotor<'_> {
    fn drop(&mut self) {
        if !self.released {
            self.stop_and_disarm(&mut |_| true);
        }
    }
}
