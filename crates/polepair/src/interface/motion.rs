//! A motion that a program started: checking it while it is held, and stopping it.

use std::time::Duration;

use polepair_core::axis::{Command, Verb};
use polepair_core::judge::{SpeedJudge, SpeedVerdict};
use polepair_core::plan::Argument;
use polepair_core::profile::AxisKind;
use polepair_core::time::Instant;
use polepair_core::units::Unit;
use polepair_link::clock;

use super::{Axis, AxisRequest, MotionState};
use crate::axis::{
    PreparedCommand, STOP_RETRY_MAX, StopNotice, StopOptions, StopPersistence, StopResult,
    StopSupervisor, await_stops,
};
use crate::error::{Error, Exit};

/// Interval of a monitor's readings of the motion.
const READ_INTERVAL: Duration = Duration::from_millis(250);
/// A shorter motion may end before its speed was read twice.
const MEASURED_MIN: Duration = Duration::from_millis(500);
/// Time by which a monitor looks ahead on an axis with position limits: reading and stopping take time.
const LOOKAHEAD: Duration = Duration::from_millis(150);
/// The motor has turned once it was faster than this share of the commanded speed.
const TURNING_SHARE: f64 = 0.5;
/// The motor is at standstill if it is slower than this share of the commanded speed.
const STANDSTILL_SHARE: f64 = 0.02;
/// Longest standstill of a motor that has turned and goes on.
const STANDSTILL_MAX: Duration = Duration::from_secs(1);

/// Checks a motor that this program holds in motion: another client, an input, a fault or the drive itself may
/// have ended the motion.
///
/// ```
/// # use polepair_core::axis::{Command, Verb};
/// # if polepair_drives::profiles().iter().any(|p| p.protocol == "tmcl") {
/// use polepair::interface::MotionMonitor;
/// use std::time::Duration;
///
/// let link = polepair::connect("sim:tmcl?time=virtual")?;
/// let armed = link.axis(1)?.armed()?;
/// let command = Command { velocity: Some(6.0), ..Command::new(Verb::Velocity) };
/// armed.run(command)?;
/// let mut monitor = MotionMonitor::new(&armed, &command);
/// for _ in 0..40 {
///     monitor.check()?; // an error has the reason of its end
///     link.sleep(Duration::from_millis(25));
/// }
/// monitor.finish()?; // an error if the motor never turned
/// armed.release()?;
/// # }
/// # Ok::<(), polepair::Error>(())
/// ```
#[derive(Debug)]
pub struct MotionMonitor {
    axis: Axis,
    /// The commanded speed, rad/s or m/s; `None` if the command has none.
    velocity: Option<f64>,
    started: Instant,
    next_read: Instant,
    was_enabled: bool,
    has_turned: bool,
    stands_since: Option<Instant>,
    /// The verb turns the motor.
    is_velocity: bool,
    judge: SpeedJudge,
    last_velocity: Option<f64>,
    /// The limit that held the motor at the last reading.
    limit: Option<String>,
    /// The last emergency that the drive sent, which a note has.
    emergency: Option<(Instant, String)>,
    notes: Vec<String>,
}

impl MotionMonitor {
    /// A monitor of a command that was started just now.
    #[must_use]
    pub fn new(axis: &Axis, command: &Command) -> Self {
        let is_velocity = command.verb == Verb::Velocity && command.velocity != Some(0.0);
        let velocity = command.velocity.filter(|_| is_velocity && !command.raw);
        let is_linear = axis.facts().kind == AxisKind::Linear;
        Self {
            axis: axis.clone(),
            is_velocity,
            judge: SpeedJudge::new(velocity, is_linear),
            limit: None,
            emergency: None,
            notes: Vec::new(),
            last_velocity: None,
            velocity,
            started: axis.now(),
            next_read: axis.now(),
            was_enabled: false,
            has_turned: false,
            stands_since: None,
        }
    }

