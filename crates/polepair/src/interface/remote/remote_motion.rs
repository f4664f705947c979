//! A motion under the lease of this program: whether it still is, its state as the gateway sent it, its stop.

use crate::url::without_axes;
use std::time::Duration;

use polepair_client::message::AxisState;
use polepair_client::{GatewayError, Lease, PendingOperation};
use polepair_core::axis::{Command, Verb};
use polepair_core::profile::Signal;
use polepair_core::time::Instant;
use polepair_link::clock;

use super::RemoteAxis;
use super::convert::command_arguments;
use super::server::STOP_MAX;
use crate::error::{ARMING_HINT, Error};
use crate::interface::{FaultReport, MotionState};
use crate::url::{AxisNumber, shell_word};

/// Interval of reading the state that the gateway sends.
const POLL_INTERVAL: Duration = Duration::from_millis(25);
/// Longest silence of a drive while its motor is held in motion. A gateway sends the state of an axis every second,
/// also if nothing of it has changed.
const SILENT_MAX: Duration = Duration::from_millis(2500);
/// Time limit of a wait for values that were read after the request.
const FRESH_MAX: Duration = Duration::from_secs(1);
/// Silence of the gateway after which its drive states are outdated. It answers twice a second.
const GATEWAY_SILENT_MAX: Duration = Duration::from_millis(1500);
/// Time limit of a motor's standstill after its lease has ended.
const STANDSTILL_MAX: Duration = Duration::from_secs(3);

/// A stop that was started, if the axis has one.
pub type StartedStop = Option<Result<PendingOperation, GatewayError>>;

impl RemoteAxis {
    /// The state that the gateway has read since now, or its last one after a second.
    ///
    /// # Errors
    /// [`Error::Gateway`] if the gateway does not answer.
    pub fn fresh_state(&self) -> Result<AxisState, Error> {
        let started = clock::now();
        loop {
            let state = self.gateway().axis_state(self.info().id)?;
            let waited = clock::now().since(started);
            let has_all = state.signals.len() >= self.info().signals.len();
            if waited >= FRESH_MAX
                || has_all
                    && state.signals.iter().all(|read| read.age_ms <= waited.as_secs_f64() * 1e3)
            {
                return Ok(state);
            }
            clock::sleep_until(clock::now() + POLL_INTERVAL);
        }
    }

    /// The error for a drive from which its gateway has received nothing for 2.5 s: `E401`.
    #[must_use]
    pub fn silent_error(&self, state: &AxisState) -> Option<Error> {
        is_silent(state).then(|| {
            let seconds = newest_ms(state) / 1e3;
            let what = format!(
                "{} has not answered for {seconds:.1} s; the state of the motor is unknown",
                self.info().label
            );
            let hint =
                "check the supply, the wire and the adapter between the server and the drive";
            GatewayError::new("E401", what).hint(hint).into()
        })
    }

    /// Fails if this program no longer controls the axis that it armed.
    pub(super) fn check_lease(&self) -> Result<(), Error> {
        let Some(lease) = self.armed_lease() else {
            let what = format!("{}: the axis is not armed", self.info().label);
            return Err(GatewayError::new("E219", what).hint(ARMING_HINT).into());
        };
        if let Some(lost) = self.lost_link(&lease) {
            return Err(lost);
        }
        let Err(ended) = lease.check() else { return Ok(()) };
        // The gateway stops it then.
        let may_turn = !self.wait_standstill(&lease);
        Err(self.lost_link(&lease).unwrap_or_else(|| GatewayError { may_turn, ..ended }.into()))
    }

    /// State of the motion that the gateway has sent since then.
    pub(super) fn pushed_motion_state(&self, since: Instant) -> Result<MotionState, Error> {
        let Some(lease) = self.armed_lease() else { return Ok(MotionState::default()) };
        let Some(state) = lease.state() else { return Ok(MotionState::default()) };
        let held = clock::now().since(since);
        let is_current = lease.live().silence() < clock::scale_timeout(GATEWAY_SILENT_MAX);
        if is_current
            && held >= clock::scale_timeout(SILENT_MAX)
            && let Some(silent) = self.silent_error(&state)
        {
            return Err(silent.with_unseen_motor());
        }
        let newest = |signal: Signal| newest_value(&state, signal, held);
        let has_new_fault = newest(Signal::Fault).is_some();
        let faults = state.faults.iter().filter(|fault| has_new_fault && !fault.warning);
        Ok(MotionState {
            fault: faults.cloned().map(FaultReport::from).next(),
            enabled: newest(Signal::Enabled).map(|value| value != 0.0),
            velocity: newest(Signal::Velocity),
            position: newest(Signal::Position),
            limit: held_limit(&newest),
            emergency: None,
        })
    }

    /// Starts to stop the axis that this program armed, by its lease.
    pub(crate) fn begin_stop(&self) -> StartedStop {
        let lease = self.armed_lease()?;
        let start =
            |()| lease.start(Verb::Stop.name(), command_arguments(&Command::new(Verb::Stop)));
        self.has_verb(Verb::Stop).then(|| lease.check().and_then(start))
    }