    /// Checks the motion. Call it every 25 ms; a drive on a wire of this program is read every 250 ms.
    ///
    /// # Errors
    /// [`Error::MotionEnded`]: `E801` for a fault of the drive, `E102` if the motor lost its power or stopped,
    /// `E105` if the axis is about to leave its position limits. [`Error::Gateway`] if a gateway has ended the
    /// lease or is lost. Others by source. The motor may turn on: stop it.
    pub fn check(&mut self) -> Result<(), Error> {
        self.axis.interface().check_control()?;
        if let Some(axis) = self.axis.local()
            && let Some(what) = axis.predict_limit_violation(LOOKAHEAD)?
        {
            let hint = "use a shorter time: --for; `polepair move` ends by itself";
            return Err(motion_ended("E105", what, "", hint));
        }
        let now = self.axis.now();
        if now < self.next_read {
            return Ok(());
        }
        self.next_read = now + READ_INTERVAL;
        let state = self.axis.interface().motion_state(self.started, self.is_velocity)?;
        self.judge(now, state)
    }

    /// Checks the measurements at the end of the motion. Returns a note on a set-point that
    /// was not reached.
    ///
    /// # Errors
    /// [`Error::MotionEnded`] `E106` for a motor that was never seen at half of its set-point, `E102` for one that
    /// has stopped before the end; the reason is in it, as far as the drive reports one. Others as
    /// [`check`](Self::check).
    pub fn finish(&mut self) -> Result<Option<String>, Error> {
        self.next_read = self.axis.now();
        self.check()?;
        // Two readings: one alone may be of a coarse speed.
        let now = self.axis.now();
        if self.stands_since.is_some_and(|since| now.since(since) >= READ_INTERVAL) {
            self.stopped_error()?;
        }
        let label = self.axis.label();
        let never = if self.is_velocity {
            !self.judge.has_come_near()
        } else {
            // A torque need not turn the motor, unless a limit holds it.
            self.limit.is_some() && !self.judge.has_turned()
        };
        if never && self.limit.is_none() && self.axis.now().since(self.started) < MEASURED_MIN {
            return Ok(Some(format!("{label}: the motion was too short to measure its speed")));
        }
        if never {
            let what = match self.velocity {
                Some(setpoint) => {
                    let far = match self.judge.verdict() {
                        SpeedVerdict::Slower(fastest) => {
                            format!("its greatest speed was {}", self.speed_text(fastest))
                        }
                        _ => "it did not turn".to_owned(),
                    };
                    format!("{label} never came near {}: {far}", self.speed_text(setpoint))
                }
                None => format!("{label} did not turn"),
            };
            let why = match &self.limit {
                Some(limit) => format!("The {limit} holds it."),
                None => self.emergency_or("The drive reports no reason."),
            };
            let hint = "look for a limit, a brake or a load; `polepair info URL` shows its state";
            return Err(motion_ended("E106", what, &why, hint));
        }
        match (self.judge.verdict(), self.velocity) {
            (SpeedVerdict::Slower(fastest), Some(setpoint)) => {
                let (fastest, setpoint) =
                    (self.speed_text(fastest), self.speed_text(setpoint.abs()));
                Ok(Some(format!("{label} reached {fastest} of {setpoint}")))
            }
            (SpeedVerdict::Unknown, _) if self.is_velocity => {
                Ok(Some(format!("{label} reports no speed: whether it turned is not known")))
            }
            _ => Ok(None),
        }
    }

    /// The speed at the last check that read the drive, rad/s or m/s. `None` before the first, or for a drive or a
    /// command without a speed.
    #[must_use]
    pub const fn last_velocity(&self) -> Option<f64> {
        self.last_velocity
    }

    /// Takes the notes on what happened without an end of the motion: an error that the drive reported by itself.
    pub fn take_notes(&mut self) -> Vec<String> {
        std::mem::take(&mut self.notes)
    }

    /// A speed in the unit of the drive, with the digits that matter.
    fn speed_text(&self, si: f64) -> String {
        let unit = self.axis.unit_of(Verb::Velocity, Argument::Velocity).unwrap_or(Unit::Rpm);
        let value = si / unit.si_factor();
        let shown =
            if value.abs() < 10.0 { (value * 100.0).round() / 100.0 } else { value.round() };
        format!("{shown} {}", unit.symbol())
    }

    fn judge(&mut self, now: Instant, state: MotionState) -> Result<(), Error> {
        let axis = self.axis.clone();
        let label = axis.label();
        self.judge.observe(state.velocity, state.position);
        self.last_velocity = state.velocity;
        self.limit.clone_from(&state.limit);
        if let Some(fault) = &state.fault {
            return Err(fault.to_error(label));
        }
        self.note_emergency(&state);
        self.was_enabled |= state.enabled == Some(true);
        if self.was_enabled && state.enabled == Some(false) {
            let why =
                self.emergency_or("Another program, an input or the drive itself switched it off.");
            return ended_error("has lost its power during the motion", &why, label);
        }
        let (Some(commanded), Some(actual)) = (self.velocity, state.velocity) else {
            return Ok(());
        };
        self.has_turned |= actual.abs() > commanded.abs() * TURNING_SHARE;
        let stands = self.has_turned && actual.abs() < commanded.abs() * STANDSTILL_SHARE;
        self.stands_since = stands.then(|| self.stands_since.unwrap_or(now));
        match self.stands_since {
            Some(since) if now.since(since) >= clock::scale_timeout(STANDSTILL_MAX) => {
                self.stopped_error()
            }
            _ => Ok(()),
        }
    }

    fn stopped_error(&self) -> Result<(), Error> {
        let why = self.emergency_or("Another program stopped it, or it is blocked.");
        ended_error("stopped during the motion", &why, self.axis.label())
    }

    /// Notes an emergency that did not end the motion, with the speed that shows it.
    fn note_emergency(&mut self, state: &MotionState) {
        let Some((at, emergency)) = &state.emergency else { return };
        if self.emergency.as_ref().is_some_and(|(noted, _)| noted == at) {
            return;
        }
        let goes_on = match state.velocity {
            Some(velocity) => format!("its speed is {}", self.speed_text(velocity)),
            None => "whether it turns is not known".to_owned(),
        };
        self.notes.push(format!("{} sent {emergency}; {goes_on}", self.axis.label()));
        self.emergency = Some((*at, emergency.clone()));
    }

    /// The reason that the drive gave by itself, else `otherwise`.
    fn emergency_or(&self, otherwise: &str) -> String {
        match &self.emergency {
            Some((_, emergency)) => format!("It sent {emergency}."),
            None => otherwise.to_owned(),
        }
    }
}

fn ended_error(what: &str, why: &str, label: &str) -> Result<(), Error> {
    let hint = "`polepair info URL` shows its state; check whether another master controls it";
    Err(motion_ended("E102", format!("{label} {what}"), why, hint))
}

fn motion_ended(code: &'static str, what: String, why: &str, hint: &str) -> Error {
    let (why, hint) = (why.to_owned(), hint.to_owned());
    Error::MotionEnded { code, what, why, hint, exit: Exit::Negative }
}

/// Starts a command on each axis, one directly after the other, and does not wait for their ends.
///
/// # Errors
/// [`Error`] by source. Those before it are started: stop them.
pub fn start_each(commands: &[(Axis, Command)]) -> Result<Vec<AxisRequest>, Error> {
    // Values are converted for all axes before the first is started.
    let prepared: Vec<Option<PreparedCommand>> = commands
        .iter()
        .map(|(axis, command)| axis.local().map(|axis| axis.prepare(*command)).transpose())
        .collect::<Result<_, _>>()?;
    commands
        .iter()
        .zip(&prepared)
        .map(|((axis, command), prepared)| match prepared {
            Some(prepared) => prepared.start().map(AxisRequest::from),
            None => axis.start(*command),
        })
        .collect()
}

/// End of a motion of this program.
#[derive(Debug)]
pub struct EndedMotion {
    /// True if the stop was confirmed.
    pub stopped: Result<(), Error>,
    /// True if the power was taken off; `None` if that was not requested, or the axis has no power switch.
    pub power_off: Option<Result<(), Error>>,
}