    /// Waits for the standstill. One whose lease has ended was stopped by the gateway.
    pub(crate) fn finish_stop(&self, started: StartedStop) -> Result<(), Error> {
        let (Some(started), Some(lease)) = (started, self.armed_lease()) else { return Ok(()) };
        let stopped = match started.and_then(|mut stop| stop.wait(clock::scale_timeout(STOP_MAX))) {
            Ok(Some(())) => return Ok(()),
            Ok(None) => self.late_error("stop"),
            Err(error) => Error::from(error),
        };
        if let Some(lost) = self.lost_link(&lease) {
            return if lost.may_turn() { Err(lost) } else { Ok(()) };
        }
        let is_ended =
            lease.check().is_err() || ["gateway.lease", "gateway.busy"].contains(&stopped.code());
        if is_ended && self.wait_standstill(&lease) {
            Ok(())
        } else {
            Err(stopped.with_unseen_motor())
        }
    }

    /// Reason why the axis cannot be stopped from here: the gateway, or its link, is lost.
    fn lost_link(&self, lease: &Lease) -> Option<Error> {
        let lost = lease.live().check_link(self.info().id).err()?;
        let lost = GatewayError { executed: None, ..lost };
        if was_left_standing(lease) {
            let message = format!(
                "{}; the server stopped the axis before it ended: standstill is confirmed",
                lost.message
            );
            return Some(GatewayError { message, executed: Some(true), ..lost }.into());
        }
        // A simulated motor is gone with its gateway.
        let lost = GatewayError { may_turn: !self.info().simulated, ..lost };
        // The gateway opens a lost link again, and sends the stop then.
        Some(match lease.live().check() {
            Ok(()) => lost.into(),
            Err(_) => GatewayError { hint: self.direct_stop_hint(), ..lost }.into(),
        })
    }

    /// Hint for stopping the drive without its gateway.
    fn direct_stop_hint(&self) -> String {
        let (link, number) = (self.info().link, self.info().number);
        let link = self.bench().links.iter().find(|its| its.id == link && !its.simulated);
        link.map_or_else(String::new, |link| {
            let url = without_axes(&link.url);
            let url = format!("{url}#{}", AxisNumber(number));
            format!(
                "`polepair stop {}` stops it without the server, as soon as the server has \
                 released the port",
                shell_word(&url)
            )
        })
    }

    /// Waits until an axis whose lease has ended is at standstill by later readings, or another client has
    /// it. False if neither was seen.
    fn wait_standstill(&self, lease: &Lease) -> bool {
        let started = clock::now();
        loop {
            let waited = clock::now().since(started);
            let is_last =
                waited >= clock::scale_timeout(STANDSTILL_MAX) || lease.live().check().is_err();
            let is_over = lease.state().is_some_and(|state| {
                let stands = state.lease.is_none()
                    && state.pending_stop.is_none()
                    && state.moving != Some(true);
                let is_new = newest_ms(&state) < waited.as_secs_f64() * 1e3;
                let of_another = state.lease.is_some_and(|other| other.epoch > lease.epoch());
                of_another || stands && is_new
            });
            if is_over || is_last {
                return is_over || was_left_standing(lease);
            }
            clock::sleep_until(clock::now() + POLL_INTERVAL);
        }
    }
}

/// Returns whether the gateway reported, after this lease began, that the axis is at standstill and no client commands
/// it.
fn was_left_standing(lease: &Lease) -> bool {
    lease.has_current_state()
        && lease.state().is_some_and(|state| {
            state.lease.is_none() && state.pending_stop.is_none() && state.moving == Some(false)
        })
}

/// The name of the limit that holds the axis.
fn held_limit(newest: &impl Fn(Signal) -> Option<f64>) -> Option<String> {
    let holds = |signal: &Signal| newest(*signal).is_some_and(|value| value != 0.0);
    let ends = [Signal::PositiveLimit, Signal::NegativeLimit];
    match ends.iter().filter(|end| holds(end)).count() {
        2 => Some("limit".to_owned()),
        _ => ends.iter().find(|end| holds(end)).map(|end| end.name().to_owned()),
    }
}

/// Returns whether nothing of the state was read lately.
fn is_silent(state: &AxisState) -> bool {
    !state.signals.is_empty()
        && newest_ms(state) > clock::scale_timeout(SILENT_MAX).as_secs_f64() * 1e3
}

/// The age of the newest reading, ms.
fn newest_ms(state: &AxisState) -> f64 {
    state.signals.iter().map(|value| value.age_ms).fold(f64::MAX, f64::min)
}

/// The value of a signal that is no older than this.
fn newest_value(state: &AxisState, signal: Signal, age: Duration) -> Option<f64> {
    let read = state.signals.iter().find(|value| value.signal == signal.name())?;
    read.value.filter(|_| read.age_ms < age.as_secs_f64() * 1e3)
}

#[cfg(test)]
mod tests {
    use super::*;
    use polepair_client::message::SignalValue;

    #[test]
    fn a_reading_from_before_the_motion_does_not_end_it() {
        let read = |age_ms| SignalValue {
            signal: Signal::Fault.name().to_owned(),
            value: Some(4.0),
            unit: String::new(),
            age_ms,
        };
        let state = |age_ms| AxisState {
            id: 0,
            mode: None,
            enabled: Some(true),
            armed: true,
            moving: None,
            signals: vec![read(age_ms)],
            faults: Vec::new(),
            lease: None,
            pending_stop: None,
            panel: None,
        };
        let fault = |ms| newest_value(&state(80.0), Signal::Fault, Duration::from_millis(ms));
        assert_eq!((fault(50), fault(100)), (None, Some(4.0)));
        assert_eq!((is_silent(&state(2400.0)), is_silent(&state(2600.0))), (false, true));
    }
}