impl EndedMotion {
    /// The first error.
    ///
    /// # Errors
    /// The error of the stop, otherwise that of the power.
    pub fn into_result(self) -> Result<(), Error> {
        self.stopped.and(self.power_off.unwrap_or(Ok(())))
    }
}

/// Stops axes that this program armed, and takes the power of those whose flag is set: all stops are sent before
/// the first is waited for. A stop on a wire of this program is repeated for [`STOP_RETRY_MAX`] without a reply;
/// `on_notice` is called with the news of each, and ends the repetitions by `false`. A gateway repeats stops
/// itself.
///
/// An axis whose lease has ended was stopped by its gateway; its standstill is waited for.
#[must_use = "a motor whose stop failed may still turn"]
pub fn stop_each(
    axes: &[(Axis, bool)],
    mut on_notice: impl FnMut(&Axis, &StopNotice) -> bool,
) -> Vec<EndedMotion> {
    #[cfg(feature = "remote")]
    let mut started: Vec<_> = axes
        .iter()
        .map(|(axis, _)| axis.remote().map(crate::interface::remote::RemoteAxis::begin_stop))
        .collect();
    let stops = axes
        .iter()
        .filter_map(|(axis, power_off)| {
            let options = StopOptions { power_off: *power_off, ..StopOptions::default() };
            Some(StopSupervisor::begin(
                axis.local()?,
                options,
                StopPersistence::Within(STOP_RETRY_MAX),
            ))
        })
        .collect();
    let mut stopped =
        await_stops(stops, |axis, notice| on_notice(&Axis::from(axis.clone()), notice)).into_iter();
    axes.iter()
        .enumerate()
        .map(|(_index, (axis, _power_off))| {
            #[cfg(feature = "remote")]
            if let (Some(remote), Some(started)) = (axis.remote(), started[_index].take()) {
                let stopped = remote.finish_stop(started);
                // An axis that this program no longer controls is left to its gateway.
                let is_switched = *_power_off
                    && axis.has_verb(Verb::Disable)
                    && axis.interface().check_control().is_ok();
                return EndedMotion { stopped, power_off: is_switched.then(|| axis.disable()) };
            }
            let _ = axis;
            let stop = stopped.next();
            EndedMotion {
                stopped: stop.as_ref().map_or(Ok(()), StopResult::to_motion_end),
                power_off: stop.and_then(|stop| stop.power_off),
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A motor of a simulation.
    fn monitor() -> Option<MotionMonitor> {
        let has = polepair_drives::profiles().iter().any(|p| p.protocol == "tmcl");
        let link = has.then(|| crate::connect("sim:tmcl?time=virtual").expect("a simulation"))?;
        let command = Command { velocity: Some(10.0), ..Command::new(Verb::Velocity) };
        Some(MotionMonitor::new(&link.axis(1).expect("its axis"), &command))
    }

    #[test]
    fn a_motor_that_stops_or_loses_its_power_ends_the_motion() {
        let Some(mut monitor) = monitor() else { return };
        let at = |seconds: u32| Instant::ZERO.plus_ms(seconds * 1000);
        let turning = |si: f64| MotionState {
            velocity: Some(si),
            enabled: Some(true),
            ..MotionState::default()
        };
        assert_eq!(monitor.judge(at(0), turning(0.0)), Ok(()), "it has not turned yet");
        assert_eq!(monitor.judge(at(9), turning(9.0)), Ok(()));
        assert_eq!(monitor.judge(at(10), turning(0.1)), Ok(()));
        let error = monitor.judge(at(60), turning(0.1)).unwrap_err();
        assert_eq!((error.code(), error.exit()), ("E102", Exit::Negative));
        assert!(error.to_string().contains("stopped during the motion"), "{error}");
        let off = MotionState { enabled: Some(false), ..MotionState::default() };
        let error = monitor.judge(at(61), off).unwrap_err();
        assert!(error.to_string().contains("has lost its power"), "{error}");
    }
}
